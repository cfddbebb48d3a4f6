"""Tunings, transitions and whole observer steps as numbers to compare: python -m tests.kernel_numbers FILE.

Each array is given in the units in which its rounding errors are to be judged, so that differences compare with 1.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from ndob_fmu.codegen.compile_model import compile_model, linear_part
from ndob_fmu.runtime.design.augmented import augment
from ndob_fmu.runtime.design.intensity_law import tuned_law
from ndob_fmu.runtime.design.tuning import Knowledge, tuned_intensities
from ndob_fmu.runtime.linear_part import LinearPart
from ndob_fmu.runtime.numerics.transition import NO_PARTS, transition
from tests.helpers.observers import sampled_observer
from tests.helpers.problems import MODELS, RANDOM

ALPHA = 0.3
# Step (s) and σ: noise below the rounding of any sensor, and noise of a good and of a bad one.
CASES = ((1e-3, 1e-15), (1e-2, 1e-6), (0.1, 1e-2))
STEPS = 120
OUTLIER_AT = 70


def numbers() -> dict[str, np.ndarray]:
    """Return all arrays by what they are."""
    plants = {problem.name: problem.linear for problem in RANDOM[::3]} | {
        name: linear_part(model) for name, model in MODELS.items()
    }
    found: dict[str, np.ndarray] = {}
    for name, linear in plants.items():
        for order in (0, 1, 2, 3):
            for H, sigma in CASES:
                for what, values in of_tuning(linear, order, H, sigma).items():
                    found[f"{what} of {name}, r = {order}, H = {H:g} s, sigma = {sigma:g}"] = values
    for name, model in MODELS.items():
        if model.channel_expressions:
            continue
        for order in (0, 1, 2, 3):
            found[f"steps of {name}, r = {order}"] = of_steps(model, order, 1e-2, 1e-6)
    return found


def of_tuning(linear: LinearPart, order: int, H: float, sigma: float) -> dict[str, np.ndarray]:
    """Return the logarithms of tuned intensities and of their law, and the transition of a step."""
    p, q = len(linear.C), linear.G_d.shape[1]
    rate = np.arange(1.0, q + 1.0) * (2.0 * np.pi) ** max(order, 1)
    known = Knowledge(sigma * np.diag(np.arange(1.0, p + 1.0)), np.arange(1.0, q + 1.0), rate)
    system = augment(linear, order)
    intensities = tuned_intensities(system, H, ALPHA, known)
    found = {"tuning": np.log(np.append(intensities.disturbance, intensities.scale))}
    if order:
        law = tuned_law(system, H, ALPHA, known)
        found["law"] = np.array([*np.log(law.disturbance), law.exponent, law.limit_exponent])
        done = transition(system.A, system.noise, H, np.zeros((len(system.A), 0)), NO_PARTS)
        Phi, covariance = done.Phi, done.noise @ done.noise.T
        size = np.sqrt(np.diag(covariance))
        size = np.where(size > 0.0, size, 1.0)
        found["transition"] = np.hstack([Phi / np.max(np.abs(Phi)), covariance / np.outer(size, size)])
    return found


def of_steps(model, order: int, H: float, sigma: float) -> np.ndarray:
    """Return the estimates and error bars, over the bound of d, of steps through start-up, an outlier and freezing."""
    equations = compile_model(model)
    bound = np.array(equations.disturbance_bound)
    observer = sampled_observer(
        equations,
        model.parameter_values(),
        order=order,
        noise_std=[sigma] * len(model.outputs),
        disturbance_bound=bound.tolist(),
        disturbance_rate=(bound * 6.0 ** max(order, 1)).tolist(),
        x_hat=equations.x0,
        x_std=np.ones(len(equations.states)),
        alpha=model.observer.alpha,
        pi=1e8,
    )
    state, random = observer.init(list(equations.x0)), np.random.default_rng(0)
    nothing, rows = (0.0,) * len(model.outputs), []
    for k in range(STEPS):
        expected = -np.array(observer.estimate(state, nothing).residual)
        y = expected + sigma * random.normal(size=len(model.outputs)) + (1e3 * sigma if k == OUTLIER_AT else 0.0)
        state, estimate = observer.step(state, (0.0,) * len(model.inputs), y.tolist(), H)
        rows.append([*(np.array(estimate.d_at_sample) / bound), *(np.array(estimate.d_std) / bound), estimate.valid])
    return np.array(rows, dtype=float)


if __name__ == "__main__":
    np.savez(Path(sys.argv[1]), **numbers())
