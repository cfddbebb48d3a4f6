/* The shell: FMI's functions, in the library that a host loads as the FMU's binary.
 *
 * It decodes the resource location, checks each call against FMI's rules, keeps modes, states and log, and hands on what
 * is allowed to the core (core.h), which computes. An instance is known to the host by a handle that cannot be confused
 * with a freed one. */
#ifndef NDOB_SHELL_H
#define NDOB_SHELL_H

#include "fmi2Functions.h"
#include "fmi2_rules.h"
#include "platform.h"

#include <fenv.h>
#include <stdatomic.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* -- description.c: resources/front.txt, which the build writes */

typedef struct {
    char type; /* R, I (and enumerations), B, S */
    char role; /* i input, f fixed parameter, t tunable parameter, o what is calculated */
    const char *name;
} Variable;

typedef struct {
    const char *key, *value;
} Setting;

#define MOST_SETTINGS 16
typedef struct {
    char *text; /* the file; the strings below lie in it */
    Setting settings[MOST_SETTINGS]; /* the lines that do not declare variables */
    size_t setting_count;
    const char *guid;
    Variable *variables; /* by value reference */
    size_t count;
} Description;

/* Decode a resource location into the absolute path of a folder that holds front.txt (malloc), or return NULL with the
 * reason. */
char *resources_folder(const char *location, char *reason, size_t size);
/* Read it, and see that all is there that the slave will read. */
bool description_read(Description *description, const char *folder, char *reason, size_t size);
void description_free(Description *description);
/* Return the value of a line of front.txt; "" if there is none. */
const char *description_value(const Description *description, const char *key);
/* Return the path of a file in a folder (malloc), and what is in a file (malloc); NULL if that cannot be done. */
char *path_in(const char *folder, const char *name);
char *file_text(const char *path);

/* -- log.c */

typedef struct {
    fmi2CallbackLogger logger;
    fmi2ComponentEnvironment environment;
    char *name;
    bool on;
    unsigned categories; /* bits by status */
    char *overheard; /* NULL, or where messages of the core go instead of to the host */
    fmi2Status worst; /* of the present call */
} Log;

#define ALL_CATEGORIES (~0u)
#define OVERHEARD_SIZE 1024

__attribute__((format(printf, 3, 4))) void log_line(Log *log, fmi2Status status, const char *format, ...);
/* The logger that the core gets, with a Log as its environment. */
void log_from_core(fmi2ComponentEnvironment environment, fmi2String name, fmi2Status status, fmi2String category,
                    fmi2String message, ...);
/* Return the categories' bits, and in `unknown` the first name that is not a category. */
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
Slot *handle_slot(Handles *handles, const void *handle); /* NULL if the handle is invalid */
void handle_free(Handles *handles, Slot *slot);
void handles_each(Handles *handles, void (*function)(Slot *));
void handles_after_fork(void); /* in the child, as the next two */

/* -- instance.c */

extern _Atomic int living; /* instances */
void instances_after_fork(bool usable);

/* The host's floating-point environment, kept during a call. */
typedef struct {
    bool changed; /* it differs from the default */
    fenv_t numerics; /* if it differs */
} Surroundings;

/* What a saved state holds besides that of the core. */
typedef struct {
    uint32_t mode;
    uint32_t has_experiment;
    double last_time; /* the end of the last step that was accepted */
} Progress;

typedef struct State State;

typedef struct {
    Slot *slot;
    fmi2Component core;
    int opened; /* a file descriptor that the core keeps open for it; -1 if there is none */
    Surroundings host;
    State *states; /* that it has made */
    fmi2CallbackFunctions callbacks; /* the core keeps the pointer */
    Log log;
    Description description;
    Progress progress;
} Instance;

/* -- call.c */

extern Handles instances;

void surroundings_enter(Surroundings *host);
void surroundings_leave(const Surroundings *host);
/* Begin a call: the instance, or NULL (which means fmi2Error) if the handle is invalid or the call not allowed now. */
Instance *enter(fmi2Component component, const char *function, unsigned modes);
#define ENTER(function) enter(component, #function, MODES_OF_##function)
/* The worse of the core's status and what it logged during the call. */
fmi2Status judged(Instance *self, fmi2Status status);
/* End the call and return the status. */
fmi2Status leave(Instance *self, fmi2Status status);

/* -- state.c */

/* Release the states that the instance has made. */
void states_free(Instance *self);
void states_after_fork(void);

#endif
