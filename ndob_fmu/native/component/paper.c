/* Method 1, the paper's observer: the gains along π made once, and steps from state to state, as numbers.
 *
 * The caller fills `equations` and `parameters`, and gives the memory. */
#include "translated.h"

typedef struct {
    Equations equations;
    nd parameters;
    PaperObserver observer;
    nd_arena lasting, scratch;
    jmp_buf full;
    char message[ND_MESSAGE];
} Paper;

enum { PAPER_NO_MEMORY = -1, PAPER_SAMPLES = 6 }; /* samples that a polynomial of degree 2 is chosen from */

/* Divide a block of memory: a quarter for what lasts. */
void paper_memory(Paper *self, void *block, size_t bytes) {
    nd_start(&self->lasting, block, bytes / 4);
    nd_start(&self->scratch, (char *)block + bytes / 4, bytes - bytes / 4);
    self->lasting.full = self->scratch.full = &self->full;
    self->scratch.message = self->message;
}

/* A state as numbers: x, the time since the start, how many samples, their ages, the samples, u, w. */
typedef struct {
    int n, p, m, q;
} PaperSizes;

static PaperSizes paper_sizes(const Paper *self) {
    const LinearPart *linear = &self->observer.gains.linear;
    int q = linear->matched ? 0 : linear->G_f->n[1];
    PaperSizes sizes = {linear->A->n[0], linear->C->n[0], linear->B->n[1], q + linear->G_d->n[1]};
    return sizes;
}

size_t paper_state_size(const Paper *self) {
    PaperSizes s = paper_sizes(self);
    return (size_t)(s.n + 2 + PAPER_SAMPLES * (1 + s.p) + s.m + s.q);
}

static PaperObserverState paper_state(Paper *self, const double *state) {
    PaperSizes s = paper_sizes(self);
    PaperObserverState given;
    int count = nd_integer(state[s.n + 1]);
    const double *ages = state + s.n + 2, *samples = ages + PAPER_SAMPLES, *u = samples + PAPER_SAMPLES * s.p;
    count = nd_imax2(0, nd_imin2(count, PAPER_SAMPLES));
    given.x_hat = nd_view_of(&self->scratch, s.n, state);
    given.elapsed = state[s.n];
    given.history.ages = nd_view_of(&self->scratch, count, ages);
    given.history.samples = nd_view_of(&self->scratch, count * s.p, samples);
    given.history.samples->rank = 2;
    given.history.samples->n[0] = count, given.history.samples->n[1] = s.p;
    given.history.samples->s[0] = (int16_t)s.p, given.history.samples->s[1] = 1;
    given.u = nd_view_of(&self->scratch, s.m, u);
    given.w_hat = nd_view_of(&self->scratch, s.q, u + s.m);
    return given;
}

static void write_paper_state(Paper *self, const PaperObserverState *from, double *to) {
    PaperSizes s = paper_sizes(self);
    size_t bytes = paper_state_size(self) * sizeof(double);
    double *state = nd_take_bytes(&self->scratch, bytes); /* `from` may be part of the state that is replaced */
    double *ages = state + s.n + 2, *samples = ages + PAPER_SAMPLES, *u = samples + PAPER_SAMPLES * s.p;
    memset(state, 0, bytes);
    (void)nd_write(state, from->x_hat);
    state[s.n] = from->elapsed;
    state[s.n + 1] = nd_len(from->history.ages);
    (void)nd_write(ages, from->history.ages);
    (void)nd_write(samples, from->history.samples);
    (void)nd_write(nd_write(u, from->u), from->w_hat);
    memcpy(to, state, bytes);
}

/* Make the gains. Returns an error of nd.h, whose message `scratch` holds, or PAPER_NO_MEMORY. */
int paper_start(Paper *self, double pi_start, double pi_end, double ramp_time, double alpha, nd noise_std, nd bound,
                nd nominal) {
    PiSchedule schedule = {pi_start, pi_end, ramp_time};
    if (setjmp(self->full)) return PAPER_NO_MEMORY;
    self->scratch.used = 0;
    self->scratch.error = ND_NONE;
    PiSchedule___post_init__(&self->scratch, &schedule);
    if (self->scratch.error) return self->scratch.error;
    PaperObserver found = paper_observer_paper_observer(&self->scratch, &self->equations, self->parameters, &schedule,
                                                        alpha, 2, noise_std, bound, nominal);
    if (!self->scratch.error) self->observer = copied_PaperObserver(&self->lasting, found);
    return self->scratch.error;
}

/* Write the state that starts from an estimate. */
void paper_first_state(Paper *self, nd x_hat, double *state) {
    self->scratch.used = 0;
    PaperObserverState first = PaperObserver_init(&self->scratch, &self->observer, x_hat);
    write_paper_state(self, &first, state);
}

/* Advance a state by H from a sample y, with the input u held. `outputs`: the fields of Estimate but for x_at_sample. */
int paper_step(Paper *self, double *state, nd u, nd y, double H, double *outputs) {
    if (setjmp(self->full)) return PAPER_NO_MEMORY;
    self->scratch.used = 0;
    self->scratch.error = ND_NONE;
    PaperObserverState given = paper_state(self, state);
    p2_PaperObserverState_Estimate done = PaperObserver_step(&self->scratch, &self->observer, &given, u, y, H);
    if (self->scratch.error) return self->scratch.error;
    if (write_finite_estimate(&self->scratch, outputs, &done.v1)) write_paper_state(self, &done.v0, state);
    return self->scratch.error;
}

/* What is known at a sample before any step from it. */
int paper_show(Paper *self, const double *state, nd y, double *outputs) {
    if (setjmp(self->full)) return PAPER_NO_MEMORY;
    self->scratch.used = 0;
    self->scratch.error = ND_NONE;
    PaperObserverState given = paper_state(self, state);
    Estimate known = PaperObserver_estimate(&self->scratch, &self->observer, &given, y);
    if (!self->scratch.error) (void)write_estimate(outputs, &known);
    return self->scratch.error;
}

/* Whether numbers can be a state. */
bool paper_possible(Paper *self, const double *state) {
    PaperSizes s = paper_sizes(self);
    if (setjmp(self->full)) return false;
    self->scratch.used = 0;
    self->scratch.error = ND_NONE;
    PaperObserverState given = paper_state(self, state);
    return nd_len(given.history.ages) == state[s.n + 1]
           && PaperObserver_possible(&self->scratch, &self->observer, &given);
}
