/* FMI 2.0 for co-simulation: its functions over the instance. */
#include "shell.h"

#include "fmi2Functions.h"

#include <stdlib.h>
#include <string.h>

/* A host takes the text as a printf format, or does not: with doubled percent signs it reads well either way. */
static void send_message(Function *logger, void *environment, const char *name, Status status, const char *category,
                         const char *message) {
    char format[2 * MESSAGE_SIZE];
    size_t used = 0;
    for (const char *from = message; *from; from++) {
        format[used++] = *from;
        if (*from == '%') format[used++] = '%';
    }
    format[used] = '\0';
    ((fmi2CallbackLogger)logger)(environment, name, (fmi2Status)status, category, format);
}

char accessed_as(char type) { return type == 'E' ? 'I' : type; }

const char *type_name(char type) {
    return type == 'R' ? "Real" : type == 'I' ? "Integer" : type == 'B' ? "Boolean" : "String";
}

#define ENTER(function) \
    Environment host; \
    Instance *self = enter(component, #function, MODES_OF_##function, &host); \
    if (!self) return fmi2Error
#define LEAVE(good) return (fmi2Status)leave(self, (good) ? OK : ERROR, host)

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }

const char *fmi2GetVersion(void) { return "2.0"; }

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String location,
                              const fmi2CallbackFunctions *functions, fmi2Boolean visible, fmi2Boolean logging) {
    (void)location, (void)visible;
    if (!functions) return NULL;
    bool named = name && *name && is_utf8(name);
    Log log = {send_message, (Function *)functions->logger, functions->componentEnvironment, named ? name : "unnamed",
               logging != fmi2False, ALL_CATEGORIES, OK};
    char own[TOKEN_SIZE];
    own_token(own);
    Instance nobody; /* who can only log */
    nobody.log = log;
    const char *function = "fmi2Instantiate";
    if (!named) {
        say_error(&nobody, "fmi2Instantiate: instanceName", "a name in UTF-8",
                  name ? (*name ? "other bytes" : "an empty string") : "NULL");
    } else if (type != fmi2CoSimulation) {
        say_error(&nobody, function, "fmi2CoSimulation",
                  type == fmi2ModelExchange ? "fmi2ModelExchange" : "an unknown type");
    } else if (!guid || strcmp(guid, own) != 0) {
        say(&nobody, ERROR, "fmi2Instantiate: fmuGUID", own, guid ? guid : "NULL",
            "a modelDescription.xml of another build");
    } else {
        void *block = calloc(1, instance_size(name));
        Instance *self = block ? instance_in(block, name, log) : NULL;
        if (self) return self->handle;
        if (!block) say_error(&nobody, function, "memory for an instance", "none");
        free(block);
    }
    return NULL;
}

void fmi2FreeInstance(fmi2Component component) {
    Environment host;
    Instance *self = enter(component, "fmi2FreeInstance", MODES_OF_fmi2FreeInstance, &host);
    if (!self) return;
    instance_free(self);
    free(self);
    environment_leave(host);
}

fmi2Status fmi2SetDebugLogging(fmi2Component component, fmi2Boolean on, size_t count, const fmi2String names[]) {
    ENTER(fmi2SetDebugLogging);
    LEAVE(set_logging(self, "fmi2SetDebugLogging", on != fmi2False, count, names));
}

fmi2Status fmi2SetupExperiment(fmi2Component component, fmi2Boolean has_tolerance, fmi2Real tolerated, fmi2Real start,
                               fmi2Boolean has_stop, fmi2Real stop) {
    (void)has_tolerance, (void)tolerated;
    ENTER(fmi2SetupExperiment);
    LEAVE(set_up(self, "fmi2SetupExperiment", start, has_stop != fmi2False, stop));
}

fmi2Status fmi2EnterInitializationMode(fmi2Component component) {
    ENTER(fmi2EnterInitializationMode);
    LEAVE(enter_initialization(self, "fmi2EnterInitializationMode"));
}

fmi2Status fmi2ExitInitializationMode(fmi2Component component) {
    ENTER(fmi2ExitInitializationMode);
    LEAVE(exit_initialization(self));
}

fmi2Status fmi2Terminate(fmi2Component component) {
    ENTER(fmi2Terminate);
    self->progress.mode = TERMINATED;
    LEAVE(true);
}

fmi2Status fmi2Reset(fmi2Component component) {
    ENTER(fmi2Reset);
    reset(self);
    LEAVE(true);
}

fmi2Status fmi2DoStep(fmi2Component component, fmi2Real time, fmi2Real step, fmi2Boolean no_set_state_before) {
    (void)no_set_state_before;
    ENTER(fmi2DoStep);
    return (fmi2Status)leave(self, do_step(self, time, step), host);
}

/* -- values */

#define ACCESS(Name, TYPE, READ, WRITTEN) \
    fmi2Status fmi2Get##Name(fmi2Component component, const fmi2ValueReference references[], size_t count, \
                             fmi2##Name values[]) { \
        ENTER(fmi2Get##Name); \
        bool good = !count || readable(self, "fmi2Get" #Name, references, count, values, TYPE); \
        if (good && count && self->progress.stale) good = refreshed(self, ERROR); \
        for (size_t i = 0; good && i < count; i++) values[i] = READ; \
        LEAVE(good); \
    } \
    fmi2Status fmi2Set##Name(fmi2Component component, const fmi2ValueReference references[], size_t count, \
                             const fmi2##Name values[]) { \
        ENTER(fmi2Set##Name); \
        bool good = !count || settable(self, "fmi2Set" #Name, references, count, values, TYPE); \
        bool all = good; \
        for (size_t i = 0; good && i < count; i++) set_number(self, references[i], WRITTEN, &all); \
        LEAVE(all); \
    }
ACCESS(Real, 'R', self->values[references[i]], values[i])
ACCESS(Integer, 'I', (fmi2Integer)self->values[references[i]], (double)values[i])
ACCESS(Boolean, 'B', self->values[references[i]] != 0.0 ? fmi2True : fmi2False, values[i] != fmi2False ? 1.0 : 0.0)

fmi2Status fmi2GetString(fmi2Component component, const fmi2ValueReference references[], size_t count,
                         fmi2String values[]) {
    ENTER(fmi2GetString);
    bool good = !count || readable(self, "fmi2GetString", references, count, values, 'S');
    for (size_t i = 0; good && i < count; i++) values[i] = self->texts[text_place(references[i])];
    LEAVE(good);
}

fmi2Status fmi2SetString(fmi2Component component, const fmi2ValueReference references[], size_t count,
                         const fmi2String values[]) {
    ENTER(fmi2SetString);
    bool good = !count
                || (settable(self, "fmi2SetString", references, count, values, 'S')
                    && texts_good(self, "fmi2SetString", references, count, values));
    for (size_t i = 0; good && i < count; i++) set_text(self, references[i], values[i]);
    LEAVE(good);
}

/* -- states */

fmi2Status fmi2GetFMUstate(fmi2Component component, fmi2FMUstate *handle) {
    ENTER(fmi2GetFMUstate);
    LEAVE(state_get(self, "fmi2GetFMUstate", handle));
}

fmi2Status fmi2SetFMUstate(fmi2Component component, fmi2FMUstate handle) {
    ENTER(fmi2SetFMUstate);
    LEAVE(state_set(self, "fmi2SetFMUstate", handle));
}

fmi2Status fmi2FreeFMUstate(fmi2Component component, fmi2FMUstate *handle) {
    ENTER(fmi2FreeFMUstate);
    LEAVE(state_free(self, "fmi2FreeFMUstate", handle));
}

fmi2Status fmi2SerializedFMUstateSize(fmi2Component component, fmi2FMUstate handle, size_t *size) {
    ENTER(fmi2SerializedFMUstateSize);
    LEAVE(state_size(self, "fmi2SerializedFMUstateSize", handle, size));
}

fmi2Status fmi2SerializeFMUstate(fmi2Component component, fmi2FMUstate handle, fmi2Byte bytes[], size_t size) {
    ENTER(fmi2SerializeFMUstate);
    LEAVE(state_write(self, "fmi2SerializeFMUstate", handle, (unsigned char *)bytes, size));
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component component, const fmi2Byte bytes[], size_t size, fmi2FMUstate *handle) {
    ENTER(fmi2DeSerializeFMUstate);
    LEAVE(state_read(self, "fmi2DeSerializeFMUstate", (const unsigned char *)bytes, size, handle));
}

/* -- what can be asked about steps, and functions that these FMUs say they do not have */

static fmi2Status unsupported(fmi2Component component, const char *function) {
    Environment host;
    Instance *self = enter(component, function, ANY_MODE, &host);
    if (!self) return fmi2Error;
    say_error(self, function, "none but the functions that the model description declares", "this one");
    LEAVE(false);
}

fmi2Status fmi2GetRealStatus(fmi2Component component, const fmi2StatusKind kind, fmi2Real *value) {
    if (kind != fmi2LastSuccessfulTime) return unsupported(component, "fmi2GetRealStatus");
    ENTER(fmi2GetRealStatus);
    if (value) *value = self->progress.last_time;
    else say_error(self, "fmi2GetRealStatus", "a place for the value", "NULL");
    LEAVE(value != NULL);
}

fmi2Status fmi2GetBooleanStatus(fmi2Component component, const fmi2StatusKind kind, fmi2Boolean *value) {
    if (kind != fmi2Terminated) return unsupported(component, "fmi2GetBooleanStatus");
    ENTER(fmi2GetBooleanStatus);
    if (value) *value = fmi2False; /* none of these FMUs ends a simulation by itself */
    else say_error(self, "fmi2GetBooleanStatus", "a place for the value", "NULL");
    LEAVE(value != NULL);
}

fmi2Status fmi2GetStatus(fmi2Component component, const fmi2StatusKind kind, fmi2Status *value) {
    return (void)kind, (void)value, unsupported(component, "fmi2GetStatus");
}
fmi2Status fmi2GetIntegerStatus(fmi2Component component, const fmi2StatusKind kind, fmi2Integer *value) {
    return (void)kind, (void)value, unsupported(component, "fmi2GetIntegerStatus");
}
fmi2Status fmi2GetStringStatus(fmi2Component component, const fmi2StatusKind kind, fmi2String *value) {
    return (void)kind, (void)value, unsupported(component, "fmi2GetStringStatus");
}
fmi2Status fmi2CancelStep(fmi2Component component) { return unsupported(component, "fmi2CancelStep"); }
fmi2Status fmi2SetRealInputDerivatives(fmi2Component component, const fmi2ValueReference references[], size_t count,
                                       const fmi2Integer order[], const fmi2Real values[]) {
    return (void)references, (void)count, (void)order, (void)values,
           unsupported(component, "fmi2SetRealInputDerivatives");
}
fmi2Status fmi2GetRealOutputDerivatives(fmi2Component component, const fmi2ValueReference references[], size_t count,
                                        const fmi2Integer order[], fmi2Real values[]) {
    return (void)references, (void)count, (void)order, (void)values,
           unsupported(component, "fmi2GetRealOutputDerivatives");
}
fmi2Status fmi2GetDirectionalDerivative(fmi2Component component, const fmi2ValueReference unknowns[],
                                        size_t unknown_count, const fmi2ValueReference knowns[], size_t known_count,
                                        const fmi2Real known[], fmi2Real unknown[]) {
    return (void)unknowns, (void)unknown_count, (void)knowns, (void)known_count, (void)known, (void)unknown,
           unsupported(component, "fmi2GetDirectionalDerivative");
}
