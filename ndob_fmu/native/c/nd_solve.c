/* Linear equations, by Gauss with partial pivoting. */
#include "nd_linear.h"

#include <float.h>

#if !defined __GNUC__ || defined __clang__
#pragma STDC FP_CONTRACT OFF
#endif

bool nd_all_finite(nd x) {
    for (int i = 0; i < x->n[0]; i++)
        for (int j = 0; j < x->n[1]; j++)
            if (!(fabs(nd_at2(x, i, j)) <= DBL_MAX)) return false;
    return true;
}

nd nd_failed(nd_arena *a, nd like) {
    nd_raise(a, ND_LINALG, "linear algebra: no solution");
    return nd_full_like(a, like, NAN);
}

double nd_norm1(nd x) {
    double largest = 0.0;
    for (int j = 0; j < x->n[1]; j++) {
        double sum = 0.0;
        for (int i = 0; i < x->n[0]; i++) sum += fabs(nd_at2(x, i, j));
        if (sum > largest || sum != sum) largest = sum;
    }
    return largest;
}

nd nd_solve(nd_arena *a, nd A, nd B) {
    int n = A->n[0], columns = B->rank == 1 ? 1 : B->n[1];
    nd L = nd_copy(a, A), X = nd_copy(a, B);
    double *l = L->p, *x = X->p;
    for (int k = 0; k < n; k++) {
        int best = k;
        for (int i = k + 1; i < n; i++)
            if (fabs(l[i * n + k]) > fabs(l[best * n + k])) best = i;
        if (l[best * n + k] == 0.0) return nd_failed(a, X);
        if (best != k) {
            for (int j = 0; j < n; j++) {
                double kept = l[k * n + j];
                l[k * n + j] = l[best * n + j], l[best * n + j] = kept;
            }
            for (int j = 0; j < columns; j++) {
                double kept = x[k * columns + j];
                x[k * columns + j] = x[best * columns + j], x[best * columns + j] = kept;
            }
        }
        for (int i = k + 1; i < n; i++) {
            double f = l[i * n + k] / l[k * n + k];
            if (f == 0.0) continue;
            for (int j = k + 1; j < n; j++) l[i * n + j] -= f * l[k * n + j];
            for (int j = 0; j < columns; j++) x[i * columns + j] -= f * x[k * columns + j];
        }
    }
    for (int i = n - 1; i >= 0; i--)
        for (int j = 0; j < columns; j++) {
            double sum = x[i * columns + j];
            for (int k = i + 1; k < n; k++) sum -= l[i * n + k] * x[k * columns + j];
            x[i * columns + j] = sum / l[i * n + i];
        }
    return X;
}

nd nd_inv(nd_arena *a, nd A) { return nd_solve(a, A, nd_eye(a, A->n[0], A->n[0], 0)); }
