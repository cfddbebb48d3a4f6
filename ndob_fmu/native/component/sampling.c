/* `Sensor` and `Encoder`: hand over the value that is set before a step as that at its end.
 *
 * The build defines DEVICE, `Sensor` or `Encoder`, and RESOLUTION, the number of which a sample is a multiple. */
#include "fmu.h"
#include "translated.h"

enum {
    POINTS = 1024, /* that are kept: the values of the steps within the delay */
    NOT_A_NUMBER = 2,
    MEMORY = 16 * POINTS
};

typedef struct {
    double start_time, index, good, shown, is_new, count;
    double times[POINTS], values[POINTS];
} State;

typedef struct {
    DEVICE device;
    nd_arena arena;
    double memory[MEMORY];
} Core;

static SampledState read_state(nd_arena *arena, const State *from) {
    int count = (int)from->count;
    SampledState state = {from->start_time, from->index, nd_view_of(arena, count, from->times),
                          nd_view_of(arena, count, from->values),
                          from->good, from->shown, from->is_new != 0.0};
    return state;
}

/* Take over a state and show it; false, with a message, where it remembers too much. */
static bool take(const Call *call, const SampledState *after, Status status) {
    State *state = call->state;
    int count = nd_len(after->times);
    if (count > POINTS) {
        say(call->instance, status, "delay", "at most 1023 communication steps", "more", "a delay in another unit than s");
        return false;
    }
    for (int i = 0; i < count; i++) {
        state->times[i] = nd_at(after->times, i);
        state->values[i] = nd_at(after->values, i);
    }
    memset(state->times + count, 0, (size_t)(POINTS - count) * sizeof(double));
    memset(state->values + count, 0, (size_t)(POINTS - count) * sizeof(double));
    state->start_time = after->start_time;
    state->index = after->index;
    state->good = after->good;
    state->shown = call->outputs[0] = after->shown;
    state->is_new = call->outputs[1] = after->new ? 1.0 : 0.0;
    state->count = count;
    return true;
}

static bool begin_in_memory(const Job *job) {
    Core *core = job->call->core;
    SampledState first = DEVICE_INIT(&core->arena, &core->device, job->call->values[AT_MEASURED], job->first);
    if (core->arena.error) return fail(job->call, &core->arena, job->status, "start");
    return take(job->call, &first, job->status);
}

static bool step_in_memory(const Job *job) {
    Core *core = job->call->core;
    SampledState before = read_state(&core->arena, job->call->state);
    SampledState after = DEVICE_STEP(&core->arena, &core->device, &before, job->call->values[AT_MEASURED],
                                     job->first + job->second, job->second);
    if (core->arena.error) return fail(job->call, &core->arena, job->status, "step");
    return take(job->call, &after, job->status);
}

static bool possible_in_memory(const Job *job) {
    Core *core = job->call->core;
    const State *state = job->call->state;
    bool in_range = state->count >= 0.0 && state->count <= POINTS && state->count == floor(state->count)
                    && (state->is_new == 0.0 || state->is_new == 1.0);
    if (!in_range || state->start_time != job->first) return false;
    SampledState given = read_state(&core->arena, state);
    return DEVICE_POSSIBLE(&core->arena, &core->device, &given, job->second);
}

static bool start(const Call *call, double time) {
    const double *values = call->values;
    Sampling sampling = {values[AT_noise_std],
                         values[AT_bias],
                         (int)values[AT_seed],
                         values[AT_sample_time],
                         values[AT_delay],
                         values[AT_dropout_probability],
                         values[AT_between_samples] == NOT_A_NUMBER,
                         values[AT_dropped_sample] == NOT_A_NUMBER,
                         RESOLUTION};
    ((Core *)call->core)->device.sampling = sampling;
    return IN_MEMORY(call, time, 0.0, ERROR, begin_in_memory);
}

static bool show(const Call *call) {
    return IN_MEMORY(call, ((State *)call->state)->start_time, 0.0, ERROR, begin_in_memory);
}

static bool step(const Call *call, double time, double step_size) {
    return IN_MEMORY(call, time, step_size, DISCARD, step_in_memory);
}

static bool possible(const Call *call, double begin, double now) {
    return IN_MEMORY(call, begin, now, ERROR, possible_in_memory);
}
