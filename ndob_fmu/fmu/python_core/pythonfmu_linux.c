/* pythonfmu's binary on Linux, and the location of its resources. */
#define _GNU_SOURCE
#include "pythonfmu.h"

#include <dlfcn.h>
#include <fcntl.h>
#include <limits.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#define SLAVE_BINARY "pythonfmu-export.so"

static char own_folder[PATH_MAX];

/* Where this library lies; asked while it is loaded: its name may be relative to a folder that the host leaves. */
__attribute__((constructor)) static void note_own_folder(void) {
    Dl_info self;
    char path[PATH_MAX];
    if (!dladdr((void *)&core, &self) || !realpath(self.dli_fname, path)) return;
    *strrchr(path, '/') = '\0';
    strcpy(own_folder, path);
}

void *slave_library(char *reason, size_t size) {
    char path[PATH_MAX + sizeof SLAVE_BINARY];
    snprintf(path, sizeof path, "%s/" SLAVE_BINARY, own_folder);
    void *library = dlopen(path, RTLD_NOW | RTLD_LOCAL);
    if (!library) snprintf(reason, size, "%s", dlerror());
    return library;
}

void *library_symbol(void *library, const char *name) { return dlsym(library, name); }
void library_close(void *library) { dlclose(library); }

/* In a library: at its unloading or at the end of the process, whichever comes first. */
void at_end(void (*finish)(void)) { atexit(finish); }

/* pythonfmu takes a literal %20 for a space, and decodes UTF-8. */
char *slave_location(const char *folder, int *handle, char *reason, size_t size) {
    char *location = malloc(strlen(folder) + 64);
    if (!location) {
        snprintf(reason, size, "expected memory, received none");
        return NULL;
    }
    if (strstr(folder, "%20") || !python_finds(folder)) {
        *handle = open(folder, O_PATH | O_DIRECTORY | O_CLOEXEC);
        sprintf(location, FILE_SCHEME "/proc/self/fd/%d", *handle);
    } else {
        sprintf(location, FILE_SCHEME "%s", folder);
    }
    return location;
}

void slave_location_close(int handle) {
    if (handle >= 0) close(handle);
}
