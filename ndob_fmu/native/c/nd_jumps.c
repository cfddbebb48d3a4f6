/* What an innovation says of jumps of the disturbance: runtime.step.jump_bank.with_innovation, in the same order. */
#include "nd_loops.h"

#if !defined __GNUC__ || defined __clang__
#pragma STDC FP_CONTRACT OFF
#endif

/* A hypothesis has NODES x WIDTH numbers. The jumps of one disturbance in a step have INSTANTS signatures: that at the
 * sample has the first one, and of its numbers all but [0][0] and [0][NODES] are zero; that in the step has the others. */
enum { NODES = 3, WIDTH = NODES + 1, INSTANTS = NODES + 1 };

/* [u, v] of a jump at the sample after an innovation; returns its variance, and the misfit e²/s. */
static double at_sample_explained(double *to, const double *from, double rho, double e, double alpha, double *misfit) {
    double f = rho * from[0], r = e - rho * from[NODES], s = f * f + alpha;
    double along = from[0] * f;
    memcpy(to, from, sizeof(double) * NODES * WIDTH);
    to[0] = from[0] - along * (f / (s + sqrt(alpha * s)));
    to[NODES] = from[NODES] - along * (-r / s);
    *misfit = r * r / s;
    return s;
}

/* [U, v] of a jump in the step after an innovation; returns its variance, and the misfit e²/s. */
static double in_step_explained(double *to, const double *from, const double *rho, double e, double alpha,
                                double *misfit) {
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
    if (!nd_is_compact(of_jumps)) of_jumps = nd_copy(a, of_jumps);
    double *without = told.v1->p, *within = without + count, *samples = within + count;
    for (int h = 0; h < count; h++) {
        double own, s, *to = told.v0->p + h * NODES * WIDTH;
        const double *from = before->p + h * NODES * WIDTH, *rho = of_jumps->p + h / 2 * INSTANTS;
        if (h % 2) s = in_step_explained(to, from, rho + 1, e, alpha, &own);
        else s = at_sample_explained(to, from, *rho, e, alpha, &own);
        without[h] += e * e / alpha;
        within[h] += own;
        samples[h] += 1.0;
        told.v2->p[h] = -0.5 * log(s / alpha);
    }
    return told;
}
