/* Entry by entry, with NumPy's rules for axes of length one. */
#include "nd_loops.h"
#include "nd_pairs.h"

#include <float.h>

/* Without contraction every product is rounded, as in Python; so results are the same on every processor. */
#if !defined __GNUC__ || defined __clang__ /* gcc does not know it, and has the option -ffp-contract=off */
#pragma STDC FP_CONTRACT OFF
#endif

static double power(double x, double y) { return y == 2.0 ? x * x : y == 0.5 ? sqrt(x) : pow(x, y); }

#ifdef __GNUC__
#define ND_PAIRS(first, second, value)                 \
    for (; i + 2 <= n; i += 2) {                       \
        two u = first, v = second;                     \
        put_two(r + i, value);                         \
    }
#else
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
        ND_EACH(ND_MAX, u >= v || nd_is_not_a_number(u) ? u : v)
        ND_EACH(ND_MIN, u <= v || nd_is_not_a_number(u) ? u : v)
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
        ND_LOOP2(o) {                                                     \
            const double *first = ND_ROW(x, sx), *second = ND_ROW(y, sy); \
            for (int i = 0; i < o.n[2]; i++) {                            \
                double u = *first, v = *second;                           \
                *to++ = (value);                                          \
                first += sx[2], second += sy[2];                          \
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
    if ((x->rank == 0 || nd_is_compact(x)) && (y->rank == 0 || nd_is_compact(y)) && (x->rank == 0 || y->rank == 0 || nd_same_shape(x, y))) {
        r = nd_new(a, like->rank, like->n);
        binary_row(op, nd_size(r), r->p, x->p, x->rank > 0, y->p, y->rank > 0);
        return r;
    }
    nd_shape3 shape_x, shape_y, o;
    int sx[ND_RANK], sy[ND_RANK];
    nd_shape_of(x, &shape_x);
    nd_shape_of(y, &shape_y);
    for (int i = 0; i < ND_RANK; i++) o.n[i] = shape_x.n[i] == 1 ? shape_y.n[i] : shape_x.n[i];
    r = nd_new(a, like->rank, o.n + ND_RANK - like->rank);
    nd_strides_over(x, &o, sx);
    nd_strides_over(y, &o, sy);
    double *to = r->p;
    switch (o.n[2] < 8 ? op : -1) {
        ND_EVERY(ND_ADD, u + v)
        ND_EVERY(ND_SUB, u - v)
        ND_EVERY(ND_MUL, u *v)
        ND_EVERY(ND_DIV, u / v)
    default:
        ND_LOOP2(o) {
            binary_row(op, o.n[2], to, ND_ROW(x, sx), sx[2], ND_ROW(y, sy), sy[2]);
            to += o.n[2];
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
    if (!nd_is_compact(x)) nd_put(r, x), from = r->p;
    if (f == nd_square)
        for (int i = 0; i < size; i++) r->p[i] = from[i] * from[i];
    else
        for (int i = 0; i < size; i++) r->p[i] = f(from[i]);
    return r;
}

nd nd_where(nd_arena *a, nd mask, nd x, nd y) {
    /* The sum of all has the shape of the result. */
    nd r = nd_binary(a, ND_ADD, nd_binary(a, ND_ADD, mask, x), y);
    nd_shape3 o;
    int sm[ND_RANK], sx[ND_RANK], sy[ND_RANK], sr[ND_RANK];
    nd_shape_of(r, &o);
    nd_strides_over(mask, &o, sm);
    nd_strides_over(x, &o, sx);
    nd_strides_over(y, &o, sy);
    nd_strides_over(r, &o, sr);
    ND_LOOP2(o) {
        double *to = ND_ROW(r, sr);
        const double *m = ND_ROW(mask, sm), *u = ND_ROW(x, sx), *v = ND_ROW(y, sy);
        for (int i = 0; i < o.n[2]; i++) to[i] = m[i * sm[2]] != 0.0 ? u[i * sx[2]] : v[i * sy[2]];
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
