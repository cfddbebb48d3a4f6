/* pythonfmu's binary on Windows, and the location of its resources. It takes a path that is UTF-8 for Python and in the
 * system's code page for the file that it opens: only ASCII is both. */
#include "pythonfmu.h"

#include "../shell/windows_text.h"

#include <stdlib.h>
#include <string.h>

#define SLAVE_BINARY L"pythonfmu-export.dll"

/* This library stays loaded: instances and Python's threads may outlive the host's handle of it. */
static HMODULE own_module(void) {
    HMODULE own = NULL;
    DWORD flags = GET_MODULE_HANDLE_EX_FLAG_FROM_ADDRESS | GET_MODULE_HANDLE_EX_FLAG_PIN;
    GetModuleHandleExW(flags, (const wchar_t *)(void *)&core, &own);
    return own;
}

void *slave_library(char *reason, size_t size) {
    wchar_t path[32768];
    DWORD length = GetModuleFileNameW(own_module(), path, 32768);
    wchar_t *name = length && length < 32768 ? wcsrchr(path, L'\\') : NULL;
    HMODULE library = NULL;
    if (name && name - path + sizeof SLAVE_BINARY / sizeof *name < 32768) {
        wcscpy(name + 1, SLAVE_BINARY);
        library = LoadLibraryExW(path, NULL, LOAD_WITH_ALTERED_SEARCH_PATH);
    }
    if (!library)
        snprintf(reason, size,
                 "error %lu of Windows; likely cause: the Visual C++ runtime (msvcp140.dll, vcruntime140_1.dll) is missing",
                 GetLastError());
    return library;
}

void *library_symbol(void *library, const char *name) { return (void *)GetProcAddress(library, name); }
void library_close(void *library) { FreeLibrary(library); }

/* Its static objects are destroyed when the process ends, with no thread left and in an order of Windows' own. */
void at_end(void (*finish)(void)) { (void)finish; }

static DWORD short_path(const wchar_t *path, wchar_t *buffer, DWORD size) {
    return GetShortPathNameW(path, buffer, size);
}

static bool is_ascii(const char *text) {
    while (*text)
        if ((unsigned char)*text++ >= 0x80) return false;
    return true;
}

char *slave_location(const char *folder, int *handle, char *reason, size_t size) {
    *handle = -1;
    char *path = NULL;
    if (is_ascii(folder) && !strstr(folder, "%20")) {
        path = _strdup(folder);
    } else {
        wchar_t *given = wide(folder), *brief = given ? filled(short_path, given) : NULL;
        path = brief ? narrow(brief) : NULL;
        free(given);
        free(brief);
    }
    char *location = NULL;
    if (path && is_ascii(path) && !strstr(path, "%20") && (location = malloc(strlen(path) + sizeof FILE_SCHEME))) {
        sprintf(location, FILE_SCHEME "%s", path);
        for (char *c = location; *c; c++)
            if (*c == '\\') *c = '/';
    } else {
        snprintf(reason, size,
                 "expected an FMU unpacked to a folder that has a name in ASCII, received \"%s\"; likely cause: a drive "
                 "without short (8.3) names; unpack it elsewhere",
                 folder);
    }
    free(path);
    return location;
}

void slave_location_close(int handle) { (void)handle; }
