/* The model's printed functions, as translated code calls them. The build adds one `call_…` for each function. */
#include "fmu.h"
#include "translated.h"

/* As Python says it. */
static const char *const FAULTS[] = {"", "no result", "float division by zero", "math domain error", "math range error",
                                      "(34, 'Numerical result out of range')"};
static const char *const CLASSES[] = {"", "ValueError", "ZeroDivisionError", "ValueError", "OverflowError", "OverflowError"};

static void raise_fault(nd_arena *arena, int fault) { nd_raise(arena, ND_ARITHMETIC, "%s", FAULTS[fault]); }

static const double *flat(nd_arena *arena, nd x) {
    return x.rank != 1 || x.s[0] == 1 || x.n[0] < 2 ? x.p : nd_copy(arena, x).p;
}

static nd numbers(nd_arena *arena, int count) { return nd_new(arena, 1, &count); }

/* An array of numbers that nobody changes. */
static nd nd_view_of(int count, const double *given) {
    nd view = {NULL, 1, {1, 1, 1, 1}, {1, 1, 1, 1}};
    memcpy(&view.p, &given, sizeof given);
    view.n[0] = count;
    return view;
}

/* What the printed functions call of the runtime; neither takes memory. */
static double largest(const double *ratios, int count) {
    nd_arena no_memory;
    no_memory.used = 0;
    return integrate_largest(&no_memory, nd_view_of(count, ratios));
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
