/* Triangular and orthogonal factors, by Householder's reflections with LAPACK's signs. */
#include "nd_linear.h"

#if !defined __GNUC__ || defined __clang__
#pragma STDC FP_CONTRACT OFF
#endif

double nd_reflection(double *v, int n, double *tau) {
    double largest = 0.0, sum = 0.0, first = v[0], norm;
    for (int i = 1; i < n; i++) sum += v[i] * v[i];
    norm = sqrt(sum + first * first);
    if (!(sum > 1e-280 && sum + first * first < 1e280)) { /* squares leave the range of numbers */
        for (int i = 1; i < n; i++)
            if (fabs(v[i]) > largest || v[i] != v[i]) largest = fabs(v[i]);
        if (largest == 0.0) {
            *tau = 0.0;
            v[0] = 1.0;
            return first;
        }
        if (fabs(first) > largest) largest = fabs(first);
        sum = 0.0;
        for (int i = 0; i < n; i++) sum += v[i] / largest * (v[i] / largest);
        norm = largest * sqrt(sum);
    }
    norm = -copysign(norm, first);
    *tau = (norm - first) / norm;
    sum = 1.0 / (first - norm);
    for (int i = 1; i < n; i++) v[i] *= sum;
    v[0] = 1.0;
    return norm;
}

void nd_reflect(double *x, const double *v, int n, double tau) {
    double dot = 0.0;
    for (int i = 0; i < n; i++) dot += v[i] * x[i];
    dot *= tau;
    for (int i = 0; i < n; i++) x[i] -= dot * v[i];
}

/* The reflections work on rows, which lie together in memory. */
nd nd_triangular(nd_arena *a, nd rows) {
    int m = rows->n[0], n = rows->n[1];
    nd T = nd_full(a, 2, (int[]){m, m}, 0.0);
    size_t mark = a->used;
    nd X = nd_copy(a, rows);
    for (int k = 0; k < m && k < n; k++) {
        double tau, *v = X->p + k * n + k, diagonal = nd_reflection(v, n - k, &tau);
        if (tau != 0.0)
            for (int i = k + 1; i < m; i++) nd_reflect(X->p + i * n + k, v, n - k, tau);
        T->p[k * m + k] = diagonal;
        for (int i = k + 1; i < m; i++) T->p[i * m + k] = X->p[i * n + k];
    }
    a->used = mark;
    return T;
}

nd nd_orthogonal_rows(nd_arena *a, nd A, int count) {
    int m = A->n[0], n = A->n[1], k = m < n ? m : n;
    nd Q = nd_eye(a, count, m, 0);
    size_t mark = a->used;
    nd X = nd_copy(a, nd_transposed(a, A)), tau = nd_full(a, 1, &k, 0.0);
    for (int c = 0; c < k; c++) {
        double *v = X->p + c * m + c;
        (void)nd_reflection(v, m - c, tau->p + c);
        for (int i = c + 1; i < n; i++) nd_reflect(X->p + i * m + c, v, m - c, tau->p[c]);
    }
    for (int c = k - 1; c >= 0; c--)
        for (int i = 0; i < count; i++) nd_reflect(Q->p + i * m + c, X->p + c * m + c, m - c, tau->p[c]);
    a->used = mark;
    return Q;
}

nd nd_qr_q(nd_arena *a, nd A) { return nd_transposed(a, nd_orthogonal_rows(a, A, nd_imin2(A->n[0], A->n[1]))); }
