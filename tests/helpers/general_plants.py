"""Plants that have no constant matrices: a robot arm with two torques, a cart that hears a beacon, a levitated ball."""

from __future__ import annotations

from pathlib import Path

import sympy

from ndob_fmu.model.loading import load_model
from ndob_fmu.model.model import Model

ARM = load_model(Path(__file__).parents[2] / "examples" / "two_link_arm.py")

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

# A trolley, which an encoder measures, and a load that hangs on a rope, which a camera sees.
TROLLEY = Model(
    name="Trolley",
    states=["speed", "sway", "sway_rate"],
    inputs=["force"],
    outputs=["speed", "sway"],
    disturbances=["rail", "wind"],
    dynamics=lambda x, u, d, p: [u.force + d.rail - 0.5 * x.speed, x.sway_rate, d.wind - 1.2 * x.sway],
    parameters={},
    noise_std={"speed": 1e-3, "sway": 0.1},
    disturbance_bound={"rail": 1.0, "wind": 1.0},
    x0={},
)

GENERAL: dict[str, Model] = {model.name: model for model in (ARM, CART, BALL)}
