/* Many steps of a component in one call, and what it is tuned to: for a log, which `ndob-fmu estimate` has whole. These are
 * no functions of FMI, and take the steps as they are, without FMI's rules for their times. */
#include "shell.h"

#include "fmi2Functions.h"

#include <stdint.h>
#include <string.h>

typedef struct {
    size_t count;               /* of the steps */
    const double *lengths;      /* of each step (s) */
    size_t input_count;
    const double *inputs;       /* of each step */
    size_t given_count;
    const uint32_t *given_at;   /* places among the numbers of the component's state, */
    const double *given;        /* and what is put there first */
    size_t read_count;
    const uint32_t *read_at;    /* places whose numbers are read after each step */
    double *found;              /* for each step: all outputs, then these numbers */
} ndobSteps;

static bool has_places(const Instance *self, const uint32_t places[], size_t count) {
    for (size_t i = 0; i < count; i++)
        if (places[i] >= self->state_size / sizeof(double)) return false;
    return true;
}

/* Take the steps and return how many were taken: fewer where one is refused. */
FMI2_Export size_t fmi2FullName(ndobManySteps)(fmi2Component component, const ndobSteps *steps);

size_t fmi2FullName(ndobManySteps)(fmi2Component component, const ndobSteps *steps) {
    Environment host;
    Instance *self = enter(component, "ndobManySteps", MODES_OF_fmi2DoStep, &host);
    if (!self) return 0;
    size_t k = 0, count = steps->count;
    double *numbers = self->state, *found = steps->found;
    if (!has_places(self, steps->given_at, steps->given_count) || !has_places(self, steps->read_at, steps->read_count))
        count = 0;
    Call call = call_of(self);
    for (size_t i = 0; count && i < steps->given_count; i++) numbers[steps->given_at[i]] = steps->given[i];
    for (; k < count; k++) {
        memcpy(self->values, steps->inputs + k * steps->input_count, steps->input_count * sizeof(double));
        if (!fmu.step(&call, self->progress.clock.now, steps->lengths[k])) break;
        self->progress.clock.now += steps->lengths[k];
        memcpy(found, self->outputs, fmu.output_count * sizeof(double));
        found += fmu.output_count;
        for (size_t i = 0; i < steps->read_count; i++) *found++ = numbers[steps->read_at[i]];
    }
    (void)leave(self, OK, host);
    return k;
}

/* Write the numbers of the component's tuning and return how many there are; 0 where there is none, or too little room. */
FMI2_Export size_t fmi2FullName(ndobTuning)(fmi2Component component, double numbers[], size_t room);

size_t fmi2FullName(ndobTuning)(fmi2Component component, double numbers[], size_t room) {
    Environment host;
    Instance *self = enter(component, "ndobTuning", MODES_OF_fmi2DoStep, &host);
    if (!self) return 0;
    Call call = call_of(self);
    size_t count = fmu.tuning(&call, numbers, room);
    (void)leave(self, OK, host);
    return count;
}
