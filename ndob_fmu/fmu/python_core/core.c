/* The Python core: instances of the slave that is written in Python, made and called through pythonfmu's binary.
 *
 * pythonfmu makes fmi2Fatal of every exception. The slave therefore never raises: it logs with a status. */
#define _GNU_SOURCE
#include "interpreters.h"
#include "pythonfmu.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

Core core;

static struct {
    void *library; /* NULL before it is loaded */
    fmi2InstantiateTYPE *instantiate;
    void (*finalize)(void);
} pythonfmu;
static Lock loading = UNLOCKED;

/* Before pythonfmu's static objects are destroyed, after which its own call of this frees one of them twice. */
static void finish(void) {
    if (pythonfmu.finalize && !python_is_orphaned()) pythonfmu.finalize();
    if (pythonfmu.library && !living && !python_is_orphaned()) library_close(pythonfmu.library);
    pythonfmu.library = NULL;
    pythonfmu.finalize = NULL;
    core = (Core){0};
    python_leave();
}

/* After Python is there: the binary takes its symbols from the process. */
static bool load_pythonfmu(char *reason, size_t size) {
    char said[1024] = "a binary without FMI's functions";
    lock_acquire(&loading);
    if (!pythonfmu.library) {
        Core loaded = {0};
        void *library = slave_library(said, sizeof said);
        bool complete = library != NULL;
        if (complete) {
            pythonfmu.finalize = (void (*)(void))library_symbol(library, "finalizePythonInterpreter");
            pythonfmu.instantiate = (fmi2InstantiateTYPE *)library_symbol(library, "fmi2Instantiate");
            complete = pythonfmu.instantiate != NULL;
#define F(name) \
    complete = complete && (loaded.name = (fmi2##name##TYPE *)library_symbol(library, "fmi2" #name));
            CORE_FUNCTIONS(F)
#undef F
        }
        if (complete) {
            core = loaded;
            pythonfmu.library = library;
            at_end(finish);
        } else {
            snprintf(reason, size, "expected pythonfmu's binary beside the FMU's, received %s", said);
        }
    }
    lock_release(&loading);
    return pythonfmu.library != NULL;
}

bool core_files_good(const Description *description, const char *folder, char *reason, size_t size) {
    const char *entry = description_value(description, "entry");
    char *path = path_in(folder, "slavemodule.txt");
    char *named = path ? file_text(path) : NULL;
    free(path);
    if (named) named[strcspn(named, "\r\n")] = '\0';
    bool good = named && strcmp(named, entry) == 0;
    if (!good)
        snprintf(reason, size, "%s/slavemodule.txt: expected %s, received %.60s", folder, entry,
                 named ? named : "what cannot be read");
    free(named);
    return good;
}

bool core_start(const Description *description, Log *log) {
    char reason[4096], warning[4096];
    if (python_is_orphaned()) {
        log_line(log, fmi2Error,
                 "fmi2Instantiate: expected a process that starts by itself, received one that was forked while a thread "
                 "was calling an FMU; fork before the first or between two calls, or use spawn or exec");
        return false;
    }
    if (!python_start(description, reason, sizeof reason, warning, sizeof warning)) {
        log_line(
            log, fmi2Error,
            "fmi2Instantiate: expected a Python of 3.10 or later with NumPy and a shared libpython, received none: %s; %s",
            reason,
            python_is_the_hosts() ? "install NumPy for the Python that the host runs in"
                                  : "set NDOB_FMU_PYTHON to the path of such a Python");
        return false;
    }
    if (*warning) log_line(log, fmi2Warning, "fmi2Instantiate: %s", warning);
    if (load_pythonfmu(reason, sizeof reason)) return true;
    log_line(log, fmi2Error, "fmi2Instantiate: %s", reason);
    return false;
}

void core_first_instance(void) {
    if (python_is_the_hosts()) interrupts_hold_back();
}

void core_last_instance(void) {
    interrupts_give_back();
    python_drop_thread();
}

fmi2Component core_instantiate(Instance *self, fmi2String name, const char *folder, fmi2Boolean visible) {
    char reason[4096] = "", said[OVERHEARD_SIZE] = "nothing";
    char *location = slave_location(folder, &self->opened, reason, sizeof reason);
    if (!location) {
        log_line(&self->log, fmi2Error, "fmi2Instantiate: %s", reason);
        return NULL;
    }
    self->log.overheard = said;
    fmi2Component made = pythonfmu.instantiate(name, fmi2CoSimulation, self->description.guid, location,
                                               &self->callbacks, visible, fmi2True);
    self->log.overheard = NULL;
    /* pythonfmu puts the folder first on Python's path and leaves it there; by now all that the FMU carries is imported. */
    python_forget_path(location + strlen(FILE_SCHEME), self->opened >= 0);
    if (!made)
        log_line(&self->log, fmi2Error,
                 "fmi2Instantiate: expected the code that the build put into %s, received code that does not run (%s); "
                 "likely cause: files that were changed or damaged",
                 location + strlen(FILE_SCHEME), said);
    free(location);
    return made;
}

void core_release(Instance *self) { slave_location_close(self->opened); }

bool core_alive(void) { return python_alive(); }

void core_entered(void) { python_entered(); }

void core_left(void) { python_left(); }

void core_hold_interrupts(void) { interrupts_begin(); }

void core_release_interrupts(void) { interrupts_end(); }

void core_keep_thread(void) { python_keep_thread(); }

bool core_after_fork(void) {
    lock_renew(&loading);
    return python_after_fork();
}
