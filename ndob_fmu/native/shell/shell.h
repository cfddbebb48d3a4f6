/* The parts of the shell, for one another. The build joins all sources into one file: what is not FMI's is static. */
#ifndef NDOB_SHELL_H
#define NDOB_SHELL_H

#include "fmu.h"
#include "rules.h"

/* -- text.c: numbers and characters as Python writes them */

#define NUMBER_SIZE 32
/* The fewest digits that give the number back. */
static void number_text(double number, char text[NUMBER_SIZE]);
/* As printf's %g. */
static void short_number_text(double number, char text[NUMBER_SIZE]);
/* The number of bytes of the first character of UTF-8, 0 if it is invalid. */
static size_t character(const char *text);
/* Append to what is in `line` as much as there is room for. */
static void append(char *line, size_t size, const char *text);

/* -- log.c */

typedef void Function(void);
typedef struct {
    /* Hands a message to the host; `logger` is the host's function. */
    void (*send)(Function *logger, void *environment, const char *name, Status status, const char *category,
                 const char *message);
    Function *logger;
    void *environment;
    const char *name;
    bool on;
    unsigned categories; /* bits by status */
    Status worst; /* of the present call */
} Log;

#define ALL_CATEGORIES (~0u)
static void log_message(Log *log, Status status, const char *message);
/* Switch messages of these categories, or of all, on or off; false, with a message, where `names` is missing. */
static bool set_logging(Instance *self, const char *function, bool on, size_t count, const char *const names[]);

/* -- handles.c: names for objects that can be told from the names of freed ones */

#define SLOT_BITS 12
#define SLOTS ((size_t)1 << SLOT_BITS)
typedef enum { INSTANCE_HANDLES, STATE_HANDLES } Table;
static void *handle_new(Table table, void *object); /* NULL when all are taken */
/* The object of a handle, which is busy until handle_leave; NULL if the handle is invalid or the object busy. */
static void *handle_enter(Table table, const void *handle);
static void handle_leave(Table table, const void *handle);
static void handle_free(Table table, const void *handle); /* by the one who has entered */
static const void *handle_at(Table table, size_t place); /* in a slot; NULL where that is free */

/* -- environment.c: the floating-point environment */

#if defined(__SSE2__) && defined(__x86_64__)
typedef unsigned Environment; /* of the SSE unit alone: fenv.h saves that of x87 too, which takes longer than a step */
#else
#include <fenv.h>
typedef fenv_t Environment;
#endif
static Environment environment_enter(void);
static void environment_leave(Environment host);

/* -- instance.c: what both versions of FMI ask for */

/* A step begins where the last one ended, within this part of a step: hosts add up steps, or round them. */
#define TIME_TOLERANCE 1e-3
/* The error (s) that a time may have beside a step. */
static double tolerance(double step_size, double time);

static void own_token(char token[TOKEN_SIZE]);

typedef struct {
    double start, stop, now, step_size; /* s; `stop` counts where there is one */
} Clock;

/* What a saved state holds besides values, parameters and the component's state; without padding. */
typedef struct {
    Clock clock;
    double last_time; /* the end of the last step that was accepted */
    uint32_t mode;
    uint32_t has_experiment, has_stop;
    uint32_t initializing, stale; /* stale: the outputs have to be computed before they are read */
    uint32_t made; /* there is a core, for the parameters in `started_with` */
} Progress;

struct Instance {
    Log log;
    Progress progress;
    void *handle;
    double *values;
    double *started_with; /* parameters */
    char (*texts)[TEXT_SIZE];
    char (*started_with_texts)[TEXT_SIZE];
    double *outputs; /* of a step that may fail yet */
    void *state, *core;
    size_t state_size; /* the bytes there are for the state */
};

/* The bytes of an instance of that name. */
static size_t instance_size(const char *name);
/* Set up an instance in such a block of zeros, and give it a handle; NULL, with a message, where there are too many. */
static Instance *instance_in(void *block, const char *name, Log log);
static void instance_free(Instance *self); /* but for its block */
/* Begin a call: the instance, or NULL (which means an error) if the handle is invalid or the call not allowed now. */
static Instance *enter(void *handle, const char *function, unsigned modes, Environment *host);
/* End the call and return the status. */
static Status leave(Instance *self, Status status, Environment host);
/* Say something of a call, with the name of FMI's function. */
static void say_error(Instance *self, const char *function, const char *expected, const char *received);

static bool set_up(Instance *self, const char *function, double start, bool has_stop, double stop);
static bool enter_initialization(Instance *self, const char *function);
static bool exit_initialization(Instance *self);
static void reset(Instance *self);
static bool remake(Instance *self, double start_time);
static bool has_started_with(const Instance *self, const double *parameters, const char (*texts)[TEXT_SIZE]);
static Call call_of(Instance *self);
static bool refreshed(Instance *self, Status status);
static Status do_step(Instance *self, double time, double step_size);

/* -- values.c */

/* Whether the references are those of variables of the type, and may be set now. */
static bool readable(Instance *self, const char *function, const uint32_t references[], size_t count, const void *values,
              char type);
static bool settable(Instance *self, const char *function, const uint32_t references[], size_t count, const void *values,
              char type);
static bool texts_good(Instance *self, const char *function, const uint32_t references[], size_t count,
                const char *const values[]);
/* Take over values that may be set; false where a parameter's value is not acceptable. */
static void set_number(Instance *self, uint32_t reference, double value, bool *good);
static void set_text(Instance *self, uint32_t reference, const char *value);
static size_t text_place(uint32_t reference);
/* The first parameter with a value that cannot be used, or none: `fmu.count`. */
static uint32_t unusable_parameter(const Instance *self);
static bool acceptable(const Variable *variable, double value);
static void say_unacceptable(Instance *self, uint32_t reference, Status status);

/* -- fmi2.c or fmi3.c: by which function a variable's type is accessed, and what FMI calls the type */

static char accessed_as(char type);
static const char *type_name(char type);

/* -- states.c */

/* Each says what is wrong where it returns false. */
static bool state_get(Instance *self, const char *function, void **handle);
static bool state_set(Instance *self, const char *function, void *handle);
static bool state_free(Instance *self, const char *function, void **handle);
static bool state_size(Instance *self, const char *function, void *handle, size_t *size);
static bool state_write(Instance *self, const char *function, void *handle, unsigned char bytes[], size_t size);
static bool state_read(Instance *self, const char *function, const unsigned char bytes[], size_t size, void **handle);
static void states_free(Instance *self);

#endif
