/* `<Name>Plant`: the plant with its built-in disturbance generators, one step for each doStep.
 *
 * The build defines STATES, INPUTS, OUTPUTS, DISTURBANCES, PARAMETERS, MEMORY, HIDDEN_STATES, JUMPS, `hidden` and
 * `nominal`. */
#include "fmu.h"
#include "translated.h"

enum {
    HELD = INPUTS + DISTURBANCES,
    /* Where the variables are. */
    FIRST_PARAMETER = HELD + OUTPUTS + HIDDEN_STATES + DISTURBANCES,
    FIRST_START = FIRST_PARAMETER + PARAMETERS,
    FIRST_GENERATOR = FIRST_START + STATES
};

typedef struct {
    double x[STATES + 1];
    double t, substep;
    double held[HELD + 1]; /* the last finite inputs and disturbances */
} State;

typedef struct {
    Plant plant;
    nd_array parameters_view;
    Generator generators[DISTURBANCES + 1];
    double parameters[PARAMETERS + 1];
    nd_arena arena;
    double memory[MEMORY / sizeof(double)];
} Core;

/* y for the input held until then, the other states, and the disturbances. */
static bool write_outputs(const Call *call, const State *state, const double *held, Status status, const char *where) {
    Core *core = call->core;
    nd y = call_output(&core->arena, NULL, nd_view_of(&core->arena, STATES, state->x), nd_view_of(&core->arena, INPUTS, held),
                       core->plant.parameters);
    if (core->arena.error) return fail(call, &core->arena, status, where);
    double *to = call->outputs;
    for (int i = 0; i < OUTPUTS; i++) *to++ = nd_at(y, i);
    for (int i = 0; i < HIDDEN_STATES; i++) *to++ = state->x[hidden[i]];
    nd d = Plant_disturbance(&core->arena, &core->plant, state->t, nd_view_of(&core->arena, DISTURBANCES, held + INPUTS));
    for (int i = 0; i < DISTURBANCES; i++) *to++ = nd_at(d, i);
    return true;
}

/* u and d as set; a value that is not finite is replaced by the last finite one, so that x survives. */
static void take_inputs(const Call *call, double held[HELD + 1]) {
    const State *state = call->state;
    if (!finite_numbers(call->values, HELD)) tell(call->instance, WARNING, "inputs that are not finite are held");
    for (int i = 0; i < HELD; i++) held[i] = finite_number(call->values[i]) ? call->values[i] : state->held[i];
}

static bool start(const Call *call, double start_time) {
    Core *core = call->core;
    State *state = call->state;
    memset(&core->plant, 0, sizeof core->plant);
    memcpy(core->parameters, call->values + FIRST_PARAMETER, PARAMETERS * sizeof(double));
    for (int i = 0; i < DISTURBANCES; i++) {
        const double *given = call->values + FIRST_GENERATOR + 4 * i;
        Generator generator = {(int)given[0], given[1], given[2], given[3]};
        core->generators[i] = generator;
    }
    core->plant.equations.states.n = STATES;
    core->plant.equations.derivatives.call = call_derivatives;
    core->plant.equations.linearisation.call = call_linearisation;
#if JUMPS
    core->plant.equations.surfaces.some = true;
    core->plant.equations.surfaces.value.call = call_surfaces;
#endif
    core->plant.equations.steps.plant_constants.call = call_plant_constants;
    core->plant.equations.steps.plant_trial.call = call_plant_trial;
    core->parameters_view = nd_around(PARAMETERS, core->parameters);
    core->plant.parameters = &core->parameters_view;
    core->plant.generators.n = DISTURBANCES;
    core->plant.generators.p = core->generators;
    memset(state, 0, sizeof *state);
    memcpy(state->x, call->values + FIRST_START, STATES * sizeof(double));
    memcpy(state->held + INPUTS, nominal, DISTURBANCES * sizeof(double));
    state->t = start_time;
    state->substep = HUGE_VAL;
    return true;
}

static bool show_in_memory(const Job *job) {
    double held[HELD + 1];
    take_inputs(job->call, held);
    return write_outputs(job->call, job->call->state, held, job->status, "start");
}

static bool step_in_memory(const Job *job) {
    Core *core = job->call->core;
    State *state = job->call->state, after;
    memset(&after, 0, sizeof after);
    take_inputs(job->call, after.held);
    PlantState before = {nd_view_of(&core->arena, STATES, state->x), state->t, state->substep};
    m_double size = {true, job->second};
    PlantState done = Plant_step(&core->arena, &core->plant, &before, nd_view_of(&core->arena, INPUTS, after.held),
                                 nd_view_of(&core->arena, DISTURBANCES, after.held + INPUTS), job->first + job->second, &size);
    if (core->arena.error) return fail(job->call, &core->arena, job->status, "step");
    for (int i = 0; i < STATES; i++) after.x[i] = nd_at(done.x, i);
    after.t = done.t;
    after.substep = done.substep;
    if (!write_outputs(job->call, &after, after.held, job->status, "step")) return false;
    *state = after;
    return true;
}

static bool possible_in_memory(const Job *job) {
    Core *core = job->call->core;
    const State *state = job->call->state;
    PlantState given = {nd_view_of(&core->arena, STATES, state->x), state->t, state->substep};
    return Plant_possible(&core->arena, &core->plant, &given) && times_same_time(&core->arena, state->t, job->second)
           && finite_numbers(state->held, HELD);
}

static bool show(const Call *call) { return IN_MEMORY(call, 0.0, 0.0, ERROR, show_in_memory); }

static bool step(const Call *call, double time, double step_size) {
    return IN_MEMORY(call, time, step_size, DISCARD, step_in_memory);
}

static bool possible(const Call *call, double begin, double now) {
    return IN_MEMORY(call, begin, now, ERROR, possible_in_memory);
}
