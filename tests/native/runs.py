"""Runs of the runtime in Python whose calls are repeated in C: observers of both methods, and numerics alone."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np
import scipy.linalg
import sympy

from ndob_fmu.codegen.compile_model import compile_model
from ndob_fmu.model.loading import load_model
from ndob_fmu.model.model import Model
from ndob_fmu.runtime.design.gains import paper_gains
from ndob_fmu.runtime.design.lumping import lumped
from ndob_fmu.runtime.design.minimum_phase import transmission_zeros
from ndob_fmu.runtime.design.operating_point import driven_modes
from ndob_fmu.runtime.design.schedule import PiSchedule
from ndob_fmu.runtime.numerics.integrate import integrate
from ndob_fmu.runtime.numerics.riccati import solve_riccati
from ndob_fmu.runtime.numerics.sliding import no_surfaces
from ndob_fmu.runtime.numerics.stiff import integrate_any
from ndob_fmu.runtime.numerics.zeros import balance, pencil_zeros
from ndob_fmu.runtime.step.channel_observer import read_out
from ndob_fmu.runtime.step.paper_observer import paper_observer
from tests.helpers.general_plants import CART
from tests.helpers.observers import sampled_observer
from tests.helpers.problems import MODELS

JOINT = MODELS["flexible_joint"]
# A sensor that follows the rate at once, so that the explicit steps are too many.
STIFF = Model(
    name="Stiff",
    states=["rate", "seen"],
    inputs=["torque"],
    outputs=["seen"],
    disturbances=["load"],
    dynamics=lambda x, u, d, p: [u.torque + d.load - x.rate**3, p.pace * (x.rate - x.seen)],
    parameters={"pace": 1e6},
    noise_std=1e-4,
    disturbance_bound=1.0,
    x0=[1.0, 1.0],
    xhat0=[1.0, 1.0],
)
# Its disturbance moves nothing where it starts.
TURNED = Model(
    name="Turned",
    states=["angle", "rate"],
    inputs=["torque"],
    outputs=["angle"],
    disturbances=["wind"],
    dynamics=lambda x, u, d, p: [x.rate, u.torque - x.rate + x.angle * d.wind],
    parameters={},
    ranges={"angle": (0.0, 2.0)},
    noise_std=1e-4,
    disturbance_bound=1.0,
    x0=[0.0, 0.0],
    xhat0=[0.0, 0.0],
)
# Friction holds it, so that its equations jump back and forth.
HELD = Model(
    name="Held",
    states=["place", "rate"],
    inputs=["force"],
    outputs=["place"],
    disturbances=["push"],
    dynamics=lambda x, u, d, p: [x.rate, u.force - 9.0 * sympy.sign(x.rate) + d.push],
    parameters={},
    noise_std=1e-4,
    disturbance_bound=1.0,
)
_H = 1e-3


def _sampled(model, *, steps=101, **settings) -> None:
    """Step an observer over samples of a plant, with jumps, outliers and a gap, and at last with another motion."""
    random = np.random.default_rng(1)
    eq, p = compile_model(model), model.parameter_values()
    observer = sampled_observer(eq, p, x_hat=eq.xhat0, **settings)
    x, u = list(eq.x0), [0.1] * len(eq.inputs)
    design = observer.design(_H)
    assert design.error_dynamics.shape == (len(design.poles),) * 2
    driven_modes(observer.system.linear.A, observer.system.linear.G_d)
    state = observer.init(eq.xhat0)
    d = 0.3 * np.array(eq.disturbance_bound)
    h, last = _H, np.zeros(len(eq.outputs))
    for k in range(steps):
        if k in (50, 62):
            d = -d
        y = np.array(eq.output(x, u, p)) + 1e-5 * random.standard_normal(len(eq.outputs))
        if k in (2, 30, 78):
            y[0] += 1.0
        if k > 85:
            y += 5.0 + np.arange(len(y))
        if k == 40:
            y[0] = np.nan
        if k == 45:
            y[0] = last[0]
        last = y
        observer.estimate(state, tuple(y))
        state, _ = observer.step(state, u, y.tolist(), h)
        observer.possible(state)
        if model is not STIFF:
            x = (np.array(x) + h * np.array(eq.derivatives(x, u, d.tolist(), p))).tolist()


def _channel() -> None:
    """Step the observer of a disturbance whose direction the state turns, until it vanishes."""
    model = load_model(Path(__file__).parents[2] / "examples" / "tool_on_arm.py")
    eq, p = compile_model(model), model.parameter_values()
    inner = sampled_observer(lumped(eq), p, x_hat=eq.xhat0, lag=0.01)
    observer = read_out(eq, p, inner, disturbance_bound=eq.disturbance_bound, lag=0.01)
    state = observer.init(eq.xhat0)
    for k in range(40):
        y = (np.array(eq.output(eq.x0, [0.0] * len(eq.inputs), p)) + 1e-3 * k).tolist()
        state, _ = observer.step(state, [0.0] * len(eq.inputs), y, _H)


def _paper() -> None:
    eq, p = compile_model(JOINT), JOINT.parameter_values()
    paper_gains(eq.linear_part(p), pi=1e6, alpha=1.0)
    transmission_zeros(eq.linear_part(p))
    observer = paper_observer(
        eq,
        p,
        PiSchedule(1.0, 1e8, 0.05),
        alpha=1.0,
        noise_std=(1e-5, 1e-5),
        disturbance_bound=(2.0,),
        disturbance_nominal=(0.5,),
    )
    state = observer.init(eq.xhat0)
    for k in range(60):
        y = [1.0 + 0.1 * np.sin(k * _H), np.nan if k == 20 else 1.0]
        state, _ = observer.step(state, (0.1,), y, _H * (1.0 + 0.3 * (k % 3)))
        observer.possible(state)


def _numerics() -> None:
    """Solve what the observers above do not: stiff plants, zeros of tall systems, large π."""
    random = np.random.default_rng(2)
    A = scipy.linalg.block_diag([[-1e5]], [[0.0, 1.0], [-4.0, -0.1]])

    def rate(t, x):
        return A @ x + np.array([1e5 * np.sin(t), 0.0, np.cos(t) - x[1] ** 3])

    def slopes(t, x):
        J = A.copy()
        J[2, 1] -= 3.0 * x[1] ** 2
        return J, np.array([1e5 * np.cos(t), 0.0, -np.sin(t)])

    integrate_any(rate, slopes, no_surfaces, np.array([1.0, 0.5, 0.0]), 0.5, 0.5)
    integrate_any(lambda t, x: rate(t, x) * [0.0, 1.0, 1.0], slopes, no_surfaces, np.array([1.0, 0.5, 0.0]), 0.5, 0.1)
    integrate_any(
        lambda t, x: np.array([1.0 - 3.0 * np.sign(x[0])]),
        lambda t, x: (np.zeros((1, 1)), np.zeros(1)),
        no_surfaces,
        np.array([0.01]),
        0.5,
        0.1,
    )
    integrate(lambda t, x: np.array([x[1], -x[0]]), np.array([1.0, 0.0]), 0.0, 3.0, 0.1)
    for n, q, p in ((4, 1, 2), (5, 2, 2), (6, 2, 3)):
        full = random.standard_normal((n, n))
        G, C = random.standard_normal((n, q)), random.standard_normal((p, n))
        for pi in (1.0, 1e6, 1e12):
            solve_riccati(full - 3.0 * np.eye(n), C, G, pi=pi, alpha=0.5)
        plant = balance(1e3 * full, 1e-3 * G, C)
        pencil_zeros(plant.A, plant.G, plant.C)


RUNS = [
    *(partial(_sampled, JOINT, order=order, noise_std=[1e-5, 2e-5]) for order in (0, 1, 3)),
    partial(_sampled, JOINT, order=2, lag=0.02, delay=[0.0, 3e-3], bias_std=[1e-3, 0.0], noise_std=[1e-5, 2e-5]),
    partial(_sampled, JOINT, order=1, parameter_std=[0.1] * len(JOINT.parameters), noise_std=[1e-5, 2e-5]),
    partial(_sampled, CART, order=1),
    partial(_sampled, JOINT, order=2, own_order=(1,), noise_std=[1e-5, 2e-5]),
    # The gain is frozen between the faults.
    partial(_sampled, JOINT, order=1, noise_std=[1e-5, 2e-5], adapt_noise=False),
    partial(_sampled, STIFF, order=1, steps=10),
    partial(_sampled, TURNED, order=1, steps=5),
    partial(_sampled, HELD, order=2, steps=30),
    partial(_sampled, JOINT, order=2, steps=40, disturbance_rate=[0.0], noise_std=[1e-5, 2e-5]),
    _channel,
    _paper,
    _numerics,
]
