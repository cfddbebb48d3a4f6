/* What the host takes from Linux, with Windows' own functions. Arguments and paths are UTF-8. */
#ifndef NDOB_HOST_WINDOWS_H
#define NDOB_HOST_WINDOWS_H

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <windows.h>

#define RTLD_NOW 0
#define RTLD_LOCAL 0
#define RTLD_DEFAULT NULL

static void *dlopen(const char *path, int flags) {
    wchar_t name[4096];
    (void)flags;
    MultiByteToWideChar(CP_UTF8, 0, path, -1, name, 4096);
    for (wchar_t *c = name; *c; c++)
        if (*c == L'/') *c = L'\\';
    return LoadLibraryExW(name, NULL, LOAD_WITH_ALTERED_SEARCH_PATH);
}

static void *dlsym(void *library, const char *name) { return (void *)GetProcAddress(library, name); }

static const char *dlerror(void) {
    static char text[64];
    snprintf(text, sizeof text, "error %lu of Windows", GetLastError());
    return text;
}

static char *strsep(char **text, const char *separators) {
    char *begin = *text;
    if (!begin) return NULL;
    char *end = begin + strcspn(begin, separators);
    *text = *end ? end + 1 : NULL;
    *end = '\0';
    return begin;
}

static int feenableexcept(int exceptions) { return (void)exceptions, 0; }

/* The command line as UTF-8, in place of the code page that main gets it in. */
static char **utf8_words(int *count) {
    wchar_t **wide = CommandLineToArgvW(GetCommandLineW(), count);
    char **words = calloc((size_t)*count + 1, sizeof *words);
    for (int i = 0; i < *count; i++) {
        int size = WideCharToMultiByte(CP_UTF8, 0, wide[i], -1, NULL, 0, NULL, NULL);
        words[i] = malloc((size_t)size);
        WideCharToMultiByte(CP_UTF8, 0, wide[i], -1, words[i], size, NULL, NULL);
    }
    return words;
}

#endif
