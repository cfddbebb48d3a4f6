/* Making arrays. */
#include "nd_loops.h"

static int length_of(int rank, const int *n, int axis) { return axis >= rank ? 1 : n[axis] > 0 ? n[axis] : 0; }

nd nd_new(nd_arena *a, int rank, const int *n) {
    int n0 = length_of(rank, n, 0), n1 = length_of(rank, n, 1), n2 = length_of(rank, n, 2);
    if ((int64_t)n1 * n2 > INT16_MAX) longjmp(*a->full, 1); /* a stride has 16 bits */
    size_t size = (size_t)n0 * (size_t)(n1 * n2);
    nd x = nd_take_bytes(a, sizeof *x + sizeof(double) * (size ? size : 1));
    x->p = (double *)(void *)(x + 1);
    x->n[0] = n0, x->n[1] = n1, x->n[2] = n2;
    x->s[0] = (int16_t)(n1 * n2), x->s[1] = (int16_t)n2, x->s[2] = 1;
    x->rank = (int16_t)rank;
    return x;
}

nd nd_full(nd_arena *a, int rank, const int *n, double value) {
    nd x = nd_new(a, rank, n);
    double *to = x->p;
    for (int size = nd_size(x); size > 0; size--) *to++ = value;
    return x;
}

nd nd_filled(nd_arena *a, int n, double value) { return nd_full(a, 1, &n, value); }

nd nd_filled2(nd_arena *a, int rows, int columns, double value) { return nd_full(a, 2, (int[]){rows, columns}, value); }

nd nd_full_like(nd_arena *a, nd x, double value) { return nd_full(a, x->rank, x->n, value); }

nd nd_scalar(nd_arena *a, double value) { return nd_full(a, 0, NULL, value); }

nd nd_vector(nd_arena *a, int n, const double *values) {
    nd x = nd_new(a, 1, &n);
    memcpy(x->p, values, sizeof(double) * (size_t)n);
    return x;
}

nd_array nd_around(int n, const double *values) {
    nd_array view = {NULL, {n, 1, 1}, {1, 1, 1}, 1};
    memcpy(&view.p, &values, sizeof values);
    return view;
}

nd nd_view(nd_arena *a, int n, double *values) {
    nd x = nd_view_at(a, values, 1);
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

nd nd_copy(nd_arena *a, nd x) {
    nd r;
    if (!x) return x;
    r = nd_new(a, x->rank, x->n);
    if (nd_is_compact(x)) nd_copy_row(r->p, 1, x->p, 1, nd_size(x));
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
