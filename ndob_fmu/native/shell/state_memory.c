/* For components whose parameters tell how large the state is. */
#include "shell.h"

#include <stdlib.h>

/* Have the instance's state in a block of so many bytes, all 0; NULL where the host has no memory. */
void *state_memory(Instance *self, size_t size) {
    free(self->state);
    self->state = calloc(1, size);
    self->state_size = self->state ? size : 0;
    return self->state;
}
