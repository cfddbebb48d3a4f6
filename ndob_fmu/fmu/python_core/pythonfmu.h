/* pythonfmu's binary, which runs the slave: pythonfmu_linux.c, pythonfmu_windows.c. */
#ifndef NDOB_PYTHONFMU_H
#define NDOB_PYTHONFMU_H

#include "python.h"

#ifdef _WIN32
#define FILE_SCHEME "file:///"
#else
#define FILE_SCHEME "file://"
#endif

/* Open pythonfmu's binary, which lies beside this library; NULL with the reason. */
void *slave_library(char *reason, size_t size);
/* Have this called before the static objects of pythonfmu's binary are destroyed, where that is needed. */
void at_end(void (*finish)(void));

/* Return the resource location (malloc) in the form in which pythonfmu's binary can read it, or NULL with the reason. It
 * begins with FILE_SCHEME. `handle` stays open as long as the location is used, or is -1. */
char *slave_location(const char *folder, int *handle, char *reason, size_t size);
void slave_location_close(int handle);

#endif
