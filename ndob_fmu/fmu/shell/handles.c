/* Handles: 64-bit names of objects. A slot's memory is never given back and a name never used twice, so that a host may
 * come with a handle that was freed, or is another FMU's, or was never one. */
#include "shell.h"

#include <stdlib.h>

static Lock lock = UNLOCKED;
static uint64_t serial;

#define SLOT_BITS 16
#define SLOTS ((size_t)1 << SLOT_BITS)

static uint64_t mixed(uint64_t x) {
    /* The finaliser of splitmix64. */
    x ^= x >> 30;
    x *= 0xbf58476d1ce4e5b9u;
    x ^= x >> 27;
    x *= 0x94d049bb133111ebu;
    return x ^ (x >> 31);
}

void *handle_new(Handles *handles, void *object) {
    lock_acquire(&lock);
    Slot *found = NULL;
    uintptr_t index = 0;
    for (; handles->next < SLOTS && !found; handles->next++) {
        index = handles->next;
        Slot *chunk = atomic_load(&handles->chunks[index / SLOTS_PER_CHUNK]);
        if (!chunk) {
            chunk = calloc(SLOTS_PER_CHUNK, sizeof *chunk);
            if (!chunk) break;
            atomic_store(&handles->chunks[index / SLOTS_PER_CHUNK], chunk);
        }
        if (!atomic_load(&chunk[index % SLOTS_PER_CHUNK].handle)) found = &chunk[index % SLOTS_PER_CHUNK];
    }
    uintptr_t handle = 0;
    if (found) {
        /* Counted, so never the same twice; from a start that the handles of two loaded FMUs do not share. */
        handle = (mixed((uintptr_t)handles) + ++serial) << SLOT_BITS | index;
        if (!handle) handle = (mixed((uintptr_t)handles) + ++serial) << SLOT_BITS | index;
        found->object = object;
        atomic_flag_clear(&found->busy);
        atomic_store(&found->handle, handle);
    }
    lock_release(&lock);
    return (void *)handle;
}

Slot *handle_slot(Handles *handles, const void *handle) {
    uintptr_t index = (uintptr_t)handle & (SLOTS - 1);
    Slot *chunk = atomic_load_explicit(&handles->chunks[index / SLOTS_PER_CHUNK], memory_order_acquire);
    if (!chunk || !handle) return NULL;
    Slot *slot = &chunk[index % SLOTS_PER_CHUNK];
    return atomic_load_explicit(&slot->handle, memory_order_acquire) == (uintptr_t)handle ? slot : NULL;
}

void handles_each(Handles *handles, void (*function)(Slot *)) {
    for (size_t i = 0; i < SLOTS; i++) {
        Slot *chunk = atomic_load(&handles->chunks[i / SLOTS_PER_CHUNK]);
        if (chunk && atomic_load(&chunk[i % SLOTS_PER_CHUNK].handle)) function(&chunk[i % SLOTS_PER_CHUNK]);
    }
}

void handles_after_fork(void) { lock_renew(&lock); }

void handle_free(Handles *handles, Slot *slot) {
    lock_acquire(&lock);
    uintptr_t index = (uintptr_t)atomic_load(&slot->handle) & (SLOTS - 1);
    if (index < handles->next) handles->next = index;
    slot->object = NULL;
    atomic_store(&slot->handle, 0);
    lock_release(&lock);
}
