"""Plants that have no constant matrices: a robot arm with two torques, a cart that hears a beacon, a levitated ball."""

from __future__ import annotations

import sympy

from ndob_fmu.model.model import Model


def _arm(x, u, d, p):
    """Return ẋ of M(q) q̈ + h(q, q̇) + damping q̇ = torques + loads."""
    c, s = sympy.cos(x.elbow), sympy.sin(x.elbow)
    coupled = p.m2 * (p.l2**2 / 3 + p.l1 * p.l2 * c / 2)
    first = p.m1 * p.l1**2 / 3 + p.m2 * (p.l1**2 + p.l2**2 / 3 + p.l1 * p.l2 * c)
    inertia = sympy.Matrix([[first, coupled], [coupled, p.m2 * p.l2**2 / 3]])
    turning = p.m2 * p.l1 * p.l2 * s / 2
    torques = sympy.Matrix(
        [
            u.shoulder_torque + d.shoulder_load + turning * (2 * x.shoulder_rate + x.elbow_rate) * x.elbow_rate,
            u.elbow_torque + d.elbow_load - turning * x.shoulder_rate**2,
        ]
    )
    accelerations = inertia.inv() * (torques - p.damping * sympy.Matrix([x.shoulder_rate, x.elbow_rate]))
    return [x.shoulder_rate, x.elbow_rate, *accelerations]


ARM = Model(
    name="TwoLinkArm",
    states=["shoulder", "elbow", "shoulder_rate", "elbow_rate"],
    inputs=["shoulder_torque", "elbow_torque"],
    outputs=["elbow", "shoulder"],
    disturbances=["shoulder_load", "elbow_load"],
    dynamics=_arm,
    parameters={"m1": 2.0, "m2": 1.5, "l1": 0.5, "l2": 0.4, "damping": 0.5},
    ranges={"elbow": (-3.0, 3.0)},
    disturbance_bound=[2.0, 1.0],
    xhat0_std=[0.1] * 4,
)

# y = h(x, u): a distance, and an acceleration that shows the force at once.
CART = Model(
    name="Cart",
    states=["position", "rate", "drag"],
    inputs=["force"],
    outputs={
        "distance": lambda x, u, p: sympy.sqrt(x.position**2 + p.height**2),
        "acceleration": lambda x, u, p: (u.force - p.friction * x.rate + x.drag) / p.mass,
    },
    disturbances=["drag_rate"],
    dynamics=lambda x, u, d, p: [x.rate, (u.force - p.friction * x.rate + x.drag) / p.mass, d.drag_rate],
    parameters={"mass": 2.0, "friction": 1.0, "height": 3.0},
    noise_std={"distance": 1e-3, "acceleration": 1e-2},
    disturbance_bound=3.0,
    x0=[4.0, 0.0, 0.0],
    xhat0=[4.0, 0.0, 0.0],
    xhat0_std=[0.1, 0.1, 0.5],
)

# The pull of the magnet, and with it the input's direction, grows beyond all numbers as the gap closes.
BALL = Model(
    name="Ball",
    states=["gap", "rate"],
    inputs=["current"],
    outputs=["gap"],
    disturbances=["push"],
    dynamics=lambda x, u, d, p: [x.rate, p.gravity - p.pull * (u.current / x.gap) ** 2 + (1 + x.gap) * d.push],
    parameters={"gravity": 9.81, "pull": 1e-4},
    ranges={"gap": (2e-3, 2e-2), "current": (0.0, 5.0)},
    noise_std=1e-5,
    disturbance_bound=5.0,
    x0=[1e-2, 0.0],
    xhat0=[1e-2, 0.0],
    xhat0_std=[1e-3, 1e-2],
)

GENERAL: dict[str, Model] = {model.name: model for model in (ARM, CART, BALL)}
