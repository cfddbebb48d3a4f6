/* FMI 3.0 for co-simulation: its functions over the instance. The build adds those that these FMUs do not have. */
#include "shell.h"

#include "fmi3Functions.h"

#include <stdlib.h>
#include <string.h>

static void send_message(Function *logger, void *environment, const char *name, Status status, const char *category,
                         const char *message) {
    (void)name;
    ((fmi3LogMessageCallback)logger)(environment, (fmi3Status)status, category, message);
}

char accessed_as(char type) { return type == 'E' ? 'L' : type; }

const char *type_name(char type) {
    switch (type) {
    case 'R': return "Float64";
    case 'I': return "Int32";
    case 'L': return "Int64";
    case 'B': return "Boolean";
    default: return "String";
    }
}

#define ENTER(function, modes) \
    Environment host; \
    Instance *self = enter(instance, function, modes, &host); \
    if (!self) return fmi3Error
#define LEAVE(good) return (fmi3Status)leave(self, (good) ? OK : ERROR, host)

const char *fmi3GetVersion(void) { return "3.0"; }

fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
                                         fmi3Boolean logging, fmi3Boolean event_mode, fmi3Boolean early_return,
                                         const fmi3ValueReference intermediate[], size_t intermediate_count,
                                         fmi3InstanceEnvironment environment, fmi3LogMessageCallback log_message_to,
                                         fmi3IntermediateUpdateCallback intermediate_update) {
    (void)resources, (void)visible, (void)early_return, (void)intermediate, (void)intermediate_update;
    bool named = name && *name && is_utf8(name);
    Log log = {send_message, (Function *)log_message_to, environment, named ? name : "unnamed", logging, ALL_CATEGORIES,
               OK};
    char own[TOKEN_SIZE];
    own_token(own);
    Instance nobody; /* who can only log */
    nobody.log = log;
    const char *function = "fmi3InstantiateCoSimulation";
    if (!named) {
        say_error(&nobody, "fmi3InstantiateCoSimulation: instanceName", "a name in UTF-8",
                  name ? (*name ? "other bytes" : "an empty string") : "NULL");
    } else if (event_mode || intermediate_count) {
        say_error(&nobody, function, "no event mode and no intermediate variables",
                  event_mode ? "event mode" : "intermediate variables");
    } else if (!token || strcmp(token, own) != 0) {
        say(&nobody, ERROR, "fmi3InstantiateCoSimulation: instantiationToken", own, token ? token : "NULL",
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

fmi3Instance fmi3InstantiateModelExchange(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
                                          fmi3Boolean logging, fmi3InstanceEnvironment environment,
                                          fmi3LogMessageCallback log_message_to) {
    (void)name, (void)token, (void)resources, (void)visible, (void)logging, (void)environment, (void)log_message_to;
    return NULL;
}

fmi3Instance fmi3InstantiateScheduledExecution(fmi3String name, fmi3String token, fmi3String resources,
                                               fmi3Boolean visible, fmi3Boolean logging,
                                               fmi3InstanceEnvironment environment,
                                               fmi3LogMessageCallback log_message_to, fmi3ClockUpdateCallback clock,
                                               fmi3LockPreemptionCallback lock, fmi3UnlockPreemptionCallback unlock) {
    (void)name, (void)token, (void)resources, (void)visible, (void)logging, (void)environment, (void)log_message_to;
    (void)clock, (void)lock, (void)unlock;
    return NULL;
}

void fmi3FreeInstance(fmi3Instance instance) {
    Environment host;
    Instance *self = enter(instance, "fmi3FreeInstance", MODES_OF_fmi2FreeInstance, &host);
    if (!self) return;
    instance_free(self);
    free(self);
    environment_leave(host);
}

fmi3Status fmi3SetDebugLogging(fmi3Instance instance, fmi3Boolean on, size_t count, const fmi3String names[]) {
    ENTER("fmi3SetDebugLogging", MODES_OF_fmi2SetDebugLogging);
    LEAVE(set_logging(self, "fmi3SetDebugLogging", on, count, names));
}

fmi3Status fmi3EnterInitializationMode(fmi3Instance instance, fmi3Boolean has_tolerance, fmi3Float64 tolerated,
                                       fmi3Float64 start, fmi3Boolean has_stop, fmi3Float64 stop) {
    (void)has_tolerance, (void)tolerated;
    const char *function = "fmi3EnterInitializationMode";
    ENTER(function, MODES_OF_fmi2EnterInitializationMode);
    LEAVE(set_up(self, function, start, has_stop, stop) && enter_initialization(self, function));
}

fmi3Status fmi3ExitInitializationMode(fmi3Instance instance) {
    ENTER("fmi3ExitInitializationMode", MODES_OF_fmi2ExitInitializationMode);
    LEAVE(exit_initialization(self));
}

fmi3Status fmi3Terminate(fmi3Instance instance) {
    ENTER("fmi3Terminate", MODES_OF_fmi2Terminate);
    self->progress.mode = TERMINATED;
    LEAVE(true);
}

fmi3Status fmi3Reset(fmi3Instance instance) {
    ENTER("fmi3Reset", MODES_OF_fmi2Reset);
    reset(self);
    LEAVE(true);
}

fmi3Status fmi3DoStep(fmi3Instance instance, fmi3Float64 time, fmi3Float64 step, fmi3Boolean no_set_state_before,
                      fmi3Boolean *event_needed, fmi3Boolean *terminate, fmi3Boolean *early_return,
                      fmi3Float64 *last_time) {
    (void)no_set_state_before;
    ENTER("fmi3DoStep", MODES_OF_fmi2DoStep);
    Status status = do_step(self, time, step);
    if (event_needed) *event_needed = false;
    if (terminate) *terminate = false; /* none of these FMUs ends a simulation by itself */
    if (early_return) *early_return = false;
    if (last_time) *last_time = self->progress.last_time;
    return (fmi3Status)leave(self, status, host);
}

/* -- values: one number for each variable, because there are no arrays */

static bool as_many(Instance *self, const char *function, size_t references, size_t values) {
    if (references != values) say_error(self, function, "as many values as value references", "another number");
    return references == values;
}

#define ACCESS(Name, TYPE, READ, WRITTEN) \
    fmi3Status fmi3Get##Name(fmi3Instance instance, const fmi3ValueReference references[], size_t count, \
                             fmi3##Name values[], size_t value_count) { \
        const char *function = "fmi3Get" #Name; \
        ENTER(function, MODES_OF_fmi2GetReal); \
        bool good = as_many(self, function, count, value_count); \
        if (good && count) good = readable(self, function, references, count, values, TYPE); \
        if (good && count && self->progress.stale) good = refreshed(self, ERROR); \
        for (size_t i = 0; good && i < count; i++) values[i] = READ; \
        LEAVE(good); \
    } \
    fmi3Status fmi3Set##Name(fmi3Instance instance, const fmi3ValueReference references[], size_t count, \
                             const fmi3##Name values[], size_t value_count) { \
        const char *function = "fmi3Set" #Name; \
        ENTER(function, MODES_OF_fmi2SetReal); \
        bool good = as_many(self, function, count, value_count); \
        if (good && count) good = settable(self, function, references, count, values, TYPE); \
        bool all = good; \
        for (size_t i = 0; good && i < count; i++) set_number(self, references[i], WRITTEN, &all); \
        LEAVE(all); \
    }
ACCESS(Float64, 'R', self->values[references[i]], values[i])
ACCESS(Int32, 'I', (fmi3Int32)self->values[references[i]], (double)values[i])
ACCESS(Int64, 'L', (fmi3Int64)self->values[references[i]], (double)values[i])
ACCESS(Boolean, 'B', self->values[references[i]] != 0.0, values[i] ? 1.0 : 0.0)

fmi3Status fmi3GetString(fmi3Instance instance, const fmi3ValueReference references[], size_t count,
                         fmi3String values[], size_t value_count) {
    const char *function = "fmi3GetString";
    ENTER(function, MODES_OF_fmi2GetString);
    bool good = as_many(self, function, count, value_count);
    if (good && count) good = readable(self, function, references, count, values, 'S');
    for (size_t i = 0; good && i < count; i++) values[i] = self->texts[text_place(references[i])];
    LEAVE(good);
}

fmi3Status fmi3SetString(fmi3Instance instance, const fmi3ValueReference references[], size_t count,
                         const fmi3String values[], size_t value_count) {
    const char *function = "fmi3SetString";
    ENTER(function, MODES_OF_fmi2SetString);
    bool good = as_many(self, function, count, value_count);
    if (good && count)
        good = settable(self, function, references, count, values, 'S')
               && texts_good(self, function, references, count, values);
    for (size_t i = 0; good && i < count; i++) set_text(self, references[i], values[i]);
    LEAVE(good);
}

/* -- states */

fmi3Status fmi3GetFMUState(fmi3Instance instance, fmi3FMUState *handle) {
    ENTER("fmi3GetFMUState", MODES_OF_fmi2GetFMUstate);
    LEAVE(state_get(self, "fmi3GetFMUState", handle));
}

fmi3Status fmi3SetFMUState(fmi3Instance instance, fmi3FMUState handle) {
    ENTER("fmi3SetFMUState", MODES_OF_fmi2SetFMUstate);
    LEAVE(state_set(self, "fmi3SetFMUState", handle));
}

fmi3Status fmi3FreeFMUState(fmi3Instance instance, fmi3FMUState *handle) {
    ENTER("fmi3FreeFMUState", MODES_OF_fmi2FreeFMUstate);
    LEAVE(state_free(self, "fmi3FreeFMUState", handle));
}

fmi3Status fmi3SerializedFMUStateSize(fmi3Instance instance, fmi3FMUState handle, size_t *size) {
    ENTER("fmi3SerializedFMUStateSize", MODES_OF_fmi2SerializedFMUstateSize);
    LEAVE(state_size(self, "fmi3SerializedFMUStateSize", handle, size));
}

fmi3Status fmi3SerializeFMUState(fmi3Instance instance, fmi3FMUState handle, fmi3Byte bytes[], size_t size) {
    ENTER("fmi3SerializeFMUState", MODES_OF_fmi2SerializeFMUstate);
    LEAVE(state_write(self, "fmi3SerializeFMUState", handle, bytes, size));
}

fmi3Status fmi3DeserializeFMUState(fmi3Instance instance, const fmi3Byte bytes[], size_t size, fmi3FMUState *handle) {
    ENTER("fmi3DeserializeFMUState", MODES_OF_fmi2DeSerializeFMUstate);
    LEAVE(state_read(self, "fmi3DeserializeFMUState", bytes, size, handle));
}

/* -- functions that the model description says these FMUs do not have */

static fmi3Status unsupported(fmi3Instance instance, const char *function) {
    ENTER(function, ANY_MODE);
    say_error(self, function, "none but the functions that the model description declares", "this one");
    LEAVE(false);
}
