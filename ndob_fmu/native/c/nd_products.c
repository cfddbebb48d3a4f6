/* Products. */
#include "nd_loops.h"
#include "nd_pairs.h"

/* Without contraction every product is rounded, as in Python; so results are the same on every processor. */
#if !defined __GNUC__ || defined __clang__ /* gcc does not know it, and has the option -ffp-contract=off */
#pragma STDC FP_CONTRACT OFF
#endif

/* r (rows,columns) in one piece = x (rows,inner) y (inner,columns), for the strides of rows and columns. Two columns at a
   time stay in one register; each sum goes in the order of the terms. */
static void multiply(double *r, int rows, int inner, int columns, const double *x, const int16_t *sx, const double *y,
                     const int16_t *sy) {
    int next = sx[1], row = sy[0], column = sy[1];
    for (int i = 0; i < rows; i++, r += columns, x += sx[0]) {
        int j = 0;
        for (; column == 1 && j + 6 <= columns; j += 6) {
            two s0 = two_of(0.0), s1 = s0, s2 = s0;
            const double *u = x, *v = y + j;
            for (int k = inner; k > 0; k--, u += next, v += row) {
                two f = two_of(*u);
                s0 = ND_PLUS(s0, ND_TIMES(f, two_at(v)));
                s1 = ND_PLUS(s1, ND_TIMES(f, two_at(v + 2)));
                s2 = ND_PLUS(s2, ND_TIMES(f, two_at(v + 4)));
            }
            put_two(r + j, s0), put_two(r + j + 2, s1), put_two(r + j + 4, s2);
        }
        for (; column == 1 && j + 2 <= columns; j += 2) {
            two sum = two_of(0.0);
            const double *u = x, *v = y + j;
            for (int k = inner; k > 0; k--, u += next, v += row) sum = ND_PLUS(sum, ND_TIMES(two_of(*u), two_at(v)));
            put_two(r + j, sum);
        }
        for (; j < columns; j++) {
            double sum = 0.0;
            const double *u = x, *v = y + j * column;
            for (int k = inner; k > 0; k--, u += next, v += row) sum += *u * *v;
            r[j] = sum;
        }
    }
}

nd nd_matmul(nd_arena *a, nd x, nd y) {
    nd_array left, right;
    nd_as_row(&left, x);
    nd_as_column(&right, y);
    int lm = left.rank - 2, rm = right.rank - 2; /* 1 with a batch of matrices */
    int rows = left.n[lm], inner = left.n[lm + 1], columns = right.n[rm + 1];
    if (lm && !rm && left.s[0] == rows * left.s[1]) { /* a batch times one matrix is one product */
        nd r = nd_new(a, 3, (int[]){left.n[0], rows, columns});
        multiply(r->p, left.n[0] * rows, inner, columns, left.p, left.s + 1, right.p, right.s);
        return r;
    }
    if (lm || rm) {
        int count = lm ? left.n[0] : right.n[0];
        nd r = nd_new(a, 3, (int[]){count, rows, columns});
        for (int i = 0; i < count; i++)
            multiply(r->p + i * rows * columns, rows, inner, columns, left.p + (lm ? i * left.s[0] : 0), left.s + lm,
                     right.p + (rm ? i * right.s[0] : 0), right.s + rm);
        return r;
    }
    nd r = nd_new(a, 2, (int[]){rows, columns});
    multiply(r->p, rows, inner, columns, left.p, left.s, right.p, right.s);
    if (y->rank == 1) r->rank--;
    else if (x->rank == 1) r->rank--, r->n[0] = r->n[1], r->s[0] = 1;
    if (x->rank == 1 && y->rank == 1) r->rank = 0;
    return r;
}

nd nd_tensordot1(nd_arena *a, nd x, nd y) {
    int inner = y->n[0], n[ND_RANK], rank = 0;
    nd product = nd_matmul(a, nd_reshape(a, x, 2, (int[]){-1, inner}), nd_reshape(a, y, 2, (int[]){inner, -1}));
    for (int i = 0; i < x->rank - 1; i++) n[rank++] = x->n[i];
    for (int i = 1; i < y->rank; i++) n[rank++] = y->n[i];
    return nd_reshape(a, product, rank, n);
}

nd nd_rhk_hkj(nd_arena *a, nd x, nd y) {
    int rows = x->n[0], count = x->n[1], inner = x->n[2], columns = y->n[2];
    nd r = nd_full(a, 3, (int[]){rows, count, columns}, 0.0);
    double *to = r->p;
    for (int i = 0; i < rows; i++)
        for (int h = 0; h < count; h++, to += columns)
            for (int k = 0; k < inner; k++) {
                double u = x->p[i * x->s[0] + h * x->s[1] + k * x->s[2]];
                const double *from = y->p + h * y->s[0] + k * y->s[1];
                for (int j = 0; j < columns; j++) to[j] += u * from[j * y->s[2]];
            }
    return r;
}
