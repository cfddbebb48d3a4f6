/* The tuning that an instance has found last, for the others of this FMU with the same parameters: it takes most of an
 * instance's start. Without atomic types, or global data, every instance finds its own. */
#include "fmu.h"
#include "translated.h"

#include <stdlib.h>

#if !defined NDOB_NO_HANDLES && defined __STDC_VERSION__ && __STDC_VERSION__ >= 201112L && !defined __STDC_NO_ATOMICS__
#include <stdatomic.h>

/* No call between enter_latest and leave_latest takes memory of a block that may be too small. */
static atomic_flag latest_is_busy = ATOMIC_FLAG_INIT;
static struct {
    size_t users; /* instances */
    bool some;
    double H;
    double *parameters;
    Tuned tuned;
    nd_arena memory;
} latest;

static void enter_latest(void) {
    while (atomic_flag_test_and_set_explicit(&latest_is_busy, memory_order_acquire)) {}
}

static void leave_latest(void) { atomic_flag_clear_explicit(&latest_is_busy, memory_order_release); }

/* Take memory for what is shared, with the first instance. */
static void use_latest(const Sampled *self) {
    size_t bytes = self->of_tuned.memory.size;
    enter_latest();
    if (latest.users++ == 0) {
        latest.some = false;
        latest.parameters = malloc((fmu.parameter_count + 1) * sizeof(double));
        void *block = malloc(bytes);
        nd_start(&latest.memory, block, block ? bytes : 0);
    }
    leave_latest();
}

/* Release it with the last one. */
static void stop_using_latest(void) {
    enter_latest();
    if (--latest.users == 0) {
        free(latest.parameters);
        free(latest.memory.base);
    }
    leave_latest();
}

static bool is_latest(const Sampled *self, double H) {
    if (!latest.some || latest.H != H || latest.memory.used > self->of_tuned.memory.size) return false;
    for (uint32_t i = 0; i < fmu.parameter_count; i++)
        if (memcmp(&latest.parameters[i], &self->values[fmu.parameters[i]], sizeof(double)) != 0) return false;
    return true;
}

static bool recall_latest(Sampled *self, double H, nd none) {
    enter_latest();
    bool found = is_latest(self, H);
    if (found) {
        nd_arena *memory = keep(&self->of_tuned, H, H, none);
        self->tuned = copied_Tuned(memory, latest.tuned);
        self->tuned.model.equations = self->prepared.equations;
        self->tuned.model.parameters = self->prepared.parameters;
        self->tuned.model.settings = self->prepared.settings;
        self->of_tuned.some = true;
    }
    leave_latest();
    return found;
}

/* The copy takes as much memory as what is copied. */
static void publish_latest(const Sampled *self, double H) {
    size_t bytes = self->of_tuned.memory.used;
    enter_latest();
    latest.some = latest.parameters && bytes <= latest.memory.size;
    if (latest.some) {
        for (uint32_t i = 0; i < fmu.parameter_count; i++) latest.parameters[i] = self->values[fmu.parameters[i]];
        latest.H = H;
        latest.memory.used = 0;
        latest.tuned = copied_Tuned(&latest.memory, self->tuned);
        latest.memory.used = bytes;
    }
    leave_latest();
}

#define SHARES_TUNING 1
#else
#define SHARES_TUNING 0
#endif
