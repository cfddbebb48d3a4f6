/* What an innovation says of jumps of the disturbance: runtime.step.jump_bank.with_innovation, in the same order. */
#include "nd_loops.h"

#if !defined __GNUC__ || defined __clang__
#pragma STDC FP_CONTRACT OFF
#endif

enum { NODES = 3, WIDTH = NODES + 1 };

/* [U, v] of one hypothesis after an innovation; returns its variance, and the misfit e²/s. */
static double one_explained(double *to, const double *from, const double *rho, double e, double alpha, double *misfit) {
    double f[WIDTH], share[WIDTH], s = 0.0;
    for (int j = 0; j < WIDTH; j++) {
        f[j] = 0.0;
        for (int k = 0; k < NODES; k++) f[j] += rho[k] * from[k * WIDTH + j];
    }
    double r = e - f[NODES];
    for (int j = 0; j < NODES; j++) s += f[j] * f[j];
    s += alpha;
    double root = s + sqrt(alpha * s);
    for (int j = 0; j < NODES; j++) share[j] = f[j] / root;
    share[NODES] = -r / s;
    for (int k = 0; k < NODES; k++, from += WIDTH, to += WIDTH) {
        double along = 0.0;
        for (int j = 0; j < NODES; j++) along += from[j] * f[j];
        for (int j = 0; j < WIDTH; j++) to[j] = from[j] - along * share[j];
    }
    *misfit = r * r / s;
    return s;
}

nd_three nd_with_innovation(nd_arena *a, nd sizes, nd misfit, nd of_jumps, double e, double alpha) {
    int count = nd_len(sizes);
    nd_three told = {nd_new(a, sizes->rank, sizes->n), nd_copy(a, misfit), nd_new(a, 1, &count)};
    nd before = nd_is_compact(sizes) ? sizes : nd_copy(a, sizes);
    double *without = told.v1->p, *within = without + count, *samples = within + count;
    for (int h = 0; h < count; h++) {
        double rho[NODES], own;
        for (int k = 0; k < NODES; k++) rho[k] = nd_at(of_jumps, h * NODES + k);
        int place = h * NODES * WIDTH;
        double s = one_explained(told.v0->p + place, before->p + place, rho, e, alpha, &own);
        without[h] += e * e / alpha;
        within[h] += own;
        samples[h] += 1.0;
        told.v2->p[h] = -0.5 * log(s / alpha);
    }
    return told;
}
