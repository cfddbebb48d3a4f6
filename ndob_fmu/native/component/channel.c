/* The disturbance read out of the lumped inputs w = n(x, u) d, which the observers estimate like CHANNEL disturbances.
 *
 * What it remembers follows the numbers of the observer's state: the last disturbance that could be read, then the
 * directions at past samples, which a lag needs. */
#include "fmu.h"
#include "translated.h"

typedef struct {
    ChannelReading reading;
    int kept; /* instants of the past */
} Channelled;

static size_t channel_state_size(const Channelled *self) { return (size_t)(1 + self->kept * (1 + 2 * CHANNEL)); }

static void write_channel_state(nd d_hat, const LagMemory *directions, double *to) {
    to = nd_write(nd_write(to, d_hat), directions->age);
    (void)nd_write(nd_write(to, directions->value), directions->variance);
}

/* Make it from the plant, its parameters and the settings, and write its first state; returns an error of nd.h. */
static int channel_start(Channelled *self, nd_arena *arena, const Equations *plant, nd parameters, nd bound, double lag,
                         double *state) {
    LagMemory empty = fixed_lag_empty_lag(arena, CHANNEL, lag, 0);
    self->reading.channel = plant->channel.value;
    self->reading.parameters = parameters;
    self->reading.disturbance_bound = bound;
    self->reading.lag = lag;
    self->kept = nd_len(empty.age);
    write_channel_state(nd_full(arena, 1, (int[]){1}, 0.0), &empty, state);
    return arena->error;
}

/* An estimate of w as `write_estimate` has written it. */
static Estimate estimate_of_lumped(nd_arena *arena, const double *from) {
    Estimate w;
    struct {
        nd *part;
        int count;
    } parts[] = {{&w.x_hat, STATES},         {&w.d_hat, CHANNEL},        {&w.d_at_sample, CHANNEL},
                 {&w.d_std, CHANNEL},        {&w.d_lagged, CHANNEL},     {&w.d_lagged_std, CHANNEL},
                 {&w.residual, OUTPUTS},     {&w.residual_std, OUTPUTS}};
    for (size_t i = 0; i < sizeof parts / sizeof *parts; from += parts[i++].count)
        *parts[i].part = nd_view_of(arena, parts[i].count, from);
    w.valid = from[0] != 0.0;
    w.consistency = from[1];
    w.x_at_sample = nd_view_of(arena, STATES, from + 2);
    return w;
}

/* Write the estimate of d for one of w, which `lumped` begins with; `u`: the last finite input. Where H > 0, the state
 * goes on by H. Returns an error of nd.h. */
static int channel_read(const Channelled *self, nd_arena *arena, const double *lumped, nd u, double H, double *state,
                        double *outputs) {
    const Estimate w = estimate_of_lumped(arena, lumped);
    const double *values = state + 1 + self->kept;
    LagMemory before = {nd_view_of(arena, self->kept, state + 1), nd_view_of(arena, self->kept * CHANNEL, values),
                        nd_view_of(arena, self->kept * CHANNEL, values + self->kept * CHANNEL),
                        nd_full(arena, 2, (int[]){self->kept * CHANNEL, 0}, 0.0)};
    p2_Estimate_LagMemory read = ChannelReading_read(arena, &self->reading, &w, u, nd_view_of(arena, 1, state), &before);
    double found[2 * STATES + 5 + 2 * OUTPUTS + 2];
    if (arena->error || !write_finite_estimate(arena, found, &read.v0)) return arena->error;
    memcpy(outputs, found, sizeof found - STATES * sizeof(double));
    if (H > 0.0) {
        LagMemory after = fixed_lag_later(arena, &read.v1, H);
        nd d_hat = nd_copy(arena, read.v0.d_hat);
        write_channel_state(d_hat, &after, state);
    }
    return ND_NONE;
}
