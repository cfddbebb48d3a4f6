/* Views of numbers: shapes, strides, and copies from one to another. */
#include "nd_loops.h"

bool nd_is_compact(nd x) {
    if (x->rank == 1) return x->s[0] == 1 || x->n[0] == 1;
    if (x->rank == 2) return (x->s[1] == 1 || x->n[1] == 1) && (x->s[0] == x->n[1] || x->n[0] == 1);
    for (int i = x->rank - 1, s = 1; i >= 0; i--) {
        if (x->s[i] != s && x->n[i] != 1) return false;
        s *= x->n[i];
    }
    return true;
}

bool nd_same_shape(nd x, nd y) {
    if (x->rank != y->rank) return false;
    for (int i = 0; i < x->rank; i++)
        if (x->n[i] != y->n[i]) return false;
    return true;
}

/* The rows of small arrays are shorter than a call. */
nd nd_view_at(nd_arena *a, double *p, int rank) {
    nd x = nd_take_bytes(a, sizeof *x);
    x->p = p;
    x->rank = (int16_t)rank;
    return x;
}

nd nd_same_view(nd_arena *a, nd x) {
    nd r = nd_view_at(a, x->p, x->rank);
    for (int i = 0; i < ND_RANK; i++) r->n[i] = x->n[i], r->s[i] = x->s[i];
    return r;
}

/* An array of that shape in one piece, without numbers. */
nd nd_form_of(nd_arena *a, nd x) {
    nd r = nd_same_view(a, x);
    r->p = NULL;
    for (int i = x->rank - 1, s = 1; i >= 0; s *= x->n[i--]) r->s[i] = (int16_t)s;
    return r;
}

void nd_shape_of(nd x, nd_shape3 *r) {
    for (int i = 0; i < ND_RANK; i++) {
        int axis = i - ND_RANK + x->rank;
        r->n[i] = axis < 0 ? 1 : x->n[axis];
    }
}

/* The strides of x over a shape, 0 along axes that it does not have or in which its length is one. */
void nd_strides_over(nd x, const nd_shape3 *over, int *s) {
    for (int i = 0; i < ND_RANK; i++) {
        int axis = i - ND_RANK + x->rank;
        s[i] = axis < 0 || (x->n[axis] == 1 && over->n[i] != 1) ? 0 : x->s[axis];
    }
}

/* Rows of small arrays are shorter than a call. */
void nd_copy_row(double *to, int st, const double *from, int sf, int n) {
    if (n > 16 && st == 1 && sf == 1) memmove(to, from, sizeof(double) * (size_t)n);
    else
        for (int i = 0; i < n; i++, to += st, from += sf) *to = *from;
}

void nd_as_row(nd r, nd x) {
    bool is_row = x->rank == 1;
    r->p = x->p;
    r->rank = is_row ? 2 : x->rank;
    for (int i = 0; i < ND_RANK; i++) r->n[i] = x->n[i], r->s[i] = x->s[i];
    if (is_row) r->n[1] = x->n[0], r->s[1] = x->s[0], r->n[0] = 1, r->s[0] = 0;
}

void nd_as_column(nd r, nd x) {
    bool is_column = x->rank == 1;
    r->p = x->p;
    r->rank = is_column ? 2 : x->rank;
    for (int i = 0; i < ND_RANK; i++) r->n[i] = x->n[i], r->s[i] = x->s[i];
    if (is_column) r->n[1] = 1, r->s[1] = 0;
}
