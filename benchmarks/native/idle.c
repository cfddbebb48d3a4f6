/* An FMU that does nothing: its instance holds the values that a host sets and reads. */
#include "fmi2Functions.h"

#include <stdlib.h>

#define VALUES 256

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String location,
                              const fmi2CallbackFunctions *functions, fmi2Boolean visible, fmi2Boolean logging) {
    (void)name, (void)type, (void)guid, (void)location, (void)functions, (void)visible, (void)logging;
    return calloc(VALUES, sizeof(fmi2Real));
}
void fmi2FreeInstance(fmi2Component c) { free(c); }
fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean has_tolerance, fmi2Real tolerance, fmi2Real start,
                               fmi2Boolean has_stop, fmi2Real stop) {
    (void)c, (void)has_tolerance, (void)tolerance, (void)start, (void)has_stop, (void)stop;
    return fmi2OK;
}
fmi2Status fmi2EnterInitializationMode(fmi2Component c) { return (void)c, fmi2OK; }
fmi2Status fmi2ExitInitializationMode(fmi2Component c) { return (void)c, fmi2OK; }
fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference at[], size_t count, const fmi2Real values[]) {
    for (size_t i = 0; i < count; i++) ((fmi2Real *)c)[at[i] % VALUES] = values[i];
    return fmi2OK;
}
fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference at[], size_t count, fmi2Real values[]) {
    for (size_t i = 0; i < count; i++) values[i] = ((fmi2Real *)c)[at[i] % VALUES];
    return fmi2OK;
}
fmi2Status fmi2DoStep(fmi2Component c, fmi2Real time, fmi2Real step, fmi2Boolean no_set_state_before) {
    (void)c, (void)time, (void)step, (void)no_set_state_before;
    return fmi2OK;
}
