/* Between interpreters.c, which finds a Python, and python.c, which starts it. */
#ifndef NDOB_FRONT_INTERPRETERS_H
#define NDOB_FRONT_INTERPRETERS_H

#include "front.h"

#include <limits.h>

#define VARIABLE "NDOB_FMU_PYTHON"
#define OLDEST_MINOR 10

/* An interpreter, its libpython, and the folder that NumPy lies in. */
typedef struct {
    char executable[PATH_MAX], library[PATH_MAX], packages[PATH_MAX];
    int minor; /* of 3.minor; 0 if not known */
} Candidate;

/* Why what was tried does not serve, one after the other. */
typedef struct {
    char *text;
    size_t size, used;
} Reasons;

__attribute__((format(printf, 2, 3))) void add_reason(Reasons *reasons, const char *format, ...);

/* Each fills in a candidate that has what an FMU needs, or returns false with its reasons. */
bool candidate_from_variable(Candidate *candidate, Reasons *reasons); /* NDOB_FMU_PYTHON, which is set */
bool candidate_from_build(Candidate *candidate, const Description *description, Reasons *reasons);
bool candidate_from_system(Candidate *candidate, Reasons *reasons);

#endif
