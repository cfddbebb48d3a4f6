/* Eigenvalues of a matrix that need not be symmetric: balanced, reduced to Hessenberg's form by reflections, then
   Francis' double shifts (Golub and Van Loan, Matrix Computations, section 7.5) */
#include "nd_linear.h"

#include <float.h>

#if !defined __GNUC__ || defined __clang__
#pragma STDC FP_CONTRACT OFF
#endif

enum { ND_SHIFTS = 60 };
static const double PI = 3.14159265358979323846;

#define ENTRY(i, j) h[(i) * n + (j)]

static void balance(double *h, int n) {
    for (bool again = true; again;) {
        again = false;
        for (int i = 0; i < n; i++) {
            double row = 0.0, column = 0.0, f = 1.0, sum;
            for (int j = 0; j < n; j++)
                if (j != i) row += fabs(ENTRY(i, j)), column += fabs(ENTRY(j, i));
            if (row == 0.0 || column == 0.0) continue;
            sum = row + column;
            while (column < row / 2.0) f *= 2.0, column *= 4.0;
            while (column >= row * 2.0) f /= 2.0, column /= 4.0;
            if ((column + row) / f >= 0.95 * sum) continue;
            again = true;
            for (int j = 0; j < n; j++) ENTRY(i, j) /= f;
            for (int j = 0; j < n; j++) ENTRY(j, i) *= f;
        }
    }
}

/* Reflect rows or columns first ... first + count - 1 by v. */
static void from_both_sides(double *h, int n, int first, int count, const double *v, double tau) {
    for (int j = 0; j < n; j++) {
        double dot = 0.0;
        for (int i = 0; i < count; i++) dot += v[i] * ENTRY(first + i, j);
        for (int i = 0; i < count; i++) ENTRY(first + i, j) -= tau * dot * v[i];
    }
    for (int j = 0; j < n; j++) nd_reflect(&ENTRY(j, first), v, count, tau);
}

static void to_hessenberg(double *h, int n, double *v) {
    for (int k = 0; k + 2 < n; k++) {
        double tau;
        for (int i = k + 1; i < n; i++) v[i - k - 1] = ENTRY(i, k);
        (void)nd_reflection(v, n - k - 1, &tau);
        from_both_sides(h, n, k + 1, n - k - 1, v, tau);
        for (int i = k + 2; i < n; i++) ENTRY(i, k) = 0.0;
    }
}

static void two_by_two(double p, double q, double r, double s, double *re, double *im) {
    /* Of [[p, q], [r, s]]. */
    double half = 0.5 * (p - s), mean = 0.5 * (p + s), under = half * half + q * r;
    if (under < 0.0) {
        re[0] = re[1] = mean;
        im[0] = sqrt(-under), im[1] = -im[0];
        return;
    }
    double root = half + copysign(sqrt(under), half);
    re[0] = s + root;
    re[1] = root != 0.0 ? s - q * r / root : s;
    im[0] = im[1] = 0.0;
}

nd_two nd_eigvals(nd_arena *a, nd A) {
    int n = A->n[0], end = n - 1, tries = 0;
    nd re = nd_full(a, 1, &n, 0.0), im = nd_full(a, 1, &n, 0.0), H = nd_copy(a, A), V = nd_full(a, 1, &n, 0.0);
    double *h = H->p, v[3];
    if (!nd_all_finite(A)) return (nd_two){nd_failed(a, re), im};
    balance(h, n);
    to_hessenberg(h, n, V->p);
    while (end >= 0) {
        int start = end;
        for (; start > 0; start--) {
            double size = fabs(ENTRY(start - 1, start - 1)) + fabs(ENTRY(start, start));
            if (fabs(ENTRY(start, start - 1)) <= DBL_EPSILON * (size > 0.0 ? size : nd_norm1(H))) {
                ENTRY(start, start - 1) = 0.0;
                break;
            }
        }
        if (start == end) {
            re->p[end] = ENTRY(end, end);
            end--, tries = 0;
            continue;
        }
        if (start == end - 1) {
            two_by_two(ENTRY(start, start), ENTRY(start, end), ENTRY(end, start), ENTRY(end, end), re->p + start, im->p + start);
            end -= 2, tries = 0;
            continue;
        }
        if (++tries > ND_SHIFTS) return (nd_two){nd_failed(a, re), im};
        double trace = ENTRY(end - 1, end - 1) + ENTRY(end, end);
        double determinant = ENTRY(end - 1, end - 1) * ENTRY(end, end) - ENTRY(end - 1, end) * ENTRY(end, end - 1);
        if (tries % 10 == 0) { /* a shift that breaks a cycle */
            double size = fabs(ENTRY(end, end - 1)) + fabs(ENTRY(end - 1, end - 2));
            trace = 1.5 * size, determinant = size * size;
        }
        v[0] = ENTRY(start, start) * ENTRY(start, start) + ENTRY(start, start + 1) * ENTRY(start + 1, start) - trace * ENTRY(start, start) + determinant;
        v[1] = ENTRY(start + 1, start) * (ENTRY(start, start) + ENTRY(start + 1, start + 1) - trace);
        v[2] = ENTRY(start + 1, start) * ENTRY(start + 2, start + 1);
        for (int k = start; k < end; k++) {
            int count = nd_imin2(3, end - k + 1);
            double tau;
            if (k > start)
                for (int i = 0; i < count; i++) v[i] = ENTRY(k + i, k - 1);
            (void)nd_reflection(v, count, &tau);
            from_both_sides(h, n, k, count, v, tau);
            if (k > start)
                for (int i = 1; i < count; i++) ENTRY(k + i, k - 1) = 0.0;
        }
    }
    return (nd_two){re, im};
}

nd_two nd_leggauss(nd_arena *a, int n) {
    nd x = nd_new(a, 1, &n), w = nd_new(a, 1, &n);
    for (int i = 0; i < n; i++) {
        double z = -cos(PI * (i + 0.75) / (n + 0.5)), slope = 1.0;
        for (int tries = 0; tries < 8; tries++) {
            double here = 1.0, before = 0.0;
            for (int k = 0; k < n; k++) {
                double next = ((2 * k + 1) * z * here - k * before) / (k + 1);
                before = here, here = next;
            }
            slope = n * (z * here - before) / (z * z - 1.0);
            z -= here / slope;
        }
        x->p[i] = z;
        w->p[i] = 2.0 / ((1.0 - z * z) * slope * slope);
    }
    return (nd_two){x, w};
}
