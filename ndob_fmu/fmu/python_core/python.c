/* The process's Python, once it is found: started where it was not, asked and called. python_linux.c and
 * python_windows.c find it.
 *
 * Python is never ended: its threads and NumPy's cannot be stopped safely in somebody else's process. */
#define _GNU_SOURCE
#include "interpreters.h"

#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <wchar.h>

struct Python py;
_Atomic bool python_ready;

void add_reason(Reasons *reasons, const char *format, ...) {
    va_list arguments;
    va_start(arguments, format);
    if (reasons->used)
        reasons->used += (size_t)snprintf(reasons->text + reasons->used, reasons->size - reasons->used, "; ");
    if (reasons->used < reasons->size)
        reasons->used +=
            (size_t)vsnprintf(reasons->text + reasons->used, reasons->size - reasons->used, format, arguments);
    va_end(arguments);
    if (reasons->used >= reasons->size) reasons->used = reasons->size - 1;
}

static bool symbols(void *library, Reasons *reasons) {
#define F(result, name, arguments) \
    if (!(py.name = (result(*) arguments)library_symbol(library, #name))) \
        return add_reason(reasons, "the process's Python has no " #name), false;
    PYTHON_FUNCTIONS(F)
#undef F
    py.is_finalizing = (int (*)(void))library_symbol(library, "Py_IsFinalizing");
    if (!py.is_finalizing) py.is_finalizing = (int (*)(void))library_symbol(library, "_Py_IsFinalizing");
    return true;
}

/* CPython's own structures; theirs is the beginning that has been the same since 3.8. */
typedef struct {
    int config_init, parse_argv, isolated, use_environment, configure_locale, coerce_c_locale, coerce_c_locale_warn;
#ifdef _WIN32
    int legacy_file_names;
#endif
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
    int (*is_exception)(PyStatus) = (int (*)(PyStatus))library_symbol(library, "PyStatus_Exception");
    if (is_exception && !is_exception(status)) return false;
    add_reason(reasons, "%s does not start (%s)", what, status.message ? status.message : "no reason given");
    return true;
}

/* Python 3.14 and later, PEP 741. */
static bool initialize_by_name(void *library, const Candidate *candidate, Reasons *reasons) {
    void *(*create)(void) = (void *(*)(void))library_symbol(library, "PyInitConfig_Create");
    int (*set_integer)(void *, const char *, int64_t) =
        (int (*)(void *, const char *, int64_t))library_symbol(library, "PyInitConfig_SetInt");
    int (*set_text)(void *, const char *, const char *) =
        (int (*)(void *, const char *, const char *))library_symbol(library, "PyInitConfig_SetStr");
    int (*start)(void *) = (int (*)(void *))library_symbol(library, "Py_InitializeFromInitConfig");
    int (*get_error)(void *, const char **) = (int (*)(void *, const char **))library_symbol(library, "PyInitConfig_GetError");
    void (*release)(void *) = (void (*)(void *))library_symbol(library, "PyInitConfig_Free");
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
    void (*default_pre)(PyPreConfig *) = (void (*)(PyPreConfig *))library_symbol(library, "PyPreConfig_InitIsolatedConfig");
    PyStatus (*pre_initialize)(const PyPreConfig *) =
        (PyStatus (*)(const PyPreConfig *))library_symbol(library, "Py_PreInitialize");
    void (*default_config)(void *) = (void (*)(void *))library_symbol(library, "PyConfig_InitIsolatedConfig");
    PyStatus (*start)(void *) = (PyStatus (*)(void *))library_symbol(library, "Py_InitializeFromConfig");
    void (*clear)(void *) = (void (*)(void *))library_symbol(library, "PyConfig_Clear");
    wchar_t *(*decode)(const char *, size_t *) =
        (wchar_t * (*)(const char *, size_t *)) library_symbol(library, "Py_DecodeLocale");
    void (*set_program)(const wchar_t *) = (void (*)(const wchar_t *))library_symbol(library, "Py_SetProgramName");
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
    bool named = library_symbol(library, "PyInitConfig_Create") != NULL;
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

bool python_use(void *library, const Candidate *candidate, Reasons *reasons) {
    if (!symbols(library, reasons)) return false;
    if (!py.Py_IsInitialized()) {
        if (!initialize(library, candidate, reasons)) return false;
        python_note_started();
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

bool python_is_the_hosts(void) { return py.Py_IsInitialized && py.Py_IsInitialized() && !python_was_started_by_an_fmu(); }

bool python_alive(void) { return python_ready && py.Py_IsInitialized() && !(py.is_finalizing && py.is_finalizing()); }

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

void python_leave(void) { python_ready = false; }
