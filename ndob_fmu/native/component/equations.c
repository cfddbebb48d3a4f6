/* The model's printed functions, as translated code calls them. The build adds one `call_…` for each function. */
#include "fmu.h"
#include "translated.h"

static void raise_fault(nd_arena *arena, int fault) { nd_raise(arena, ND_ARITHMETIC, "%s", FAULTS[fault]); }

static const double *flat(nd_arena *arena, nd x) {
    return x->rank != 1 || x->s[0] == 1 || x->n[0] < 2 ? x->p : nd_copy(arena, x)->p;
}

static nd numbers(nd_arena *arena, int count) { return nd_new(arena, 1, &count); }

/* What the printed functions call of the runtime; neither takes memory. */
static double largest(const double *ratios, int count) {
    nd_arena no_memory;
    nd_array given = nd_around(count, ratios);
    no_memory.used = 0;
    return integrate_largest(&no_memory, &given);
}

static void next_substep(double t, double length, double trials, double error_norm, double t_end, double *next_t,
                         double *next_length, double *left, double *next_trials, double *planned) {
    nd_arena no_memory;
    no_memory.used = 0;
    Substep next = integrate_next_substep(&no_memory, t, length, (int)trials, error_norm, t_end);
    *next_t = next.t;
    *next_length = next.length;
    *left = next.left;
    *next_trials = next.trials;
    *planned = next.planned;
}
