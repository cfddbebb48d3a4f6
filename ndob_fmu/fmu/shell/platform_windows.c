#include "platform.h"
#include "windows_text.h"

#include <stdlib.h>
#include <string.h>

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

wchar_t *filled(DWORD (*function)(const wchar_t *, wchar_t *, DWORD), const wchar_t *argument) {
    DWORD size = function(argument, NULL, 0);
    wchar_t *made = size ? malloc(size * sizeof *made) : NULL;
    if (made && function(argument, made, size) < size) return made;
    free(made);
    return NULL;
}

static DWORD full_path(const wchar_t *path, wchar_t *buffer, DWORD size) {
    return GetFullPathNameW(path, size, buffer, NULL);
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
