/* FMU states: copies of what an instance remembers; as bytes with a head that tells a damaged one and another FMU's. */
#include "shell.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

typedef struct {
    const Instance *owner; /* it is gone with the instance that it was got from */
    Progress progress;
    size_t state_size; /* of the component's state, without the zeros at its end */
    /* Then values, started_with, texts, started_with_texts and the component's state. */
} Saved;

typedef struct {
    char magic[8];
    uint64_t token; /* hash of the GUID */
    uint64_t size; /* of the bytes that follow */
    uint64_t hash; /* of them */
} Head;

static const char MAGIC[8] = "NDOBNA2";

static size_t values_size(void) { return fmu.count * sizeof(double); }
static size_t parameters_size(void) { return fmu.parameter_count * sizeof(double); }
static size_t texts_size(void) { return fmu.text_count * (size_t)TEXT_SIZE; }
static size_t fixed_size(void) { return values_size() + parameters_size() + 2 * texts_size(); }
static size_t contents_size(const Saved *saved) { return fixed_size() + saved->state_size; }
static size_t written_size(const Saved *saved) { return sizeof(Head) + sizeof(Progress) + contents_size(saved); }

/* A component has room for the most that its parameters can ask for; what they do not ask for is 0. */
static size_t used_size(const Instance *self) {
    const void *state = self->state;
    size_t size = self->state_size;
    uint64_t word = 0;
    while (size >= sizeof word) {
        memcpy(&word, (const char *)state + size - sizeof word, sizeof word);
        if (word) break;
        size -= sizeof word;
    }
    return size;
}

/* Where the parts of a saved state are. */
typedef struct {
    double *values, *started_with;
    char (*texts)[TEXT_SIZE], (*started_with_texts)[TEXT_SIZE];
    void *state;
} Parts;

static Parts parts_of(Saved *saved) {
    char *at = (char *)saved + sizeof *saved;
    Parts parts;
    parts.values = (double *)(void *)at;
    parts.started_with = (double *)(void *)(at += values_size());
    parts.texts = (char(*)[TEXT_SIZE])(at += parameters_size());
    parts.started_with_texts = (char(*)[TEXT_SIZE])(at += texts_size());
    parts.state = at + texts_size();
    return parts;
}

static Saved *new_saved(Instance *self, const char *function) {
    Saved *saved = calloc(1, sizeof *saved + fixed_size() + fmu.state_size);
    if (!saved) say_error(self, function, "memory for an FMU state", "none");
    return saved;
}

static void save(const Instance *self, Saved *saved) {
    Parts to = parts_of(saved);
    saved->owner = self;
    saved->progress = self->progress;
    memcpy(to.values, self->values, values_size());
    memcpy(to.texts, self->texts, texts_size());
    if (!self->progress.made) return; /* what was made before a reset means nothing now */
    memcpy(to.started_with, self->started_with, parameters_size());
    memcpy(to.started_with_texts, self->started_with_texts, texts_size());
    saved->state_size = used_size(self);
    memcpy(to.state, self->state, saved->state_size);
}

static bool needs_another_core(const Instance *self, Saved *saved) {
    Parts from = parts_of(saved);
    return saved->progress.made
           && !has_started_with(self, from.started_with, (const char(*)[TEXT_SIZE])from.started_with_texts);
}

/* Take over a saved state, or return false: its parameters may allow no core, or that core no such state. */
static bool adopt(Instance *self, Saved *saved, bool check) {
    Parts from = parts_of(saved);
    bool made = saved->progress.made;
    if (needs_another_core(self, saved)) {
        for (uint32_t i = 0; i < fmu.parameter_count; i++) self->values[fmu.parameters[i]] = from.started_with[i];
        memcpy(self->texts, from.started_with_texts, texts_size());
        if (!remake(self, saved->progress.clock.start)) return false;
    }
    memcpy(self->values, from.values, values_size());
    memcpy(self->texts, from.texts, texts_size());
    self->progress = saved->progress;
    if (!made) return true;
    size_t before = used_size(self), now = saved->state_size;
    if (now > self->state_size) return false;
    memcpy(self->state, from.state, now);
    if (before > now) memset((char *)self->state + now, 0, before - now);
    Call call = call_of(self);
    return !check || fmu.possible(&call, self->progress.clock.start, self->progress.clock.now);
}

/* Go back to the state before another one was tried. An instance that finds no core for it any more is reset. */
static void go_back(Instance *self, Saved *before) {
    if (!adopt(self, before, false)) reset(self);
}

/* Take over a saved state, or return false and stay in the present one. */
static bool adopt_or_stay(Instance *self, const char *function, Saved *saved) {
    if (!needs_another_core(self, saved)) return adopt(self, saved, false);
    Saved *present = new_saved(self, function);
    if (!present) return false;
    save(self, present);
    bool done = adopt(self, saved, false);
    if (!done) go_back(self, present);
    free(present);
    return done;
}

/* Return the state behind a handle, in use until it is left; NULL, with a message, if the handle is invalid. */
static Saved *taken(Instance *self, const char *function, void *handle) {
    Saved *saved = handle_enter(STATE_HANDLES, handle);
    if (!saved)
        say_error(self, function, "an FMU state that was got from this FMU and not freed",
                  handle ? "something else" : "NULL");
    return saved;
}

static bool given(Instance *self, const char *function, const void *place) {
    if (!place) say_error(self, function, "no argument to be NULL", "NULL");
    return place != NULL;
}

/* Give the host a handle, or overwrite the state that `handle` holds already. */
static bool hand_out(Instance *self, const char *function, Saved *saved, void **handle) {
    Saved *before = *handle ? handle_enter(STATE_HANDLES, *handle) : NULL;
    if (before) {
        memcpy(before, saved, sizeof *saved + contents_size(saved));
        handle_leave(STATE_HANDLES, *handle);
        free(saved);
        return true;
    }
    *handle = handle_new(STATE_HANDLES, saved);
    if (*handle) return true;
    free(saved);
    say_error(self, function, "fewer than 4096 FMU states", "one more");
    return false;
}

bool state_get(Instance *self, const char *function, void **handle) {
    if (!given(self, function, handle)) return false;
    Saved *saved = new_saved(self, function);
    if (!saved) return false;
    save(self, saved);
    return hand_out(self, function, saved, handle);
}

bool state_set(Instance *self, const char *function, void *handle) {
    Saved *saved = taken(self, function, handle);
    bool done = saved && adopt_or_stay(self, function, saved);
    if (saved) handle_leave(STATE_HANDLES, handle);
    return done;
}

bool state_free(Instance *self, const char *function, void **handle) {
    if (!handle || !*handle) return true; /* FMI: the call is ignored */
    Saved *saved = taken(self, function, *handle);
    if (!saved) return false;
    handle_free(STATE_HANDLES, *handle);
    free(saved);
    *handle = NULL;
    return true;
}

void states_free(Instance *self) {
    for (size_t place = 0; place < SLOTS; place++) {
        const void *handle = handle_at(STATE_HANDLES, place);
        Saved *saved = handle ? handle_enter(STATE_HANDLES, handle) : NULL;
        if (!saved) continue;
        if (saved->owner == self) {
            handle_free(STATE_HANDLES, handle);
            free(saved);
        } else {
            handle_leave(STATE_HANDLES, handle);
        }
    }
}

/* -- as bytes */

static uint64_t hashed(const void *data, size_t size) {
    uint64_t hash = 0xcbf29ce484222325u; /* FNV-1a */
    for (const unsigned char *byte = data; size; size--, byte++) hash = (hash ^ *byte) * 0x100000001b3u;
    return hash;
}

static uint64_t token_hash(void) {
    char token[TOKEN_SIZE];
    own_token(token);
    return hashed(token, strlen(token));
}

bool state_size(Instance *self, const char *function, void *handle, size_t *size) {
    Saved *saved = given(self, function, size) ? taken(self, function, handle) : NULL;
    if (!saved) return false;
    *size = written_size(saved);
    handle_leave(STATE_HANDLES, handle);
    return true;
}

bool state_write(Instance *self, const char *function, void *handle, unsigned char bytes[], size_t size) {
    Saved *saved = given(self, function, bytes) ? taken(self, function, handle) : NULL;
    if (!saved) return false;
    bool fits = size >= written_size(saved);
    if (fits) {
        unsigned char *contents = bytes + sizeof(Head);
        memcpy(contents, &saved->progress, sizeof(Progress));
        memcpy(contents + sizeof(Progress), (char *)saved + sizeof *saved, contents_size(saved));
        Head head = {"", token_hash(), sizeof(Progress) + contents_size(saved),
                     hashed(contents, sizeof(Progress) + contents_size(saved))};
        memcpy(head.magic, MAGIC, sizeof MAGIC);
        memcpy(bytes, &head, sizeof head);
    }
    handle_leave(STATE_HANDLES, handle);
    if (!fits) say_error(self, function, "room for as many bytes as the state has", "less");
    return fits;
}

static bool is_flag(uint32_t value) { return value <= 1; }

static bool times_fault(const Progress *progress) {
    const Clock *clock = &progress->clock;
    if (!finite_number(clock->start) || !finite_number(clock->now) || !finite_number(clock->step_size)) return true;
    if (!finite_number(progress->last_time) || not_a_number(clock->stop)) return true;
    double passed = clock->now - clock->start, size = fmax(fabs(clock->now), fabs(clock->start));
    double longest = passed / (1.0 - TIME_TOLERANCE) + 8.0 * (nextafter(size, HUGE_VAL) - size);
    /* The last step may have been longer by a rounding error than the one that it was taken for. */
    double most = tolerance((1.0 + TIME_TOLERANCE) * clock->step_size, clock->stop);
    bool late = progress->has_stop && !(clock->now <= clock->stop + most);
    bool early = progress->has_stop && !(clock->stop >= clock->start);
    return late || early || !(passed >= 0.0) || !(clock->step_size >= 0.0 && clock->step_size <= longest);
}

static bool mode_fault(const Progress *progress) {
    bool flags = is_flag(progress->has_experiment) && is_flag(progress->has_stop) && is_flag(progress->initializing)
                 && is_flag(progress->stale) && is_flag(progress->made);
    uint32_t mode = progress->mode;
    bool begun = progress->clock.now > progress->clock.start || progress->clock.step_size > 0.0;
    if (!flags || (progress->initializing != 0) != (mode == INITIALIZATION)) return true;
    switch (mode) {
    case INSTANTIATED: return progress->made || progress->stale || begun;
    case INITIALIZATION: return !progress->has_experiment || begun || !(progress->made || progress->stale);
    case STEPPING:
    case TERMINATED: return !progress->has_experiment || progress->stale || !progress->made;
    default: return true;
    }
}

static bool is_of_type(const Variable *variable, double value) {
    if (variable->type == 'I' || variable->type == 'E') return value >= -2147483648.0 && value <= 2147483647.0 && value == floor(value);
    return variable->type != 'B' || value == 0.0 || value == 1.0;
}

static bool texts_fault(const char (*texts)[TEXT_SIZE]) {
    for (uint32_t i = 0; i < fmu.text_count; i++)
        if (!memchr(texts[i], '\0', TEXT_SIZE) || !is_utf8(texts[i])) return true;
    return false;
}

static bool values_fault(Saved *saved) {
    Parts parts = parts_of(saved);
    for (uint32_t i = 0; i < fmu.count; i++)
        if (!is_of_type(&fmu.variables[i], parts.values[i])) return true;
    bool stepping = saved->progress.mode == STEPPING || saved->progress.mode == TERMINATED;
    for (uint32_t i = 0; saved->progress.made && i < fmu.parameter_count; i++) {
        const Variable *variable = &fmu.variables[fmu.parameters[i]];
        double value = parts.started_with[i];
        if (!is_of_type(variable, value) || !acceptable(variable, value)) return true;
        if (stepping && memcmp(&value, &parts.values[fmu.parameters[i]], sizeof value) != 0) return true;
    }
    return texts_fault((const char(*)[TEXT_SIZE])parts.texts)
           || texts_fault((const char(*)[TEXT_SIZE])parts.started_with_texts);
}

/* Return what is wrong with the bytes, or NULL. */
static const char *fault(const unsigned char bytes[], size_t size) {
    Head head;
    if (size < sizeof head) return "bytes that are no FMU state";
    memcpy(&head, bytes, sizeof head);
    if (memcmp(head.magic, MAGIC, sizeof MAGIC) != 0) return "bytes that are no FMU state";
    if (head.token != token_hash()) return "the state of another FMU, or of another build of this one";
    const size_t least = sizeof(Progress) + fixed_size();
    if (head.size > size - sizeof head || size - sizeof head < least) return "a state that was cut off";
    if (head.size < least || head.size > least + fmu.state_size
        || head.hash != hashed(bytes + sizeof head, (size_t)head.size))
        return "a state that was damaged";
    return NULL;
}

bool state_read(Instance *self, const char *function, const unsigned char bytes[], size_t size, void **handle) {
    if (!given(self, function, bytes) || !given(self, function, handle)) return false;
    const char *wrong = fault(bytes, size);
    Saved *saved = wrong ? NULL : new_saved(self, function);
    if (!wrong && !saved) return false;
    if (saved) {
        Head head;
        memcpy(&head, bytes, sizeof head);
        saved->owner = self;
        saved->state_size = (size_t)head.size - sizeof(Progress) - fixed_size();
        memcpy(&saved->progress, bytes + sizeof(Head), sizeof(Progress));
        memcpy((char *)saved + sizeof *saved, bytes + sizeof(Head) + sizeof(Progress), contents_size(saved));
        if (times_fault(&saved->progress) || mode_fault(&saved->progress) || values_fault(saved))
            wrong = "a state that no instance can have";
    }
    if (saved && !wrong) {
        /* The component alone can tell whether its state is possible: it is tried, and the present one comes back. */
        Saved *present = new_saved(self, function);
        if (!present) wrong = "no memory";
        if (present) {
            save(self, present);
            Log log = self->log;
            self->log.logger = NULL; /* what the core says of a state that is only tried is nothing that happened */
            if (!adopt(self, saved, true)) wrong = "a state that no instance can have";
            go_back(self, present);
            self->log = log;
            free(present);
        }
    }
    if (!wrong) return hand_out(self, function, saved, handle);
    free(saved);
    say_error(self, function, "the bytes of a state of this FMU", wrong);
    return false;
}
