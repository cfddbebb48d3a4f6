/* The block of memory, and how results move in it. */
#include "nd_loops.h"

enum { ND_ALIGNMENT = sizeof(double), LITTLE = 256 };

void nd_start(nd_arena *a, void *block, size_t bytes) {
    uintptr_t odd = (uintptr_t)block % ND_ALIGNMENT, skipped = odd ? ND_ALIGNMENT - odd : 0;
    memset(a, 0, sizeof *a);
    a->base = (char *)block + skipped;
    a->size = bytes > skipped ? bytes - skipped : 0;
}

void *nd_take_bytes(nd_arena *a, size_t bytes) {
    void *p = a->base + a->used;
    bytes = (bytes + ND_ALIGNMENT - 1) / ND_ALIGNMENT * ND_ALIGNMENT;
    if (bytes > a->size - a->used) longjmp(*a->full, 1);
    a->used += bytes;
    return p;
}

void nd_raise(nd_arena *a, int error, const char *format, ...) {
    char text[ND_MESSAGE]; /* the message of the error before may be an argument */
    va_list arguments;
    a->error = error;
    va_start(arguments, format);
    nd_print_of(text, sizeof text, format, arguments);
    va_end(arguments);
    if (a->message) memcpy(a->message, text, sizeof text);
}

static bool is_inside(const nd_arena *a, const void *p, size_t from, size_t to) {
    uintptr_t at = (uintptr_t)p, base = (uintptr_t)a->base;
    return at >= base + from && at < base + to;
}

/* The passes of a move, and the one pass of a copy into another block, with its numbers or with the shapes of arrays
 * alone. */
enum { BEFORE, COUNT, MOVE_UP, SHIFT, COPY, FORMS };
nd_keeping nd_keep_begin(nd_arena *a, size_t mark) { return (nd_keeping){a, mark, a->used, BEFORE, 0}; }
nd_keeping nd_copy_begin(nd_arena *to) { return (nd_keeping){to, 0, 0, COPY, 0}; }
nd_keeping nd_forms_begin(nd_arena *to) { return (nd_keeping){to, 0, 0, FORMS, 0}; }

/* Whether what may be given back is not worth a copy: it is little, or the result is at least half of it. Functions around
 * this one judge again, with what was left here, so that all of it together stays no larger than the result. */
static bool is_enough(const nd_keeping *k) { return k->top - k->mark <= LITTLE || 2 * k->kept >= k->top - k->mark; }

static void end_move(nd_keeping *k) {
    size_t bytes = k->a->used - k->top;
    memmove(k->a->base + k->mark, k->a->base + k->top, bytes);
    k->a->used = k->mark + bytes;
}

/* Begin the next pass; false after the last one. */
bool nd_keep_pass(nd_keeping *k) {
    if (k->pass == SHIFT) end_move(k);
    if (k->pass == SHIFT || (k->pass <= COUNT && is_enough(k))) return false;
    k->pass++;
    return true;
}

/* Copy a block that would be given back behind all others. */
void nd_keep_block(nd_keeping *k, void **p, size_t bytes) {
    if (k->pass == COUNT && is_inside(k->a, *p, k->mark, k->top)) k->kept += bytes;
    if (bytes && (k->pass >= COPY || (k->pass == MOVE_UP && is_inside(k->a, *p, k->mark, k->top)))) {
        void *copy = nd_take_bytes(k->a, bytes);
        memcpy(copy, *p, bytes);
        *p = copy;
    }
}

/* Point to where `end_move` moves the copy. */
void nd_keep_shift(nd_keeping *k, void **p) {
    if (k->pass == SHIFT && is_inside(k->a, *p, k->top, k->a->used)) *p = (char *)*p - (k->top - k->mark);
}

void nd_keep_array(nd_keeping *k, nd *x) {
    void *p;
    if (!*x) return;
    if (k->pass == COUNT) {
        if (is_inside(k->a, (*x)->p, k->mark, k->top)) k->kept += (size_t)nd_size(*x) * sizeof(double);
        if (is_inside(k->a, *x, k->mark, k->top)) k->kept += sizeof **x;
        return;
    }
    if (k->pass == FORMS) {
        *x = nd_form_of(k->a, *x);
        return;
    }
    if (k->pass != SHIFT) {
        if (k->pass == COPY || is_inside(k->a, (*x)->p, k->mark, k->top)) *x = nd_copy(k->a, *x);
        else if (is_inside(k->a, *x, k->mark, k->top)) *x = nd_same_view(k->a, *x);
        return;
    }
    if (!is_inside(k->a, *x, k->top, k->a->used)) return;
    p = (*x)->p;
    nd_keep_shift(k, &p);
    (*x)->p = p;
    p = *x;
    nd_keep_shift(k, &p);
    *x = p;
}

void nd_keep_parts(nd_arena *a, size_t mark, void *x, void (*keep)(nd_keeping *, void *)) {
    for (nd_keeping k = nd_keep_begin(a, mark); nd_keep_pass(&k);) keep(&k, x);
}

/* Whether the numbers follow their view, as `nd_new` puts them. */
static bool is_whole(nd x) { return (void *)x->p == (void *)(x + 1) && nd_is_compact(x); }

nd nd_keep(nd_arena *a, size_t mark, nd x) {
    if (a->used - mark <= LITTLE) return x;
    if (x && is_inside(a, x, mark, a->used) && is_whole(x)) {
        size_t bytes = sizeof *x + (size_t)nd_size(x) * sizeof(double);
        memmove(a->base + mark, x, bytes);
        a->used = mark;
        x = nd_take_bytes(a, bytes);
        x->p = (double *)(void *)(x + 1);
        return x;
    }
    for (nd_keeping k = nd_keep_begin(a, mark); nd_keep_pass(&k);) nd_keep_array(&k, &x);
    return x;
}
