/* What the shell needs of an FMU: its variables and the component that computes. The build writes both.
 *
 * The shell is FMI's functions (fmi2.c or fmi3.c) over one instance (instance.c): it checks each call against FMI's rules,
 * keeps modes, values, times, states and log, and hands on what is allowed to the component. All memory of an instance is
 * one block, whose size is known when the FMU is built. */
#ifndef NDOB_FMU_H
#define NDOB_FMU_H

#include <float.h>
#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* The macros of math.h are for any type, which compilers warn of. */
static bool finite_number(double number) { return fabs(number) <= DBL_MAX; }
static bool not_a_number(double number) { return !(fabs(number) <= HUGE_VAL); }

/* As FMI numbers them, in both versions. */
typedef enum { OK, WARNING, DISCARD, ERROR, FATAL } Status;

#define TEXT_SIZE 1024 /* bytes of the value of a String variable, its end included */
#define TOKEN_SIZE 40
#define MESSAGE_SIZE 1200 /* bytes of 300 characters in UTF-8 */

typedef struct {
    const char *name;
    char type; /* R, I, E (an enumeration), B, S */
    char role; /* i input, f fixed parameter, t tunable parameter, o what is calculated */
    double least, most; /* of a parameter's value */
    bool above; /* the least value is itself not allowed */
    const char *expected; /* of a parameter, for a message; NULL where every value is good */
} Variable;

typedef struct Instance Instance;

/* What a component gets with each call. It writes outputs and state; where it returns false it has said why and leaves
 * the state as it was. */
typedef struct {
    const double *values; /* of all variables, by value reference */
    const char (*texts)[TEXT_SIZE]; /* of the String variables, in their order */
    double *outputs; /* in their order; where the call fails they are not shown */
    void *core; /* what follows from the parameters, and room to compute in */
    void *state; /* what is remembered from step to step: bytes without pointers */
    Instance *instance;
} Call;

typedef struct {
    const Variable *variables; /* by value reference */
    uint32_t count;
    uint32_t first_output, output_count;
    const uint32_t *parameters; /* their references */
    uint32_t parameter_count, text_count;
    size_t core_size, state_size;
    bool sizes_state; /* `start` asks for the memory of the state, of at most `state_size` bytes, by state_memory.c */
    bool (*start)(const Call *call, double start_time); /* make the core from the parameters, and the first state */
    bool (*show)(const Call *call); /* the outputs at the start, for the inputs set so far */
    bool (*step)(const Call *call, double time, double step_size);
    bool (*possible)(const Call *call, double begin, double now); /* whether the core can be in this state */
    size_t (*tuning)(const Call *call, double *numbers, size_t room); /* for many_steps.c; NULL where none is tuned */
    void (*end)(void *core); /* release what the core has taken besides its memory; NULL where that is nothing */
} Fmu;

static const Fmu fmu;

#ifdef SIZES_STATE
static void *state_memory(Instance *self, size_t size);
#endif

/* Beside it the build writes `first_values`: the token, which is guid in FMI 2 and instantiationToken in FMI 3, and the
 * start values of all variables and of the String variables. A packed system has its own, which start_values.py writes
 * into sources and binaries alike. Volatile, so that no compiler computes with what stands in the source. */

/* Say what was expected and received, in one line of at most 300 characters; `likely` may be empty. */
static void say(Instance *self, Status status, const char *where, const char *expected, const char *received,
         const char *likely);

static bool is_utf8(const char *text);
/* Say a message as it stands. */
static void tell(Instance *self, Status status, const char *message);

#endif
