/* Along axes: sums and the like, order, search. */
#include "nd_loops.h"

/* Without contraction every product is rounded, as in Python; so results are the same on every processor. */
#if !defined __GNUC__ || defined __clang__ /* gcc does not know it, and has the option -ffp-contract=off */
#pragma STDC FP_CONTRACT OFF
#endif

static double start_of(int op) {
    return op == ND_ALL_TRUE ? 1.0 : op == ND_LARGEST ? -INFINITY : op == ND_SMALLEST ? INFINITY : 0.0;
}

/* The sum, the largest number, … of a row and what came before it. */
#define ND_FOLD(op, value)                      \
    case op:                                    \
        for (; n > 0; n--, row += step) {       \
            double x = *row;                    \
            r = (value);                        \
        }                                       \
        return r;

static double folded(int op, double r, int n, const double *row, int step) {
    switch (op) {
        ND_FOLD(ND_SUM, r + x)
        ND_FOLD(ND_ANY, x != 0.0 ? 1.0 : r)
        ND_FOLD(ND_ALL_TRUE, x != 0.0 ? r : 0.0)
        ND_FOLD(ND_NORM, r + x * x)
        ND_FOLD(ND_LARGEST, x > r || nd_is_not_a_number(x) ? x : r)
        ND_FOLD(ND_SMALLEST, x < r || nd_is_not_a_number(x) ? x : r)
    default: return r;
    }
}

double nd_reduced(int op, nd x) {
    double r = start_of(op);
    if (x->rank == 1) r = folded(op, r, x->n[0], x->p, x->s[0]);
    else if (nd_is_compact(x)) r = folded(op, r, nd_size(x), x->p, 1);
    else {
        nd_shape3 o;
        int s[ND_RANK];
        nd_shape_of(x, &o);
        nd_strides_over(x, &o, s);
        ND_LOOP2(o) r = folded(op, r, o.n[2], ND_ROW(x, s), s[2]);
    }
    return op == ND_NORM ? sqrt(r) : r;
}

nd nd_reduce(nd_arena *a, int op, nd x, int axis) {
    int n[ND_RANK] = {1, 1, 1}, s[ND_RANK] = {0}, rank = 0;
    if (axis < 0) axis += x->rank;
    for (int i = 0; i < x->rank; i++)
        if (i != axis) n[rank] = x->n[i], s[rank++] = x->s[i];
    nd r = nd_new(a, rank, n);
    double *to = r->p;
    for (int i0 = 0; i0 < n[0]; i0++)
        for (int i1 = 0; i1 < n[1]; i1++) {
            double found = folded(op, start_of(op), x->n[axis], x->p + i0 * s[0] + i1 * s[1], x->s[axis]);
            *to++ = op == ND_NORM ? sqrt(found) : found;
        }
    return r;
}

double nd_mean(nd x) { return nd_reduced(ND_SUM, x) / nd_size(x); }

int nd_argmin(nd x) {
    int best = 0;
    for (int i = 1; i < nd_len(x); i++)
        if (!nd_is_not_a_number(nd_at(x, best)) && (nd_at(x, i) < nd_at(x, best) || nd_is_not_a_number(nd_at(x, i)))) best = i;
    return best;
}

int nd_argmax(nd x) {
    int best = 0;
    for (int i = 1; i < nd_len(x); i++)
        if (!nd_is_not_a_number(nd_at(x, best)) && (nd_at(x, i) > nd_at(x, best) || nd_is_not_a_number(nd_at(x, i)))) best = i;
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
    return nd_binary(a, ND_SUB, nd_range(a, x, 1, ND_END), nd_range(a, x, 0, x->n[0] ? -1 : 0));
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
