/* Dense arrays of doubles in a block of memory, as far as the runtime uses NumPy: what translated code stands on.

   An array is a view: a pointer, and for each axis a length and a stride. Slices and transposes share memory with what
   they were taken from, as in NumPy. Code hands on the address of a view, which lies in the block too: that keeps the
   calls short. A view comes with or behind its numbers. All memory comes from one block, in order; a function gives back
   what it took when it returns, but for its result (`nd_keep`), where that is worth it. A method that finds no answer sets the error of the
   block, which translated code looks at after each call that can fail. A block that is too small ends the call of the
   outermost function: its owner sets `full`. */
#ifndef ND_H
#define ND_H

#include "nd_text.h"

#include <math.h>
#include <setjmp.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#define ND_RANK 3
#define ND_MESSAGE 300
#define ND_END INT32_MAX /* the end of a slice that has none */

typedef struct {
    double *p;
    int n[ND_RANK];
    int16_t s[ND_RANK]; /* in numbers, not in bytes: an array of several axes is small */
    int16_t rank;
} nd_array;
typedef nd_array *nd; /* NULL: there is no array */

typedef struct {
    char *base;
    size_t size, used; /* in bytes */
    jmp_buf *full;     /* where to go when the block is too small */
    int error;         /* one of ND_NONE ... */
    char *message;     /* of ND_MESSAGE bytes; NULL in a block in which nothing raises */
} nd_arena;

/* The errors of the runtime, by the class that Python raises. */
enum { ND_NONE, ND_LINALG, ND_DESIGN, ND_ASSUMPTION, ND_INTEGRATION, ND_ARITHMETIC };

typedef struct {
    int n;
    nd *p;
} nd_list;

typedef struct {
    int n;
    const char *const *p;
} nd_names;

typedef struct {
    int start, stop;
} nd_slice;

/* -- memory */
void nd_start(nd_arena *a, void *block, size_t bytes);
void *nd_take_bytes(nd_arena *a, size_t bytes);
void nd_raise(nd_arena *a, int error, const char *format, ...);

/* The move of a function's result to where its memory began: passes over all blocks that the result consists of. */
typedef struct {
    nd_arena *a;
    size_t mark, top;
    int pass;
    size_t kept;
} nd_keeping;
nd_keeping nd_keep_begin(nd_arena *a, size_t mark);
nd_keeping nd_copy_begin(nd_arena *to);
nd_keeping nd_forms_begin(nd_arena *to);
bool nd_keep_pass(nd_keeping *k);
void nd_keep_block(nd_keeping *k, void **p, size_t bytes);
void nd_keep_shift(nd_keeping *k, void **p);
void nd_keep_array(nd_keeping *k, nd *x);
nd nd_keep(nd_arena *a, size_t mark, nd x);
void nd_keep_parts(nd_arena *a, size_t mark, void *x, void (*keep)(nd_keeping *k, void *x)); /* of a structure */

/* -- making arrays */
nd nd_new(nd_arena *a, int rank, const int *n); /* not initialised */
nd nd_full(nd_arena *a, int rank, const int *n, double value);
nd nd_filled(nd_arena *a, int n, double value); /* of one axis */
nd nd_filled2(nd_arena *a, int rows, int columns, double value);
nd nd_full_like(nd_arena *a, nd x, double value);
nd nd_scalar(nd_arena *a, double value);
nd nd_vector(nd_arena *a, int n, const double *values);
nd nd_view(nd_arena *a, int n, double *values);
nd nd_view_of(nd_arena *a, int n, const double *values); /* that nobody changes */
nd_array nd_around(int n, const double *values);         /* such a view in the caller's memory */
nd nd_eye(nd_arena *a, int rows, int columns, int k);
nd nd_tri(nd_arena *a, int n);
nd nd_copy(nd_arena *a, nd x);
nd nd_arange(nd_arena *a, int start, int stop);
nd nd_linspace(nd_arena *a, double low, double high, int n);
nd nd_geomspace(nd_arena *a, double low, double high, int n);

/* -- reading and writing entries */
enum { ND_RANGE, ND_AT, ND_NEW };
typedef struct {
    int kind, a, b;
} nd_ix;
int nd_len(nd x);
int nd_size(nd x);
double nd_item(nd x);
double nd_at(nd x, int i);
double nd_at2(nd x, int i, int j);
void nd_set(nd x, int i, double value);
nd nd_get(nd_arena *a, nd x, int count, const nd_ix *at);
nd nd_reversed(nd_arena *a, nd x); /* along the first axis */
nd nd_row(nd_arena *a, nd x, int i);                    /* x[i] */
nd nd_column(nd_arena *a, nd x, int i);                 /* x[:, i] */
nd nd_range(nd_arena *a, nd x, int start, int stop);    /* x[start:stop] */
nd nd_block(nd_arena *a, nd x, int top, int bottom, int left, int right); /* x[top:bottom, left:right] */
nd nd_upright(nd_arena *a, nd x);                       /* x[:, None] */
void nd_put(nd x, nd value);
void nd_put_number(nd x, double value);
nd nd_take(nd_arena *a, nd x, nd indices, int axis);
nd nd_take2(nd_arena *a, nd x, nd rows, nd columns);
void nd_put2(nd x, nd rows, nd columns, nd value);
void nd_put_rows(nd x, nd rows, nd value);
nd nd_indices(nd_arena *a, nd mask); /* flatnonzero */
nd nd_argwhere(nd_arena *a, nd mask);
void *nd_room(nd_arena *a, const void *items, int count, size_t bytes);
void nd_append(nd_arena *a, nd *x, double value);

/* Arrays as numbers one after the other; what is read has its shape already, and shows the numbers where they lie. */
double *nd_write(double *to, nd x);
const double *nd_read(const double *from, nd x);
int nd_truncated(nd_arena *a, double x); /* int(x), an error where x is not finite, at most INT32_MAX */
int nd_integer(double x); /* of a number from outside: -1 where it is none */

/* -- forms */
nd nd_transposed(nd_arena *a, nd x);
nd nd_permuted(nd_arena *a, nd x, const int *axes);
nd nd_reshape(nd_arena *a, nd x, int rank, const int *n); /* one length may be -1 */
nd nd_concatenate(nd_arena *a, int axis, int count, const nd *x);
nd nd_joined(nd_arena *a, int axis, nd x, nd y);
nd nd_beside(nd_arena *a, nd x, nd y);
nd nd_hstack(nd_arena *a, int count, const nd *x);
nd nd_vstack(nd_arena *a, int count, const nd *x);
nd nd_column_stack(nd_arena *a, int count, const nd *x);
nd nd_stack(nd_arena *a, int count, const nd *x);
nd nd_block2(nd_arena *a, nd x, nd y, nd z, nd w);
nd nd_tile(nd_arena *a, nd x, int times); /* along the first axis */
nd nd_delete(nd_arena *a, nd x, int i);   /* along the first axis */
nd nd_diag(nd_arena *a, nd x);
void nd_fill_diagonal(nd x, nd values);

/* -- entry by entry, with NumPy's rules for axes of length one */
enum { ND_ADD, ND_SUB, ND_MUL, ND_DIV, ND_POW, ND_MAX, ND_MIN, ND_HYPOT, ND_COPYSIGN, ND_LT, ND_LE, ND_GT, ND_GE, ND_EQ, ND_NE, ND_AND, ND_OR };
nd nd_binary(nd_arena *a, int op, nd x, nd y);
nd nd_binary_xn(nd_arena *a, int op, nd x, double y);
nd nd_binary_nx(nd_arena *a, int op, double x, nd y);
nd nd_map(nd_arena *a, double (*f)(double), nd x);
nd nd_where(nd_arena *a, nd mask, nd x, nd y);
double nd_isfinite(double x);
double nd_isnan(double x);
double nd_isinf(double x);
double nd_not(double x);
double nd_negative(double x);
double nd_square(double x);
double nd_exponent_of(double x); /* frexp(x)[1] */

/* -- along an axis, or over all entries (nd_reduced) */
enum { ND_SUM, ND_ANY, ND_ALL_TRUE, ND_NORM, ND_LARGEST, ND_SMALLEST };
nd nd_reduce(nd_arena *a, int op, nd x, int axis);
double nd_reduced(int op, nd x);
double nd_mean(nd x);
int nd_argmin(nd x);
int nd_argmax(nd x);
nd nd_lexsort(nd_arena *a, nd then, nd first);
nd nd_sorted(nd_arena *a, nd x);
nd nd_cumsum(nd_arena *a, nd x);
nd nd_diff(nd_arena *a, nd x);
int nd_searchsorted_right(nd x, double value);
bool nd_equal(nd x, nd y);

/* -- products */
nd nd_matmul(nd_arena *a, nd x, nd y);
nd nd_tensordot1(nd_arena *a, nd x, nd y); /* the last axis of x with the first of y */
nd nd_rhk_hkj(nd_arena *a, nd x, nd y);    /* einsum("rhk,hkj->rhj") */

int nd_find(int n, const char *const *names, const char *name);

/* -- linear algebra (nd_linear.c) */
typedef struct {
    nd v0, v1;
} nd_two;
typedef struct {
    nd v0, v1, v2;
} nd_three;
double nd_norm1(nd x);
double nd_norm2(nd_arena *a, nd x);
double nd_cond(nd_arena *a, nd x);
nd nd_solve(nd_arena *a, nd A, nd B);
nd nd_inv(nd_arena *a, nd A);
nd nd_triangular(nd_arena *a, nd rows);
nd nd_qr_q(nd_arena *a, nd A);
nd_three nd_svd(nd_arena *a, nd A, bool full);
nd nd_pinv(nd_arena *a, nd A);
nd nd_lstsq(nd_arena *a, nd A, nd B);
nd_two nd_eigh(nd_arena *a, nd A);
nd_two nd_eigvals(nd_arena *a, nd A); /* real and imaginary parts */
nd_two nd_leggauss(nd_arena *a, int n);

/* -- numbers, as Python has them */
double nd_max2(double x, double y);
double nd_min2(double x, double y);
int nd_imax2(int x, int y);
int nd_imin2(int x, int y);
int nd_mod(int x, int y);
int nd_floordiv(int x, int y);
int nd_bits(int x);
int nd_bit_length(int x);
double nd_factorial(int n);
double nd_ulp(double x);

/* -- jumps of the disturbance (nd_jumps.c) */
nd_three nd_with_innovation(nd_arena *a, nd sizes, nd misfit, nd of_jumps, double e, double alpha);

/* -- random numbers (nd_random.c) */
nd nd_uniforms(nd_arena *a, int seed, double index); /* runtime.blocks.random_numbers.uniforms */
double nd_rounded(double x, int digits);

#endif
