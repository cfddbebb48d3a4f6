/* Steps, what can be asked about them, and the functions that these FMUs say they do not have. */
#include "core.h"

fmi2Status fmi2DoStep(fmi2Component component, fmi2Real time, fmi2Real step, fmi2Boolean no_set_state_before) {
    Instance *self = ENTER(fmi2DoStep);
    if (!self) return fmi2Error;
    fmi2Status status = judged(self, core.DoStep(self->core, time, step, no_set_state_before));
    if (status < fmi2Discard) self->progress.last_time = time + step;
    return leave(self, status);
}

static fmi2Status unsupported(fmi2Component component, const char *function) {
    Instance *self = enter(component, function, ANY_MODE);
    if (!self) return fmi2Error;
    log_line(&self->log, fmi2Error,
             "%s: expected none but the functions that the model description declares; this FMU has not this one",
             function);
    return leave(self, fmi2Error);
}

fmi2Status fmi2GetRealStatus(fmi2Component component, const fmi2StatusKind kind, fmi2Real *value) {
    if (kind != fmi2LastSuccessfulTime) return unsupported(component, __func__);
    Instance *self = ENTER(fmi2GetRealStatus);
    if (!self) return fmi2Error;
    if (!value) {
        log_line(&self->log, fmi2Error, "%s: expected a place for the value, received NULL", __func__);
        return leave(self, fmi2Error);
    }
    *value = self->progress.last_time;
    return leave(self, fmi2OK);
}

fmi2Status fmi2GetBooleanStatus(fmi2Component component, const fmi2StatusKind kind, fmi2Boolean *value) {
    if (kind != fmi2Terminated) return unsupported(component, __func__);
    Instance *self = ENTER(fmi2GetBooleanStatus);
    if (!self) return fmi2Error;
    if (!value) {
        log_line(&self->log, fmi2Error, "%s: expected a place for the value, received NULL", __func__);
        return leave(self, fmi2Error);
    }
    *value = fmi2False; /* none of these FMUs ends a simulation by itself */
    return leave(self, fmi2OK);
}

#define UNUSED __attribute__((unused))
#define REFERENCES UNUSED const fmi2ValueReference

fmi2Status fmi2GetStatus(fmi2Component component, UNUSED const fmi2StatusKind kind, UNUSED fmi2Status *value) {
    return unsupported(component, __func__);
}
fmi2Status fmi2GetIntegerStatus(fmi2Component component, UNUSED const fmi2StatusKind kind, UNUSED fmi2Integer *value) {
    return unsupported(component, __func__);
}
fmi2Status fmi2GetStringStatus(fmi2Component component, UNUSED const fmi2StatusKind kind, UNUSED fmi2String *value) {
    return unsupported(component, __func__);
}
fmi2Status fmi2CancelStep(fmi2Component component) { return unsupported(component, __func__); }
fmi2Status fmi2SetRealInputDerivatives(fmi2Component component, REFERENCES references[], UNUSED size_t count,
                                       UNUSED const fmi2Integer order[], UNUSED const fmi2Real values[]) {
    return unsupported(component, __func__);
}
fmi2Status fmi2GetRealOutputDerivatives(fmi2Component component, REFERENCES references[], UNUSED size_t count,
                                        UNUSED const fmi2Integer order[], UNUSED fmi2Real values[]) {
    return unsupported(component, __func__);
}
fmi2Status fmi2GetDirectionalDerivative(fmi2Component component, REFERENCES unknowns[], UNUSED size_t unknown_count,
                                        REFERENCES knowns[], UNUSED size_t known_count, UNUSED const fmi2Real known[],
                                        UNUSED fmi2Real unknown[]) {
    return unsupported(component, __func__);
}
