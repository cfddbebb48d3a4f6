/* Windows' own functions take UTF-16. pythonfmu's binary takes a path that is UTF-8 for Python and in the system's code
 * page for the file that it opens: only ASCII is both. */
#include "windows_text.h"

#include "front.h"

#include <stdlib.h>
#include <string.h>
#include <windows.h>

#define SLAVE_BINARY L"pythonfmu-export.dll"

wchar_t *wide(const char *text) {
    int size = MultiByteToWideChar(CP_UTF8, 0, text, -1, NULL, 0);
    wchar_t *made = malloc((size_t)size * sizeof *made);
    if (made) MultiByteToWideChar(CP_UTF8, 0, text, -1, made, size);
    return made;
}

char *narrow(const wchar_t *text) {
    int size = WideCharToMultiByte(CP_UTF8, 0, text, -1, NULL, 0, NULL, NULL);
    char *made = malloc((size_t)size);
    if (made) WideCharToMultiByte(CP_UTF8, 0, text, -1, made, size, NULL, NULL);
    return made;
}

char *strsep(char **text, const char *separators) {
    char *begin = *text;
    if (!begin) return NULL;
    char *end = begin + strcspn(begin, separators);
    *text = *end ? end + 1 : NULL;
    *end = '\0';
    return begin;
}

void lock_acquire(Lock *lock) { AcquireSRWLockExclusive((PSRWLOCK)lock); }
void lock_release(Lock *lock) { ReleaseSRWLockExclusive((PSRWLOCK)lock); }
void lock_renew(Lock *lock) { *lock = (Lock)UNLOCKED; }

FILE *file_open(const char *path) {
    wchar_t *name = wide(path);
    FILE *file = name ? _wfopen(name, L"rb") : NULL;
    free(name);
    return file;
}

bool can_read(const char *path) {
    FILE *file = file_open(path);
    if (file) fclose(file);
    return file != NULL;
}

/* Return what a function of Windows writes that asks for a buffer, NULL if it fails. */
static wchar_t *filled(DWORD (*function)(const wchar_t *, wchar_t *, DWORD), const wchar_t *argument) {
    DWORD size = function(argument, NULL, 0);
    wchar_t *made = size ? malloc(size * sizeof *made) : NULL;
    if (made && function(argument, made, size) < size) return made;
    free(made);
    return NULL;
}

static DWORD full_path(const wchar_t *path, wchar_t *buffer, DWORD size) {
    return GetFullPathNameW(path, size, buffer, NULL);
}

static DWORD short_path(const wchar_t *path, wchar_t *buffer, DWORD size) {
    return GetShortPathNameW(path, buffer, size);
}

char *real_folder(const char *path) {
    wchar_t *given = wide(path), *full = given ? filled(full_path, given) : NULL;
    DWORD attributes = full ? GetFileAttributesW(full) : INVALID_FILE_ATTRIBUTES;
    bool there = attributes != INVALID_FILE_ATTRIBUTES && (attributes & FILE_ATTRIBUTE_DIRECTORY);
    char *folder = there ? narrow(full) : NULL;
    free(given);
    free(full);
    return folder;
}

/* file:///C:/x means C:/x. */
const char *path_of_uri(const char *rest) {
    bool drive = rest[0] == '/' && ((rest[1] | 0x20) >= 'a' && (rest[1] | 0x20) <= 'z') && rest[2] == ':';
    return drive ? rest + 1 : rest;
}

/* This library stays loaded: instances and Python's threads may outlive the host's handle of it. */
static HMODULE own_module(void) {
    HMODULE own = NULL;
    DWORD flags = GET_MODULE_HANDLE_EX_FLAG_FROM_ADDRESS | GET_MODULE_HANDLE_EX_FLAG_PIN;
    GetModuleHandleExW(flags, (const wchar_t *)(void *)&slave, &own);
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

/* Ctrl-C comes in a thread of its own on Windows, and Python notes it there. */
void interrupts_hold_back(void) {}
void interrupts_give_back(void) {}
void interrupts_begin(void) {}
void interrupts_end(void) {}
