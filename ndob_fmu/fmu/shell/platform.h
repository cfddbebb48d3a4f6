/* What each system does in a way of its own: platform_linux.c, platform_windows.c. Paths are UTF-8 everywhere. */
#ifndef NDOB_PLATFORM_H
#define NDOB_PLATFORM_H

#include <stdbool.h>
#include <stddef.h>
#include <stdio.h>

#ifdef _WIN32
typedef struct {
    void *word;
} Lock;
#define UNLOCKED {NULL}
char *strsep(char **text, const char *separators);
#else
#include <pthread.h>
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

#endif
