/* Between python.c, which starts a Python and calls it, and what finds one on each system. */
#ifndef NDOB_INTERPRETERS_H
#define NDOB_INTERPRETERS_H

#include "python.h"

#include <limits.h>
#include <sys/types.h>

#define VARIABLE "NDOB_FMU_PYTHON"
#define OLDEST_MINOR 10

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

struct Python {
#define F(result, name, arguments) result(*name) arguments;
    PYTHON_FUNCTIONS(F)
#undef F
    int (*is_finalizing)(void); /* NULL if this Python does not tell */
};
extern struct Python py;
extern _Atomic bool python_ready;

/* An interpreter, its libpython, and the folder that NumPy lies in. */
typedef struct {
    char executable[PATH_MAX], library[PATH_MAX], packages[PATH_MAX];
    int minor; /* of 3.minor; 0 if not known */
} Candidate;

/* Why what was tried does not serve, one after the other. */
typedef struct {
    char *text;
    size_t size, used;
} Reasons;

__attribute__((format(printf, 2, 3))) void add_reason(Reasons *reasons, const char *format, ...);

void *library_symbol(void *library, const char *name);
void library_close(void *library);

/* Start the Python of an open libpython if it does not run, and import NumPy; else give the reasons. */
bool python_use(void *library, const Candidate *candidate, Reasons *reasons);
/* Whether one of these FMUs has started the process's Python. */
void python_note_started(void);
bool python_was_started_by_an_fmu(void);

/* interpreters_linux.c: each fills in a candidate that has what an FMU needs, or returns false with its reasons. */
bool candidate_from_variable(Candidate *candidate, Reasons *reasons); /* NDOB_FMU_PYTHON, which is set */
bool candidate_from_build(Candidate *candidate, const Description *description, Reasons *reasons);
bool candidate_from_system(Candidate *candidate, Reasons *reasons);

#endif
