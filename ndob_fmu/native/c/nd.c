#include "nd.h"

#include <float.h>
#include <stdarg.h>
#include <stdio.h>

/* Without contraction every product is rounded, as in Python; so results are the same on every processor. */
#if !defined __GNUC__ || defined __clang__ /* gcc does not know it, and has the option -ffp-contract=off */
#pragma STDC FP_CONTRACT OFF
#endif

/* -- memory */

enum { ND_ALIGNMENT = 16 };

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
    if (a->used > a->high) a->high = a->used;
    return p;
}

void nd_raise(nd_arena *a, int error, const char *format, ...) {
    char text[ND_MESSAGE]; /* the message of the error before may be an argument */
    va_list arguments;
    a->error = error;
    va_start(arguments, format);
    (void)vsnprintf(text, sizeof text, format, arguments);
    va_end(arguments);
    memcpy(a->message, text, sizeof text);
}

static bool is_inside(const nd_arena *a, const void *p, size_t from, size_t to) {
    uintptr_t at = (uintptr_t)p, base = (uintptr_t)a->base;
    return at >= base + from && at < base + to;
}

/* Whether a function keeps what it took since a mark, because there is room for four times as much: to give it back takes
   copies of its result. */
bool nd_has_room(const nd_arena *a, size_t mark) { return !a->tight && 4 * (a->used - mark) <= a->size - a->used; }

bool nd_was_tight(nd_arena *a) {
    bool tight = a->tight;
    a->tight = true;
    return tight;
}

nd_keeping nd_keep_begin(nd_arena *a, size_t mark) { return (nd_keeping){a, mark, a->used, 1}; }

/* The one pass of a copy into another block. */
nd_keeping nd_copy_begin(nd_arena *to) { return (nd_keeping){to, 0, 0, 3}; }

void nd_keep_end(nd_keeping *k) {
    size_t bytes = k->a->used - k->top;
    memmove(k->a->base + k->mark, k->a->base + k->top, bytes);
    k->a->used = k->mark + bytes;
}

/* First pass: copy a block that would be given back behind all others. Returns whether a pass copies. */
bool nd_keep_block(nd_keeping *k, void **p, size_t bytes) {
    if (bytes && (k->pass == 3 || (k->pass == 1 && is_inside(k->a, *p, k->mark, k->top)))) {
        void *copy = nd_take_bytes(k->a, bytes);
        memcpy(copy, *p, bytes);
        *p = copy;
    }
    return k->pass != 2;
}

/* Second pass: point to where `nd_keep_end` moves the copy. */
void nd_keep_shift(nd_keeping *k, void **p) {
    if (k->pass == 2 && is_inside(k->a, *p, k->top, k->a->used)) *p = (char *)*p - (k->top - k->mark);
}

static bool is_compact(nd x) {
    if (x->rank == 1) return x->s[0] == 1 || x->n[0] == 1;
    if (x->rank == 2) return (x->s[1] == 1 || x->n[1] == 1) && (x->s[0] == x->n[1] || x->n[0] == 1);
    for (int i = x->rank - 1, s = 1; i >= 0; i--) {
        if (x->s[i] != s && x->n[i] != 1) return false;
        s *= x->n[i];
    }
    return true;
}

static bool same_shape(nd x, nd y) {
    if (x->rank != y->rank) return false;
    for (int i = 0; i < x->rank; i++)
        if (x->n[i] != y->n[i]) return false;
    return true;
}

/* The rows of small arrays are shorter than a call. */
static nd view(nd_arena *a, double *p, int rank) {
    nd x = nd_take_bytes(a, sizeof *x);
    x->p = p;
    x->rank = rank;
    return x;
}

static nd same_view(nd_arena *a, nd x) {
    nd r = view(a, x->p, x->rank);
    for (int i = 0; i < ND_RANK; i++) r->n[i] = x->n[i], r->s[i] = x->s[i];
    return r;
}

void nd_keep_array(nd_keeping *k, nd *x) {
    void *p;
    if (!*x) return;
    if (k->pass != 2) {
        if (k->pass == 3 || is_inside(k->a, (*x)->p, k->mark, k->top)) *x = nd_copy(k->a, *x);
        else if (is_inside(k->a, *x, k->mark, k->top)) *x = same_view(k->a, *x);
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

/* Whether the numbers follow their view, as `nd_new` puts them. */
static bool is_whole(nd x) { return (void *)x->p == (void *)(x + 1) && is_compact(x); }

nd nd_keep(nd_arena *a, size_t mark, nd x) {
    if (nd_has_room(a, mark)) return x;
    nd_keeping k = {a, mark, a->used, 1};
    if (x && is_inside(a, x, mark, a->used) && is_whole(x)) {
        size_t bytes = sizeof *x + (size_t)nd_size(x) * sizeof(double);
        memmove(a->base + mark, x, bytes);
        a->used = mark;
        x = nd_take_bytes(a, bytes);
        x->p = (double *)(void *)(x + 1);
        return x;
    }
    for (; k.pass <= 2; k.pass++) nd_keep_array(&k, &x);
    nd_keep_end(&k);
    return x;
}

static bool is_nan(double x) { return x != x; }

/* -- loops: every array as one of four axes, the first ones of length one */

/* Structures are written in place, entry by entry: processors wait where a copy reads what smaller writes just left. */
typedef struct {
    int n[ND_RANK];
} shape4;

static void shape_of(nd x, shape4 *r) {
    for (int i = 0; i < ND_RANK; i++) {
        int axis = i - ND_RANK + x->rank;
        r->n[i] = axis < 0 ? 1 : x->n[axis];
    }
}

/* The strides of x over a shape, 0 along axes that it does not have or in which its length is one. */
static void strides_over(nd x, const shape4 *over, int *s) {
    for (int i = 0; i < ND_RANK; i++) {
        int axis = i - ND_RANK + x->rank;
        s[i] = axis < 0 || (x->n[axis] == 1 && over->n[i] != 1) ? 0 : x->s[axis];
    }
}

#define ND_LOOP3(o)                           \
    for (int i0 = 0; i0 < (o).n[0]; i0++)     \
        for (int i1 = 0; i1 < (o).n[1]; i1++) \
            for (int i2 = 0; i2 < (o).n[2]; i2++)
#define ND_ROW(x, s) ((x)->p + i0 * (s)[0] + i1 * (s)[1] + i2 * (s)[2])

/* -- making arrays */

nd nd_new(nd_arena *a, int rank, const int *n) {
    nd x = nd_take_bytes(a, sizeof *x);
    int size = 1;
    x->p = (double *)(void *)(x + 1);
    x->rank = rank;
    for (int i = ND_RANK - 1; i >= rank; i--) x->n[i] = x->s[i] = 1;
    for (int i = rank - 1; i >= 0; i--) {
        int length = n[i] > 0 ? n[i] : 0;
        x->n[i] = length;
        x->s[i] = size;
        size *= length;
    }
    (void)nd_take_bytes(a, sizeof(double) * (size_t)(size ? size : 1));
    return x;
}

nd nd_full(nd_arena *a, int rank, const int *n, double value) {
    nd x = nd_new(a, rank, n);
    for (int i = 0, size = nd_size(x); i < size; i++) x->p[i] = value;
    return x;
}

nd nd_full_like(nd_arena *a, nd x, double value) { return nd_full(a, x->rank, x->n, value); }

nd nd_scalar(nd_arena *a, double value) { return nd_full(a, 0, NULL, value); }

nd nd_vector(nd_arena *a, int n, const double *values) {
    nd x = nd_new(a, 1, &n);
    memcpy(x->p, values, sizeof(double) * (size_t)n);
    return x;
}

nd_array nd_around(int n, const double *values) {
    nd_array view = {NULL, 1, {n, 1, 1, 1}, {1, 1, 1, 1}};
    memcpy(&view.p, &values, sizeof values);
    return view;
}

nd nd_view(nd_arena *a, int n, double *values) {
    nd x = view(a, values, 1);
    x->n[0] = n, x->s[0] = 1;
    for (int i = 1; i < ND_RANK; i++) x->n[i] = x->s[i] = 1;
    return x;
}

nd nd_view_of(nd_arena *a, int n, const double *values) {
    double *p;
    memcpy(&p, &values, sizeof values);
    return nd_view(a, n, p);
}

nd nd_eye(nd_arena *a, int rows, int columns, int k) {
    nd x = nd_full(a, 2, (int[]){rows, columns}, 0.0);
    for (int i = 0; i < x->n[0]; i++)
        if (i + k >= 0 && i + k < x->n[1]) x->p[i * x->n[1] + i + k] = 1.0;
    return x;
}

nd nd_tri(nd_arena *a, int n) {
    nd x = nd_full(a, 2, (int[]){n, n}, 0.0);
    for (int i = 0; i < n; i++)
        for (int j = 0; j <= i; j++) x->p[i * n + j] = 1.0;
    return x;
}

/* Rows of small arrays are shorter than a call. */
static void copy_row(double *to, int st, const double *from, int sf, int n) {
    if (n > 16 && st == 1 && sf == 1) memmove(to, from, sizeof(double) * (size_t)n);
    else
        for (int i = 0; i < n; i++, to += st, from += sf) *to = *from;
}

nd nd_copy(nd_arena *a, nd x) {
    nd r;
    if (!x) return x;
    r = nd_new(a, x->rank, x->n);
    if (is_compact(x)) copy_row(r->p, 1, x->p, 1, nd_size(x));
    else nd_put(r, x);
    return r;
}

nd nd_arange(nd_arena *a, int start, int stop) {
    nd x = nd_new(a, 1, (int[]){stop - start});
    for (int i = 0; i < x->n[0]; i++) x->p[i] = start + i;
    return x;
}

nd nd_linspace(nd_arena *a, double low, double high, int n) {
    nd x = nd_new(a, 1, &n);
    double step = n > 1 ? (high - low) / (n - 1) : 0.0;
    for (int i = 0; i < n; i++) x->p[i] = i * step + low;
    if (n > 1) x->p[n - 1] = high;
    return x;
}

nd nd_geomspace(nd_arena *a, double low, double high, int n) {
    nd x = nd_linspace(a, 0.0, log10(high / low), n);
    for (int i = 0; i < n; i++) x->p[i] = pow(10.0, x->p[i]) * low;
    if (n > 0) x->p[0] = low;
    if (n > 1) x->p[n - 1] = high;
    return x;
}

/* -- reading and writing entries */

int nd_len(nd x) { return x->n[0]; }

int nd_size(nd x) {
    int size = 1;
    for (int i = 0; i < x->rank; i++) size *= x->n[i];
    return size;
}

double nd_item(nd x) { return *x->p; }

double nd_at(nd x, int i) { return x->p[(i < 0 ? x->n[0] + i : i) * x->s[0]]; }

double nd_at2(nd x, int i, int j) { return x->p[(i < 0 ? x->n[0] + i : i) * x->s[0] + (j < 0 ? x->n[1] + j : j) * x->s[1]]; }

void nd_set(nd x, int i, double value) { x->p[(i < 0 ? x->n[0] + i : i) * x->s[0]] = value; }

static int bounded(int at, int n) {
    if (at < 0) at += n;
    return at < 0 ? 0 : at > n ? n : at;
}

static void part_of(nd r, nd x, int count, const nd_ix *at) {
    double *p = x->p;
    int axis = 0, rank = 0;
    for (int i = 0; i < count; i++) {
        int start, stop;
        if (at[i].kind == ND_NEW) {
            r->n[rank] = 1, r->s[rank++] = 0;
            continue;
        }
        if (at[i].kind == ND_AT) {
            p += (at[i].a < 0 ? x->n[axis] + at[i].a : at[i].a) * x->s[axis];
            axis++;
            continue;
        }
        start = bounded(at[i].a, x->n[axis]);
        stop = at[i].b == ND_END ? x->n[axis] : bounded(at[i].b, x->n[axis]);
        p += start * x->s[axis];
        r->n[rank] = stop > start ? stop - start : 0;
        r->s[rank++] = x->s[axis++];
    }
    for (; axis < x->rank; axis++) r->n[rank] = x->n[axis], r->s[rank++] = x->s[axis];
    r->p = p;
    r->rank = rank;
    for (; rank < ND_RANK; rank++) r->n[rank] = r->s[rank] = 1;
}

nd nd_get(nd_arena *a, nd x, int count, const nd_ix *at) {
    nd r = nd_take_bytes(a, sizeof *r);
    if (x->rank == 1 && count == 1 && at->kind == ND_RANGE) {
        int start = bounded(at->a, x->n[0]), stop = at->b == ND_END ? x->n[0] : bounded(at->b, x->n[0]);
        r->p = x->p + start * x->s[0];
        r->rank = 1;
        r->n[0] = stop > start ? stop - start : 0;
        r->s[0] = x->s[0];
        for (int i = 1; i < ND_RANK; i++) r->n[i] = r->s[i] = 1;
        return r;
    }
    part_of(r, x, count, at);
    return r;
}

nd nd_reversed(nd_arena *a, nd x) {
    nd r = same_view(a, x);
    if (x->n[0]) r->p += (x->n[0] - 1) * x->s[0];
    r->s[0] = -x->s[0];
    return r;
}

static void row_of(nd r, nd x, int i) { part_of(r, x, 1, (nd_ix[]){{ND_AT, i, 0}}); }

nd nd_row(nd_arena *a, nd x, int i) {
    nd r = nd_take_bytes(a, sizeof *r);
    row_of(r, x, i);
    return r;
}

void nd_put(nd x, nd value) {
    shape4 o;
    int sx[ND_RANK], sv[ND_RANK];
    if (same_shape(x, value) && is_compact(x) && is_compact(value)) {
        copy_row(x->p, 1, value->p, 1, nd_size(x));
        return;
    }
    if (x->rank <= 1 && value->rank <= 1) {
        copy_row(x->p, x->s[0], value->p, value->n[0] == 1 ? 0 : value->s[0], x->rank ? x->n[0] : 1);
        return;
    }
    if (x->rank == 2 && value->rank == 2 && value->n[0] == x->n[0] && value->n[1] == x->n[1]) {
        for (int i = 0; i < x->n[0]; i++)
            copy_row(x->p + i * x->s[0], x->s[1], value->p + i * value->s[0], value->s[1], x->n[1]);
        return;
    }
    shape_of(x, &o);
    strides_over(x, &o, sx);
    strides_over(value, &o, sv);
    ND_LOOP3(o) copy_row(ND_ROW(x, sx), sx[3], ND_ROW(value, sv), sv[3], o.n[3]);
}

void nd_put_number(nd x, double value) {
    shape4 o;
    int sx[ND_RANK];
    shape_of(x, &o);
    strides_over(x, &o, sx);
    ND_LOOP3(o) {
        double *to = ND_ROW(x, sx);
        for (int i = 0; i < o.n[3]; i++) to[i * sx[3]] = value;
    }
}

static int index_of(nd indices, int i) { return (int)nd_at(indices, i); }

static nd_ix all_of(void) { return (nd_ix){ND_RANGE, 0, ND_END}; }

static void slot(nd r, nd x, int axis, int i) {
    nd_ix at[ND_RANK] = {all_of(), all_of(), all_of(), all_of()};
    at[axis] = (nd_ix){ND_AT, i, 0};
    part_of(r, x, axis + 1, at);
}

nd nd_take(nd_arena *a, nd x, nd indices, int axis) {
    nd_array like = *x;
    like.n[axis] = nd_len(indices);
    nd r = nd_new(a, x->rank, like.n);
    for (int i = 0; i < nd_len(indices); i++) {
        nd_array to, from;
        slot(&to, r, axis, i);
        slot(&from, x, axis, index_of(indices, i));
        nd_put(&to, &from);
    }
    return r;
}

nd nd_take2(nd_arena *a, nd x, nd rows, nd columns) {
    nd r = nd_new(a, 2, (int[]){nd_len(rows), nd_len(columns)});
    for (int i = 0; i < r->n[0]; i++)
        for (int j = 0; j < r->n[1]; j++) r->p[i * r->n[1] + j] = nd_at2(x, index_of(rows, i), index_of(columns, j));
    return r;
}

void nd_put2(nd x, nd rows, nd columns, nd value) {
    for (int i = 0; i < nd_len(rows); i++)
        for (int j = 0; j < nd_len(columns); j++)
            x->p[index_of(rows, i) * x->s[0] + index_of(columns, j) * x->s[1]] = nd_at2(value, i, j);
}

void nd_put_rows(nd x, nd rows, nd value) {
    for (int i = 0; i < nd_len(rows); i++) {
        nd_array to, from;
        row_of(&to, x, index_of(rows, i));
        if (value->rank == x->rank) row_of(&from, value, i);
        nd_put(&to, value->rank == x->rank ? &from : value);
    }
}

nd nd_indices(nd_arena *a, nd mask) {
    nd x = nd_copy(a, mask), r = nd_new(a, 1, (int[]){nd_size(mask)});
    int count = 0;
    for (int i = 0, size = nd_size(x); i < size; i++)
        if (x->p[i] != 0.0) r->p[count++] = i;
    r->n[0] = count;
    return r;
}

nd nd_argwhere(nd_arena *a, nd mask) {
    nd found = nd_indices(a, mask), r = nd_new(a, 2, (int[]){nd_len(found), mask->rank});
    for (int k = 0; k < nd_len(found); k++)
        for (int axis = mask->rank - 1, left = index_of(found, k); axis >= 0; left /= mask->n[axis], axis--)
            r->p[k * mask->rank + axis] = left % mask->n[axis];
    return r;
}

/* A copy of the items of a list with room for one more. */
void *nd_room(nd_arena *a, const void *items, int count, size_t bytes) {
    void *more = nd_take_bytes(a, bytes * (size_t)(count + 1));
    if (count) memcpy(more, items, bytes * (size_t)count);
    return more;
}

void nd_append(nd_arena *a, nd *x, double value) {
    nd before = *x;
    *x = nd_new(a, 1, (int[]){before->n[0] + 1});
    memcpy((*x)->p, before->p, sizeof(double) * (size_t)before->n[0]);
    (*x)->p[before->n[0]] = value;
}

double *nd_write(double *to, nd x) {
    if (!x) return to;
    if (is_compact(x)) return (double *)memcpy(to, x->p, sizeof(double) * (size_t)nd_size(x)) + nd_size(x);
    nd_array compact = *x;
    compact.p = to;
    for (int i = x->rank - 1, s = 1; i >= 0; s *= x->n[i--]) compact.s[i] = s;
    nd_put(&compact, x);
    return to + nd_size(x);
}

const double *nd_read(const double *from, nd x) {
    if (!x) return from;
    memcpy(x->p, from, sizeof(double) * (size_t)nd_size(x));
    return from + nd_size(x);
}

int nd_truncated(nd_arena *a, double x) {
    if (!(fabs(x) <= DBL_MAX)) nd_raise(a, ND_ARITHMETIC, "cannot convert a number that is not finite to an integer");
    return x < -INT32_MAX ? -INT32_MAX : x > INT32_MAX ? INT32_MAX : x == x ? (int)x : 0;
}

int nd_integer(double x) { return x >= -1e9 && x <= 1e9 ? (int)x : -1; }

/* -- forms */

nd nd_transposed(nd_arena *a, nd x) {
    nd r = same_view(a, x);
    for (int i = 0; i < x->rank; i++) r->n[i] = x->n[x->rank - 1 - i], r->s[i] = x->s[x->rank - 1 - i];
    return r;
}

nd nd_permuted(nd_arena *a, nd x, const int *axes) {
    nd r = same_view(a, x);
    for (int i = 0; i < x->rank; i++) r->n[i] = x->n[axes[i]], r->s[i] = x->s[axes[i]];
    return r;
}

nd nd_reshape(nd_arena *a, nd x, int rank, const int *n) {
    int known = 1, size = nd_size(x);
    nd r = view(a, (is_compact(x) ? x : nd_copy(a, x))->p, rank);
    for (int i = 0; i < rank; i++) known *= n[i] < 0 ? 1 : n[i];
    for (int i = rank - 1, s = 1; i >= 0; i--) {
        int length = n[i] < 0 ? (known ? size / known : 0) : n[i];
        r->n[i] = length;
        r->s[i] = s;
        s *= length;
    }
    for (int i = rank; i < ND_RANK; i++) r->n[i] = r->s[i] = 1;
    return r;
}

nd nd_concatenate(nd_arena *a, int axis, int count, const nd *x) {
    int n[ND_RANK], at = 0;
    for (int i = 0; i < ND_RANK; i++) n[i] = i == axis ? 0 : x[0]->n[i];
    for (int i = 0; i < count; i++) n[axis] += x[i]->n[axis];
    nd r = nd_new(a, x[0]->rank, n);
    for (int i = 0; i < count; at += x[i]->n[axis], i++) {
        nd_array to;
        to.p = r->p + at * r->s[axis];
        to.rank = r->rank;
        for (int k = 0; k < ND_RANK; k++) to.n[k] = k == axis ? x[i]->n[k] : r->n[k], to.s[k] = r->s[k];
        if (x[i]->n[axis]) nd_put(&to, x[i]);
    }
    return r;
}

nd nd_hstack(nd_arena *a, int count, const nd *x) { return nd_concatenate(a, x[0]->rank == 1 ? 0 : 1, count, x); }

static void as_row(nd r, nd x) {
    bool is_row = x->rank == 1;
    r->p = x->p;
    r->rank = is_row ? 2 : x->rank;
    for (int i = 0; i < ND_RANK; i++) r->n[i] = x->n[i], r->s[i] = x->s[i];
    if (is_row) r->n[1] = x->n[0], r->s[1] = x->s[0], r->n[0] = 1, r->s[0] = 0;
}

static void as_column(nd r, nd x) {
    bool is_column = x->rank == 1;
    r->p = x->p;
    r->rank = is_column ? 2 : x->rank;
    for (int i = 0; i < ND_RANK; i++) r->n[i] = x->n[i], r->s[i] = x->s[i];
    if (is_column) r->n[1] = 1, r->s[1] = 0;
}

static nd stacked(nd_arena *a, int axis, int count, const nd *x, void (*form)(nd, nd)) {
    nd *forms = nd_take_bytes(a, sizeof(nd) * (size_t)count);
    for (int i = 0; i < count; i++) {
        forms[i] = nd_take_bytes(a, sizeof(nd_array));
        form(forms[i], x[i]);
    }
    return nd_concatenate(a, axis, count, forms);
}

nd nd_vstack(nd_arena *a, int count, const nd *x) { return stacked(a, 0, count, x, as_row); }

nd nd_column_stack(nd_arena *a, int count, const nd *x) { return stacked(a, 1, count, x, as_column); }

nd nd_stack(nd_arena *a, int count, const nd *x) {
    int n[ND_RANK] = {count, 1, 1, 1}, rank = 1;
    for (; count && rank <= x[0]->rank; rank++) n[rank] = x[0]->n[rank - 1];
    nd r = nd_new(a, rank, n);
    for (int i = 0; i < count; i++) {
        nd_array to;
        row_of(&to, r, i);
        nd_put(&to, x[i]);
    }
    return r;
}

nd nd_block2(nd_arena *a, nd x, nd y, nd z, nd w) {
    nd rows[2];
    rows[0] = nd_hstack(a, 2, (nd[]){x, y});
    rows[1] = nd_hstack(a, 2, (nd[]){z, w});
    return nd_concatenate(a, 0, 2, rows);
}

nd nd_tile(nd_arena *a, nd x, int times) {
    nd_array like = *x;
    like.n[0] = x->n[0] * times;
    nd r = nd_new(a, x->rank, like.n);
    double *to = r->p;
    for (int i = 0; i < times; i++) to = nd_write(to, x);
    return r;
}

nd nd_delete(nd_arena *a, nd x, int i) {
    nd parts[2];
    parts[0] = nd_get(a, x, 1, (nd_ix[]){{ND_RANGE, 0, i}});
    parts[1] = nd_get(a, x, 1, (nd_ix[]){{ND_RANGE, i + 1, ND_END}});
    return nd_concatenate(a, 0, 2, parts);
}

nd nd_diag(nd_arena *a, nd x) {
    nd r;
    if (x->rank == 2) {
        r = nd_view(a, nd_imin2(x->n[0], x->n[1]), x->p);
        r->s[0] = x->s[0] + x->s[1];
        return r;
    }
    r = nd_full(a, 2, (int[]){x->n[0], x->n[0]}, 0.0);
    nd_fill_diagonal(r, x);
    return r;
}

void nd_fill_diagonal(nd x, nd values) {
    for (int i = 0; i < nd_imin2(x->n[0], x->n[1]); i++) x->p[i * (x->s[0] + x->s[1])] = nd_at(values, i);
}

/* -- entry by entry */

static double power(double x, double y) { return y == 2.0 ? x * x : y == 0.5 ? sqrt(x) : pow(x, y); }

/* Two numbers at a time, where the compiler has types for that: each has the bits that it has alone. */
#ifdef __GNUC__
typedef double two __attribute__((vector_size(16)));
typedef double two_in_memory __attribute__((vector_size(16), aligned(8), may_alias));
static two two_of(double x) { return (two){x, x}; }
static two two_at(const double *p) { return *(const two_in_memory *)p; }
static void put_two(double *p, two x) { *(two_in_memory *)p = x; }
#define ND_TIMES(x, y) ((x) * (y))
#define ND_PLUS(x, y) ((x) + (y))
#define ND_PAIRS(first, second, value)                 \
    for (; i + 2 <= n; i += 2) {                       \
        two u = first, v = second;                     \
        put_two(r + i, value);                         \
    }
#else
typedef struct {
    double p, q;
} two;
static two two_of(double x) { return (two){x, x}; }
static two two_at(const double *p) { return (two){p[0], p[1]}; }
static void put_two(double *p, two x) { p[0] = x.p, p[1] = x.q; }
#define ND_TIMES(x, y) ((two){(x).p * (y).p, (x).q * (y).q})
#define ND_PLUS(x, y) ((two){(x).p + (y).p, (x).q + (y).q})
#define ND_PAIRS(first, second, value)
#endif

/* Rows whose entries lie together, or are one number, are what two at a time can be done of. */
#define ND_EACH(op, value)                        \
    case op:                                      \
        for (int i = 0; i < n; i++) {             \
            double u = x[i * sx], v = y[i * sy];  \
            r[i] = (value);                       \
        }                                         \
        break;

#define ND_FAST(op, value)                                        \
    case op: {                                                    \
        int i = 0;                                                \
        if (sx == 1 && sy == 1) {                                 \
            ND_PAIRS(two_at(x + i), two_at(y + i), value)         \
        } else if (sx == 0 && sy == 1) {                          \
            ND_PAIRS(two_of(*x), two_at(y + i), value)            \
        } else if (sx == 1 && sy == 0) {                          \
            ND_PAIRS(two_at(x + i), two_of(*y), value)            \
        }                                                         \
        for (; i < n; i++) {                                      \
            double u = x[i * sx], v = y[i * sy];                  \
            r[i] = (value);                                       \
        }                                                         \
        break;                                                    \
    }

static void binary_row(int op, int n, double *restrict r, const double *restrict x, int sx, const double *restrict y,
                       int sy) {
    switch (op) {
        ND_FAST(ND_ADD, u + v)
        ND_FAST(ND_SUB, u - v)
        ND_FAST(ND_MUL, u *v)
        ND_FAST(ND_DIV, u / v)
        ND_EACH(ND_POW, power(u, v))
        ND_EACH(ND_MAX, u >= v || is_nan(u) ? u : v)
        ND_EACH(ND_MIN, u <= v || is_nan(u) ? u : v)
        ND_EACH(ND_HYPOT, hypot(u, v))
        ND_EACH(ND_COPYSIGN, copysign(u, v))
        ND_EACH(ND_LT, u < v ? 1.0 : 0.0)
        ND_EACH(ND_LE, u <= v ? 1.0 : 0.0)
        ND_EACH(ND_GT, u > v ? 1.0 : 0.0)
        ND_EACH(ND_GE, u >= v ? 1.0 : 0.0)
        ND_EACH(ND_EQ, u == v ? 1.0 : 0.0)
        ND_EACH(ND_NE, u != v ? 1.0 : 0.0)
        ND_EACH(ND_AND, u != 0.0 && v != 0.0 ? 1.0 : 0.0)
        ND_EACH(ND_OR, u != 0.0 || v != 0.0 ? 1.0 : 0.0)
    default: break;
    }
}

/* The rows of small arrays are shorter than a call. */
#define ND_EVERY(op, value)                                               \
    case op:                                                              \
        ND_LOOP3(o) {                                                     \
            const double *first = ND_ROW(x, sx), *second = ND_ROW(y, sy); \
            for (int i = 0; i < o.n[3]; i++) {                            \
                double u = *first, v = *second;                           \
                *to++ = (value);                                          \
                first += sx[3], second += sy[3];                          \
            }                                                             \
        }                                                                 \
        break;

nd nd_binary(nd_arena *a, int op, nd x, nd y) {
    nd like = x->rank >= y->rank ? x : y, r;
    if (like->rank == 1 && (x->rank == 0 || y->rank == 0 || x->n[0] == y->n[0])) {
        r = nd_new(a, 1, like->n);
        binary_row(op, r->n[0], r->p, x->p, x->rank ? x->s[0] : 0, y->p, y->rank ? y->s[0] : 0);
        return r;
    }
    if ((x->rank == 0 || is_compact(x)) && (y->rank == 0 || is_compact(y)) && (x->rank == 0 || y->rank == 0 || same_shape(x, y))) {
        r = nd_new(a, like->rank, like->n);
        binary_row(op, nd_size(r), r->p, x->p, x->rank > 0, y->p, y->rank > 0);
        return r;
    }
    shape4 sx4, sy4, o;
    int sx[ND_RANK], sy[ND_RANK];
    shape_of(x, &sx4);
    shape_of(y, &sy4);
    for (int i = 0; i < ND_RANK; i++) o.n[i] = sx4.n[i] == 1 ? sy4.n[i] : sx4.n[i];
    r = nd_new(a, like->rank, o.n + ND_RANK - like->rank);
    strides_over(x, &o, sx);
    strides_over(y, &o, sy);
    double *to = r->p;
    switch (o.n[3] < 8 ? op : -1) {
        ND_EVERY(ND_ADD, u + v)
        ND_EVERY(ND_SUB, u - v)
        ND_EVERY(ND_MUL, u *v)
        ND_EVERY(ND_DIV, u / v)
    default:
        ND_LOOP3(o) {
            binary_row(op, o.n[3], to, ND_ROW(x, sx), sx[3], ND_ROW(y, sy), sy[3]);
            to += o.n[3];
        }
    }
    return r;
}

static nd_array alone(const double *x) {
    nd_array view = nd_around(1, x);
    view.rank = 0;
    return view;
}

nd nd_binary_xn(nd_arena *a, int op, nd x, double y) {
    nd_array number = alone(&y);
    return nd_binary(a, op, x, &number);
}

nd nd_binary_nx(nd_arena *a, int op, double x, nd y) {
    nd_array number = alone(&x);
    return nd_binary(a, op, &number, y);
}

nd nd_map(nd_arena *a, double (*f)(double), nd x) {
    nd r = nd_new(a, x->rank, x->n);
    int size = nd_size(r);
    const double *from = x->p;
    if (!is_compact(x)) nd_put(r, x), from = r->p;
    if (f == nd_square)
        for (int i = 0; i < size; i++) r->p[i] = from[i] * from[i];
    else
        for (int i = 0; i < size; i++) r->p[i] = f(from[i]);
    return r;
}

nd nd_where(nd_arena *a, nd mask, nd x, nd y) {
    /* The sum of all has the shape of the result. */
    nd r = nd_binary(a, ND_ADD, nd_binary(a, ND_ADD, mask, x), y);
    shape4 o;
    int sm[ND_RANK], sx[ND_RANK], sy[ND_RANK], sr[ND_RANK];
    shape_of(r, &o);
    strides_over(mask, &o, sm);
    strides_over(x, &o, sx);
    strides_over(y, &o, sy);
    strides_over(r, &o, sr);
    ND_LOOP3(o) {
        double *to = ND_ROW(r, sr);
        const double *m = ND_ROW(mask, sm), *u = ND_ROW(x, sx), *v = ND_ROW(y, sy);
        for (int i = 0; i < o.n[3]; i++) to[i] = m[i * sm[3]] != 0.0 ? u[i * sx[3]] : v[i * sy[3]];
    }
    return r;
}

double nd_isfinite(double x) { return fabs(x) <= DBL_MAX ? 1.0 : 0.0; }
double nd_isnan(double x) { return x != x ? 1.0 : 0.0; }
double nd_isinf(double x) { return fabs(x) > DBL_MAX ? 1.0 : 0.0; }
double nd_not(double x) { return x != 0.0 ? 0.0 : 1.0; }
double nd_negative(double x) { return -x; }
double nd_square(double x) { return x * x; }

double nd_exponent_of(double x) {
    int exponent = 0;
    (void)frexp(x, &exponent);
    return exponent;
}

/* -- along axes */

static double start_of(int op) {
    return op == ND_ALL_TRUE ? 1.0 : op == ND_LARGEST ? -INFINITY : op == ND_SMALLEST ? INFINITY : 0.0;
}

static double more_of(int op, double so_far, double x) {
    switch (op) {
    case ND_SUM: return so_far + x;
    case ND_ANY: return x != 0.0 ? 1.0 : so_far;
    case ND_ALL_TRUE: return x != 0.0 ? so_far : 0.0;
    case ND_NORM: return so_far + x * x;
    case ND_LARGEST: return x > so_far || is_nan(x) ? x : so_far;
    default: return x < so_far || is_nan(x) ? x : so_far;
    }
}

double nd_reduced(int op, nd x) {
    shape4 o;
    int s[ND_RANK];
    double r = start_of(op);
    if (x->rank == 1) {
        for (int i = 0; i < x->n[0]; i++) r = more_of(op, r, x->p[i * x->s[0]]);
        return op == ND_NORM ? sqrt(r) : r;
    }
    shape_of(x, &o);
    strides_over(x, &o, s);
    ND_LOOP3(o) {
        const double *row = ND_ROW(x, s);
        for (int i = 0; i < o.n[3]; i++) r = more_of(op, r, row[i * s[3]]);
    }
    return op == ND_NORM ? sqrt(r) : r;
}

nd nd_reduce(nd_arena *a, int op, nd x, int axis) {
    nd_array like = *x;
    int sr[ND_RANK], sl[ND_RANK], steps;
    shape4 o;
    if (axis < 0) axis += x->rank;
    for (int i = axis; i + 1 < x->rank; i++) like.n[i] = x->n[i + 1];
    nd r = nd_full(a, x->rank - 1, like.n, start_of(op));
    if (x->rank == 2 && op == ND_SUM) {
        for (int i = 0; i < r->n[0]; i++) {
            const double *from = x->p + i * x->s[1 - axis];
            double sum = 0.0;
            for (int k = 0; k < x->n[axis]; k++) sum += from[k * x->s[axis]];
            r->p[i] = sum;
        }
        return r;
    }
    if (x->rank == 2) {
        for (int i = 0; i < r->n[0]; i++) {
            const double *from = x->p + i * x->s[1 - axis];
            double so_far = r->p[i];
            for (int k = 0; k < x->n[axis]; k++) so_far = more_of(op, so_far, from[k * x->s[axis]]);
            r->p[i] = op == ND_NORM ? sqrt(so_far) : so_far;
        }
        return r;
    }
    shape_of(r, &o);
    steps = x->n[axis];
    for (int k = 0; k < steps; k++) {
        nd_array last;
        slot(&last, x, axis, k);
        strides_over(r, &o, sr);
        strides_over(&last, &o, sl);
        ND_LOOP3(o) {
            double *to = ND_ROW(r, sr);
            const double *from = ND_ROW(&last, sl);
            for (int i = 0; i < o.n[3]; i++) to[i] = more_of(op, to[i], from[i * sl[3]]);
        }
    }
    if (op == ND_NORM)
        for (int i = 0, size = nd_size(r); i < size; i++) r->p[i] = sqrt(r->p[i]);
    return r;
}

double nd_mean(nd x) { return nd_reduced(ND_SUM, x) / nd_size(x); }

int nd_argmin(nd x) {
    int best = 0;
    for (int i = 1; i < nd_len(x); i++)
        if (!is_nan(nd_at(x, best)) && (nd_at(x, i) < nd_at(x, best) || is_nan(nd_at(x, i)))) best = i;
    return best;
}

int nd_argmax(nd x) {
    int best = 0;
    for (int i = 1; i < nd_len(x); i++)
        if (!is_nan(nd_at(x, best)) && (nd_at(x, i) > nd_at(x, best) || is_nan(nd_at(x, i)))) best = i;
    return best;
}

/* The order of entries by `first`, equal ones by `then`. */
nd nd_lexsort(nd_arena *a, nd then, nd first) {
    int n = nd_len(first);
    nd order = nd_new(a, 1, &n);
    for (int i = 0; i < n; i++) {
        int place = 0;
        for (int j = 0; j < n; j++) {
            double u = nd_at(first, i), v = nd_at(first, j), s = nd_at(then, i), t = nd_at(then, j);
            place += v < u || (v == u && (t < s || (t == s && j < i)));
        }
        order->p[place] = i;
    }
    return order;
}

nd nd_sorted(nd_arena *a, nd x) {
    nd r = nd_take(a, x, nd_lexsort(a, x, x), 0);
    return r;
}

int nd_find(int n, const char *const *names, const char *name) {
    for (int i = 0; i < n; i++)
        if (strcmp(names[i], name) == 0) return i;
    return -1;
}

nd nd_cumsum(nd_arena *a, nd x) {
    nd r = nd_copy(a, x);
    for (int i = 1; i < nd_len(r); i++) r->p[i] += r->p[i - 1];
    return r;
}

nd nd_diff(nd_arena *a, nd x) {
    return nd_binary(a, ND_SUB, nd_get(a, x, 1, (nd_ix[]){{ND_RANGE, 1, ND_END}}), nd_get(a, x, 1, (nd_ix[]){{ND_RANGE, 0, x->n[0] ? -1 : 0}}));
}

int nd_searchsorted_right(nd x, double value) {
    int i = 0;
    while (i < nd_len(x) && nd_at(x, i) <= value) i++;
    return i;
}

bool nd_equal(nd x, nd y) {
    if (nd_len(x) != nd_len(y)) return false;
    for (int i = 0; i < nd_len(x); i++)
        if (nd_at(x, i) != nd_at(y, i)) return false;
    return true;
}

/* -- products */

/* Two columns at a time stay in one register; each sum goes in the order of the terms. */
/* r (rows,columns) in one piece = x (rows,inner) y (inner,columns), for the strides of rows and columns. */
static void multiply(double *r, int rows, int inner, int columns, const double *x, const int *sx, const double *y,
                     const int *sy) {
    int next = sx[1], row = sy[0], column = sy[1];
    for (int i = 0; i < rows; i++, r += columns, x += sx[0]) {
        int j = 0;
        for (; column == 1 && j + 6 <= columns; j += 6) {
            two s0 = two_of(0.0), s1 = s0, s2 = s0;
            const double *u = x, *v = y + j;
            for (int k = inner; k > 0; k--, u += next, v += row) {
                two f = two_of(*u);
                s0 = ND_PLUS(s0, ND_TIMES(f, two_at(v)));
                s1 = ND_PLUS(s1, ND_TIMES(f, two_at(v + 2)));
                s2 = ND_PLUS(s2, ND_TIMES(f, two_at(v + 4)));
            }
            put_two(r + j, s0), put_two(r + j + 2, s1), put_two(r + j + 4, s2);
        }
        for (; column == 1 && j + 2 <= columns; j += 2) {
            two sum = two_of(0.0);
            const double *u = x, *v = y + j;
            for (int k = inner; k > 0; k--, u += next, v += row) sum = ND_PLUS(sum, ND_TIMES(two_of(*u), two_at(v)));
            put_two(r + j, sum);
        }
        for (; j < columns; j++) {
            double sum = 0.0;
            const double *u = x, *v = y + j * column;
            for (int k = inner; k > 0; k--, u += next, v += row) sum += *u * *v;
            r[j] = sum;
        }
    }
}

nd nd_matmul(nd_arena *a, nd x, nd y) {
    nd_array left, right;
    as_row(&left, x);
    as_column(&right, y);
    int lm = left.rank - 2, rm = right.rank - 2; /* 1 with a batch of matrices */
    int rows = left.n[lm], inner = left.n[lm + 1], columns = right.n[rm + 1];
    if (lm && !rm && left.s[0] == rows * left.s[1]) { /* a batch times one matrix is one product */
        nd r = nd_new(a, 3, (int[]){left.n[0], rows, columns});
        multiply(r->p, left.n[0] * rows, inner, columns, left.p, left.s + 1, right.p, right.s);
        return r;
    }
    if (lm || rm) {
        int count = lm ? left.n[0] : right.n[0];
        nd r = nd_new(a, 3, (int[]){count, rows, columns});
        for (int i = 0; i < count; i++)
            multiply(r->p + i * rows * columns, rows, inner, columns, left.p + (lm ? i * left.s[0] : 0), left.s + lm,
                     right.p + (rm ? i * right.s[0] : 0), right.s + rm);
        return r;
    }
    nd r = nd_new(a, 2, (int[]){rows, columns});
    multiply(r->p, rows, inner, columns, left.p, left.s, right.p, right.s);
    if (y->rank == 1) r->rank--;
    else if (x->rank == 1) r->rank--, r->n[0] = r->n[1], r->s[0] = 1;
    if (x->rank == 1 && y->rank == 1) r->rank = 0;
    return r;
}

nd nd_tensordot1(nd_arena *a, nd x, nd y) {
    int inner = y->n[0], n[ND_RANK], rank = 0;
    nd product = nd_matmul(a, nd_reshape(a, x, 2, (int[]){-1, inner}), nd_reshape(a, y, 2, (int[]){inner, -1}));
    for (int i = 0; i < x->rank - 1; i++) n[rank++] = x->n[i];
    for (int i = 1; i < y->rank; i++) n[rank++] = y->n[i];
    return nd_reshape(a, product, rank, n);
}

nd nd_rhk_hkj(nd_arena *a, nd x, nd y) {
    int rows = x->n[0], count = x->n[1], inner = x->n[2], columns = y->n[2];
    nd r = nd_full(a, 3, (int[]){rows, count, columns}, 0.0);
    double *to = r->p;
    for (int i = 0; i < rows; i++)
        for (int h = 0; h < count; h++, to += columns)
            for (int k = 0; k < inner; k++) {
                double u = x->p[i * x->s[0] + h * x->s[1] + k * x->s[2]];
                const double *from = y->p + h * y->s[0] + k * y->s[1];
                for (int j = 0; j < columns; j++) to[j] += u * from[j * y->s[2]];
            }
    return r;
}

/* -- numbers */

/* The second one counts where it is larger, as in Python's max(x, y): so a NaN before stays, one behind does not. */
double nd_max2(double x, double y) { return y > x ? y : x; }
double nd_min2(double x, double y) { return y < x ? y : x; }
int nd_imax2(int x, int y) { return y > x ? y : x; }
int nd_imin2(int x, int y) { return y < x ? y : x; }

int nd_mod(int x, int y) {
    int r = x % y;
    return r != 0 && (r < 0) != (y < 0) ? r + y : r;
}

int nd_floordiv(int x, int y) { return (x - nd_mod(x, y)) / y; }

int nd_bits(int x) {
    int count = 0;
    for (unsigned left = (unsigned)x; left; left >>= 1) count += (int)(left & 1u);
    return count;
}

int nd_bit_length(int x) {
    int count = 0;
    for (unsigned left = (unsigned)x; left; left >>= 1) count++;
    return count;
}

double nd_factorial(int n) {
    double r = 1.0;
    for (int i = 2; i <= n; i++) r *= i;
    return r;
}

double nd_rounded(double x, int digits) {
    double scale = pow(10.0, digits);
    return nearbyint(x * scale) / scale;
}

double nd_ulp(double x) {
    double size = fabs(x);
    return size <= DBL_MAX ? nextafter(size, HUGE_VAL) - size : size;
}
