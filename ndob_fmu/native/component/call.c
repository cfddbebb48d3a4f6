/* A call of the component: its memory, and what is said where translated code raises. */
#include "fmu.h"
#include "translated.h"

/* Say why there is no result, in the words of the Python FMU. `where` names the computation. */
static bool fail(const Call *call, const nd_arena *arena, Status status, const char *where) {
    char received[2 * ND_MESSAGE];
    if (arena->error != ND_ARITHMETIC && arena->error != ND_LINALG) {
        tell(call->instance, status, arena->message);
        return false;
    }
    const char *class = "LinAlgError";
    for (size_t i = 1; i < sizeof FAULTS / sizeof *FAULTS; i++)
        if (arena->error == ND_ARITHMETIC && strcmp(arena->message, FAULTS[i]) == 0) class = CLASSES[i];
    received[0] = '\0';
    strncat(received, arena->message, ND_MESSAGE);
    strcat(strcat(strcat(received, " ("), class), ")");
    say(call->instance, status, where, "numbers that can be computed with", received, "");
    return false;
}

/* What is done in a block of memory: a call of the component with its two times, and the status of a failure. */
typedef struct {
    const Call *call;
    double first, second;
    Status status;
} Job;

/* Do a job in a block of memory; false, with a message, where that is too small. */
static bool in_memory(nd_arena *arena, double *block, size_t bytes, const Job *job, bool (*work)(const Job *)) {
    bool (*volatile hidden_work)(const Job *) = work; /* inlined, its variables would be at the mercy of longjmp */
    jmp_buf full;
    nd_start(arena, block, bytes);
    arena->full = &full;
    if (setjmp(full) == 0) return hidden_work(job);
    say(job->call->instance, job->status, "memory", "enough for one step", "less", "a defect of this FMU; report it");
    return false;
}

/* The core has `arena` and `memory`. */
#define IN_MEMORY(call, first, second, status, work) \
    in_memory(&((Core *)(call)->core)->arena, ((Core *)(call)->core)->memory, sizeof((Core *)0)->memory, \
              &(Job){call, first, second, status}, work)

static bool finite_numbers(const double *given, size_t count) {
    for (size_t i = 0; i < count; i++)
        if (!finite_number(given[i])) return false;
    return true;
}
