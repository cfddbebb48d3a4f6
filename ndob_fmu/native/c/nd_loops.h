/* What the functions on arrays have in common: every array as one of three axes, the first ones of length one. */
#ifndef ND_LOOPS_H
#define ND_LOOPS_H

#include "nd.h"

/* Structures are written in place, entry by entry: processors wait where a copy reads what smaller writes just left. */
typedef struct {
    int n[ND_RANK];
} nd_shape3;

#define ND_LOOP2(o)                       \
    for (int i0 = 0; i0 < (o).n[0]; i0++) \
        for (int i1 = 0; i1 < (o).n[1]; i1++)
#define ND_ROW(x, s) ((x)->p + i0 * (s)[0] + i1 * (s)[1])

bool nd_is_compact(nd x);
bool nd_same_shape(nd x, nd y);
nd nd_view_at(nd_arena *a, double *p, int rank);
nd nd_same_view(nd_arena *a, nd x);
nd nd_form_of(nd_arena *a, nd x);
void nd_shape_of(nd x, nd_shape3 *r);
void nd_strides_over(nd x, const nd_shape3 *over, int *s);
void nd_copy_row(double *to, int st, const double *from, int sf, int n);
void nd_as_row(nd r, nd x);
void nd_as_column(nd r, nd x);
void nd_part_of(nd r, nd x, int count, const nd_ix *at);
void nd_row_of(nd r, nd x, int i);
void nd_slot(nd r, nd x, int axis, int i);
int nd_index_of(nd indices, int i);
bool nd_is_not_a_number(double x);

#endif
