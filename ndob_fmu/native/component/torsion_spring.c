/* `TorsionSpring`: shows the torques for the angles that a step begins with; it remembers nothing. */
#include "fmu.h"
#include "translated.h"

typedef struct {
    char nothing;
} Core;
typedef Core State;

static bool start(const Call *call, double time) { return (void)call, (void)time, true; }

static bool show(const Call *call) {
    const double *values = call->values;
    nd_arena no_memory;
    no_memory.used = 0;
    p2_double_double torques = torsion_spring_spring_torques(&no_memory, values[AT_stiffness], values[AT_angle_a],
                                                             values[AT_angle_b]);
    call->outputs[0] = torques.v0;
    call->outputs[1] = torques.v1;
    return true;
}

static bool step(const Call *call, double time, double step_size) { return (void)time, (void)step_size, show(call); }

static bool possible(const Call *call, double begin, double now) { return (void)call, (void)begin, (void)now, true; }
