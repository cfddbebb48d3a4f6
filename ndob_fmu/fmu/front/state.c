/* FMU states: the slave's, and with it the mode and time that the front keeps; as bytes with a head that tells a
 * damaged state and another FMU's. */
#include "front.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

typedef struct {
    Slot *slot;
    Instance *owner;
    fmi2FMUstate slave;
    Progress progress;
} State;

typedef struct {
    char magic[8];
    uint64_t fmu; /* hash of the GUID */
    uint64_t size; /* of the slave's bytes, which follow */
    uint64_t hash; /* of everything after this member */
    Progress progress;
} Head;

static const char MAGIC[8] = "NDOBST1";
static Handles states;

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

static State *state_of(Instance *self, const char *function, fmi2FMUstate handle) {
    Slot *slot = handle_slot(&states, handle);
    if (slot) return slot->object;
    log_line(&self->log, fmi2Error, "%s: expected an FMU state that was got from this FMU and not freed, received %s",
             function, handle ? "something else" : "NULL");
    return NULL;
}

static bool given(Instance *self, const char *function, const void *place) {
    if (place) return true;
    log_line(&self->log, fmi2Error, "%s: expected no argument to be NULL, received NULL", function);
    return false;
}

static void state_free(Instance *self, State *state) {
    slave.FreeFMUstate(self->slave, &state->slave);
    handle_free(state->slot);
    free(state);
}

void states_free(Instance *self) {
    for (size_t c = 0; c < sizeof states.chunks / sizeof *states.chunks; c++) {
        Slot *chunk = atomic_load(&states.chunks[c]);
        for (size_t i = 0; chunk && i < SLOTS_PER_CHUNK; i++) {
            State *state = atomic_load(&chunk[i].handle) ? chunk[i].object : NULL;
            if (state && state->owner == self) state_free(self, state);
        }
    }
}

/* Give the host a handle of a slave's state, in place of the one that `handle` may hold already. */
static bool keep(Instance *self, fmi2FMUstate *handle, fmi2FMUstate made, Progress progress) {
    Slot *before = handle_slot(&states, *handle);
    State *state = before ? before->object : calloc(1, sizeof *state);
    if (state && before) slave.FreeFMUstate(self->slave, &state->slave);
    if (state && !before) {
        state->owner = self;
        *handle = handle_new(&states, state);
        state->slot = handle_slot(&states, *handle);
        if (!state->slot) {
            free(state);
            state = NULL;
        }
    }
    if (!state) {
        log_line(&self->log, fmi2Error, "expected memory for an FMU state, received none");
        slave.FreeFMUstate(self->slave, &made);
        return false;
    }
    state->slave = made;
    state->progress = progress;
    return true;
}

fmi2Status fmi2GetFMUstate(fmi2Component component, fmi2FMUstate *handle) {
    Instance *self = enter(component, __func__, ANY_MODE);
    if (!self) return fmi2Error;
    if (!given(self, __func__, handle)) return leave(self, fmi2Error);
    fmi2FMUstate made = NULL;
    fmi2Status status = judged(self, slave.GetFMUstate(self->slave, &made));
    if (status < fmi2Discard && !keep(self, handle, made, self->progress)) status = fmi2Error;
    return leave(self, status);
}

fmi2Status fmi2SetFMUstate(fmi2Component component, fmi2FMUstate handle) {
    Instance *self = enter(component, __func__, ANY_MODE);
    if (!self) return fmi2Error;
    State *state = state_of(self, __func__, handle);
    if (!state) return leave(self, fmi2Error);
    fmi2Status status = judged(self, slave.SetFMUstate(self->slave, state->slave));
    if (status < fmi2Discard) self->progress = state->progress;
    return leave(self, status);
}

fmi2Status fmi2FreeFMUstate(fmi2Component component, fmi2FMUstate *handle) {
    Instance *self = enter(component, __func__, ANY_MODE);
    if (!self) return fmi2Error;
    if (!handle || !*handle) return leave(self, fmi2OK);
    State *state = state_of(self, __func__, *handle);
    if (!state) return leave(self, fmi2Error);
    state_free(self, state);
    *handle = NULL;
    return leave(self, judged(self, fmi2OK));
}

static fmi2Status sizes(Instance *self, const State *state, size_t *size) {
    return judged(self, slave.SerializedFMUstateSize(self->slave, state->slave, size));
}

fmi2Status fmi2SerializedFMUstateSize(fmi2Component component, fmi2FMUstate handle, size_t *size) {
    Instance *self = enter(component, __func__, ANY_MODE);
    if (!self) return fmi2Error;
    State *state = given(self, __func__, size) ? state_of(self, __func__, handle) : NULL;
    if (!state) return leave(self, fmi2Error);
    size_t inner = 0;
    fmi2Status status = sizes(self, state, &inner);
    if (status < fmi2Discard) *size = sizeof(Head) + inner;
    return leave(self, status);
}

fmi2Status fmi2SerializeFMUstate(fmi2Component component, fmi2FMUstate handle, fmi2Byte bytes[], size_t size) {
    Instance *self = enter(component, __func__, ANY_MODE);
    if (!self) return fmi2Error;
    State *state = given(self, __func__, bytes) ? state_of(self, __func__, handle) : NULL;
    if (!state) return leave(self, fmi2Error);
    size_t inner = 0;
    fmi2Status status = sizes(self, state, &inner);
    if (status >= fmi2Discard) return leave(self, status);
    if (size < sizeof(Head) + inner) {
        log_line(&self->log, fmi2Error, "%s: expected room for %zu bytes, received %zu", __func__, sizeof(Head) + inner,
                 size);
        return leave(self, fmi2Error);
    }
    char *content = bytes + sizeof(Head);
    status = judged(self, slave.SerializeFMUstate(self->slave, state->slave, content, inner));
    Head head = {.fmu = fmu_hash(self), .size = inner, .progress = state->progress};
    head.hash = content_hash(&head.progress, content, inner);
    memcpy(head.magic, MAGIC, sizeof MAGIC);
    memcpy(bytes, &head, sizeof head);
    return leave(self, status);
}

/* Return what is wrong with the bytes, or NULL. */
static const char *fault(const Instance *self, const Head *head, const fmi2Byte bytes[], size_t size) {
    if (size < sizeof *head || memcmp(head->magic, MAGIC, sizeof MAGIC) != 0) return "bytes that are no FMU state";
    if (head->fmu != fmu_hash(self)) return "the state of another FMU, or of another build of this one";
    if (head->size > size - sizeof *head) return "a state that was cut off";
    if (head->hash != content_hash(&head->progress, bytes + sizeof *head, head->size))
        return "a state that was damaged";
    return NULL;
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component component, const fmi2Byte bytes[], size_t size, fmi2FMUstate *handle) {
    Instance *self = enter(component, __func__, ANY_MODE);
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
    fmi2Status status = judged(self, slave.DeSerializeFMUstate(self->slave, bytes + sizeof head, head.size, &made));
    if (status < fmi2Discard && !keep(self, handle, made, head.progress)) status = fmi2Error;
    return leave(self, status);
}
