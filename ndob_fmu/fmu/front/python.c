/* A Python with NumPy for the FMU: the one that the process has, else the first suitable one that is found.
 *
 * pythonfmu's binary takes its Python symbols from the global scope. In a host that has none they come from libpython,
 * opened here with RTLD_GLOBAL (as a library that this one needs they would be hidden from NumPy). Python is never
 * ended: its threads and NumPy's cannot be stopped safely in somebody else's process. */
#define _GNU_SOURCE
#include "interpreters.h"

#include <dlfcn.h>
#include <limits.h>
#include <link.h>
#include <pthread.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <wchar.h>

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

/* What is called of Python; each has been there since 3.4 at least. */
typedef struct PyObject PyObject;
#define PYTHON_FUNCTIONS(F) \
    F(int, Py_IsInitialized, (void)) \
    F(const char *, Py_GetVersion, (void)) \
    F(int, PyGILState_Ensure, (void)) \
    F(void, PyGILState_Release, (int)) \
    F(void *, PyGILState_GetThisThreadState, (void)) \
    F(void *, PyEval_SaveThread, (void)) \
    F(void, PyEval_RestoreThread, (void *)) \
    F(int, PyGILState_Check, (void)) \
    F(void, PyThreadState_Clear, (void *)) \
    F(void, PyThreadState_DeleteCurrent, (void)) \
    F(PyObject *, PyImport_ImportModule, (const char *)) \
    F(void, PyErr_Fetch, (PyObject **, PyObject **, PyObject **)) \
    F(void, PyErr_Restore, (PyObject *, PyObject *, PyObject *)) \
    F(void, PyErr_Clear, (void)) \
    F(int, PyErr_CheckSignals, (void)) \
    F(int, Py_AddPendingCall, (int (*)(void *), void *)) \
    F(PyObject *, PyObject_CallMethod, (PyObject *, const char *, const char *, ...)) \
    F(PyObject *, PyObject_Str, (PyObject *)) \
    F(const char *, PyUnicode_AsUTF8AndSize, (PyObject *, ssize_t *)) \
    F(PyObject *, PyUnicode_DecodeFSDefault, (const char *)) \
    F(PyObject *, PyUnicode_FromString, (const char *)) \
    F(PyObject *, PyUnicode_EncodeFSDefault, (PyObject *)) \
    F(char *, PyBytes_AsString, (PyObject *)) \
    F(PyObject *, PySys_GetObject, (const char *)) \
    F(int, PySequence_Contains, (PyObject *, PyObject *)) \
    F(int, PyList_Append, (PyObject *, PyObject *)) \
    F(ssize_t, PySequence_Index, (PyObject *, PyObject *)) \
    F(int, PySequence_DelItem, (PyObject *, ssize_t)) \
    F(void, Py_DecRef, (PyObject *))

static struct {
#define F(result, name, arguments) result(*name) arguments;
    PYTHON_FUNCTIONS(F)
#undef F
    int (*is_finalizing)(void); /* NULL if this Python does not tell */
} py;

static _Atomic bool ready;

static bool symbols(void *library, Reasons *reasons) {
#define F(result, name, arguments) \
    if (!(py.name = (result(*) arguments)dlsym(library, #name))) \
        return add_reason(reasons, "the process's Python has no " #name), false;
    PYTHON_FUNCTIONS(F)
#undef F
    shared.has_lock = py.PyGILState_Check;
    py.is_finalizing = (int (*)(void))dlsym(library, "Py_IsFinalizing");
    if (!py.is_finalizing) py.is_finalizing = (int (*)(void))dlsym(library, "_Py_IsFinalizing");
    return true;
}

/* CPython's own structures; theirs is the beginning that has been the same since 3.8. */
typedef struct {
    int config_init, parse_argv, isolated, use_environment, configure_locale, coerce_c_locale, coerce_c_locale_warn;
    int utf8_mode, dev_mode, allocator;
    int reserved[16];
} PyPreConfig;
typedef struct {
    int type;
    const char *function, *message;
    int exit_code;
} PyStatus;
#define LARGER_THAN_ANY_CONFIG 16384

static bool failed(void *library, PyStatus status, const char *what, Reasons *reasons) {
    int (*is_exception)(PyStatus) = (int (*)(PyStatus))dlsym(library, "PyStatus_Exception");
    if (is_exception && !is_exception(status)) return false;
    add_reason(reasons, "%s does not start (%s)", what, status.message ? status.message : "no reason given");
    return true;
}

/* Python 3.14 and later, PEP 741. */
static bool initialize_by_name(void *library, const Candidate *candidate, Reasons *reasons) {
    void *(*create)(void) = (void *(*)(void))dlsym(library, "PyInitConfig_Create");
    int (*set_integer)(void *, const char *, int64_t) =
        (int (*)(void *, const char *, int64_t))dlsym(library, "PyInitConfig_SetInt");
    int (*set_text)(void *, const char *, const char *) =
        (int (*)(void *, const char *, const char *))dlsym(library, "PyInitConfig_SetStr");
    int (*start)(void *) = (int (*)(void *))dlsym(library, "Py_InitializeFromInitConfig");
    int (*get_error)(void *, const char **) = (int (*)(void *, const char **))dlsym(library, "PyInitConfig_GetError");
    void (*release)(void *) = (void (*)(void *))dlsym(library, "PyInitConfig_Free");
    void *config = create && set_integer && set_text && start && get_error && release ? create() : NULL;
    if (!config) return add_reason(reasons, "%s cannot be configured", candidate->library), false;
    bool good = set_integer(config, "utf8_mode", 1) == 0
                && (!*candidate->executable || set_text(config, "program_name", candidate->executable) == 0)
                && start(config) == 0;
    const char *message = NULL;
    if (!good) {
        get_error(config, &message);
        add_reason(reasons, "%s does not start (%s)", candidate->library, message ? message : "no reason given");
    }
    release(config);
    return good;
}

static bool initialize_by_structure(void *library, const Candidate *candidate, Reasons *reasons) {
    void (*default_pre)(PyPreConfig *) = (void (*)(PyPreConfig *))dlsym(library, "PyPreConfig_InitIsolatedConfig");
    PyStatus (*pre_initialize)(const PyPreConfig *) =
        (PyStatus (*)(const PyPreConfig *))dlsym(library, "Py_PreInitialize");
    void (*default_config)(void *) = (void (*)(void *))dlsym(library, "PyConfig_InitIsolatedConfig");
    PyStatus (*start)(void *) = (PyStatus (*)(void *))dlsym(library, "Py_InitializeFromConfig");
    void (*clear)(void *) = (void (*)(void *))dlsym(library, "PyConfig_Clear");
    wchar_t *(*decode)(const char *, size_t *) =
        (wchar_t * (*)(const char *, size_t *)) dlsym(library, "Py_DecodeLocale");
    void (*set_program)(const wchar_t *) = (void (*)(const wchar_t *))dlsym(library, "Py_SetProgramName");
    if (!default_pre || !pre_initialize || !default_config || !start || !clear || !decode || !set_program)
        return add_reason(reasons, "%s cannot be configured", candidate->library), false;
    PyPreConfig before;
    default_pre(&before);
    before.utf8_mode = 1; /* else a host without a locale cannot import from a folder with ä in its name */
    if (failed(library, pre_initialize(&before), candidate->library, reasons)) return false;
    /* The name by which the virtual environment is found; Python keeps the pointer. */
    wchar_t *program = *candidate->executable ? decode(candidate->executable, NULL) : NULL;
    if (program) set_program(program);
    void *config = calloc(1, LARGER_THAN_ANY_CONFIG);
    if (!config) return add_reason(reasons, "no memory"), false;
    default_config(config);
    bool good = !failed(library, start(config), candidate->library, reasons);
    clear(config);
    free(config);
    return good;
}

/* Start Python isolated: no signal handlers, no environment variables, no change of locale. */
static bool initialize(void *library, const Candidate *candidate, Reasons *reasons) {
    bool named = dlsym(library, "PyInitConfig_Create") != NULL;
    return (named ? initialize_by_name : initialize_by_structure)(library, candidate, reasons);
}

/* With the GIL. NumPy's folder may be one that the isolated start leaves out: a user's, or one of PYTHONPATH's. */
static bool import_numpy(const char *packages, Reasons *reasons) {
    PyObject *path = py.PySys_GetObject("path");
    PyObject *folder = *packages ? py.PyUnicode_DecodeFSDefault(packages) : NULL;
    if (path && folder && py.PySequence_Contains(path, folder) == 0) py.PyList_Append(path, folder);
    if (folder) py.Py_DecRef(folder);
    py.PyErr_Clear();
    PyObject *numpy = py.PyImport_ImportModule("numpy");
    if (numpy) return py.Py_DecRef(numpy), true;
    PyObject *type = NULL, *value = NULL, *trace = NULL;
    py.PyErr_Fetch(&type, &value, &trace);
    PyObject *text = value ? py.PyObject_Str(value) : NULL;
    const char *message = text ? py.PyUnicode_AsUTF8AndSize(text, NULL) : NULL;
    int version = (int)strcspn(py.Py_GetVersion(), " ");
    add_reason(reasons, "the process's Python %.*s cannot import NumPy (%.200s)", version, py.Py_GetVersion(),
               message ? message : "no reason given");
    if (text) py.Py_DecRef(text);
    if (type) py.Py_DecRef(type);
    if (value) py.Py_DecRef(value);
    if (trace) py.Py_DecRef(trace);
    py.PyErr_Clear();
    return false;
}

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

static bool use(void *library, const Candidate *candidate, Reasons *reasons) {
    if (!symbols(library, reasons)) return false;
    if (!py.Py_IsInitialized()) {
        if (!initialize(library, candidate, reasons)) return false;
        shared.started_by_us = true;
        bool good = import_numpy(candidate->packages, reasons);
        py.PyEval_SaveThread();
        return good;
    }
    int minor = 0;
    if (sscanf(py.Py_GetVersion(), "3.%d", &minor) != 1 || minor < OLDEST_MINOR)
        return add_reason(reasons, "the process's Python is 3.%d", minor), false;
    int state = py.PyGILState_Ensure();
    bool good = import_numpy("", reasons);
    py.PyGILState_Release(state);
    return good;
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
    return use(library, candidate, reasons);
}

static bool find(const Description *description, Reasons *reasons, char *warning, size_t warning_size) {
    void *library = present();
    if (library) {
        int (*initialized)(void) = (int (*)(void))dlsym(library, "Py_IsInitialized");
        if (initialized && initialized()) return use(library, NULL, reasons);
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
    ready = false;
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
    if (!ready) {
        void *restore, *state = gil_released(&restore);
        pthread_mutex_lock(&shared.lock);
        if (!ready && find(description, &reasons, warning, warning_size)) {
            if (!shared.has_key) shared.has_key = pthread_key_create(&shared.kept_state, delete_state) == 0;
            if (!shared.has_key) add_reason(&reasons, "the process has no key for thread-specific data left");
            ready = shared.has_key;
        }
        pthread_mutex_unlock(&shared.lock);
        if (state) ((void (*)(void *))restore)(state);
    }
    if (!ready) return false;
    if (!python_alive()) return add_reason(&reasons, "the process's Python has ended"), false;
    return true;
}

bool python_is_the_hosts(void) { return py.Py_IsInitialized && py.Py_IsInitialized() && !shared.started_by_us; }

bool python_alive(void) { return ready && py.Py_IsInitialized() && !(py.is_finalizing && py.is_finalizing()); }

void python_keep_thread(void) {
    if (py.PyGILState_GetThisThreadState()) return; /* the host's, or one that is kept already */
    py.PyGILState_Ensure();
    pthread_setspecific(shared.kept_state, py.PyEval_SaveThread());
}

void python_drop_thread(void) {
    void *state = ready ? pthread_getspecific(shared.kept_state) : NULL;
    if (!state || !python_alive() || py.PyGILState_Check()) return;
    pthread_setspecific(shared.kept_state, NULL);
    /* Counted down, not deleted: the host may have entered Python with it too. */
    py.PyEval_RestoreThread(state);
    py.PyGILState_Release(1 /* PyGILState_UNLOCKED */);
}

bool python_finds(const char *folder) {
    int state = py.PyGILState_Ensure();
    PyObject *name = py.PyUnicode_FromString(folder);
    PyObject *bytes = name ? py.PyUnicode_EncodeFSDefault(name) : NULL;
    bool same = bytes && strcmp(py.PyBytes_AsString(bytes), folder) == 0;
    if (bytes) py.Py_DecRef(bytes);
    if (name) py.Py_DecRef(name);
    py.PyErr_Clear();
    py.PyGILState_Release(state);
    return same;
}

void python_forget_path(const char *folder, bool reused) {
    int state = py.PyGILState_Ensure();
    PyObject *path = py.PySys_GetObject("path"), *name = py.PyUnicode_DecodeFSDefault(folder);
    ssize_t index = path && name ? py.PySequence_Index(path, name) : -1;
    if (index >= 0) py.PySequence_DelItem(path, index);
    if (name) py.Py_DecRef(name);
    if (reused) { /* Python would look for the next folder's files in this one's listing */
        PyObject *importlib = py.PyImport_ImportModule("importlib");
        PyObject *done = importlib ? py.PyObject_CallMethod(importlib, "invalidate_caches", NULL) : NULL;
        if (done) py.Py_DecRef(done);
        if (importlib) py.Py_DecRef(importlib);
    }
    py.PyErr_Clear();
    py.PyGILState_Release(state);
}

static PyObject *taken[3]; /* type, value and trace; with the GIL */

void python_take_pending(void) {
    if (!python_alive()) return;
    int state = py.PyGILState_Ensure();
    if (py.PyErr_CheckSignals() != 0 && !taken[0]) py.PyErr_Fetch(&taken[0], &taken[1], &taken[2]);
    py.PyErr_Clear();
    py.PyGILState_Release(state);
}

static int raise_taken(void *unused) {
    (void)unused;
    if (!taken[0]) return 0;
    py.PyErr_Restore(taken[0], taken[1], taken[2]);
    taken[0] = taken[1] = taken[2] = NULL;
    return -1;
}

/* By Python's main thread when it runs the host's code again. */
void python_raise_taken(void) {
    if (taken[0] && python_alive()) py.Py_AddPendingCall(raise_taken, NULL);
}

void python_leave(void) { ready = false; }
