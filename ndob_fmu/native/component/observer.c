/* `<Name>Observer`: the disturbance observer, one step for each doStep.
 *
 * The build defines STATES, INPUTS, OUTPUTS, DISTURBANCES, PARAMETERS, FEEDTHROUGH, NUMBERS, IN_PAST, SIGNATURES,
 * LAGGED, MEMORY_OF_A_NUMBER, `bounds_of_states`, `noise_of_states`, for one disturbance `no_own_order`, and the places
 * of the variables.
 *
 * The memory to compute in is taken when the settings are known, which tell how much is needed. */
#include "fmu.h"
#include "translated.h"

enum { SHOWN = STATES + 5 * DISTURBANCES + 2 * OUTPUTS + 2 };

typedef struct {
    double count; /* of the numbers, which the settings determine */
    double numbers[NUMBERS]; /* and at most */
} State;

typedef struct {
    bool is_paper; /* method 1 */
    union {
        Paper paper;
        Sampled observer;
    } of; /* the one of the method */
    Equations plant; /* as the model has it: without lumped inputs, and not continued outside its ranges */
    double bound[LUMPED], rate[LUMPED], nominal[LUMPED];
    double estimated[PARAMETERS + 1];
    double outputs[2 * STATES + 5 * LUMPED + 2 * OUTPUTS + 2]; /* and with a channel x at the sample */
#if CHANNEL
    Channelled channel;
    double before[NUMBERS];
#endif
    size_t count; /* of the numbers of the observer's state */
    bool has_stepped, has_warned, has_left[STATES + 1];
    bool is_counted; /* among the users of what instances share */
    void *memory; /* of `size` bytes */
    size_t size;
} Core;

static bool fail_in(const Call *call, const Core *core, int error, Status status, const char *where) {
    const nd_arena *scratch = core->is_paper ? &core->of.paper.scratch : &core->of.observer.scratch;
    if (error > 0) return fail(call, scratch, status, where);
    say(call->instance, status, "memory", "enough for the design", "less", "the host has no more memory");
    return false;
}

/* -- memory */

/* A measure of the memory that is needed, in numbers: the columns of errors, the signatures of jumps, and matrices. */
static size_t about_numbers(const Call *call) {
    size_t rows = STATES + (size_t)call->values[AT_disturbance_order] * LUMPED;
    for (int i = 0; i < OUTPUTS; i++)
        rows += (call->values[AT_DELAY + i] > 0.0 ? IN_PAST : 0u) + (call->values[AT_BIAS_STD + i] > 0.0 ? 1u : 0u);
    for (int i = 0; i < PARAMETERS; i++) rows += call->values[AT_PARAMETER_STD + i] > 0.0;
    size_t lagged = call->values[AT_lag] > 0.0 ? LAGGED : 0, columns = rows + SIGNATURES + lagged;
    return rows * columns + (lagged + 8) * SIGNATURES + 8 * rows * rows;
}

/* Take so much memory in place of what there was; false where the host has less. */
static bool take_memory(Core *core, size_t size) {
    free(core->memory);
    core->memory = malloc(size);
    core->size = core->memory ? size : 0;
    return core->memory != NULL;
}

static void end(void *memory) {
    Core *core = memory;
    free(core->memory);
    core->memory = NULL;
#if SHARES_TUNING
    if (core->is_counted) stop_using_latest();
    core->is_counted = false;
#endif
}

static nd_array values_at(const Call *call, int first, int count) { return nd_around(count, call->values + first); }

/* The same as a part of what lasts. */
static nd lasting(const Call *call, nd_arena *memory, int first, int count) {
    return nd_view_of(memory, count, call->values + first);
}

/* -- what is said of the parameters */

static void join(char *line, size_t size, const char *const names[], int count, const char *between) {
    for (int i = 0; i < count; i++) {
        if (i) strncat(line, between, size - strlen(line) - 1);
        strncat(line, names[i], size - strlen(line) - 1);
    }
}

/* Say which offsets of sensors a constant disturbance explains as well. */
static void warn_of_offsets(const Call *call, Core *core, nd x_hat) {
    Sampled *self = &core->of.observer;
    if (core->has_warned) return;
    nd biased = nd_new(&self->scratch, 1, (int[]){OUTPUTS});
    int count = 0;
    for (int i = 0; i < OUTPUTS; i++)
        if (nd_at(self->settings.sensors.bias_std, i) > 0.0) nd_set(biased, count++, i);
    biased->n[0] = count;
    if (!count) return;
    nd found = separability_inseparable_offsets(&self->scratch, &self->equations, self->parameters, x_hat, biased);
    for (int k = 0; !self->scratch.error && k < nd_len(found); k++) {
        const char *name = self->equations.outputs.p[(int)nd_at(found, k)];
        char line[MESSAGE_SIZE] = "", disturbances[MESSAGE_SIZE] = "";
        join(disturbances, sizeof disturbances, core->plant.disturbances.p, DISTURBANCES, " or ");
        nd_print(line, sizeof line,
                 "%s_bias_std: in the outputs a constant offset of %s looks like a constant %.300s or another offset; the "
                 "samples cannot tell them apart",
                 name, name, disturbances);
        tell(call->instance, WARNING, line);
    }
}

/* Find which parameters are estimated; say which cannot be told from a disturbance and are not. */
static void choose_estimated(const Call *call, Core *core, nd x_hat) {
    Sampled *self = &core->of.observer;
    nd uncertain = nd_new(&self->scratch, 1, (int[]){PARAMETERS});
    int count = 0;
    for (int i = 0; i < PARAMETERS; i++) {
        bool wanted = call->values[AT_estimate_parameters] != 0.0 && nd_at(self->settings.parameter_std, i) > 0.0;
        core->estimated[i] = wanted ? 1.0 : 0.0;
        if (wanted) nd_set(uncertain, count++, i);
    }
    uncertain->n[0] = count;
    if (!count) return;
    nd found = separability_inseparable_parameters(&self->scratch, &self->equations, self->parameters, x_hat,
                                                   self->settings.x_std, uncertain);
    for (int k = 0; !self->scratch.error && k < nd_len(found); k++) {
        int i = (int)nd_at(found, k);
        const char *name = fmu_parameter_names[i];
        char line[MESSAGE_SIZE] = "", disturbances[MESSAGE_SIZE] = "";
        core->estimated[i] = 0.0;
        if (core->has_warned) continue;
        join(disturbances, sizeof disturbances, core->plant.disturbances.p, DISTURBANCES, " or ");
        nd_print(line, sizeof line,
                 "estimate_parameters: %s is not estimated, because a wrong one has the effect of a %.300s; %s_std widens "
                 "the error bars only",
                 name, disturbances, name);
        tell(call->instance, WARNING, line);
    }
}

/* Say where the rate of the disturbance or the step is absurd for the plant; a failure to find out is no failure. */
static void warn_of_pace(const Call *call, Core *core, double H) {
    Sampled *self = &core->of.observer;
    char line[MESSAGE_SIZE];
    if (setjmp(self->full)) return;
    self->scratch.used = 0;
    nd_array x_hat = values_at(call, AT_HAT_START, STATES), bound = values_at(call, AT_BOUND, DISTURBANCES);
    nd_array rate = values_at(call, AT_RATE, DISTURBANCES);
    Pace pace = pace_pace_of(&self->scratch, &core->plant, self->parameters, &x_hat, &bound, &rate,
                             self->settings.order);
    if (self->scratch.error) return;
    Absurd judged = pace_absurd(&self->scratch, &pace, H);
    for (int i = 0; i < DISTURBANCES; i++) {
        double omega = nd_at(pace.disturbance, i);
        const char *name = core->plant.disturbances.p[i];
        if (nd_at(judged.too_fast, i) != 0.0) {
            nd_print(line, sizeof line,
                     "disturbance_rate lets %s change at %.3g rad/s, %.0f times the plant's fastest mode (%.3g 1/s), so "
                     "that its estimate will be mostly noise",
                     name, omega, omega / pace.fastest, pace.fastest);
            tell(call->instance, WARNING, line);
        }
        if (nd_at(judged.within_a_step, i) != 0.0) {
            nd_print(line, sizeof line,
                     "disturbance_rate lets %s change at %.3g rad/s, which samples %g s apart cannot follow: a shorter "
                     "step or a lower rate is needed",
                     name, omega, H);
            tell(call->instance, WARNING, line);
        }
    }
    if (judged.too_long) {
        nd_print(line, sizeof line,
                 "the step of %g s is %.3g times the plant's longest time constant (%.3g s): samples show only what has "
                 "settled; take shorter steps",
                 H, H * pace.slowest, 1.0 / pace.slowest);
        tell(call->instance, WARNING, line);
    }
    if (judged.too_short) {
        nd_print(line, sizeof line,
                 "the step of %g s is %.1g of the plant's shortest time constant (%.3g s): samples tell nothing new; "
                 "take longer steps",
                 H, H * pace.fastest, 1.0 / pace.fastest);
        tell(call->instance, WARNING, line);
    }
}

/* Say once of each state that its estimate has left its range. */
static void warn_of_ranges(const Call *call, Core *core) {
    for (int i = 0; i < STATES; i++) {
        double value = core->outputs[i], low = bounds_of_states[i][0], high = bounds_of_states[i][1];
        if (core->has_left[i] || (low <= value && value <= high)) continue;
        const char *name = core->plant.states.p[i];
        char line[MESSAGE_SIZE];
        core->has_left[i] = true;
        nd_print(line, sizeof line,
                 "the estimate of %s, %.4g, is outside its range, %g to %g: equations are continued by their tangent "
                 "there; if %s has left it too, a wider range is needed",
                 name, value, low, high, name);
        tell(call->instance, WARNING, line);
    }
}

/* -- calls */

static void take_settings(const Call *call, Core *core) {
    Sampled *self = &core->of.observer;
    ObserverSettings *settings = &self->settings;
    nd_arena *memory = &self->lasting;
    set_equations(&self->equations, &self->lasting);
    self->parameters = lasting(call, memory, AT_PARAMETERS, PARAMETERS);
    settings->order = (int)call->values[AT_disturbance_order];
#if DISTURBANCES > 1
    settings->own_order = lasting(call, memory, AT_OWN_ORDER, DISTURBANCES);
#else
    settings->own_order = nd_view_of(memory, LUMPED, no_own_order);
#endif
    settings->sensors.noise_std = lasting(call, memory, AT_NOISE_STD, OUTPUTS);
    settings->sensors.delay = lasting(call, memory, AT_DELAY, OUTPUTS);
    settings->sensors.bias_std = lasting(call, memory, AT_BIAS_STD, OUTPUTS);
    settings->disturbance_bound = nd_view_of(memory, LUMPED, core->bound);
    settings->disturbance_nominal = nd_view_of(memory, LUMPED, core->nominal);
    settings->disturbance_rate = nd_view_of(memory, LUMPED, core->rate);
    settings->x_std = lasting(call, memory, AT_HAT_START_STD, STATES);
    settings->parameter_std = lasting(call, memory, AT_PARAMETER_STD, PARAMETERS);
    settings->state_noise = nd_view_of(memory, STATES, noise_of_states);
    settings->estimated = nd_view_of(memory, PARAMETERS, core->estimated);
    settings->adapt_noise = call->values[AT_adapt_noise] != 0.0;
    settings->lag = call->values[AT_lag];
    settings->alpha = call->values[AT_alpha];
    settings->pi = call->values[AT_pi_end];
}

/* Find bounds, rates and nominal values of what the observers estimate in place of the disturbances. */
static int lump_disturbances(const Call *call, Core *core, nd_arena *arena) {
    nd_array bound = values_at(call, AT_BOUND, DISTURBANCES), rate = values_at(call, AT_RATE, DISTURBANCES);
    nd_array given = values_at(call, AT_NOMINAL, DISTURBANCES);
    int order = (int)call->values[AT_disturbance_order];
    nd nominal = lumping_lumped_nominal(arena, &core->plant, &given);
    if (arena->error) return arena->error;
    (void)nd_write(core->nominal, nominal);
    (void)nd_write(core->bound, lumping_lumped_bound(arena, &core->plant, &bound));
    (void)nd_write(core->rate, lumping_lumped_rate(arena, &core->plant, &bound, &rate, order));
    return ND_NONE;
}

static int check_in_memory(const Call *call, Core *core, nd x_hat) {
    Sampled *self = &core->of.observer;
    if (setjmp(self->full)) return SAMPLED_NO_MEMORY;
    if (lump_disturbances(call, core, &self->scratch)) return self->scratch.error;
    warn_of_offsets(call, core, x_hat);
    if (!self->scratch.error) choose_estimated(call, core, x_hat);
    core->has_warned = true;
    if (!self->scratch.error) settings_check_settings(&self->scratch, &self->settings);
    return self->scratch.error;
}

#if CHANNEL
static nd_arena *scratch_of(Core *core) { return core->is_paper ? &core->of.paper.scratch : &core->of.observer.scratch; }

static nd_arena *lasting_of(Core *core) { return core->is_paper ? &core->of.paper.lasting : &core->of.observer.lasting; }

static jmp_buf *full_of(Core *core) { return core->is_paper ? &core->of.paper.full : &core->of.observer.full; }

static int start_channel(const Call *call, Core *core, double *state) {
    if (setjmp(*full_of(core))) return SAMPLED_NO_MEMORY;
    double lag = core->is_paper ? 0.0 : call->values[AT_lag];
    nd parameters = lasting(call, lasting_of(core), AT_PARAMETERS, PARAMETERS);
    nd bound = lasting(call, lasting_of(core), AT_BOUND, DISTURBANCES);
    return channel_start(&core->channel, scratch_of(core), &core->plant, parameters, bound, lag, state);
}

/* Put the estimate of d in the place of that of w in `core->outputs`; where H > 0, what is remembered goes on by H. */
static int read_channel(Core *core, double H, double *state) {
    if (setjmp(*full_of(core))) return SAMPLED_NO_MEMORY;
    scratch_of(core)->used = 0;
    nd u = core->is_paper ? paper_state(&core->of.paper, state).u : given_state(&core->of.observer, state)->u;
    return channel_read(&core->channel, scratch_of(core), core->outputs, u, H, state + core->count, core->outputs);
}
#endif

static int gains_of_paper(const Call *call, Core *core) {
    Paper *self = &core->of.paper;
    if (setjmp(self->full)) return PAPER_NO_MEMORY;
    if (lump_disturbances(call, core, &self->scratch)) return self->scratch.error;
    nd_array noise_std = values_at(call, AT_NOISE_STD, OUTPUTS), bound = nd_around(LUMPED, core->bound);
    nd_array nominal = nd_around(LUMPED, core->nominal);
    return paper_start(self, call->values[AT_pi_start], call->values[AT_pi_end], call->values[AT_pi_ramp_time],
                       call->values[AT_alpha], &noise_std, &bound, &nominal);
}

static int start_paper(const Call *call, Core *core, double *state) {
    Paper *self = &core->of.paper;
    nd_array x_hat = values_at(call, AT_HAT_START, STATES);
    memset(self, 0, sizeof *self);
    paper_memory(self, core->memory, core->size);
    set_plant(&core->plant, &self->lasting);
    set_equations(&self->equations, &self->lasting);
    self->parameters = lasting(call, &self->lasting, AT_PARAMETERS, PARAMETERS);
    int error = gains_of_paper(call, core);
    if (error) return error;
    core->count = paper_state_size(self);
    if (core->count <= NUMBERS) paper_first_state(self, &x_hat, state);
    return ND_NONE;
}

static int start_sampled(const Call *call, Core *core, double *state) {
    Sampled *self = &core->of.observer;
    nd_array x_hat = values_at(call, AT_HAT_START, STATES);
    memset(self, 0, sizeof *self);
    sampled_memory(self, core->memory, core->size);
    set_plant(&core->plant, &self->lasting);
    take_settings(call, core);
#if SHARES_TUNING
    self->values = call->values;
    self->recall = recall_latest;
    self->publish = publish_latest;
    if (!core->is_counted) use_latest(self);
    core->is_counted = true;
#endif
    int error = check_in_memory(call, core, &x_hat);
    if (!error) error = sampled_start(self, &x_hat, state, NUMBERS);
    core->count = self->count;
    return error;
}

/* Make the observer in so much memory, or in more where that is too little, with its first state. */
static int make(const Call *call, Core *core, size_t size, double *state) {
    int error;
    do {
        if (!take_memory(core, size)) return SAMPLED_NO_MEMORY;
        error = core->is_paper ? start_paper(call, core, state) : start_sampled(call, core, state);
        if (!error && core->count > NUMBERS) return SAMPLED_NO_MEMORY;
#if CHANNEL
        if (!error) error = start_channel(call, core, state + core->count);
#endif
        size *= 2;
    } while (error == SAMPLED_NO_MEMORY);
    if (!error && !core->is_paper) move_scratch(&core->of.observer);
    return error;
}

static size_t numbers_used(const Core *core) {
#if CHANNEL
    return core->count + channel_state_size(&core->channel);
#else
    return core->count;
#endif
}

/* Put a first state into memory of its own size. */
static int take_state(const Call *call, const Core *core, const double *first) {
    size_t bytes = numbers_used(core) * sizeof(double);
    State *state = state_memory(call->instance, offsetof(State, numbers) + bytes);
    if (!state) return SAMPLED_NO_MEMORY;
    state->count = (double)numbers_used(core);
    memcpy(state->numbers, first, bytes);
    return ND_NONE;
}

static bool start(const Call *call, double time) {
    Core *core = call->core;
    (void)time;
    memset(core->has_left, 0, sizeof core->has_left);
    core->has_stepped = core->has_warned = false;
    core->is_paper = call->values[AT_method] == 1.0;
    size_t size = MEMORY_OF_A_NUMBER * about_numbers(call);
    if (core->is_paper) size *= 4; /* for the gains along pi */
    double *first = malloc(NUMBERS * sizeof(double));
    int error = first ? make(call, core, size, first) : SAMPLED_NO_MEMORY;
    if (!error) error = take_state(call, core, first);
    free(first);
    return error ? fail_in(call, core, error, ERROR, "start") : true;
}

static bool show(const Call *call) {
    Core *core = call->core;
    double *numbers_now = ((State *)call->state)->numbers;
    nd_array y = values_at(call, INPUTS, OUTPUTS);
    int error = core->is_paper ? paper_show(&core->of.paper, numbers_now, &y, core->outputs)
                               : sampled_show(&core->of.observer, numbers_now,
                                              FEEDTHROUGH && !CHANNEL ? call->values : NULL, &y, core->outputs);
#if CHANNEL
    if (!error) error = read_channel(core, 0.0, numbers_now);
#endif
    if (error) return fail_in(call, core, error, ERROR, "start");
    memcpy(call->outputs, core->outputs, SHOWN * sizeof(double));
    return true;
}

static int advance_once(const Call *call, Core *core, double step_size) {
    double *numbers_now = ((State *)call->state)->numbers;
    nd_array u = values_at(call, 0, INPUTS), y = values_at(call, INPUTS, OUTPUTS);
#if CHANNEL
    size_t size = numbers_used(core) * sizeof(double);
    memcpy(core->before, numbers_now, size);
#endif
    int error = core->is_paper ? paper_step(&core->of.paper, numbers_now, &u, &y, step_size, core->outputs)
                               : sampled_step(&core->of.observer, numbers_now, &u, &y, step_size, core->outputs);
#if CHANNEL
    if (!error) error = read_channel(core, step_size, numbers_now);
    if (error) memcpy(numbers_now, core->before, size);
#endif
    return error;
}

/* Advance the observer; where that fails the state is as before. A step for which there is too little memory is made
 * again in more. */
static int advance(const Call *call, Core *core, double step_size) {
    int error = advance_once(call, core, step_size);
    while (error == SAMPLED_NO_MEMORY) {
        double *first_state = malloc(NUMBERS * sizeof(double));
        if (!first_state) return error;
        error = make(call, core, 2 * core->size, first_state);
        free(first_state);
        if (error) return error;
        error = advance_once(call, core, step_size);
    }
    return error;
}

static bool step(const Call *call, double time, double step_size) {
    Core *core = call->core;
    (void)time;
    if (!core->has_stepped && !core->is_paper) warn_of_pace(call, core, step_size);
    core->has_stepped = true;
    int error = advance(call, core, step_size);
    if (error) return fail_in(call, core, error, DISCARD, "step");
    memcpy(call->outputs, core->outputs, SHOWN * sizeof(double));
    warn_of_ranges(call, core);
    return true;
}

/* Write what the last step was tuned to, where there is room, and return how many numbers that are: the step size, whether
 * the gain may be frozen, the intensities and their law. None without a law. */
static size_t tuning(const Call *call, double *numbers, size_t room) {
    const Core *core = call->core;
    const Sampled *self = &core->of.observer;
    if (core->is_paper || !self->of_tuned.some || !self->tuned.law.some) return 0;
    const Intensities *found = &self->tuned.intensities;
    const IntensityLaw *law = &self->tuned.law.value;
    size_t arrays = nd_len(found->disturbance) + nd_len(found->f) + nd_len(law->disturbance) + nd_len(law->limit);
    if (arrays + 6 > room) return 0;
    double *end = numbers;
    *end++ = self->tuned.H;
    *end++ = self->tuned.freezes;
    end = write_IntensityLaw(write_Intensities(end, found), law);
    return (size_t)(end - numbers);
}

static bool possible(const Call *call, double begin, double now) {
    Core *core = call->core;
    State *state = call->state;
    (void)begin;
    (void)now;
    if (!finite_numbers(state->numbers + core->count, numbers_used(core) - core->count)) return false;
    if (state->count != (double)numbers_used(core)) return false;
    return core->is_paper ? paper_possible(&core->of.paper, state->numbers)
                          : sampled_possible(&core->of.observer, state->numbers);
}
