/* FMU states: the core's, with the mode and time that the shell keeps; as bytes with a head that tells a
 * damaged state and another FMU's. */
#include "core.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

/* Two threads may come with one state, on instances of their own; it is gone when the last is done with it. */
struct State {
    Slot *slot;
    Instance *owner;
    State *next, **place; /* in the owner's list, and the pointer to this one there */
    unsigned users; /* the host counts as one until it frees the state */
    fmi2FMUstate core;
    Progress progress;
};

typedef struct {
    char magic[8];
    uint64_t fmu; /* hash of the GUID */
    uint64_t size; /* of the core's bytes, which follow */
    uint64_t hash; /* of everything after this member */
    Progress progress;
} Head;

static const char MAGIC[8] = "NDOBST1";
static Handles states;
static Lock lock = UNLOCKED; /* of users, owners and their lists; not held in the core */

static uint64_t hashed(const void *data, size_t size, uint64_t hash) {
    for (const unsigned char *byte = data; size; size--, byte++) hash = (hash ^ *byte) * 0x100000001b3u; /* FNV-1a */
    return hash;
}
#define HASH_START 0xcbf29ce484222325u

static uint64_t fmu_hash(const Instance *self) {
    return hashed(self->description.guid, strlen(self->description.guid), HASH_START);
}

static uint64_t content_hash(const Progress *progress, const void *bytes, size_t size) {
    return hashed(bytes, size, hashed(progress, sizeof *progress, HASH_START));
}

/* Return the state behind the handle, in use until it is dropped; NULL, with a message, if the handle is invalid. */
static State *taken(Instance *self, const char *function, fmi2FMUstate handle) {
    lock_acquire(&lock);
    Slot *slot = handle_slot(&states, handle);
    State *state = slot ? slot->object : NULL;
    if (state) state->users++;
    lock_release(&lock);
    if (!state)
        log_line(&self->log, fmi2Error,
                 "%s: expected an FMU state that was got from this FMU and not freed, received %s", function,
                 handle ? "something else" : "NULL");
    return state;
}

static void drop(Instance *self, State *state) {
    lock_acquire(&lock);
    bool last = --state->users == 0;
    lock_release(&lock);
    if (!last) return;
    if (self->progress.mode != ORPHANED) core.FreeFMUstate(self->core, &state->core);
    free(state);
}

/* With the lock, as the next. */
static void own(State *state) {
    state->next = state->owner->states;
    state->place = &state->owner->states;
    if (state->next) state->next->place = &state->next;
    *state->place = state;
}

static void disown(State *state) {
    *state->place = state->next;
    if (state->next) state->next->place = state->place;
}

static bool given(Instance *self, const char *function, const void *place) {
    if (place) return true;
    log_line(&self->log, fmi2Error, "%s: expected no argument to be NULL, received NULL", function);
    return false;
}

void states_after_fork(void) { lock_renew(&lock); }

void states_free(Instance *self) {
    for (;;) {
        lock_acquire(&lock);
        State *state = self->states;
        if (state) {
            disown(state);
            handle_free(&states, state->slot);
        }
        lock_release(&lock);
        if (!state) return;
        drop(self, state);
    }
}

/* Give the host a handle of a core's state, in place of the one that `handle` may hold already. */
static bool keep(Instance *self, fmi2FMUstate *handle, fmi2FMUstate made, Progress progress) {
    State *state = calloc(1, sizeof *state), *before = NULL;
    if (state) {
        *state = (State){.owner = self, .users = 1, .core = made, .progress = progress};
        lock_acquire(&lock);
        state->slot = handle_slot(&states, *handle);
        if (state->slot) {
            before = state->slot->object;
            disown(before);
            state->slot->object = state;
        } else {
            void *name = handle_new(&states, state);
            if (name) *handle = name;
            state->slot = name ? handle_slot(&states, name) : NULL;
        }
        if (state->slot) own(state);
        lock_release(&lock);
    }
    if (before) drop(self, before);
    if (state && state->slot) return true;
    free(state);
    log_line(&self->log, fmi2Error, "expected memory for an FMU state, received none");
    core.FreeFMUstate(self->core, &made);
    return false;
}

fmi2Status fmi2GetFMUstate(fmi2Component component, fmi2FMUstate *handle) {
    Instance *self = ENTER(fmi2GetFMUstate);
    if (!self) return fmi2Error;
    if (!given(self, __func__, handle)) return leave(self, fmi2Error);
    fmi2FMUstate made = NULL;
    fmi2Status status = judged(self, core.GetFMUstate(self->core, &made));
    if (status < fmi2Discard && !keep(self, handle, made, self->progress)) status = fmi2Error;
    return leave(self, status);
}

fmi2Status fmi2SetFMUstate(fmi2Component component, fmi2FMUstate handle) {
    Instance *self = ENTER(fmi2SetFMUstate);
    if (!self) return fmi2Error;
    State *state = taken(self, __func__, handle);
    if (!state) return leave(self, fmi2Error);
    fmi2Status status = judged(self, core.SetFMUstate(self->core, state->core));
    if (status < fmi2Discard) self->progress = state->progress;
    drop(self, state);
    return leave(self, status);
}

fmi2Status fmi2FreeFMUstate(fmi2Component component, fmi2FMUstate *handle) {
    Instance *self = ENTER(fmi2FreeFMUstate);
    if (!self) return fmi2Error;
    if (!handle || !*handle) return leave(self, fmi2OK);
    State *state = taken(self, __func__, *handle);
    if (!state) return leave(self, fmi2Error);
    lock_acquire(&lock);
    bool kept = state->slot->object == state; /* no other thread has freed or overwritten it meanwhile */
    if (kept) {
        disown(state);
        handle_free(&states, state->slot);
    }
    lock_release(&lock);
    if (kept) drop(self, state);
    drop(self, state);
    *handle = NULL;
    return leave(self, judged(self, fmi2OK));
}

static fmi2Status sizes(Instance *self, const State *state, size_t *size) {
    return judged(self, core.SerializedFMUstateSize(self->core, state->core, size));
}

fmi2Status fmi2SerializedFMUstateSize(fmi2Component component, fmi2FMUstate handle, size_t *size) {
    Instance *self = ENTER(fmi2SerializedFMUstateSize);
    if (!self) return fmi2Error;
    State *state = given(self, __func__, size) ? taken(self, __func__, handle) : NULL;
    if (!state) return leave(self, fmi2Error);
    size_t inner = 0;
    fmi2Status status = sizes(self, state, &inner);
    if (status < fmi2Discard) *size = sizeof(Head) + inner;
    drop(self, state);
    return leave(self, status);
}

static fmi2Status serialize(Instance *self, const State *state, fmi2Byte bytes[], size_t size) {
    size_t inner = 0;
    fmi2Status status = sizes(self, state, &inner);
    if (status >= fmi2Discard) return status;
    if (size < sizeof(Head) + inner) {
        log_line(&self->log, fmi2Error, "fmi2SerializeFMUstate: expected room for %zu bytes, received %zu",
                 sizeof(Head) + inner, size);
        return fmi2Error;
    }
    char *content = bytes + sizeof(Head);
    status = judged(self, core.SerializeFMUstate(self->core, state->core, content, inner));
    Head head = {.fmu = fmu_hash(self), .size = inner, .progress = state->progress};
    head.hash = content_hash(&head.progress, content, inner);
    memcpy(head.magic, MAGIC, sizeof MAGIC);
    memcpy(bytes, &head, sizeof head);
    return status;
}

fmi2Status fmi2SerializeFMUstate(fmi2Component component, fmi2FMUstate handle, fmi2Byte bytes[], size_t size) {
    Instance *self = ENTER(fmi2SerializeFMUstate);
    if (!self) return fmi2Error;
    State *state = given(self, __func__, bytes) ? taken(self, __func__, handle) : NULL;
    if (!state) return leave(self, fmi2Error);
    fmi2Status status = serialize(self, state, bytes, size);
    drop(self, state);
    return leave(self, status);
}

/* Return what is wrong with the bytes, or NULL. */
static const char *fault(const Instance *self, const Head *head, const fmi2Byte bytes[], size_t size) {
    if (size < sizeof *head || memcmp(head->magic, MAGIC, sizeof MAGIC) != 0) return "bytes that are no FMU state";
    if (head->fmu != fmu_hash(self)) return "the state of another FMU, or of another build of this one";
    if (head->size > size - sizeof *head) return "a state that was cut off";
    if (head->hash != content_hash(&head->progress, bytes + sizeof *head, head->size))
        return "a state that was damaged";
    const Progress *progress = &head->progress;
    bool mode = progress->mode == INSTANTIATED || progress->mode == INITIALIZATION || progress->mode == STEPPING
                || progress->mode == TERMINATED;
    if (!mode || progress->has_experiment > 1 || !isfinite(progress->last_time))
        return "a state that no instance can have";
    return NULL;
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component component, const fmi2Byte bytes[], size_t size, fmi2FMUstate *handle) {
    Instance *self = ENTER(fmi2DeSerializeFMUstate);
    if (!self) return fmi2Error;
    if (!given(self, __func__, bytes) || !given(self, __func__, handle)) return leave(self, fmi2Error);
    Head head = {0};
    memcpy(&head, bytes, size < sizeof head ? size : sizeof head);
    const char *wrong = fault(self, &head, bytes, size);
    if (wrong) {
        log_line(&self->log, fmi2Error, "%s: expected the bytes of a state of this FMU, received %s", __func__, wrong);
        return leave(self, fmi2Error);
    }
    fmi2FMUstate made = NULL;
    fmi2Status status = judged(self, core.DeSerializeFMUstate(self->core, bytes + sizeof head, head.size, &made));
    size_t written = 0;
    if (status < fmi2Discard) status = judged(self, core.SerializedFMUstateSize(self->core, made, &written));
    if (status < fmi2Discard && written != head.size) { /* the core does not write what it could not read */
        core.FreeFMUstate(self->core, &made);
        log_line(&self->log, fmi2Error, "%s: expected the bytes of a state of this FMU, received others with its checksum",
                 __func__);
        return leave(self, fmi2Error);
    }
    if (status < fmi2Discard && !keep(self, handle, made, head.progress)) status = fmi2Error;
    return leave(self, status);
}
