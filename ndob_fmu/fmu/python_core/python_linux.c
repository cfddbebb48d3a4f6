/* The Python of a Linux process: the one that it has, else the first suitable one that is found.
 *
 * pythonfmu's binary takes its Python symbols from the global scope. In a host that has none they come from libpython,
 * opened here with RTLD_GLOBAL (as a library that this one needs they would be hidden from NumPy). */
#define _GNU_SOURCE
#include "interpreters.h"

#include <dlfcn.h>
#include <link.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* One for all the fronts of the process, each of which may be the one to start Python: the loader binds a unique symbol
 * to the same memory in every library that defines it. There are few keys in a process, and a front for each folder that
 * an FMU was unpacked to. */
typedef struct {
    pthread_mutex_t lock;
    pthread_key_t kept_state;
    bool has_key, started_by_us, orphaned;
    _Atomic int inside; /* threads in calls that use Python */
    int (*has_lock)(void); /* whether the calling thread has Python's lock; NULL before Python is used */
} Shared;
__asm__(".pushsection .bss.ndob_fmu_python,\"aw\",@nobits\n"
        ".balign 64\n"
        ".globl ndob_fmu_python\n"
        ".type ndob_fmu_python, @gnu_unique_object\n"
        ".size ndob_fmu_python, 64\n"
        "ndob_fmu_python:\n"
        ".zero 64\n"
        ".popsection\n");
extern Shared ndob_fmu_python __attribute__((visibility("default")));
_Static_assert(sizeof(Shared) <= 64, "it has to fit");
#define shared ndob_fmu_python

void python_note_started(void) { shared.started_by_us = true; }
bool python_was_started_by_an_fmu(void) { return shared.started_by_us; }

static int find_libpython(struct dl_phdr_info *info, size_t size, void *found) {
    (void)size;
    const char *name = strrchr(info->dlpi_name, '/');
    if (!name || strncmp(name, "/libpython3.", 12) != 0 || name[12] < '0' || name[12] > '9') return 0;
    snprintf(found, PATH_MAX, "%s", info->dlpi_name);
    return 1;
}

/* Return the Python of the process with its symbols visible to all, or NULL. */
static void *present(void) {
    if (dlsym(RTLD_DEFAULT, "Py_IsInitialized")) return dlopen(NULL, RTLD_NOW);
    char name[PATH_MAX] = "";
    dl_iterate_phdr(find_libpython, name);
    return *name ? dlopen(name, RTLD_NOW | RTLD_GLOBAL | RTLD_NOLOAD) : NULL;
}

/* Take the candidate if its library can be opened, or is the one that the process has. */
static bool take(const Candidate *candidate, void *library, Reasons *reasons, bool *settled) {
    if (library) {
        int minor = candidate->minor, has = 0;
        const char *(*version)(void) = (const char *(*)(void))dlsym(library, "Py_GetVersion");
        const char *name = strrchr(candidate->library, '/');
        if (!minor && name) sscanf(name, "/libpython3.%d", &minor);
        if (!version || sscanf(version(), "3.%d", &has) != 1 || (minor && has != minor))
            return add_reason(reasons, "%s is not the version of the process's Python", candidate->executable), false;
    } else if (!(library = dlopen(candidate->library, RTLD_NOW | RTLD_GLOBAL))) {
        return add_reason(reasons, "%s: its library cannot be opened (%s)", candidate->executable, dlerror()), false;
    }
    *settled = true; /* a library with RTLD_GLOBAL stays: no other can take its place */
    return python_use(library, candidate, reasons);
}

static bool find(const Description *description, Reasons *reasons, char *warning, size_t warning_size) {
    void *library = present();
    if (library) {
        int (*initialized)(void) = (int (*)(void))dlsym(library, "Py_IsInitialized");
        if (initialized && initialized()) return python_use(library, NULL, reasons);
    }
    Candidate candidate = {0};
    bool settled = false, good = false;
    const char *named = getenv(VARIABLE);
    if (named && *named) {
        if (candidate_from_variable(&candidate, reasons)) good = take(&candidate, library, reasons, &settled);
        if (!good) snprintf(warning, warning_size, VARIABLE " is passed over: %s", reasons->text);
    }
    candidate = good || settled ? candidate : (Candidate){0};
    if (!good && !settled && candidate_from_build(&candidate, description, reasons))
        good = take(&candidate, library, reasons, &settled);
    if (!good && !settled && candidate_from_system(&candidate, reasons))
        good = take(&candidate, library, reasons, &settled);
    return good;
}

void python_entered(void) { shared.inside++; }

void python_left(void) { shared.inside--; }

bool python_is_orphaned(void) { return shared.orphaned; }

bool python_after_fork(void) {
    pthread_mutex_init(&shared.lock, NULL);
    /* os.fork() puts Python in order for the child, and has its lock. Else nobody may have it: in a process whose Python
     * is the FMUs' own that is so while no call uses it. */
    bool held = shared.has_lock && shared.has_lock(), own = !shared.has_lock || shared.started_by_us;
    bool usable = held || (own && !shared.inside);
    shared.inside = 0;
    if (usable && !shared.orphaned) return true;
    shared.orphaned = true;
    python_ready = false;
    return false;
}

/* At a thread's end. Python's own note of the state may be gone already, so that it cannot be released by it. */
static void delete_state(void *state) {
    if (!python_alive()) return;
    python_entered();
    py.PyEval_RestoreThread(state);
    py.PyThreadState_Clear(state);
    py.PyThreadState_DeleteCurrent();
    python_left();
}

/* Let go of the GIL if the calling thread has it, so that no thread waits for it with the lock that this one wants. */
static void *gil_released(void **restore) {
    int (*initialized)(void) = (int (*)(void))dlsym(RTLD_DEFAULT, "Py_IsInitialized");
    int (*held)(void) = (int (*)(void))dlsym(RTLD_DEFAULT, "PyGILState_Check");
    void *(*save)(void) = (void *(*)(void))dlsym(RTLD_DEFAULT, "PyEval_SaveThread");
    *restore = dlsym(RTLD_DEFAULT, "PyEval_RestoreThread");
    return initialized && held && save && *restore && initialized() && held() ? save() : NULL;
}

bool python_start(const Description *description, char *reason, size_t size, char *warning, size_t warning_size) {
    Reasons reasons = {reason, size, 0};
    *reason = *warning = '\0';
    if (!python_ready) {
        void *restore, *state = gil_released(&restore);
        pthread_mutex_lock(&shared.lock);
        bool found = python_ready || find(description, &reasons, warning, warning_size);
        shared.has_lock = py.PyGILState_Check;
        if (!python_ready && found) {
            if (!shared.has_key) shared.has_key = pthread_key_create(&shared.kept_state, delete_state) == 0;
            if (!shared.has_key) add_reason(&reasons, "the process has no key for thread-specific data left");
            python_ready = shared.has_key;
        }
        pthread_mutex_unlock(&shared.lock);
        if (state) ((void (*)(void *))restore)(state);
    }
    if (!python_ready) return false;
    if (!python_alive()) return add_reason(&reasons, "the process's Python has ended"), false;
    return true;
}

void python_keep_thread(void) {
    if (py.PyGILState_GetThisThreadState()) return; /* the host's, or one that is kept already */
    py.PyGILState_Ensure();
    pthread_setspecific(shared.kept_state, py.PyEval_SaveThread());
}

void python_drop_thread(void) {
    void *state = python_ready ? pthread_getspecific(shared.kept_state) : NULL;
    if (!state || !python_alive() || py.PyGILState_Check()) return;
    pthread_setspecific(shared.kept_state, NULL);
    /* Counted down, not deleted: the host may have entered Python with it too. */
    py.PyEval_RestoreThread(state);
    py.PyGILState_Release(1 /* PyGILState_UNLOCKED */);
}
