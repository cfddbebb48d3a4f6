/* What each system does in a way of its own: platform_linux.c, platform_windows.c. Paths are UTF-8 everywhere. */
#ifndef NDOB_FRONT_PLATFORM_H
#define NDOB_FRONT_PLATFORM_H

#include <stdbool.h>
#include <stddef.h>
#include <stdio.h>

#ifdef _WIN32
#define FILE_SCHEME "file:///"
typedef struct {
    void *word;
} Lock;
#define UNLOCKED {NULL}
char *strsep(char **text, const char *separators);
#else
#include <pthread.h>
#define FILE_SCHEME "file://"
typedef pthread_mutex_t Lock;
#define UNLOCKED PTHREAD_MUTEX_INITIALIZER
#endif

void lock_acquire(Lock *lock);
void lock_release(Lock *lock);
void lock_renew(Lock *lock); /* in the child of a fork */

bool can_read(const char *path);
FILE *file_open(const char *path); /* to read bytes */
/* Return the absolute path of a folder (malloc), or NULL if there is none. */
char *real_folder(const char *path);
/* Return the path that the rest of a file URI after its authority means, within `rest`. */
const char *path_of_uri(const char *rest);

/* Open pythonfmu's binary, which lies beside this library; NULL with the reason. */
void *slave_library(char *reason, size_t size);
void *library_symbol(void *library, const char *name);
void library_close(void *library);
/* Have this called before the static objects of pythonfmu's binary are destroyed, where that is needed. */
void at_end(void (*finish)(void));

/* Return the resource location (malloc) in the form in which pythonfmu's binary can read it, or NULL with the reason. It
 * begins with FILE_SCHEME. `handle` stays open as long as the location is used, or is -1. */
char *slave_location(const char *folder, int *handle, char *reason, size_t size);
void slave_location_close(int handle);

#endif
