/* Singular values and what follows from them, by Jacobi's rotations. */
#include "nd_linear.h"

#include <float.h>

#if !defined __GNUC__ || defined __clang__
#pragma STDC FP_CONTRACT OFF
#endif

/* They converge in six or seven sweeps over all pairs; a matrix that is not finite never does. */
enum { ND_SWEEPS = 60 };

static void rotation(double alpha, double beta, double gamma, double *c, double *s) {
    double cot = (beta - alpha) / (2.0 * gamma), t = copysign(1.0, cot) / (fabs(cot) + sqrt(1.0 + cot * cot));
    *c = 1.0 / sqrt(1.0 + t * t);
    *s = t * *c;
}

static void rotate(double *x, double *y, int n, double c, double s) {
    for (int i = 0; i < n; i++) {
        double u = x[i], v = y[i];
        x[i] = c * u - s * v, y[i] = s * u + c * v;
    }
}

/* Rotate the rows of X (k,m) until they are orthogonal; V (k,k) collects the rotations. Returns whether they are. */
static bool orthogonalise(nd X, nd V) {
    int k = X->n[0], m = X->n[1];
    double least = DBL_EPSILON * m; /* what rounding leaves of the product of two rows */
    double nothing = 0.0;           /* the square of a row that is zero but for rounding */
    for (int i = 0; i < k; i++) {
        double sum = 0.0;
        for (int l = 0; l < m; l++) sum += X->p[i * m + l] * X->p[i * m + l];
        if (sum * 1e-60 > nothing) nothing = sum * 1e-60;
    }
    for (int sweep = 0; sweep < ND_SWEEPS; sweep++) {
        bool turned = false;
        for (int i = 0; i < k; i++)
            for (int j = i + 1; j < k; j++) {
                double *x = X->p + i * m, *y = X->p + j * m, alpha = 0.0, beta = 0.0, gamma = 0.0, c, s;
                for (int l = 0; l < m; l++) alpha += x[l] * x[l], beta += y[l] * y[l], gamma += x[l] * y[l];
                if (alpha <= nothing || beta <= nothing) continue;
                if (!(fabs(gamma) > least * sqrt(alpha) * sqrt(beta))) continue;
                rotation(alpha, beta, gamma, &c, &s);
                rotate(x, y, m, c, s);
                rotate(V->p + i * k, V->p + j * k, k, c, s);
                turned = true;
            }
        if (!turned) return true;
    }
    return false;
}

/* A = U diag(s) Vt with s falling; `full`: square U and Vt. */
nd_three nd_svd(nd_arena *a, nd A, bool full) {
    int m = A->n[0], n = A->n[1], k = nd_imin2(m, n), rows;
    nd X, V, S, U, Vt, sizes, taken;
    double scale = 0.0;
    if (m < n) {
        nd_three t = nd_svd(a, nd_transposed(a, A), full);
        return (nd_three){nd_transposed(a, t.v2), t.v1, nd_transposed(a, t.v0)};
    }
    /* The columns of A, as rows; scaled, so that no square leaves the range of numbers. */
    X = nd_copy(a, nd_transposed(a, A));
    V = nd_eye(a, n, n, 0);
    S = nd_full(a, 1, &k, 0.0);
    rows = full ? m : k;
    U = nd_full(a, 2, (int[]){rows, m}, 0.0);
    Vt = nd_full(a, 2, (int[]){n, n}, 0.0);
    if (!nd_all_finite(A)) {
        (void)nd_failed(a, A);
        return (nd_three){nd_transposed(a, U), S, Vt};
    }
    for (int i = 0; i < n * m; i++)
        if (fabs(X->p[i]) > scale) scale = fabs(X->p[i]);
    if (scale > 0.0)
        for (int i = 0; i < n * m; i++) X->p[i] /= scale;
    if (!orthogonalise(X, V)) (void)nd_failed(a, A);
    sizes = nd_full(a, 1, &n, 0.0);
    taken = nd_full(a, 1, &n, 0.0);
    for (int i = 0; i < n; i++) {
        double sum = 0.0;
        for (int l = 0; l < m; l++) sum += X->p[i * m + l] * X->p[i * m + l];
        sizes->p[i] = sqrt(sum);
    }
    int rank = 0;
    for (int i = 0; i < n; i++) {
        int best = -1;
        for (int j = 0; j < n; j++)
            if (taken->p[j] == 0.0 && (best < 0 || sizes->p[j] > sizes->p[best])) best = j;
        taken->p[best] = 1.0;
        S->p[i] = sizes->p[best] * scale;
        memcpy(Vt->p + i * n, V->p + best * n, sizeof(double) * (size_t)n);
        if (sizes->p[best] > DBL_EPSILON * m * sizes->p[0] * 1e-3 && sizes->p[best] > 0.0 && rank == i) {
            for (int l = 0; l < m; l++) U->p[i * m + l] = X->p[best * m + l] / sizes->p[best];
            rank = i + 1;
        }
    }
    if (rank < rows) { /* directions that A does not reach: any that complete the basis */
        nd known = nd_transposed(a, nd_range(a, U, 0, rank));
        nd Q = nd_orthogonal_rows(a, known, m);
        nd_put(nd_range(a, U, rank, rows), nd_range(a, Q, rank, rows));
    }
    return (nd_three){nd_transposed(a, U), S, Vt};
}

nd_two nd_eigh(nd_arena *a, nd A) {
    int n = A->n[0];
    nd X = nd_copy(a, A), V = nd_eye(a, n, n, 0), w = nd_full(a, 1, &n, 0.0), sorted = nd_full(a, 2, (int[]){n, n}, 0.0);
    bool done = false;
    double *x = X->p;
    for (int sweep = 0; sweep < ND_SWEEPS && !done; sweep++) {
        done = true;
        for (int i = 0; i < n; i++)
            for (int j = i + 1; j < n; j++) {
                double c, s;
                if (!(fabs(x[i * n + j]) > 1e-17 * sqrt(fabs(x[i * n + i])) * sqrt(fabs(x[j * n + j]))) || x[i * n + j] == 0.0) continue;
                rotation(x[i * n + i], x[j * n + j], x[i * n + j], &c, &s);
                rotate(x + i * n, x + j * n, n, c, s);
                for (int k = 0; k < n; k++) {
                    double u = x[k * n + i], v = x[k * n + j];
                    x[k * n + i] = c * u - s * v, x[k * n + j] = s * u + c * v;
                }
                x[i * n + j] = x[j * n + i] = 0.0;
                rotate(V->p + i * n, V->p + j * n, n, c, s);
                done = false;
            }
    }
    if (!done || !nd_all_finite(X)) return (nd_two){nd_failed(a, w), V};
    for (int i = 0; i < n; i++) {
        int place = 0;
        for (int j = 0; j < n; j++) place += x[j * n + j] < x[i * n + i] || (x[j * n + j] == x[i * n + i] && j < i);
        w->p[place] = x[i * n + i];
        memcpy(sorted->p + place * n, V->p + i * n, sizeof(double) * (size_t)n);
    }
    return (nd_two){w, nd_transposed(a, sorted)};
}

double nd_norm2(nd_arena *a, nd x) {
    nd_three t = nd_svd(a, x, false);
    return nd_size(t.v1) ? t.v1->p[0] : 0.0;
}

double nd_cond(nd_arena *a, nd x) {
    nd s = nd_svd(a, x, false).v1;
    return nd_at(s, 0) / nd_at(s, -1);
}

static nd inverted(nd_arena *a, nd A, double part) {
    nd_three t = nd_svd(a, A, false);
    nd s = nd_copy(a, t.v1);
    for (int i = 0; i < nd_len(s); i++) s->p[i] = t.v1->p[i] > part * t.v1->p[0] ? 1.0 / t.v1->p[i] : 0.0;
    return nd_matmul(a, nd_binary(a, ND_MUL, nd_transposed(a, t.v2), s), nd_transposed(a, t.v0));
}

nd nd_pinv(nd_arena *a, nd A) { return inverted(a, A, 1e-15); }

nd nd_lstsq(nd_arena *a, nd A, nd B) {
    nd_three t = nd_svd(a, A, false);
    nd seen = nd_matmul(a, nd_transposed(a, t.v0), B), columns = B->rank == 1 ? nd_reshape(a, seen, 2, (int[]){-1, 1}) : seen, X;
    double part = DBL_EPSILON * nd_imax2(A->n[0], A->n[1]);
    for (int i = 0; i < columns->n[0]; i++)
        for (int j = 0; j < columns->n[1]; j++)
            columns->p[i * columns->s[0] + j * columns->s[1]] *= t.v1->p[i] > part * t.v1->p[0] ? 1.0 / t.v1->p[i] : 0.0;
    X = nd_matmul(a, nd_transposed(a, t.v2), columns);
    return B->rank == 1 ? nd_reshape(a, X, 1, (int[]){-1}) : X;
}
