/* The plant continued by its tangent outside its ranges, as `runtime.design.ranges` has it.
 *
 * The build defines the enumeration of sizes, and the limits of states and inputs. */
#include "translated.h"

static nd clipped(nd_arena *arena, nd values, const double limits[][2], bool *inside) {
    nd found = nd_copy(arena, values);
    for (int i = 0; i < nd_len(values); i++) {
        double value = nd_at(values, i), low = limits[i][0], high = limits[i][1];
        if (!(low <= value && value <= high)) *inside = false;
        found->p[i] = nd_min2(nd_max2(value, low), high);
    }
    return found;
}

/* What x and u add to the rows of [dx/dt; y] by what they are outside. */
static nd moved(nd_arena *arena, int first, int stop, nd x, nd u, nd x_in, nd u_in, nd d, nd p) {
    nd_ix rows = {ND_RANGE, first, stop}, columns = {ND_RANGE, 0, CONTINUED_STATES};
    int size[] = {CONTINUED_STATES + CONTINUED_OUTPUTS, -1}, size_u[] = {size[0], CONTINUED_INPUTS};
    nd by_x = nd_reshape(arena, call_linearisation(arena, NULL, x_in, u_in, d, p), 2, size);
    nd by_u = nd_reshape(arena, call_input_slopes(arena, NULL, x_in, u_in, d, p), 2, size_u);
    nd of_x = nd_matmul(arena, nd_get(arena, by_x, 2, (nd_ix[]){rows, columns}), nd_binary(arena, ND_SUB, x, x_in));
    nd of_u = nd_matmul(arena, nd_get(arena, by_u, 1, &rows), nd_binary(arena, ND_SUB, u, u_in));
    return nd_binary(arena, ND_ADD, of_x, of_u);
}

static nd continued_derivatives(nd_arena *arena, const void *env, nd x, nd u, nd d, nd p) {
    bool inside = true;
    nd x_in = clipped(arena, x, limits_of_states, &inside), u_in = clipped(arena, u, limits_of_inputs, &inside);
    nd at = call_derivatives(arena, env, x_in, u_in, d, p);
    if (inside || arena->error) return at;
    return nd_binary(arena, ND_ADD, at, moved(arena, 0, CONTINUED_STATES, x, u, x_in, u_in, d, p));
}

static nd continued_output(nd_arena *arena, const void *env, nd x, nd u, nd p) {
    bool inside = true;
    nd x_in = clipped(arena, x, limits_of_states, &inside), u_in = clipped(arena, u, limits_of_inputs, &inside);
    nd at = call_output(arena, env, x_in, u_in, p);
    if (inside || arena->error) return at;
    nd no_disturbance = nd_full(arena, 1, (int[]){CONTINUED_DISTURBANCES}, 0.0);
    int stop = CONTINUED_STATES + CONTINUED_OUTPUTS;
    return nd_binary(arena, ND_ADD, at, moved(arena, CONTINUED_STATES, stop, x, u, x_in, u_in, no_disturbance, p));
}

static nd continued_linearisation(nd_arena *arena, const void *env, nd x, nd u, nd d, nd p) {
    bool inside = true;
    nd x_in = clipped(arena, x, limits_of_states, &inside), u_in = clipped(arena, u, limits_of_inputs, &inside);
    return call_linearisation(arena, env, x_in, u_in, d, p);
}

static nd continued_input_slopes(nd_arena *arena, const void *env, nd x, nd u, nd d, nd p) {
    bool inside = true;
    nd x_in = clipped(arena, x, limits_of_states, &inside), u_in = clipped(arena, u, limits_of_inputs, &inside);
    return call_input_slopes(arena, env, x_in, u_in, d, p);
}

static nd continued_sensitivity(nd_arena *arena, const void *env, nd x, nd u, nd d, nd p) {
    bool inside = true;
    nd x_in = clipped(arena, x, limits_of_states, &inside), u_in = clipped(arena, u, limits_of_inputs, &inside);
    return call_sensitivity(arena, env, x_in, u_in, d, p);
}
