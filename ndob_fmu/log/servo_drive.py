"""A servo drive with LuGre friction (Canudas de Wit, Olsson, Åström and Lischinsky, 1995): a plant to make logs of.

    inertia · ω̇ = motor_torque − F + load,   φ̇ = ω
    F = stiffness · z + bristle_damping · ż + viscous · ω,   ż = ω − stiffness · |ω| / g(ω) · z
    g(ω) = coulomb + (breakaway − coulomb) · exp(−(ω / stribeck_rate)²)

z is the deflection of the bristles between the two surfaces. An observer has a simpler model of this: what it lacks is
what a model of a real drive lacks.
"""

from __future__ import annotations

from typing import Any

import sympy

from ndob_fmu.model.model import Model

# |ω| is rounded off below this rate (rad/s), so that its slope has a value everywhere.
_ROUNDED = 1e-5


def _dynamics(x: Any, u: Any, d: Any, p: Any) -> list[Any]:
    level = p.coulomb + (p.breakaway - p.coulomb) * sympy.exp(-((x.rate / p.stribeck_rate) ** 2))
    bristle_rate = x.rate - p.stiffness * sympy.sqrt(x.rate**2 + _ROUNDED**2) / level * x.bristle
    friction = p.stiffness * x.bristle + p.bristle_damping * bristle_rate + p.viscous * x.rate
    return [x.rate, (u.motor_torque - friction + d.load) / p.inertia, bristle_rate]


def servo_drive() -> Model:
    """Return the drive, at zero speed: input `motor_torque`, outputs `angle` and `rate`, disturbance `load`."""
    return Model(
        name="ServoDrive",
        description="Servo drive with LuGre friction and an unknown load torque",
        states=["angle", "rate", "bristle"],
        inputs=["motor_torque"],
        outputs=["angle", "rate"],
        disturbances=["load"],
        dynamics=_dynamics,
        parameters={
            "inertia": 2e-3,
            "viscous": 2e-3,
            "coulomb": 0.05,
            "breakaway": 0.07,
            "stribeck_rate": 0.2,
            "stiffness": 20.0,
            "bristle_damping": 0.1,
        },
        units={
            "angle": "rad",
            "rate": "rad/s",
            "bristle": "rad",
            "motor_torque": "N.m",
            "load": "N.m",
            "inertia": "kg.m2",
            "viscous": "N.m.s/rad",
            "coulomb": "N.m",
            "breakaway": "N.m",
            "stribeck_rate": "rad/s",
            "stiffness": "N.m/rad",
            "bristle_damping": "N.m.s/rad",
        },
        disturbance_bound=0.5,
        x0=[0.0, 0.0, 0.0],
    )
