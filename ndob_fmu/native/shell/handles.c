/* Handles: names of objects. No name is used twice, so that a host may come with one that was freed, or is another FMU's,
 * or was never one. Besides this table an FMU writes only the tuning that observers share outside the blocks of its
 * instances. With NDOB_NO_HANDLES it writes nothing there: a
 * handle is the object's address, and a host must not come with a wrong one. */
#include "shell.h"

#ifdef NDOB_NO_HANDLES

void *handle_new(Table table, void *object) { return (void)table, object; }
void *handle_enter(Table table, const void *handle) { return (void)table, (void *)(uintptr_t)handle; }
void handle_leave(Table table, const void *handle) { (void)table, (void)handle; }
void handle_free(Table table, const void *handle) { (void)table, (void)handle; }
const void *handle_at(Table table, size_t place) { return (void)table, (void)place, NULL; }

#else

#if defined(__STDC_VERSION__) && __STDC_VERSION__ >= 201112L && !defined(__STDC_NO_ATOMICS__)
#include <stdatomic.h>
typedef _Atomic uintptr_t Word;
static uintptr_t load(const Word *word) { return atomic_load_explicit(word, memory_order_acquire); }
static void store(Word *word, uintptr_t value) { atomic_store_explicit(word, value, memory_order_release); }
static uintptr_t count_up(Word *word) { return atomic_fetch_add(word, 1) + 1; }
static bool claim(Word *word) {
    uintptr_t is_free = 0;
    return atomic_compare_exchange_strong_explicit(word, &is_free, 1, memory_order_acquire, memory_order_relaxed);
}
#else /* C99 has no atomic types: one thread at a time may make and free instances */
typedef volatile uintptr_t Word;
static uintptr_t load(const Word *word) { return *word; }
static void store(Word *word, uintptr_t value) { *word = value; }
static uintptr_t count_up(Word *word) { return *word += 1; }
static bool claim(Word *word) {
    if (*word) return false;
    *word = 1;
    return true;
}
#endif

static struct {
    Word handle; /* 0 while the slot is free */
    Word busy;
    void *object;
} slots[2][SLOTS];
static Word serial;

static uint64_t mixed(uint64_t x) {
    /* The finaliser of splitmix64. */
    x ^= x >> 30;
    x *= 0xbf58476d1ce4e5b9u;
    x ^= x >> 27;
    x *= 0x94d049bb133111ebu;
    return x ^ (x >> 31);
}

void *handle_new(Table table, void *object) {
    for (size_t i = 0; i < SLOTS; i++) {
        if (load(&slots[table][i].handle) || !claim(&slots[table][i].busy)) continue;
        if (!load(&slots[table][i].handle)) {
            /* Counted, so never the same twice; from a start that two loaded FMUs do not share. */
            uintptr_t name = ((uintptr_t)mixed((uintptr_t)&slots[table]) + count_up(&serial)) << SLOT_BITS | i;
            while (!name) name = ((uintptr_t)mixed((uintptr_t)&slots[table]) + count_up(&serial)) << SLOT_BITS | i;
            slots[table][i].object = object;
            store(&slots[table][i].handle, name);
            store(&slots[table][i].busy, 0);
            return (void *)name;
        }
        store(&slots[table][i].busy, 0);
    }
    return NULL;
}

void *handle_enter(Table table, const void *handle) {
    size_t i = (uintptr_t)handle & (SLOTS - 1);
    do {
        if (!handle || load(&slots[table][i].handle) != (uintptr_t)handle) return NULL;
        if (claim(&slots[table][i].busy)) break;
        /* Two instances may use one state at once; no host may call one instance twice at once. */
        if (table == INSTANCE_HANDLES) return NULL;
    } while (true);
    /* Since the look the object may have been freed, and another may have taken its slot. */
    if (load(&slots[table][i].handle) == (uintptr_t)handle) return slots[table][i].object;
    store(&slots[table][i].busy, 0);
    return NULL;
}

const void *handle_at(Table table, size_t place) {
    return place < SLOTS ? (const void *)load(&slots[table][place].handle) : NULL;
}

void handle_leave(Table table, const void *handle) {
    store(&slots[table][(uintptr_t)handle & (SLOTS - 1)].busy, 0);
}

void handle_free(Table table, const void *handle) {
    size_t i = (uintptr_t)handle & (SLOTS - 1);
    slots[table][i].object = NULL;
    store(&slots[table][i].handle, 0);
    store(&slots[table][i].busy, 0);
}

#endif
