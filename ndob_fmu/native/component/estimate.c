/* An estimate of either method as the outputs of the observer, in their order. Where a disturbance is yet to be read out
 * of a channel, x at the sample follows them. */
#include "translated.h"

static double *write_estimate(double *to, const Estimate *x) {
    const nd parts[] = {x->x_hat, x->d_hat, x->d_at_sample, x->d_std, x->d_lagged, x->d_lagged_std, x->residual,
                        x->residual_std};
    for (size_t i = 0; i < sizeof parts / sizeof *parts; i++) to = nd_write(to, parts[i]);
    *to++ = x->valid ? 1.0 : 0.0;
    *to++ = x->consistency;
    return CHANNEL ? nd_write(to, x->x_at_sample) : to;
}

/* Write an estimate; false, with an error, where a number in it is not finite. */
static bool write_finite_estimate(nd_arena *arena, double *to, const Estimate *x) {
    const double *end = write_estimate(to, x);
    for (const double *output = to; output < end; output++)
        if (!finite_number(*output)) {
            nd_raise(arena, ND_INTEGRATION, "the observer's estimate or its error bar leaves the finite numbers");
            return false;
        }
    return true;
}
