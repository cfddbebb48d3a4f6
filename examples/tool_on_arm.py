"""Two-joint robot arm in the horizontal plane with an unknown side force on its tool, as in milling or deburring.

    shoulder:  shoulder_inertia · q̈₁ = shoulder_torque − shoulder_damping · q̇₁
                   − shoulder_friction · tanh(q̇₁ / friction_rate) + (forearm + upper_arm · cos q₂) · tool_force
    elbow:     elbow_inertia · q̈₂ = elbow_torque − elbow_damping · q̇₂
                   − elbow_friction · tanh(q̇₂ / friction_rate) + forearm · tool_force

The force acts on the tip, across the forearm; its torques on the joints are n(x) · tool_force with the lever arms
n = [forearm + upper_arm · cos q₂, forearm]. The direction of this one disturbance turns with the elbow, by 85° for the
lengths below. n never vanishes: ‖n‖ ≥ forearm. The drives have gears of 100 : 1, so that the rotors' reflected inertia,
which is constant, is much larger than the links'. 20-bit encoders measure both angles. The friction enters where the
torques do: the matched case, with n = 4, m = p = 2 and k = 2 lumped inputs, and no zeros. SI units; q₁ and q₂ are
shoulder_angle and elbow_angle, the latter counted from the stretched arm.

γ = shoulder_friction / friction_rate = 6 N·m·s/rad, the slope of the shoulder's friction at zero speed. `channel_bound`
has the longest lever arms; an elbow that turns at up to 5 rad/s turns the direction at `channel_rate` = 5 rad/s.
"""

import math

import sympy

from ndob_fmu import Experiment, Model, ObserverDefaults, SignalDefaults

J1, J2, b1, b2 = sympy.symbols("shoulder_inertia elbow_inertia shoulder_damping elbow_damping")


def friction(x, u, p):
    """Return the dry friction in both joints, N·m."""
    return [
        -p.shoulder_friction * sympy.tanh(x.shoulder_rate / p.friction_rate),
        -p.elbow_friction * sympy.tanh(x.elbow_rate / p.friction_rate),
    ]


def lever_arms(x, u, p):
    """Return the torques on shoulder and elbow per tool force, m."""
    return [p.forearm + p.upper_arm * sympy.cos(x.elbow_angle), p.forearm]


model = Model(
    name="ToolOnArm",
    description="Two-joint robot arm with an unknown side force on its tool",
    states=["shoulder_angle", "shoulder_rate", "elbow_angle", "elbow_rate"],
    inputs=["shoulder_torque", "elbow_torque"],
    outputs=["elbow_angle", "shoulder_angle"],
    disturbances=["tool_force"],
    A=[[0, 1, 0, 0], [0, -b1 / J1, 0, 0], [0, 0, 0, 1], [0, 0, 0, -b2 / J2]],
    B=[[0, 0], [1 / J1, 0], [0, 0], [0, 1 / J2]],
    C=[[0, 0, 1, 0], [1, 0, 0, 0]],
    G_d=[[0, 0], [1 / J1, 0], [0, 0], [0, 1 / J2]],
    f=friction,
    channel=lever_arms,
    channel_bound=[0.7, 0.3],
    channel_rate=5.0,
    parameters={
        "shoulder_inertia": 1.2,
        "elbow_inertia": 0.4,
        "shoulder_damping": 2.0,
        "elbow_damping": 0.5,
        "shoulder_friction": 3.0,
        "elbow_friction": 1.0,
        "friction_rate": 0.5,
        "upper_arm": 0.4,
        "forearm": 0.3,
    },
    units={
        "shoulder_angle": "rad",
        "shoulder_rate": "rad/s",
        "elbow_angle": "rad",
        "elbow_rate": "rad/s",
        "shoulder_torque": "N.m",
        "elbow_torque": "N.m",
        "tool_force": "N",
        "shoulder_inertia": "kg.m2",
        "elbow_inertia": "kg.m2",
        "shoulder_damping": "N.m.s/rad",
        "elbow_damping": "N.m.s/rad",
        "shoulder_friction": "N.m",
        "elbow_friction": "N.m",
        "friction_rate": "rad/s",
        "upper_arm": "m",
        "forearm": "m",
    },
    descriptions={
        "elbow_angle": "angle between the forearm and the stretched arm",
        "shoulder_torque": "torque of the shoulder's drive, at the joint",
        "elbow_torque": "torque of the elbow's drive, at the joint",
        "tool_force": "unknown force on the tool, across the forearm",
        "shoulder_inertia": "inertia at the shoulder, mostly the rotor's through the gear",
        "elbow_inertia": "inertia at the elbow, mostly the rotor's through the gear",
        "shoulder_friction": "dry friction of the shoulder at speed",
        "elbow_friction": "dry friction of the elbow at speed",
        "friction_rate": "rate at which dry friction reaches 76 % of its value",
        "upper_arm": "length from shoulder to elbow",
        "forearm": "length from elbow to tool",
    },
    lipschitz=6.0,
    disturbance_bound=20.0,
    noise_std=6e-6,
    x0=[0.3, 0.0, -0.5, 4.0],
    xhat0=[0.3, 0.0, -0.5, 0.0],
    xhat0_std=[1e-2, 2.0, 1e-2, 4.0],
    observer=ObserverDefaults(
        disturbance_rate=20.0 * (2 * math.pi) ** 2, alpha=1.0, pi_start=1e2, pi_end=1e10, pi_ramp_time=1.0
    ),
    disturbance=SignalDefaults(kind="sine", amplitude=10.0, frequency=1.0),
    experiment=Experiment(stop_time=3.0, step_size=1e-3),
)
