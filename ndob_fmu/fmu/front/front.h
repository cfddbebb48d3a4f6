/* The front: the library that a host loads as the FMU's binary, between the host and pythonfmu's.
 *
 * It finds and starts Python where the host has none, decodes the resource location, guards the calls that pythonfmu
 * forwards unseen, and hands everything else on. One instance is an Instance, known to the host by a handle that
 * cannot be confused with a freed one. */
#ifndef NDOB_FRONT_H
#define NDOB_FRONT_H

#include "fmi2Functions.h"
#include "platform.h"

#include <fenv.h>
#include <stdatomic.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* The FMI 2.0 state machine for co-simulation, as a set of bits so that a call can name all modes it is allowed in. */
typedef enum { INSTANTIATED = 1, INITIALIZATION = 2, STEPPING = 4, TERMINATED = 8, LOST = 16, ORPHANED = 32 } Mode;
#define ANY_MODE ((unsigned)(INSTANTIATED | INITIALIZATION | STEPPING | TERMINATED))

/* -- description.c: resources/front.txt, which the build writes */

typedef struct {
    char type; /* R, I (and enumerations), B, S */
    char role; /* i input, f fixed parameter, t tunable parameter, o what is calculated */
    const char *name;
} Variable;

typedef struct {
    char *text; /* the file; the strings below lie in it */
    const char *guid, *executable, *library, *packages;
    Variable *variables; /* by value reference */
    size_t count;
} Description;

/* Decode a resource location into the absolute path of a folder that holds front.txt (malloc), or return NULL with the
 * reason. */
char *resources_folder(const char *location, char *reason, size_t size);
/* Read it, and see that all is there that the slave will read. */
bool description_read(Description *description, const char *folder, char *reason, size_t size);
void description_free(Description *description);

/* -- python.c */

/* Have a running Python with NumPy in the process; else false with one line of reasons. `warning` gets what the user
 * should know although all is well, or stays empty. */
bool python_start(const Description *description, char *reason, size_t size, char *warning, size_t warning_size);
bool python_alive(void);
/* Around what may wait for Python's lock or have it. */
void python_entered(void);
void python_left(void);
/* In the child of a fork: whether Python can be entered there. */
bool python_after_fork(void);
/* Whether it cannot, since a fork in this process or one of its parents. */
bool python_is_orphaned(void);
/* Whether the process had a Python of its own before the first of these FMUs. */
bool python_is_the_hosts(void);
/* Keep the calling thread's thread state from now on, instead of a new one for each call. */
void python_keep_thread(void);
void python_drop_thread(void);
/* Whether Python gets from the folder's name in UTF-8 back to the same bytes, with which it opens files there. */
bool python_finds(const char *folder);
/* Take a folder from Python's path again; `reused` says that others may have its name later. */
void python_forget_path(const char *folder, bool reused);
/* Have Python handle the signals that it has noted, and keep what the handlers raise; have it raised in the host. */
void python_take_pending(void);
void python_raise_taken(void);
void python_leave(void);

/* -- interrupts_linux.c, platform_windows.c */

void interrupts_hold_back(void); /* from now on, where Python handles them, during calls on the main thread */
void interrupts_give_back(void);
void interrupts_begin(void); /* of a call */
void interrupts_end(void);

/* -- log.c */

typedef struct {
    fmi2CallbackLogger logger;
    fmi2ComponentEnvironment environment;
    char *name;
    bool on;
    unsigned categories; /* bits by status */
    char *overheard; /* where what the slave says goes in place of the host; NULL but while it is being made */
    fmi2Status worst; /* of the present call */
} Log;

#define ALL_CATEGORIES (~0u)
#define OVERHEARD_SIZE 1024

__attribute__((format(printf, 3, 4))) void log_line(Log *log, fmi2Status status, const char *format, ...);
/* The logger that pythonfmu gets, with a Log as its environment. */
void log_from_slave(fmi2ComponentEnvironment environment, fmi2String name, fmi2Status status, fmi2String category,
                    fmi2String message, ...);
/* Return the categories' bits, and in `unknown` the first name that is none. */
unsigned log_categories(size_t count, const fmi2String names[], const char **unknown);

/* -- utf8.c */

/* The number of bytes of the first character of UTF-8, 0 if it is invalid. */
size_t character(const char *text);
bool is_utf8(const char *text);

/* -- handles.c: names for objects that can be told from the names of freed ones */

typedef struct {
    _Atomic uintptr_t handle; /* 0 while the slot is free */
    atomic_flag busy;
    void *object;
} Slot;

#define SLOTS_PER_CHUNK 256
typedef struct {
    _Atomic(Slot *) chunks[256];
    size_t next; /* no slot before this one is free */
} Handles;

void *handle_new(Handles *handles, void *object); /* NULL when all are taken or there is no memory */
Slot *handle_slot(Handles *handles, const void *handle); /* NULL if it is none */
void handle_free(Handles *handles, Slot *slot);
void handles_each(Handles *handles, void (*function)(Slot *));
void handles_after_fork(void); /* in the child, as the next two */

/* -- instance.c */

/* The functions of pythonfmu's binary that are called. */
#define SLAVE_FUNCTIONS(F) \
    F(Instantiate) \
    F(FreeInstance) F(SetupExperiment) F(EnterInitializationMode) F(ExitInitializationMode) F(Terminate) F(Reset) \
        F(GetReal) F(GetInteger) F(GetBoolean) F(GetString) F(SetReal) F(SetInteger) F(SetBoolean) F(SetString) \
            F(GetFMUstate) F(SetFMUstate) F(FreeFMUstate) F(SerializedFMUstateSize) F(SerializeFMUstate) \
                F(DeSerializeFMUstate) F(DoStep)

typedef struct {
#define F(name) fmi2##name##TYPE *name;
    SLAVE_FUNCTIONS(F)
#undef F
    void (*finalize)(void);
    void *library;
} Slave;

extern Slave slave;
void instances_after_fork(bool usable);

/* What of the calling thread is the host's: kept during a call. */
typedef struct {
    bool unusual;
    fenv_t numerics; /* if they are unusual */
} Surroundings;

/* What a saved state has to bring back besides the slave's own. */
typedef struct {
    uint32_t mode;
    uint32_t has_experiment;
    double last_time; /* the end of the last step that was accepted */
} Progress;

typedef struct State State;

typedef struct {
    Slot *slot;
    fmi2Component slave;
    Surroundings host;
    State *states; /* that it has made */
    fmi2CallbackFunctions callbacks; /* pythonfmu keeps the pointer */
    Log log;
    Description description;
    int folder; /* what slave_location keeps open */
    Progress progress;
} Instance;

/* -- call.c */

extern Handles instances;

void surroundings_enter(Surroundings *host);
void surroundings_leave(const Surroundings *host);
/* Begin a call: the instance, or NULL (which means fmi2Error) if the handle is none or the call is not allowed now. */
Instance *enter(fmi2Component component, const char *function, unsigned modes);
/* The worse of the slave's status and what it logged during the call. */
fmi2Status judged(Instance *self, fmi2Status status);
/* End the call and return the status. */
fmi2Status leave(Instance *self, fmi2Status status);

/* -- state.c */

/* Release the states that the instance has made. */
void states_free(Instance *self);
void states_after_fork(void);

#endif
