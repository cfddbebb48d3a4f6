/* Method 2: what follows from the parameters, made once and kept, and steps from state to state, as numbers.
 *
 * The caller fills `equations`, `parameters` and `settings`, and gives the memory. */
#include "translated.h"

/* What a result that is kept belongs to. */
typedef struct {
    bool some;
    double H, tuned_at;
    nd noise;
    nd_arena memory;
} Kept;

typedef struct Sampled Sampled;

struct Sampled {
    Equations equations;
    nd parameters;
    ObserverSettings settings;
    PreparedObserver prepared;
    SampledObserverState form; /* of a state, whose arrays show the numbers of the one that was given last */
    Tuned tuned;
    StepDesign design;
    m_ConvergedStep converged;
    size_t count; /* of the numbers of a state */
    nd_arena lasting, scratch;
    Kept of_tuned, of_design, of_converged;
    jmp_buf full;
    char message[ND_MESSAGE];
    const double *values; /* of the variables, for the two functions below */
    bool (*recall)(Sampled *self, double H, nd none); /* take the tuning over from an instance like this one, or NULL */
    void (*publish)(const Sampled *self, double H);   /* hand it to others */
};

enum { SAMPLED_NO_MEMORY = -1 };

/* Divide a block of memory: more than half of it to compute in. */
void sampled_memory(Sampled *self, void *block, size_t bytes) {
    nd_arena *const parts[] = {&self->lasting, &self->scratch, &self->of_converged.memory, &self->of_design.memory,
                               &self->of_tuned.memory};
    static const size_t shares[] = {3, 21, 3, 3, 2}; /* of 32 */
    char *begin = block;
    for (size_t i = 0; i < 5; begin += bytes / 32 * shares[i], i++) {
        nd_start(parts[i], begin, bytes / 32 * shares[i]);
        parts[i]->full = &self->full;
    }
    self->scratch.message = self->message;
}

/* Compute directly behind what lasts: pages of memory that nothing touches cost nothing. */
static void move_scratch(Sampled *self) {
    char *end = self->scratch.base + self->scratch.size;
    self->lasting.size = self->lasting.used;
    self->scratch.base = self->lasting.base + self->lasting.used; /* as aligned as all that was taken */
    self->scratch.size = (size_t)(end - self->scratch.base);
}

static bool is_kept(const Kept *kept, double H, double tuned_at, nd noise) {
    return kept->some && kept->H == H && kept->tuned_at == tuned_at && nd_equal(kept->noise, noise);
}

/* Begin to keep a result; the caller says so when it is whole. */
static nd_arena *keep(Kept *kept, double H, double tuned_at, nd noise) {
    kept->memory.used = 0;
    kept->some = false;
    kept->H = H;
    kept->tuned_at = tuned_at;
    kept->noise = nd_copy(&kept->memory, noise);
    return &kept->memory;
}

static const Tuned *tuned_for(Sampled *self, double H) {
    nd none = nd_full(&self->scratch, 1, (int[]){0}, 0.0);
    if (!is_kept(&self->of_tuned, H, H, none) && !(self->recall && self->recall(self, H, none))) {
        Tuned found = tuned_tune(&self->scratch, &self->prepared, H);
        self->of_tuned.some = false;
        if (self->scratch.error) return &self->tuned;
        self->tuned = copied_Tuned(keep(&self->of_tuned, H, H, none), found);
        self->of_tuned.some = true;
        if (self->publish) self->publish(self, H);
    }
    return &self->tuned;
}

/* The design of a step, as `step_by_definition` asks for it. */
static StepDesign sampled_design(nd_arena *arena, const void *env, double H, double tuned_at, nd noise) {
    Sampled *self;
    memcpy(&self, &env, sizeof self);
    if (!is_kept(&self->of_design, H, tuned_at, noise)) {
        m_double given = {true, tuned_at};
        m_Intensities not_yet;
        memset(&not_yet, 0, sizeof not_yet);
        StepDesign found = StepDesigns_at(arena, &self->prepared.designs, H, &given, noise, &not_yet);
        self->of_design.some = false;
        if (arena->error) return found;
        self->design = copied_StepDesign(keep(&self->of_design, H, tuned_at, noise), found);
        self->of_design.some = true;
    }
    return self->design;
}

static const m_ConvergedStep *converged_for(Sampled *self, double H, double tuned_at, nd noise) {
    if (!is_kept(&self->of_converged, H, tuned_at, noise)) {
        const Tuned *tuned = tuned_for(self, tuned_at);
        StepDesign design;
        m_ConvergedStep found;
        self->converged.some = false;
        if (self->scratch.error) return &self->converged;
        design = sampled_design(&self->scratch, self, H, tuned_at, noise);
        if (self->scratch.error) return &self->converged;
        found = converged_step_converged_step(&self->scratch, &tuned->model, &design, tuned_at, noise);
        self->of_converged.some = false;
        if (self->scratch.error) return &self->converged;
        nd_arena *memory = keep(&self->of_converged, H, tuned_at, noise);
        self->converged.some = found.some;
        if (found.some) self->converged.value = copied_ConvergedStep(memory, found.value);
        self->of_converged.some = true;
    }
    return &self->converged;
}

static const SampledObserverState *given_state(Sampled *self, const double *state) {
    (void)read_SampledObserverState(state, &self->form);
    return &self->form;
}

/* Write a state that may have parts of the one that it replaces. */
static void put_state(Sampled *self, double *state, const SampledObserverState *after) {
    double *numbers = nd_take_bytes(&self->scratch, self->count * sizeof(double));
    (void)write_SampledObserverState(numbers, after);
    memcpy(state, numbers, self->count * sizeof(double));
}

static void start_in_memory(Sampled *self, size_t mark, nd x_hat, double *state, size_t room) {
    self->lasting.used = mark;
    PreparedObserver found =
        preparation_prepared(&self->scratch, &self->equations, self->parameters, &self->settings, x_hat);
    if (self->scratch.error) return;
    self->prepared = copied_PreparedObserver(&self->lasting, found);
    SampledObserverState first = sampled_step_start_state(&self->scratch, &self->prepared, x_hat);
    if (self->scratch.error) return;
    self->form = form_of_SampledObserverState(&self->lasting, first);
    self->count = (size_t)(read_SampledObserverState(state, &self->form) - state);
    if (self->count <= room) (void)write_SampledObserverState(state, &first);
}

static bool step_with_frozen_gain(Sampled *self, const SampledObserverState *given, nd u, nd y, double H, double *state,
                                  double *outputs) {
    const FilterMemory *memory = &given->memory;
    if (!memory->converged || !converged_step_is_near(&self->scratch, memory->step, H)) return false;
    const m_ConvergedStep *common = converged_for(self, memory->step, memory->tuned_at, memory->frozen_noise);
    if (self->scratch.error || !common->some) return false;
    nd inputs = nd_concatenate(&self->scratch, 0, 2, (nd[]){u, y});
    m_p3_SampledObserverState_nd_nd done = sampled_step_step_converged(
        &self->scratch, &common->value, self->prepared.layout.n, given, inputs, H);
    if (self->scratch.error || !done.some) return false;
    put_state(self, state, &done.value.v0);
    double *end = nd_write(outputs, done.value.v1);
    if (CHANNEL) (void)nd_write(end, nd_view(&self->scratch, self->prepared.layout.n, done.value.v2->p));
    return true;
}

/* The way of most steps; what it leaves out, the others do. */
static bool step_as_kept(Sampled *self, double *state, nd u, nd y, double H, double *outputs) {
    const Kept *kept = &self->of_converged;
    if (!kept->some || !self->converged.some || self->converged.value.M_H.some) return false;
    if (!converged_step_is_near(&self->scratch, kept->H, H)) return false;
    if (!is_frozen_for(state + self->count, kept->H, kept->tuned_at, kept->noise)) return false;
    return frozen_step(&self->scratch, &self->converged.value, u->p, y->p, H, state, outputs);
}

static void step_in_memory(Sampled *self, double *state, nd u, nd y, double H, double *outputs) {
    const SampledObserverState *given = given_state(self, state);
    if (step_with_frozen_gain(self, given, u, y, H, state, outputs) || self->scratch.error) return;
    double tuned_at = sampled_step_step_to_tune_for(&self->scratch, &self->prepared, &given->memory, H);
    if (self->scratch.error) return;
    const Tuned *tuned = tuned_for(self, tuned_at);
    if (self->scratch.error) return;
    f_double_double_nd_to_StepDesign design_at = {sampled_design, self};
    p2_SampledObserverState_Estimate done =
        sampled_step_step_by_definition(&self->scratch, &self->prepared, tuned, design_at, given, u, y, H);
    if (self->scratch.error) return;
    if (write_finite_estimate(&self->scratch, outputs, &done.v1)) put_state(self, state, &done.v0);
}

static int ended(const Sampled *self) { return self->scratch.error; }

/* Make all that the steps have in common, for an estimate to start from, and the `count` numbers of the first state where
 * there is room for as many. Returns an error of nd.h, whose message `scratch` holds, or SAMPLED_NO_MEMORY. */
int sampled_start(Sampled *self, nd x_hat, double *state, size_t room) {
    const size_t mark = self->lasting.used;
    if (setjmp(self->full)) return SAMPLED_NO_MEMORY;
    self->scratch.used = 0;
    start_in_memory(self, mark, x_hat, state, room);
    return ended(self);
}

/* Advance a state by H from a sample y, with the input u held; both lie in one piece. `outputs`: the fields of Estimate
 * but for x_at_sample. */
int sampled_step(Sampled *self, double *state, nd u, nd y, double H, double *outputs) {
    if (!CHANNEL && step_as_kept(self, state, u, y, H, outputs)) return ND_NONE; /* which knows no x at the sample */
    if (setjmp(self->full)) return SAMPLED_NO_MEMORY;
    self->scratch.used = 0;
    self->scratch.error = ND_NONE;
    step_in_memory(self, state, u, y, H, outputs);
    return ended(self);
}

/* What is known at a sample before any step from it. `u`: the inputs now, or NULL for those of the state. */
int sampled_show(Sampled *self, const double *state, const double *u, nd y, double *outputs) {
    if (setjmp(self->full)) return SAMPLED_NO_MEMORY;
    self->scratch.used = 0;
    self->scratch.error = ND_NONE;
    SampledObserverState given = *given_state(self, state);
    if (u) given.u = nd_view_of(&self->scratch, nd_len(given.u), u);
    Estimate known = sampled_step_estimate_before_a_step(&self->scratch, &self->prepared, &given, y);
    if (!self->scratch.error) (void)write_estimate(outputs, &known);
    return ended(self);
}

/* Whether numbers can be a state. */
bool sampled_possible(Sampled *self, const double *state) {
    if (setjmp(self->full)) return false;
    self->scratch.used = 0;
    self->scratch.error = ND_NONE;
    return sampled_step_is_possible_state(&self->scratch, &self->prepared, given_state(self, state));
}
