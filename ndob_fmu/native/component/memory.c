/* The memory that a call of the component computes in. */
#include "fmu.h"
#include "translated.h"

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
    char message[ND_MESSAGE];
    nd_start(arena, block, bytes);
    arena->full = &full;
    arena->message = message;
    if (setjmp(full) == 0) return hidden_work(job);
    say(job->call->instance, job->status, "memory", "enough for one step", "less", "a defect of this FMU; report it");
    return false;
}

/* The core has `arena` and `memory`. */
#define IN_MEMORY(call, first, second, status, work) \
    in_memory(&((Core *)(call)->core)->arena, ((Core *)(call)->core)->memory, sizeof((Core *)0)->memory, \
              &(Job){call, first, second, status}, work)
