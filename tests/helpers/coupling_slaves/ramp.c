/* x' = u from 0; says which tolerance it was given; from `ends_at` on it does what `how` says, in the middle of a step too. */
#include <math.h>
#include <stdlib.h>

#include "fmi2Functions.h"

#define UNUSED __attribute__((unused))

enum { X, TOLERANCE, U, ENDS_AT, REALS };
enum { RUN, END, END_WITHOUT_TIME, DISCARD, FAIL, WITHHOLD, END_TOO_LATE, END_AT_NAN, SILENT };

typedef struct {
    const fmi2CallbackFunctions *callbacks;
    fmi2Real real[REALS];
    fmi2Integer how;
    fmi2Real time;
    fmi2Boolean ended;
} Ramp;

const char *fmi2GetTypesPlatform(void) { return "default"; }
const char *fmi2GetVersion(void) { return "2.0"; }
fmi2Status fmi2SetDebugLogging(UNUSED fmi2Component c, UNUSED fmi2Boolean on, UNUSED size_t n,
                               UNUSED const fmi2String categories[]) {
    return fmi2OK;
}

fmi2Status fmi2Reset(fmi2Component c) {
    Ramp *self = c;
    *self = (Ramp){.callbacks = self->callbacks, .real = {0.0, -1.0, 1.0, INFINITY}};
    return fmi2OK;
}

fmi2Component fmi2Instantiate(UNUSED fmi2String name, UNUSED fmi2Type type, UNUSED fmi2String guid,
                              UNUSED fmi2String resources, const fmi2CallbackFunctions *callbacks,
                              UNUSED fmi2Boolean visible, UNUSED fmi2Boolean logging) {
    Ramp *self = calloc(1, sizeof *self);
    self->callbacks = callbacks;
    fmi2Reset(self);
    return self;
}
void fmi2FreeInstance(fmi2Component c) { free(c); }

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean defined, fmi2Real tolerance, fmi2Real start,
                               UNUSED fmi2Boolean stop_defined, UNUSED fmi2Real stop) {
    Ramp *self = c;
    if (defined) self->real[TOLERANCE] = tolerance;
    self->time = start;
    return fmi2OK;
}
fmi2Status fmi2EnterInitializationMode(UNUSED fmi2Component c) { return fmi2OK; }
fmi2Status fmi2ExitInitializationMode(UNUSED fmi2Component c) { return fmi2OK; }
fmi2Status fmi2Terminate(UNUSED fmi2Component c) { return fmi2OK; }

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real time, fmi2Real step, UNUSED fmi2Boolean no_set_state_before) {
    Ramp *self = c;
    if (self->ended) return fmi2Error; /* a step after the end */
    fmi2Real until = fmin(time + step, self->how == RUN ? INFINITY : self->real[ENDS_AT]);
    self->real[X] += (until - time) * self->real[U];
    self->time = until;
    if (self->how == RUN || time + step < self->real[ENDS_AT]) return fmi2OK;
    const fmi2CallbackFunctions *to = self->callbacks;
    to->logger(to->componentEnvironment, "ramp", fmi2Discard, "", "the %s is reached", "top");
    if (self->how == FAIL) return fmi2Error;
    self->ended = self->how != DISCARD;
    return fmi2Discard;
}

fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *value) {
    Ramp *self = c;
    if (kind != fmi2Terminated || self->how == SILENT) {
        const fmi2CallbackFunctions *to = self->callbacks;
        to->logger(to->componentEnvironment, "ramp", fmi2Discard, "", "no such status");
        return fmi2Discard;
    }
    *value = self->ended;
    return fmi2OK;
}
fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Real *value) {
    const Ramp *self = c;
    if (kind != fmi2LastSuccessfulTime || self->how == END_WITHOUT_TIME) {
        const fmi2CallbackFunctions *to = self->callbacks;
        to->logger(to->componentEnvironment, "ramp", fmi2Discard, "", "no such time");
        return fmi2Discard;
    }
    *value = self->how == END_TOO_LATE ? 1e9 : self->how == END_AT_NAN ? NAN : self->time;
    return fmi2OK;
}

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference references[], size_t n, fmi2Real values[]) {
    const Ramp *self = c;
    if (self->ended && self->how == WITHHOLD) return fmi2Error;
    for (size_t k = 0; k < n; k++) values[k] = self->real[references[k]];
    return fmi2OK;
}
fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference references[], size_t n, const fmi2Real values[]) {
    for (size_t k = 0; k < n; k++) ((Ramp *)c)->real[references[k]] = values[k];
    return fmi2OK;
}
fmi2Status fmi2SetInteger(fmi2Component c, UNUSED const fmi2ValueReference references[], UNUSED size_t n,
                          const fmi2Integer values[]) {
    ((Ramp *)c)->how = values[0];
    return fmi2OK;
}

#define REFERENCES UNUSED const fmi2ValueReference references[], UNUSED size_t n
#define ABSENT(name, ...) \
    fmi2Status name(UNUSED fmi2Component c, __VA_ARGS__) { return fmi2Error; }
ABSENT(fmi2GetInteger, REFERENCES, UNUSED fmi2Integer values[])
ABSENT(fmi2GetBoolean, REFERENCES, UNUSED fmi2Boolean values[])
ABSENT(fmi2GetString, REFERENCES, UNUSED fmi2String values[])
ABSENT(fmi2SetBoolean, REFERENCES, UNUSED const fmi2Boolean values[])
ABSENT(fmi2SetString, REFERENCES, UNUSED const fmi2String values[])
ABSENT(fmi2GetFMUstate, UNUSED fmi2FMUstate *state)
ABSENT(fmi2SetFMUstate, UNUSED fmi2FMUstate state)
ABSENT(fmi2FreeFMUstate, UNUSED fmi2FMUstate *state)
ABSENT(fmi2SerializedFMUstateSize, UNUSED fmi2FMUstate state, UNUSED size_t *size)
ABSENT(fmi2SerializeFMUstate, UNUSED fmi2FMUstate state, UNUSED fmi2Byte bytes[], UNUSED size_t size)
ABSENT(fmi2DeSerializeFMUstate, UNUSED const fmi2Byte bytes[], UNUSED size_t size, UNUSED fmi2FMUstate *state)
ABSENT(fmi2GetDirectionalDerivative, REFERENCES, UNUSED const fmi2ValueReference known[], UNUSED size_t m,
       UNUSED const fmi2Real seed[], UNUSED fmi2Real values[])
ABSENT(fmi2SetRealInputDerivatives, REFERENCES, UNUSED const fmi2Integer order[], UNUSED const fmi2Real values[])
ABSENT(fmi2GetRealOutputDerivatives, REFERENCES, UNUSED const fmi2Integer order[], UNUSED fmi2Real values[])
ABSENT(fmi2GetStatus, UNUSED const fmi2StatusKind kind, UNUSED fmi2Status *value)
ABSENT(fmi2GetIntegerStatus, UNUSED const fmi2StatusKind kind, UNUSED fmi2Integer *value)
ABSENT(fmi2GetStringStatus, UNUSED const fmi2StatusKind kind, UNUSED fmi2String *value)
fmi2Status fmi2CancelStep(UNUSED fmi2Component c) { return fmi2Error; }
