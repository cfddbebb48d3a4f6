/* Arrays in another form, or put together. */
#include "nd_loops.h"

nd nd_transposed(nd_arena *a, nd x) {
    nd r = nd_same_view(a, x);
    for (int i = 0; i < x->rank; i++) r->n[i] = x->n[x->rank - 1 - i], r->s[i] = x->s[x->rank - 1 - i];
    return r;
}

nd nd_permuted(nd_arena *a, nd x, const int *axes) {
    nd r = nd_same_view(a, x);
    for (int i = 0; i < x->rank; i++) r->n[i] = x->n[axes[i]], r->s[i] = x->s[axes[i]];
    return r;
}

nd nd_reshape(nd_arena *a, nd x, int rank, const int *n) {
    int known = 1, size = nd_size(x);
    nd r = nd_view_at(a, (nd_is_compact(x) ? x : nd_copy(a, x))->p, rank);
    for (int i = 0; i < rank; i++) known *= n[i] < 0 ? 1 : n[i];
    for (int i = rank - 1, s = 1; i >= 0; i--) {
        int length = n[i] < 0 ? (known ? size / known : 0) : n[i];
        r->n[i] = length;
        r->s[i] = (int16_t)s;
        s *= length;
    }
    for (int i = rank; i < ND_RANK; i++) r->n[i] = r->s[i] = 1;
    return r;
}

nd nd_concatenate(nd_arena *a, int axis, int count, const nd *x) {
    int n[ND_RANK], at = 0;
    for (int i = 0; i < ND_RANK; i++) n[i] = i == axis ? 0 : x[0]->n[i];
    for (int i = 0; i < count; i++) n[axis] += x[i]->n[axis];
    nd r = nd_new(a, x[0]->rank, n);
    for (int i = 0; i < count; at += x[i]->n[axis], i++) {
        nd_array to;
        to.p = r->p + at * r->s[axis];
        to.rank = r->rank;
        for (int k = 0; k < ND_RANK; k++) to.n[k] = k == axis ? x[i]->n[k] : r->n[k], to.s[k] = r->s[k];
        if (x[i]->n[axis]) nd_put(&to, x[i]);
    }
    return r;
}

nd nd_hstack(nd_arena *a, int count, const nd *x) { return nd_concatenate(a, x[0]->rank == 1 ? 0 : 1, count, x); }

nd nd_joined(nd_arena *a, int axis, nd x, nd y) { return nd_concatenate(a, axis, 2, (nd[]){x, y}); }

nd nd_beside(nd_arena *a, nd x, nd y) { return nd_hstack(a, 2, (nd[]){x, y}); }

static nd stacked(nd_arena *a, int axis, int count, const nd *x, void (*form)(nd, nd)) {
    nd *forms = nd_take_bytes(a, sizeof(nd) * (size_t)count);
    for (int i = 0; i < count; i++) {
        forms[i] = nd_take_bytes(a, sizeof(nd_array));
        form(forms[i], x[i]);
    }
    return nd_concatenate(a, axis, count, forms);
}

nd nd_vstack(nd_arena *a, int count, const nd *x) { return stacked(a, 0, count, x, nd_as_row); }

nd nd_column_stack(nd_arena *a, int count, const nd *x) { return stacked(a, 1, count, x, nd_as_column); }

nd nd_stack(nd_arena *a, int count, const nd *x) {
    int n[ND_RANK] = {count, 1, 1}, rank = 1;
    for (; count && rank <= x[0]->rank; rank++) n[rank] = x[0]->n[rank - 1];
    nd r = nd_new(a, rank, n);
    for (int i = 0; i < count; i++) {
        nd_array to;
        nd_row_of(&to, r, i);
        nd_put(&to, x[i]);
    }
    return r;
}

nd nd_block2(nd_arena *a, nd x, nd y, nd z, nd w) {
    nd rows[2];
    rows[0] = nd_hstack(a, 2, (nd[]){x, y});
    rows[1] = nd_hstack(a, 2, (nd[]){z, w});
    return nd_concatenate(a, 0, 2, rows);
}

nd nd_tile(nd_arena *a, nd x, int times) {
    nd_array like = *x;
    like.n[0] = x->n[0] * times;
    nd r = nd_new(a, x->rank, like.n);
    double *to = r->p;
    for (int i = 0; i < times; i++) to = nd_write(to, x);
    return r;
}

nd nd_delete(nd_arena *a, nd x, int i) {
    nd parts[2];
    parts[0] = nd_range(a, x, 0, i);
    parts[1] = nd_range(a, x, i + 1, ND_END);
    return nd_concatenate(a, 0, 2, parts);
}

nd nd_diag(nd_arena *a, nd x) {
    nd r;
    if (x->rank == 2) {
        r = nd_view(a, nd_imin2(x->n[0], x->n[1]), x->p);
        r->s[0] = (int16_t)(x->s[0] + x->s[1]);
        return r;
    }
    r = nd_full(a, 2, (int[]){x->n[0], x->n[0]}, 0.0);
    nd_fill_diagonal(r, x);
    return r;
}

void nd_fill_diagonal(nd x, nd values) {
    for (int i = 0; i < nd_imin2(x->n[0], x->n[1]); i++) x->p[i * (x->s[0] + x->s[1])] = nd_at(values, i);
}
