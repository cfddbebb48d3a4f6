"""Car on a straight road in a crosswind: an unknown side force and an unknown yaw moment on a single-track model.

    offset:    ẏ = v + speed · ψ                       ψ̇ = r
    sideways:  mass · (v̇ + speed · r) = F_front + F_rear + wind_force
    yaw:       yaw_inertia · ṙ = front_arm · F_front − rear_arm · F_rear + wind_moment
    tyres:     F_front = −grip · tanh(stiffness / grip · ((v + front_arm · r) / speed − steering_angle))
               F_rear  = −grip · tanh(stiffness / grip · ((v − rear_arm · r) / speed))

The offset from the lane, the heading and the yaw rate are measured. The tyres' force and moment enter where the wind's
do: the matched case, eq. (1), with n = 4, m = 1, p = 3, q = 2, and no zeros. Masses in t and forces in kN, so that the
force, some tenths of a kN, and the moment, some tenths of a kN·m, are numbers near one.

γ: the tyres are steepest where they do not slip. There ∂f/∂(v, r) is, over the speed, the symmetric matrix
−stiffness · [[2, a − b], [a − b, a² + b²]] with a = front_arm, b = rear_arm; its norm is 11.973.
"""

import math

import sympy

from ndob_fmu import Experiment, Model, ObserverDefaults, SignalDefaults

V, M, I_z = sympy.symbols("speed mass yaw_inertia")


def tyres(x, u, p):
    """Return side force (kN) and yaw moment (kN·m) of both axles."""
    front_slip = (x.side_velocity + p.front_arm * x.yaw_rate) / p.speed - u.steering_angle
    rear_slip = (x.side_velocity - p.rear_arm * x.yaw_rate) / p.speed
    front, rear = (-p.grip * sympy.tanh(p.stiffness / p.grip * slip) for slip in (front_slip, rear_slip))
    return [front + rear, p.front_arm * front - p.rear_arm * rear]


model = Model(
    name="CarInCrosswind",
    description="Single-track car model with an unknown side force and yaw moment",
    states=["offset", "heading", "side_velocity", "yaw_rate"],
    inputs=["steering_angle"],
    outputs=["offset", "heading", "yaw_rate"],
    disturbances=["wind_force", "wind_moment"],
    A=[[0, V, 1, 0], [0, 0, 0, 1], [0, 0, 0, -V], [0, 0, 0, 0]],
    B=[[0], [0], [0], [0]],
    C=[[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1]],
    G_d=[[0, 0], [0, 0], [1 / M, 0], [0, 1 / I_z]],
    f=tyres,
    parameters={
        "speed": 25.0,
        "mass": 1.5,
        "yaw_inertia": 2.5,
        "front_arm": 1.2,
        "rear_arm": 1.5,
        "stiffness": 80.0,
        "grip": 6.0,
    },
    units={
        "offset": "m",
        "heading": "rad",
        "side_velocity": "m/s",
        "yaw_rate": "rad/s",
        "steering_angle": "rad",
        "wind_force": "kN",
        "wind_moment": "kN.m",
        "speed": "m/s",
        "mass": "t",
        "yaw_inertia": "t.m2",
        "front_arm": "m",
        "rear_arm": "m",
        "stiffness": "kN/rad",
        "grip": "kN",
    },
    descriptions={
        "offset": "distance from the middle of the lane",
        "side_velocity": "velocity of the centre of mass across the car",
        "steering_angle": "angle of the front wheels",
        "front_arm": "distance of the front axle from the centre of mass",
        "rear_arm": "distance of the rear axle from the centre of mass",
        "stiffness": "side force of an axle per slip angle",
        "grip": "largest side force of an axle",
    },
    lipschitz=11.98,
    disturbance_bound=1.0,
    observer=ObserverDefaults(
        disturbance_rate=1.0 * (2 * math.pi) ** 2, alpha=1.0, pi_start=1.0, pi_end=1e7, pi_ramp_time=1.0
    ),
    disturbance=SignalDefaults(kind="sine", amplitude=0.4, frequency=0.2),
    experiment=Experiment(stop_time=5.0, step_size=1e-3),
)
