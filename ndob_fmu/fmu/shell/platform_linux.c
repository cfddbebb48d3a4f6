#define _GNU_SOURCE
#include "platform.h"

#include <stdlib.h>
#include <unistd.h>

void lock_acquire(Lock *lock) { pthread_mutex_lock(lock); }
void lock_release(Lock *lock) { pthread_mutex_unlock(lock); }
void lock_renew(Lock *lock) { pthread_mutex_init(lock, NULL); }

bool can_read(const char *path) { return access(path, R_OK) == 0; }
FILE *file_open(const char *path) { return fopen(path, "rbe"); }
char *real_folder(const char *path) { return realpath(path, NULL); }
const char *path_of_uri(const char *rest) { return rest; }
