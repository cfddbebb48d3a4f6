/* Triangular factors by reflections (Householder). */
#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#ifdef _WIN32
#define SHARED __declspec(dllexport)
#else
#define SHARED __attribute__((visibility("default")))
#endif

static double dot(size_t count, const double *x, const double *y)
{
    double sum = 0.0;
    for (size_t i = 0; i < count; i++) sum += x[i] * y[i];
    return sum;
}

/* y += a x */
static void add(size_t count, double *restrict y, double a, const double *restrict x)
{
    for (size_t i = 0; i < count; i++) y[i] += a * x[i];
}

/* product (N,N) = A B. Most entries of A may be 0, as those of a plant's equations are. */
static void multiply(size_t N, const double *A, const double *B, double *product)
{
    memset(product, 0, N * N * sizeof(double));
    for (size_t i = 0; i < N; i++)
        for (size_t l = 0; l < N; l++)
            if (A[i * N + l] != 0.0) add(N, product + i * N, A[i * N + l], B + l * N);
}

/* Columns of N entries, one behind the other: the first N of any form, then those that `add_columns` puts there.
   ends (N,): where the columns end that have an entry in row i or above */
typedef struct {
    size_t N;
    double *columns;
    size_t *ends;
    double *shares; /* scratch (N,) */
    size_t *first;  /* scratch, one for each column that is added */
} Columns;

static int new_columns(Columns *made, size_t N, size_t most_added)
{
    made->N = N;
    made->columns = malloc((N + most_added + 1) * N * sizeof(double));
    made->ends = malloc((N + most_added) * sizeof(size_t));
    made->shares = made->columns ? made->columns + (N + most_added) * N : NULL;
    made->first = made->ends ? made->ends + N : NULL;
    return made->columns && made->ends;
}

static void free_columns(Columns *made)
{
    free(made->columns);
    free(made->ends);
}

/* Put those of rows (N,c) behind the first N, by the row in which they begin: a triangular factor costs half then. */
static void add_columns(Columns *to, size_t c, const double *rows)
{
    size_t N = to->N, end = N;
    for (size_t m = 0; m < c; m++) {
        size_t row = 0;
        while (row < N && rows[row * c + m] == 0.0) row++;
        to->first[m] = row;
    }
    for (size_t i = 0; i < N; i++) {
        for (size_t m = 0; m < c; m++) {
            if (to->first[m] != i) continue;
            double *column = to->columns + end * N;
            for (size_t j = 0; j < i; j++) column[j] = 0.0;
            for (size_t j = i; j < N; j++) column[j] = rows[j * c + m];
            end++;
        }
        to->ends[i] = end;
    }
}

/* Turn the first N columns into a lower triangle T with T Tᵀ = A Aᵀ for all columns A. */
static void make_triangular(Columns *of)
{
    size_t N = of->N;
    double *restrict shares = of->shares;
    for (size_t i = 0; i < N; i++) {
        double *restrict pivot = of->columns + i * N, *restrict others = pivot + N, rest = 0.0;
        size_t count = of->ends[i] - i - 1;
        for (size_t m = 0; m < count; m++) rest += others[m * N + i] * others[m * N + i];
        if (rest > 0.0) {
            double size = sqrt(pivot[i] * pivot[i] + rest), end = pivot[i] > 0.0 ? -size : size;
            double along = pivot[i] - end, scale = 1.0 / (size * fabs(along));
            for (size_t j = i + 1; j < N; j++) shares[j] = along * pivot[j];
            for (size_t m = 0; m < count; m++) {
                double part = others[m * N + i];
                for (size_t j = i + 1; j < N; j++) shares[j] += part * others[m * N + j];
            }
            for (size_t j = i + 1; j < N; j++) {
                shares[j] *= scale;
                pivot[j] -= along * shares[j];
            }
            for (size_t m = 0; m < count; m++) {
                double part = others[m * N + i];
                for (size_t j = i + 1; j < N; j++) others[m * N + j] -= part * shares[j];
            }
            pivot[i] = end;
        }
        for (size_t j = 0; j < i; j++) pivot[j] = 0.0;
    }
}

static void take_rows(const Columns *from, double *rows)
{
    size_t N = from->N;
    for (size_t m = 0; m < N; m++)
        for (size_t j = 0; j < N; j++) rows[j * N + m] = from->columns[m * N + j];
}

static void put_rows(Columns *to, const double *rows)
{
    size_t N = to->N;
    for (size_t m = 0; m < N; m++)
        for (size_t j = 0; j < N; j++) to->columns[m * N + j] = rows[j * N + m];
}

/* Lower triangles (K,N,N) with T Tᵀ = rows rowsᵀ, of rows (K,N,c). */
SHARED int ndob_lower_factors(size_t K, size_t N, size_t c, const double *rows, double *found)
{
    Columns work;
    int good = new_columns(&work, N, c);
    for (size_t k = 0; good && k < K; k++) {
        memset(work.columns, 0, N * N * sizeof(double));
        add_columns(&work, c, rows + k * N * c);
        make_triangular(&work);
        take_rows(&work, found + k * N * N);
    }
    free_columns(&work);
    return good;
}
