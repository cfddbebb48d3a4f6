/* What is said where translated code raises. */
#include "fmu.h"
#include "translated.h"

/* Say why there is no result, in the words of the Python FMU. `where` names the computation. */
static bool fail(const Call *call, const nd_arena *arena, Status status, const char *where) {
    char received[2 * ND_MESSAGE];
    if (arena->error != ND_ARITHMETIC && arena->error != ND_LINALG) {
        tell(call->instance, status, arena->message);
        return false;
    }
    const char *class = "LinAlgError";
    for (size_t i = 1; i < sizeof FAULTS / sizeof *FAULTS; i++)
        if (arena->error == ND_ARITHMETIC && strcmp(arena->message, FAULTS[i]) == 0) class = CLASSES[i];
    received[0] = '\0';
    strncat(received, arena->message, ND_MESSAGE);
    strcat(strcat(strcat(received, " ("), class), ")");
    say(call->instance, status, where, "numbers that can be computed with", received, "");
    return false;
}

static bool finite_numbers(const double *given, size_t count) {
    for (size_t i = 0; i < count; i++)
        if (!finite_number(given[i])) return false;
    return true;
}
