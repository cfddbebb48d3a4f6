"""Robot arm with two links that moves in the horizontal plane (SCARA), with an unknown load torque on each joint.

    M(q) · q̈ + c(q, q̇) + damping · q̇ = torques + loads,          q = (shoulder, elbow)

    M = [[ m₁·l₁²/3 + m₂·(l₁² + l₂²/3 + l₁·l₂·cos q₂),  m₂·(l₂²/3 + l₁·l₂/2·cos q₂) ],
         [ m₂·(l₂²/3 + l₁·l₂/2·cos q₂),                 m₂·l₂²/3                    ]]
    c = m₂·l₁·l₂/2·sin q₂ · [−(2·q̇₁ + q̇₂)·q̇₂,  q̇₁²]

m and l are the masses and lengths of upper arm (1) and forearm (2), which are uniform rods. The loads act in the
directions M(q)⁻¹, which turn with the elbow. 17-bit encoders measure both angles: their rounding to 48 µrad counts as
noise of 48/√12 = 14 µrad. SI units.
"""

import math

import sympy

from ndob_fmu import Experiment, Model, ObserverDefaults, SignalDefaults


def dynamics(x, u, d, p):
    """Return the rates and accelerations of both joints."""
    cosine, sine = sympy.cos(x.elbow), sympy.sin(x.elbow)
    lengths = p.upper_arm * p.forearm
    tip = p.forearm_mass * p.forearm**2 / 3
    coupled = tip + p.forearm_mass * lengths * cosine / 2
    whole = p.upper_arm_mass * p.upper_arm**2 / 3 + p.forearm_mass * (p.upper_arm**2 + lengths * cosine) + tip
    inertia = sympy.Matrix([[whole, coupled], [coupled, tip]])
    turning = p.forearm_mass * lengths * sine / 2
    torques = sympy.Matrix(
        [
            u.shoulder_torque + d.shoulder_load + turning * (2 * x.shoulder_rate + x.elbow_rate) * x.elbow_rate,
            u.elbow_torque + d.elbow_load - turning * x.shoulder_rate**2,
        ]
    )
    friction = p.damping * sympy.Matrix([x.shoulder_rate, x.elbow_rate])
    return [x.shoulder_rate, x.elbow_rate, *(inertia.inv() * (torques - friction))]


model = Model(
    name="TwoLinkArm",
    description="Robot arm with two links and an unknown load torque on each joint",
    states=["shoulder", "elbow", "shoulder_rate", "elbow_rate"],
    inputs=["shoulder_torque", "elbow_torque"],
    outputs=["elbow", "shoulder"],
    disturbances=["shoulder_load", "elbow_load"],
    dynamics=dynamics,
    parameters={"upper_arm_mass": 2.0, "forearm_mass": 1.5, "upper_arm": 0.5, "forearm": 0.4, "damping": 0.5},
    units={
        "shoulder": "rad",
        "elbow": "rad",
        "shoulder_rate": "rad/s",
        "elbow_rate": "rad/s",
        "shoulder_torque": "N.m",
        "elbow_torque": "N.m",
        "shoulder_load": "N.m",
        "elbow_load": "N.m",
        "upper_arm_mass": "kg",
        "forearm_mass": "kg",
        "upper_arm": "m",
        "forearm": "m",
        "damping": "N.m.s/rad",
    },
    descriptions={
        "elbow": "angle between the forearm and the stretched arm",
        "shoulder_load": "unknown torque on the shoulder",
        "elbow_load": "unknown torque on the elbow",
        "upper_arm": "length from shoulder to elbow",
        "forearm": "length from elbow to tool",
        "damping": "friction of each joint per rate",
    },
    ranges={"elbow": (-2.8, 2.8), "shoulder_rate": (-10.0, 10.0), "elbow_rate": (-10.0, 10.0)},
    noise_std=1.4e-5,
    disturbance_bound=[2.0, 1.0],
    x0=[0.0, 0.6, 0.0, 0.0],
    xhat0=[0.0, 0.6, 0.0, 0.0],
    xhat0_std=[0.1, 0.1, 0.1, 0.1],
    observer=ObserverDefaults(disturbance_rate=[2.0 * (2 * math.pi) ** 2, 1.0 * (2 * math.pi) ** 2]),
    disturbance=SignalDefaults(kind="sine", amplitude=0.5, frequency=1.0),
    experiment=Experiment(stop_time=3.0, step_size=1e-3),
)
