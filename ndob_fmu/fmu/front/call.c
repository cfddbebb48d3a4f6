/* What every call begins and ends with: whose it is and whether it may come now, and an environment to compute in. */
#define _GNU_SOURCE
#include "front.h"

#include <string.h>
#include <xmmintrin.h>

Handles instances;

/* Masks, rounding and flushing are as every program finds them; flags that exceptions have left do not count. */
static bool usual_numerics(void) {
    unsigned short x87;
    __asm__ volatile("fnstcw %0" : "=m"(x87));
    return (_mm_getcsr() & ~0x3fu) == 0x1f80 && x87 == 0x037f;
}

/* The FMU computes with the numerics that it was tested with: hosts trap exceptions, which LAPACK raises on purpose, or
 * flush small numbers to zero, which changes bits. And no interrupt may end the instance in the middle. */
void surroundings_enter(Surroundings *host) {
    host->unusual = !usual_numerics();
    if (host->unusual) {
        fegetenv(&host->numerics);
        fesetenv(FE_DFL_ENV);
    }
    python_entered();
    interrupts_begin();
}

void surroundings_leave(const Surroundings *host) {
    if (host->unusual) fesetenv(&host->numerics);
    interrupts_end();
    python_left();
}

static const char *mode_name(Mode mode) {
    return mode == INSTANTIATED     ? "instantiated"
           : mode == INITIALIZATION ? "in initialization mode"
           : mode == STEPPING       ? "in step mode"
           : mode == TERMINATED     ? "terminated"
           : mode == LOST           ? "lost after a fatal error"
                                    : "inherited from a process that forked while a thread was calling an FMU";
}

static void refuse(Instance *self, const char *function, unsigned modes) {
    char allowed[128] = "";
    for (unsigned mode = INSTANTIATED; mode <= TERMINATED; mode <<= 1)
        if (modes & mode) {
            if (*allowed) strcat(allowed, " or ");
            strcat(allowed, mode_name(mode));
        }
    log_line(&self->log, fmi2Error, "%s: expected an instance that is %s, received one that is %s", function, allowed,
             mode_name(self->progress.mode));
}

Instance *enter(fmi2Component component, const char *function, unsigned modes) {
    Slot *slot = handle_slot(&instances, component);
    if (!slot) return NULL; /* freed, or never one: nobody to tell */
    if (atomic_flag_test_and_set(&slot->busy)) return NULL;
    Instance *self = slot->object;
    /* Since it was looked up the instance may have been freed, and another may have taken its slot. */
    bool there = handle_slot(&instances, component) == slot && self;
    bool orphaned = there && self->progress.mode == ORPHANED;
    if (!there || (!orphaned && !python_alive())) return atomic_flag_clear(&slot->busy), NULL;
    self->log.worst = fmi2OK;
    if (!(self->progress.mode & modes)) {
        refuse(self, function, modes);
        return atomic_flag_clear(&slot->busy), NULL;
    }
    surroundings_enter(&self->host);
    if (!orphaned) python_keep_thread();
    return self;
}

fmi2Status judged(Instance *self, fmi2Status status) {
    if (self->log.worst > status) status = self->log.worst;
    if (status >= fmi2Fatal) self->progress.mode = LOST;
    return status;
}

fmi2Status leave(Instance *self, fmi2Status status) {
    Surroundings host = self->host;
    atomic_flag_clear(&self->slot->busy);
    surroundings_leave(&host);
    return status;
}
