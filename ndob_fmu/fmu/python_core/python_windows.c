/* The Python of a Windows process: the one that it has, else the one that NDOB_FMU_PYTHON names, the one that built the
 * FMU, or the one whose folder is on PATH.
 *
 * pythonfmu's binary needs python3.dll, which passes its calls on to python3<minor>.dll beside it. A library of that
 * name that is loaded already serves. */
#include "interpreters.h"
#include "../shell/windows_text.h"

#include <stdlib.h>
#include <string.h>

#define NEWEST_MINOR 40
#define FORWARDER "python3.dll"

static Lock starting = UNLOCKED;
static bool started_by_us;

void python_note_started(void) { started_by_us = true; }
bool python_was_started_by_an_fmu(void) { return started_by_us; }

/* Windows has no fork. */
void python_entered(void) {}
void python_left(void) {}
bool python_is_orphaned(void) { return false; }
bool python_after_fork(void) { return true; }

/* Calls make a thread state of their own each time, as pythonfmu's binary does where none is kept. */
void python_keep_thread(void) {}
void python_drop_thread(void) {}

static HMODULE loaded(const char *path) {
    wchar_t *name = wide(path);
    for (wchar_t *c = name; c && *c; c++) /* with slashes Windows would not look beside it */
        if (*c == L'/') *c = L'\\';
    HMODULE library = name ? LoadLibraryExW(name, NULL, LOAD_WITH_ALTERED_SEARCH_PATH) : NULL;
    free(name);
    return library;
}

/* Write the folder that a library lies in. */
static bool folder_of(HMODULE library, char *folder, size_t size) {
    wchar_t path[PATH_MAX * 4];
    DWORD length = GetModuleFileNameW(library, path, sizeof path / sizeof *path);
    wchar_t *end = length && length < sizeof path / sizeof *path ? wcsrchr(path, L'\\') : NULL;
    if (!end) return false;
    *end = L'\0';
    char *text = narrow(path);
    bool fits = text && (size_t)snprintf(folder, size, "%s", text) < size;
    free(text);
    return fits;
}

/* Return the python3<minor>.dll that the process has, or NULL. */
static HMODULE present(void) {
    for (int minor = 0; minor <= NEWEST_MINOR; minor++) {
        wchar_t name[32];
        swprintf(name, sizeof name / sizeof *name, L"python3%d.dll", minor);
        HMODULE library = GetModuleHandleW(name);
        if (library) return library;
    }
    return NULL;
}

/* Write the folder of the installation that an interpreter belongs to: its own, or its virtual environment's home. */
static bool home_of(const char *executable, char *home, size_t size) {
    char folder[PATH_MAX], path[PATH_MAX + 32], line[PATH_MAX];
    snprintf(folder, sizeof folder, "%s", executable);
    char *end = folder + strlen(folder);
    while (end > folder && *end != '/' && *end != '\\') end--;
    *end = '\0';
    snprintf(path, sizeof path, "%s\\..\\pyvenv.cfg", folder);
    FILE *settings = file_open(path);
    bool found = false;
    while (settings && !found && fgets(line, sizeof line, settings)) {
        line[strcspn(line, "\r\n")] = '\0';
        const char *value = line + strspn(line, " ");
        if (strncmp(value, "home", 4) != 0) continue;
        value += 4 + strspn(value + 4, " ");
        if (*value++ != '=') continue;
        snprintf(home, size, "%s", value + strspn(value, " "));
        found = true;
    }
    if (settings) fclose(settings);
    if (!found) snprintf(home, size, "%s", folder);
    snprintf(path, sizeof path, "%s\\" FORWARDER, home);
    return can_read(path);
}

/* Load the library of the Python in the folder, and the forwarder, which does not look for it beside itself. */
static HMODULE installed(const char *home) {
    char path[PATH_MAX + 32];
    HMODULE library = NULL;
    for (int minor = OLDEST_MINOR; minor <= NEWEST_MINOR && !library; minor++) {
        snprintf(path, sizeof path, "%s\\python3%d.dll", home, minor);
        if (can_read(path)) library = loaded(path);
    }
    snprintf(path, sizeof path, "%s\\" FORWARDER, home);
    return library && loaded(path) ? library : NULL;
}

/* Start the Python of the installation that `executable` belongs to. */
static bool take(const char *executable, const char *packages, Reasons *reasons) {
    char home[PATH_MAX];
    if (!can_read(executable)) return add_reason(reasons, "%s cannot be read", executable), false;
    if (!home_of(executable, home, sizeof home))
        return add_reason(reasons, "%s has no " FORWARDER " in its installation", executable), false;
    HMODULE library = installed(home);
    if (!library) return add_reason(reasons, "%s: error %lu of Windows", home, GetLastError()), false;
    Candidate candidate = {0};
    snprintf(candidate.executable, PATH_MAX, "%s", executable);
    snprintf(candidate.library, PATH_MAX, "%s", home);
    snprintf(candidate.packages, PATH_MAX, "%s", packages);
    return python_use(library, &candidate, reasons);
}

/* The host's Python; the forwarder beside it is loaded too. */
static bool use_present(HMODULE library, Reasons *reasons) {
    char folder[PATH_MAX], path[PATH_MAX + 32];
    if (!folder_of(library, folder, sizeof folder)) return add_reason(reasons, "the process's Python lies nowhere"), false;
    snprintf(path, sizeof path, "%s\\" FORWARDER, folder);
    if (!loaded(path)) return add_reason(reasons, "%s cannot be opened", path), false;
    Candidate candidate = {0};
    snprintf(candidate.library, PATH_MAX, "%s", path);
    snprintf(path, sizeof path, "%s\\python.exe", folder);
    if (can_read(path)) snprintf(candidate.executable, PATH_MAX, "%s", path);
    return python_use(library, &candidate, reasons);
}

static char *variable(void) {
    const wchar_t *value = _wgetenv(L"" VARIABLE);
    return value && *value ? narrow(value) : NULL;
}

static bool find(const Description *description, Reasons *reasons, char *warning, size_t warning_size) {
    HMODULE library = present();
    if (library) return use_present(library, reasons);
    char *named = variable();
    bool good = named && take(named, "", reasons);
    if (named && !good) snprintf(warning, warning_size, VARIABLE " is passed over: %s", reasons->text);
    free(named);
    if (good || present()) return good;
    const char *executable = description_value(description, "python");
    if (*executable && can_read(executable)) {
        if (take(executable, description_value(description, "packages"), reasons)) return true;
        if (present()) return false;
    }
    char folder[PATH_MAX];
    HMODULE forwarder = LoadLibraryW(L"" FORWARDER);
    if (!forwarder || !folder_of(forwarder, folder, sizeof folder))
        return add_reason(reasons, "no " FORWARDER " on PATH"), false;
    if (!(library = installed(folder))) return add_reason(reasons, "%s has no Python of 3.10 or later", folder), false;
    return use_present(library, reasons);
}

bool python_start(const Description *description, char *reason, size_t size, char *warning, size_t warning_size) {
    Reasons reasons = {reason, size, 0};
    *reason = *warning = '\0';
    if (!python_ready) {
        /* A thread that waits here with the GIL would keep it from the one that starts. */
        HMODULE library = present();
        int (*initialized)(void) = library ? (int (*)(void))library_symbol(library, "Py_IsInitialized") : NULL;
        int (*held)(void) = library ? (int (*)(void))library_symbol(library, "PyGILState_Check") : NULL;
        void *(*save)(void) = library ? (void *(*)(void))library_symbol(library, "PyEval_SaveThread") : NULL;
        void (*restore)(void *) = library ? (void (*)(void *))library_symbol(library, "PyEval_RestoreThread") : NULL;
        void *state = initialized && held && save && restore && initialized() && held() ? save() : NULL;
        lock_acquire(&starting);
        if (!python_ready) python_ready = find(description, &reasons, warning, warning_size);
        lock_release(&starting);
        if (state) restore(state);
    }
    if (!python_ready) return false;
    if (!python_alive()) return add_reason(&reasons, "the process's Python has ended"), false;
    return true;
}

/* Ctrl-C comes in a thread of its own on Windows, and Python notes it there. */
void interrupts_hold_back(void) {}
void interrupts_give_back(void) {}
void interrupts_begin(void) {}
void interrupts_end(void) {}
