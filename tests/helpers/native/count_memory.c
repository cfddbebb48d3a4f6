/* Preloaded into a process, this counts the blocks of memory that it asks for: host.c's `play` and `memory` print the number. */
#include <stdatomic.h>
#include <stddef.h>

extern void *__libc_malloc(size_t size);
extern void *__libc_calloc(size_t count, size_t size);
extern void *__libc_realloc(void *block, size_t size);

static atomic_ulong asked;

unsigned long blocks_asked_for(void) { return atomic_load(&asked); }

void *malloc(size_t size) {
    atomic_fetch_add(&asked, 1);
    return __libc_malloc(size);
}

void *calloc(size_t count, size_t size) {
    atomic_fetch_add(&asked, 1);
    return __libc_calloc(count, size);
}

void *realloc(void *block, size_t size) {
    atomic_fetch_add(&asked, 1);
    return __libc_realloc(block, size);
}
