/* Reading and writing entries. */
#include "nd_loops.h"

#include <float.h>

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

void nd_part_of(nd r, nd x, int count, const nd_ix *at) {
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
    r->rank = (int16_t)rank;
    for (; rank < ND_RANK; rank++) r->n[rank] = r->s[rank] = 1;
}

nd nd_get(nd_arena *a, nd x, int count, const nd_ix *at) {
    nd r = nd_take_bytes(a, sizeof *r);
    nd_part_of(r, x, count, at);
    return r;
}

/* Have a view show start:stop of an axis. */
static void narrow(nd r, int axis, int start, int stop) {
    start = bounded(start, r->n[axis]);
    stop = stop == ND_END ? r->n[axis] : bounded(stop, r->n[axis]);
    r->p += start * r->s[axis];
    r->n[axis] = stop > start ? stop - start : 0;
}

nd nd_range(nd_arena *a, nd x, int start, int stop) {
    nd r = nd_same_view(a, x);
    narrow(r, 0, start, stop);
    return r;
}

nd nd_block(nd_arena *a, nd x, int top, int bottom, int left, int right) {
    nd r = nd_range(a, x, top, bottom);
    narrow(r, 1, left, right);
    return r;
}

nd nd_column(nd_arena *a, nd x, int i) {
    nd r = nd_take_bytes(a, sizeof *r);
    nd_slot(r, x, 1, i);
    return r;
}

nd nd_upright(nd_arena *a, nd x) { return nd_get(a, x, 2, (nd_ix[]){{ND_RANGE, 0, ND_END}, {ND_NEW, 0, 0}}); }

nd nd_reversed(nd_arena *a, nd x) {
    nd r = nd_same_view(a, x);
    if (x->n[0]) r->p += (x->n[0] - 1) * x->s[0];
    r->s[0] = (int16_t)-x->s[0];
    return r;
}

void nd_row_of(nd r, nd x, int i) { nd_part_of(r, x, 1, (nd_ix[]){{ND_AT, i, 0}}); }

nd nd_row(nd_arena *a, nd x, int i) {
    nd r = nd_take_bytes(a, sizeof *r);
    nd_row_of(r, x, i);
    return r;
}

void nd_put(nd x, nd value) {
    nd_shape3 o;
    int sx[ND_RANK], sv[ND_RANK];
    if (nd_same_shape(x, value) && nd_is_compact(x) && nd_is_compact(value)) {
        nd_copy_row(x->p, 1, value->p, 1, nd_size(x));
        return;
    }
    if (x->rank <= 1 && value->rank <= 1) {
        nd_copy_row(x->p, x->s[0], value->p, value->n[0] == 1 ? 0 : value->s[0], x->rank ? x->n[0] : 1);
        return;
    }
    if (x->rank == 2 && value->rank == 2 && value->n[0] == x->n[0] && value->n[1] == x->n[1]) {
        for (int i = 0; i < x->n[0]; i++)
            nd_copy_row(x->p + i * x->s[0], x->s[1], value->p + i * value->s[0], value->s[1], x->n[1]);
        return;
    }
    nd_shape_of(x, &o);
    nd_strides_over(x, &o, sx);
    nd_strides_over(value, &o, sv);
    ND_LOOP2(o) nd_copy_row(ND_ROW(x, sx), sx[2], ND_ROW(value, sv), sv[2], o.n[2]);
}

void nd_put_number(nd x, double value) {
    nd_shape3 o;
    int sx[ND_RANK];
    nd_shape_of(x, &o);
    nd_strides_over(x, &o, sx);
    ND_LOOP2(o) {
        double *to = ND_ROW(x, sx);
        for (int i = 0; i < o.n[2]; i++) to[i * sx[2]] = value;
    }
}

int nd_index_of(nd indices, int i) { return (int)nd_at(indices, i); }

static nd_ix all_of(void) { return (nd_ix){ND_RANGE, 0, ND_END}; }

void nd_slot(nd r, nd x, int axis, int i) {
    nd_ix at[ND_RANK] = {all_of(), all_of(), all_of()};
    at[axis] = (nd_ix){ND_AT, i, 0};
    nd_part_of(r, x, axis + 1, at);
}

nd nd_take(nd_arena *a, nd x, nd indices, int axis) {
    nd_array like = *x;
    like.n[axis] = nd_len(indices);
    nd r = nd_new(a, x->rank, like.n);
    for (int i = 0; i < nd_len(indices); i++) {
        nd_array to, from;
        nd_slot(&to, r, axis, i);
        nd_slot(&from, x, axis, nd_index_of(indices, i));
        nd_put(&to, &from);
    }
    return r;
}

nd nd_take2(nd_arena *a, nd x, nd rows, nd columns) {
    nd r = nd_new(a, 2, (int[]){nd_len(rows), nd_len(columns)});
    for (int i = 0; i < r->n[0]; i++)
        for (int j = 0; j < r->n[1]; j++) r->p[i * r->n[1] + j] = nd_at2(x, nd_index_of(rows, i), nd_index_of(columns, j));
    return r;
}

void nd_put2(nd x, nd rows, nd columns, nd value) {
    for (int i = 0; i < nd_len(rows); i++)
        for (int j = 0; j < nd_len(columns); j++)
            x->p[nd_index_of(rows, i) * x->s[0] + nd_index_of(columns, j) * x->s[1]] = nd_at2(value, i, j);
}

void nd_put_rows(nd x, nd rows, nd value) {
    for (int i = 0; i < nd_len(rows); i++) {
        nd_array to, from;
        nd_row_of(&to, x, nd_index_of(rows, i));
        if (value->rank == x->rank) nd_row_of(&from, value, i);
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
        for (int axis = mask->rank - 1, left = nd_index_of(found, k); axis >= 0; left /= mask->n[axis], axis--)
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
    if (nd_is_compact(x)) return (double *)memcpy(to, x->p, sizeof(double) * (size_t)nd_size(x)) + nd_size(x);
    nd_array compact = *x;
    compact.p = to;
    for (int i = x->rank - 1, s = 1; i >= 0; s *= x->n[i--]) compact.s[i] = (int16_t)s;
    nd_put(&compact, x);
    return to + nd_size(x);
}

const double *nd_read(const double *from, nd x) {
    if (!x) return from;
    memcpy(&x->p, &from, sizeof from);
    return from + nd_size(x);
}

int nd_truncated(nd_arena *a, double x) {
    if (!(fabs(x) <= DBL_MAX)) nd_raise(a, ND_ARITHMETIC, "cannot convert a number that is not finite to an integer");
    return x < -INT32_MAX ? -INT32_MAX : x > INT32_MAX ? INT32_MAX : x == x ? (int)x : 0;
}

int nd_integer(double x) { return x >= -1e9 && x <= 1e9 ? (int)x : -1; }
