/* `<Name>Controller`: the command for the references and estimates that a step begins with.
 *
 * The build defines STATES, INPUTS, DISTURBANCES, PARAMETERS, MEMORY and `regulated`. */
#include "fmu.h"
#include "translated.h"

enum {
    GIVEN = INPUTS + STATES + DISTURBANCES,
    /* Where the variables are. */
    FIRST_PARAMETER = GIVEN + INPUTS + 1,
    FIRST_GAIN = FIRST_PARAMETER + PARAMETERS,
    FIRST_LIMIT = FIRST_GAIN + INPUTS * STATES,
    AT_COMPENSATION = FIRST_LIMIT + INPUTS
};

typedef struct {
    double x[STATES], u[INPUTS]; /* the last equilibrium */
    double given[GIVEN]; /* the last finite inputs */
} State;

typedef struct {
    Controller controller;
    double values[PARAMETERS + INPUTS * STATES + INPUTS]; /* of the parameters, gains and limits */
    nd_arena arena, lasting;
    double views[8 * sizeof(nd_array) / sizeof(double)]; /* of the parameters and of vectors of the equations */
    double memory[MEMORY / sizeof(double)];
} Core;

static Target target_of(nd_arena *arena, const State *state) {
    Target target = {nd_view_of(arena, STATES, state->x), nd_view_of(arena, INPUTS, state->u)};
    return target;
}

static void take_target(State *state, const Target *target) {
    (void)nd_write(nd_write(state->x, target->x), target->u);
}

/* References and estimates as set; one that is not finite is replaced by its last finite value. */
static void take_given(const Call *call, double given[GIVEN]) {
    const State *state = call->state;
    if (!finite_numbers(call->values, GIVEN))
        tell(call->instance, WARNING, "estimates or references that are not finite are held");
    for (int i = 0; i < GIVEN; i++) given[i] = finite_number(call->values[i]) ? call->values[i] : state->given[i];
}

static bool command_in_memory(const Job *job) {
    Core *core = job->call->core;
    State *state = job->call->state, after;
    Target before = target_of(&core->arena, state);
    take_given(job->call, after.given);
    const double *x_hat = after.given + INPUTS;
    p2_Target_nd done =
        Controller_step(&core->arena, &core->controller, &before, nd_view_of(&core->arena, INPUTS, after.given),
                        nd_view_of(&core->arena, STATES, x_hat),
                        nd_view_of(&core->arena, DISTURBANCES, x_hat + STATES));
    if (core->arena.error) return fail(job->call, &core->arena, job->status, job->status == ERROR ? "start" : "step");
    double *saturated = nd_write(job->call->outputs, done.v1);
    *saturated = Controller_saturates(&core->arena, &core->controller, done.v1) ? 1.0 : 0.0;
    take_target(&after, &done.v0);
    *state = after;
    return true;
}

static bool start_in_memory(const Job *job) {
    Core *core = job->call->core;
    State *state = job->call->state;
    Target first = Controller_start(&core->arena, &core->controller);
    if (core->arena.error) return fail(job->call, &core->arena, job->status, "start");
    memset(state, 0, sizeof *state);
    take_target(state, &first);
    return true;
}

static bool possible_in_memory(const Job *job) {
    Core *core = job->call->core;
    const State *state = job->call->state;
    Target target = target_of(&core->arena, state);
    return Controller_possible(&core->arena, &core->controller, &target) && finite_numbers(state->given, GIVEN);
}

static bool start(const Call *call, double time) {
    Core *core = call->core;
    Controller *controller = &core->controller;
    (void)time;
    memset(controller, 0, sizeof *controller);
    memcpy(core->values, call->values + FIRST_PARAMETER, sizeof core->values);
    nd_start(&core->lasting, core->views, sizeof core->views);
    set_equations(&controller->equations, &core->lasting);
    controller->parameters = nd_view_of(&core->lasting, PARAMETERS, core->values);
    controller->regulated.n = INPUTS;
    controller->regulated.p = regulated;
    controller->gain = nd_view_of(&core->lasting, INPUTS * STATES, core->values + PARAMETERS);
    controller->gain->rank = 2;
    controller->gain->n[0] = INPUTS, controller->gain->n[1] = STATES;
    controller->gain->s[0] = STATES, controller->gain->s[1] = 1;
    controller->limit = nd_view_of(&core->lasting, INPUTS, core->values + PARAMETERS + INPUTS * STATES);
    controller->compensation = call->values[AT_COMPENSATION] != 0.0;
    return IN_MEMORY(call, 0.0, 0.0, ERROR, start_in_memory);
}

static bool show(const Call *call) { return IN_MEMORY(call, 0.0, 0.0, ERROR, command_in_memory); }

static bool step(const Call *call, double time, double step_size) {
    return IN_MEMORY(call, time, step_size, DISCARD, command_in_memory);
}

static bool possible(const Call *call, double begin, double now) {
    return IN_MEMORY(call, begin, now, ERROR, possible_in_memory);
}
