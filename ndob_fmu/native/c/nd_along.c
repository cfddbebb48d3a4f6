/* Along axes: sums and the like, order, search. */
#include "nd_loops.h"

/* Without contraction every product is rounded, as in Python; so results are the same on every processor. */
#if !defined __GNUC__ || defined __clang__ /* gcc does not know it, and has the option -ffp-contract=off */
#pragma STDC FP_CONTRACT OFF
#endif

static double start_of(int op) {
    return op == ND_ALL_TRUE ? 1.0 : op == ND_LARGEST ? -INFINITY : op == ND_SMALLEST ? INFINITY : 0.0;
}

static double more_of(int op, double so_far, double x) {
    switch (op) {
    case ND_SUM: return so_far + x;
    case ND_ANY: return x != 0.0 ? 1.0 : so_far;
    case ND_ALL_TRUE: return x != 0.0 ? so_far : 0.0;
    case ND_NORM: return so_far + x * x;
    case ND_LARGEST: return x > so_far || nd_is_not_a_number(x) ? x : so_far;
    default: return x < so_far || nd_is_not_a_number(x) ? x : so_far;
    }
}

double nd_reduced(int op, nd x) {
    nd_shape3 o;
    int s[ND_RANK];
    double r = start_of(op);
    if (x->rank == 1) {
        for (int i = 0; i < x->n[0]; i++) r = more_of(op, r, x->p[i * x->s[0]]);
        return op == ND_NORM ? sqrt(r) : r;
    }
    nd_shape_of(x, &o);
    nd_strides_over(x, &o, s);
    ND_LOOP2(o) {
        const double *row = ND_ROW(x, s);
        for (int i = 0; i < o.n[2]; i++) r = more_of(op, r, row[i * s[2]]);
    }
    return op == ND_NORM ? sqrt(r) : r;
}

nd nd_reduce(nd_arena *a, int op, nd x, int axis) {
    nd_array like = *x;
    int sr[ND_RANK], sl[ND_RANK], steps;
    nd_shape3 o;
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
    nd_shape_of(r, &o);
    steps = x->n[axis];
    for (int k = 0; k < steps; k++) {
        nd_array last;
        nd_slot(&last, x, axis, k);
        nd_strides_over(r, &o, sr);
        nd_strides_over(&last, &o, sl);
        ND_LOOP2(o) {
            double *to = ND_ROW(r, sr);
            const double *from = ND_ROW(&last, sl);
            for (int i = 0; i < o.n[2]; i++) to[i] = more_of(op, to[i], from[i * sl[2]]);
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
