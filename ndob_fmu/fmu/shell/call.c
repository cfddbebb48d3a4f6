/* What every call begins and ends with: the instance, the check of its mode, and the environment to compute in. */
#define _GNU_SOURCE
#include "core.h"

#include <string.h>
#include <xmmintrin.h>

Handles instances;

/* Whether masks, rounding and flushing are as at the start of a program; flags that exceptions left do not count. */
static bool default_numerics(void) {
    unsigned short x87;
    __asm__ volatile("fnstcw %0" : "=m"(x87));
    return (_mm_getcsr() & ~0x3fu) == 0x1f80 && x87 == 0x037f;
}

/* The FMU computes with the numerics that it was tested with: hosts trap exceptions, which LAPACK raises on purpose, or
 * flush small numbers to zero, which changes bits. And no interrupt may end the instance in the middle. */
void surroundings_enter(Surroundings *host) {
    host->changed = !default_numerics();
    if (host->changed) {
        fegetenv(&host->numerics);
        fesetenv(FE_DFL_ENV);
    }
    core_entered();
    core_hold_interrupts();
}

void surroundings_leave(const Surroundings *host) {
    if (host->changed) fesetenv(&host->numerics);
    core_release_interrupts();
    core_left();
}

static const char *mode_name(Mode mode) {
    switch (mode) {
#define F(name, text) \
    case name: return text;
        MODES(F)
#undef F
    }
    return "in an unknown mode";
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
    if (!slot) return NULL; /* freed or invalid: there is no log to write to */
    if (atomic_flag_test_and_set(&slot->busy)) return NULL;
    Instance *self = slot->object;
    /* Since it was looked up the instance may have been freed, and another may have taken its slot. */
    bool there = handle_slot(&instances, component) == slot && self;
    bool orphaned = there && self->progress.mode == ORPHANED;
    if (!there || (!orphaned && !core_alive())) return atomic_flag_clear(&slot->busy), NULL;
    self->log.worst = fmi2OK;
    if (!(self->progress.mode & modes)) {
        refuse(self, function, modes);
        return atomic_flag_clear(&slot->busy), NULL;
    }
    surroundings_enter(&self->host);
    if (!orphaned) core_keep_thread();
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
