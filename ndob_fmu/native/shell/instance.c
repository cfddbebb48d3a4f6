/* One instance: its block of memory, its modes and times, and how calls lead to the component. */
#include "shell.h"

#include <float.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

/* -- memory */

typedef struct {
    size_t values, started_with, outputs, texts, started_with_texts, state, core, name, end;
} Places;

static size_t aligned(size_t size) { return (size + 15) / 16 * 16; }

static Places places(const char *name) {
    Places at;
    at.values = aligned(sizeof(Instance));
    at.started_with = at.values + aligned(fmu.count * sizeof(double));
    at.outputs = at.started_with + aligned(fmu.parameter_count * sizeof(double));
    at.texts = at.outputs + aligned(fmu.output_count * sizeof(double));
    at.started_with_texts = at.texts + fmu.text_count * (size_t)TEXT_SIZE;
    at.state = at.started_with_texts + fmu.text_count * (size_t)TEXT_SIZE;
    at.core = at.state + (fmu.sizes_state ? 0 : aligned(fmu.state_size));
    at.name = at.core + aligned(fmu.core_size);
    at.end = at.name + strlen(name) + 1;
    return at;
}

size_t instance_size(const char *name) { return places(name).end; }

static void copy_first(const volatile char *from, char *to, size_t size) {
    for (size_t i = 0; i < size; i++) to[i] = from[i];
}

void own_token(char token[TOKEN_SIZE]) { copy_first(first_values.token, token, TOKEN_SIZE); }

static void start_afresh(Instance *self) {
    memset(&self->progress, 0, sizeof self->progress);
    self->progress.mode = INSTANTIATED;
    for (uint32_t i = 0; i < fmu.count; i++) {
        self->values[i] = first_values.numbers[i];
        if (fmu.variables[i].type == 'S') copy_first(first_values.texts[text_place(i)], self->texts[text_place(i)], TEXT_SIZE);
    }
}

Instance *instance_in(void *block, const char *name, Log log) {
    char *begin = block;
    Places at = places(name);
    Instance *self = block;
    self->log = log;
    self->values = (double *)(void *)(begin + at.values);
    self->started_with = (double *)(void *)(begin + at.started_with);
    self->outputs = (double *)(void *)(begin + at.outputs);
    self->texts = (char(*)[TEXT_SIZE])(begin + at.texts);
    self->started_with_texts = (char(*)[TEXT_SIZE])(begin + at.started_with_texts);
    self->state = fmu.sizes_state ? NULL : begin + at.state;
    self->state_size = fmu.sizes_state ? 0 : fmu.state_size;
    self->core = begin + at.core;
    self->log.name = strcpy(begin + at.name, name);
    start_afresh(self);
    self->handle = handle_new(INSTANCE_HANDLES, self);
    if (!self->handle) say(self, ERROR, "instance", "fewer than 4096 instances of this FMU", "one more", "");
    return self->handle ? self : NULL;
}

void instance_free(Instance *self) {
    states_free(self);
    if (fmu.end) fmu.end(self->core);
    if (fmu.sizes_state) free(self->state);
    handle_free(INSTANCE_HANDLES, self->handle);
}

void reset(Instance *self) { start_afresh(self); }

/* -- calls */

static const char *mode_name(uint32_t mode) {
    switch (mode) {
#define F(name, text) \
    case name: return text;
        MODES(F)
#undef F
    }
    return "in an unknown mode";
}

void say_error(Instance *self, const char *function, const char *expected, const char *received) {
    say(self, ERROR, function, expected, received, "");
}

static void refuse(Instance *self, const char *function, unsigned modes) {
    char allowed[128] = "an instance that is ", received[64] = "one that is ";
    bool first = true;
    for (unsigned mode = INSTANTIATED; mode <= TERMINATED; mode <<= 1)
        if (modes & mode) {
            if (!first) append(allowed, sizeof allowed, " or ");
            append(allowed, sizeof allowed, mode_name(mode));
            first = false;
        }
    append(received, sizeof received, mode_name(self->progress.mode));
    say_error(self, function, allowed, received);
}

Instance *enter(void *handle, const char *function, unsigned modes, Environment *host) {
    Instance *self = handle_enter(INSTANCE_HANDLES, handle);
    if (!self) return NULL; /* freed or invalid: there is no log to write to */
    self->log.worst = OK;
    if (!(self->progress.mode & modes)) {
        refuse(self, function, modes);
        handle_leave(INSTANCE_HANDLES, handle);
        return NULL;
    }
    *host = environment_enter();
    return self;
}

Status leave(Instance *self, Status status, Environment host) {
    if (self->log.worst > status) status = self->log.worst;
    environment_leave(host);
    handle_leave(INSTANCE_HANDLES, self->handle);
    return status;
}

Call call_of(Instance *self) {
    Call call = {self->values, (const char(*)[TEXT_SIZE])self->texts, self->outputs, self->core, self->state, self};
    return call;
}

static void show_outputs(Instance *self) {
    memcpy(self->values + fmu.first_output, self->outputs, fmu.output_count * sizeof(double));
}

/* -- modes */

bool set_up(Instance *self, const char *function, double start, bool has_stop, double stop) {
    if (!has_stop) stop = HUGE_VAL;
    if (!finite_number(start) || !(stop >= start)) {
        char received[3 * NUMBER_SIZE] = "", number[NUMBER_SIZE];
        short_number_text(start, number);
        append(received, sizeof received, number);
        append(received, sizeof received, " s");
        if (has_stop) {
            short_number_text(stop, number);
            append(received, sizeof received, " and ");
            append(received, sizeof received, number);
            append(received, sizeof received, " s");
        }
        say_error(self, function, "a finite start time and no stop time before it", received);
        return false;
    }
    /* There are hosts that say "infinite" for "not defined". */
    self->progress.has_stop = has_stop && finite_number(stop);
    Clock clock = {start, self->progress.has_stop ? stop : 0.0, start, 0.0};
    self->progress.clock = clock;
    self->progress.last_time = start;
    self->progress.has_experiment = true;
    return true;
}

bool enter_initialization(Instance *self, const char *function) {
    if (!self->progress.has_experiment) {
        say_error(self, function, "fmi2SetupExperiment before it", "none");
        return false;
    }
    self->progress.mode = INITIALIZATION;
    self->progress.initializing = self->progress.stale = true;
    self->progress.made = false;
    return true;
}

bool has_started_with(const Instance *self, const double *parameters, const char (*texts)[TEXT_SIZE]) {
    return self->progress.made
           && memcmp(self->started_with, parameters, fmu.parameter_count * sizeof(double)) == 0
           && memcmp(self->started_with_texts, texts, fmu.text_count * (size_t)TEXT_SIZE) == 0;
}

static bool is_made_for_present_values(const Instance *self) {
    if (!self->progress.made) return false;
    for (uint32_t i = 0; i < fmu.parameter_count; i++)
        if (memcmp(&self->started_with[i], &self->values[fmu.parameters[i]], sizeof(double)) != 0) return false;
    return memcmp(self->started_with_texts, self->texts, fmu.text_count * (size_t)TEXT_SIZE) == 0;
}

/* Make the core for the present parameters. */
bool remake(Instance *self, double start_time) {
    Call call = call_of(self);
    self->progress.made = false;
    if (!fmu.start(&call, start_time)) return false;
    for (uint32_t i = 0; i < fmu.parameter_count; i++) self->started_with[i] = self->values[fmu.parameters[i]];
    memcpy(self->started_with_texts, self->texts, fmu.text_count * (size_t)TEXT_SIZE);
    self->progress.made = true;
    return true;
}

/* Bring the outputs up to date in initialization mode. */
bool refreshed(Instance *self, Status status) {
    uint32_t unusable = unusable_parameter(self);
    if (unusable < fmu.count) {
        say_unacceptable(self, unusable, status);
        return false;
    }
    if (!is_made_for_present_values(self) && !remake(self, self->progress.clock.start)) return false;
    Call call = call_of(self);
    if (!fmu.show(&call)) return false;
    show_outputs(self);
    self->progress.stale = false;
    return true;
}

/* If the parameters allow no core, the instance stays in initialization mode, for new ones. */
bool exit_initialization(Instance *self) {
    if (!refreshed(self, ERROR)) return false;
    self->progress.initializing = false;
    self->progress.mode = STEPPING;
    return true;
}

/* -- steps */

static double ulp(double number) {
    double size = fabs(number);
    return finite_number(size) ? nextafter(size, HUGE_VAL) - size : size;
}

static double tolerance(double step_size, double time) { return fmax(TIME_TOLERANCE * step_size, 4.0 * ulp(time)); }

static void say_time(Instance *self, Status status, const char *where, const char *before, double expected,
                     const char *after, double received, const char *at, double time, bool is_short) {
    char texts[2][160] = {"", ""}, number[NUMBER_SIZE];
    void (*written)(double, char[NUMBER_SIZE]) = is_short ? short_number_text : number_text;
    append(texts[0], sizeof texts[0], before);
    if (!not_a_number(expected)) {
        written(expected, number);
        append(texts[0], sizeof texts[0], number);
    }
    append(texts[0], sizeof texts[0], after);
    written(received, number);
    append(texts[1], sizeof texts[1], number);
    append(texts[1], sizeof texts[1], " s");
    append(texts[1], sizeof texts[1], at);
    if (*at) {
        written(time, number);
        append(texts[1], sizeof texts[1], number);
        append(texts[1], sizeof texts[1], " s");
    }
    say(self, status, where, texts[0], texts[1], "");
}

/* Whether a step may begin at `time`; else with a message. */
static bool may_begin(Instance *self, const Clock *clock, double time, double step_size) {
    const double none = NAN;
    if (!(step_size > 0.0 && step_size < HUGE_VAL)) {
        say_time(self, DISCARD, "communication step", "a finite time > 0 s", none, "", step_size, "", 0.0, false);
        return false;
    }
    if (!(fabs(time - clock->now) <= tolerance(fmax(step_size, clock->step_size), clock->now))) {
        say_time(self, DISCARD, "time of the step", "", clock->now, " s, where the last one ended", time, "", 0.0, false);
        return false;
    }
    if (time + step_size > time) return true;
    say_time(self, DISCARD, "communication step", "one that moves the time", none, "", step_size,
             ", which is lost in rounding at ", time, false);
    return false;
}

/* By how much the time of a host may be wrong that has added its steps up since the start. */
static double added_rounding(const Clock *clock, double time) {
    if (clock->step_size == 0.0) return 0.0;
    double steps = 1.0 + (time - clock->start) / clock->step_size;
    return fmin(steps * ulp(fmax(fabs(time), fabs(clock->start))), TIME_TOLERANCE * clock->step_size);
}

Status do_step(Instance *self, double time, double step_size) {
    Progress *progress = &self->progress;
    Clock *clock = &progress->clock;
    double end = time + step_size;
    bool continues = time == clock->now && step_size > 0.0 && step_size == clock->step_size && end > time && end < HUGE_VAL;
    if (!continues && !may_begin(self, clock, time, step_size)) return DISCARD;
    if (progress->has_stop && !(end <= clock->stop + tolerance(step_size, clock->stop))) {
        say_time(self, ERROR, "end of the step", "at most the stop time ", clock->stop, " s", end, "", 0.0, true);
        return ERROR;
    }
    if (!continues) {
        double rounding = added_rounding(clock, end), last = clock->step_size;
        if (step_size <= rounding) {
            progress->last_time = end;
            clock->now = fmax(clock->now, end);
            return OK;
        }
        if (!(end > clock->now && end < HUGE_VAL)) {
            say_time(self, DISCARD, "end of the step", "a finite time after ", clock->now, " s, where the last one ended",
                     end, "", 0.0, false);
            return DISCARD;
        }
        /* A step that is the difference of two rounded times varies in its last bits. */
        if (last != 0.0 && fabs(step_size - last) <= fmax(2.0 * ulp(end), rounding)) step_size = last;
    }
    Call call = call_of(self);
    if (!fmu.step(&call, time, step_size)) return DISCARD;
    show_outputs(self);
    clock->now = progress->last_time = end;
    clock->step_size = step_size;
    return OK;
}
