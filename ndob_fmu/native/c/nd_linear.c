#include "nd.h"

#include <float.h>

#if !defined __GNUC__ || defined __clang__
#pragma STDC FP_CONTRACT OFF
#endif

/* Rotations converge in six or seven sweeps over all pairs; a matrix that is not finite never does. */
enum { ND_SWEEPS = 60, ND_SHIFTS = 60 };
static const double PI = 3.14159265358979323846;

static bool is_finite(double x) { return fabs(x) <= DBL_MAX; }

static bool all_finite(nd x) {
    for (int i = 0; i < x->n[0]; i++)
        for (int j = 0; j < x->n[1]; j++)
            if (!is_finite(nd_at2(x, i, j))) return false;
    return true;
}

static nd failed(nd_arena *a, nd like) {
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

/* -- Gauss with partial pivoting */

nd nd_solve(nd_arena *a, nd A, nd B) {
    int n = A->n[0], columns = B->rank == 1 ? 1 : B->n[1];
    nd L = nd_copy(a, A), X = nd_copy(a, B);
    double *l = L->p, *x = X->p;
    for (int k = 0; k < n; k++) {
        int best = k;
        for (int i = k + 1; i < n; i++)
            if (fabs(l[i * n + k]) > fabs(l[best * n + k])) best = i;
        if (l[best * n + k] == 0.0) return failed(a, X);
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

/* -- Householder's reflections, with LAPACK's signs */

/* Make v (length n) into the direction of the reflection that leaves its first entry only; return that entry. v[0] is
   set to 1, and *tau to the factor of v vT. */
static double reflection(double *v, int n, double *tau) {
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

static void reflect(double *x, const double *v, int n, double tau) {
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
        double tau, *v = X->p + k * n + k, diagonal = reflection(v, n - k, &tau);
        if (tau != 0.0)
            for (int i = k + 1; i < m; i++) reflect(X->p + i * n + k, v, n - k, tau);
        T->p[k * m + k] = diagonal;
        for (int i = k + 1; i < m; i++) T->p[i * m + k] = X->p[i * n + k];
    }
    a->used = mark;
    return T;
}

/* The first `count` columns of the orthogonal factor of A (m,n), as rows. */
static nd orthogonal_rows(nd_arena *a, nd A, int count) {
    int m = A->n[0], n = A->n[1], k = m < n ? m : n;
    nd Q = nd_eye(a, count, m, 0);
    size_t mark = a->used;
    nd X = nd_copy(a, nd_transposed(a, A)), tau = nd_full(a, 1, &k, 0.0);
    for (int c = 0; c < k; c++) {
        double *v = X->p + c * m + c;
        (void)reflection(v, m - c, tau->p + c);
        for (int i = c + 1; i < n; i++) reflect(X->p + i * m + c, v, m - c, tau->p[c]);
    }
    for (int c = k - 1; c >= 0; c--)
        for (int i = 0; i < count; i++) reflect(Q->p + i * m + c, X->p + c * m + c, m - c, tau->p[c]);
    a->used = mark;
    return Q;
}

nd nd_qr_q(nd_arena *a, nd A) { return nd_transposed(a, orthogonal_rows(a, A, nd_imin2(A->n[0], A->n[1]))); }

/* What follows only few designs call, so that short code is better than fast code. */
#if defined __clang__
#pragma clang attribute push(__attribute__((minsize)), apply_to = function)
#elif defined __GNUC__
#pragma GCC push_options
#pragma GCC optimize("Os")
#endif

/* -- Jacobi's rotations */

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
    if (!all_finite(A)) {
        (void)failed(a, A);
        return (nd_three){nd_transposed(a, U), S, Vt};
    }
    for (int i = 0; i < n * m; i++)
        if (fabs(X->p[i]) > scale) scale = fabs(X->p[i]);
    if (scale > 0.0)
        for (int i = 0; i < n * m; i++) X->p[i] /= scale;
    if (!orthogonalise(X, V)) (void)failed(a, A);
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
        nd known = nd_transposed(a, nd_get(a, U, 1, (nd_ix[]){{ND_RANGE, 0, rank}}));
        nd Q = orthogonal_rows(a, known, m);
        nd_put(nd_get(a, U, 1, (nd_ix[]){{ND_RANGE, rank, rows}}), nd_get(a, Q, 1, (nd_ix[]){{ND_RANGE, rank, rows}}));
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
    if (!done || !all_finite(X)) return (nd_two){failed(a, w), V};
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

/* -- eigenvalues of a matrix that need not be symmetric: balanced, reduced to Hessenberg's form by reflections, then
   Francis' double shifts (Golub and Van Loan, Matrix Computations, section 7.5) */

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
    for (int j = 0; j < n; j++) reflect(&ENTRY(j, first), v, count, tau);
}

static void to_hessenberg(double *h, int n, double *v) {
    for (int k = 0; k + 2 < n; k++) {
        double tau;
        for (int i = k + 1; i < n; i++) v[i - k - 1] = ENTRY(i, k);
        (void)reflection(v, n - k - 1, &tau);
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
    if (!all_finite(A)) return (nd_two){failed(a, re), im};
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
        if (++tries > ND_SHIFTS) return (nd_two){failed(a, re), im};
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
            (void)reflection(v, count, &tau);
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

#if defined __clang__
#pragma clang attribute pop
#elif defined __GNUC__
#pragma GCC pop_options
#endif
