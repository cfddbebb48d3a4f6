"""The time update of method 2 beside samples of what it describes."""

from __future__ import annotations

import numpy as np
import pytest
import sympy

from ndob_fmu import Model
from ndob_fmu.codegen.compile_model import compile_model
from ndob_fmu.runtime.step.error_columns import joined
from ndob_fmu.runtime.step.time_update import predict, predict_mean
from tests.helpers.observers import sampled_observer

U = (0.0,)
INTENSITY = np.array([1e-12])


def pendulum(stiffness=25.0, cubic=0.0):
    """Return the constants of an observer of a pendulum, or of a mass at a stiffening spring."""
    model = Model(
        name="Pendulum",
        states=["angle", "rate"],
        inputs=["torque"],
        outputs=["angle"],
        disturbances=["load"],
        dynamics=lambda x, u, d, p: [
            x.rate,
            -stiffness * sympy.sin(x.angle) - cubic * x.angle**3 + u.torque + d.load,
        ],
        disturbance_bound=1.0,
    )
    eq = compile_model(model)
    observer = sampled_observer(eq, model.parameter_values(), x_hat=eq.xhat0)
    return observer.tuned(0.01).model


def moved(model, xi, factor, H, *, starting):
    nothing = np.zeros((model.rows, 0))
    end = predict(
        model, xi, joined(factor, nothing, nothing), U, H, INTENSITY, np.zeros(1), starting=starting, model_error=0.0
    )
    return end.xi, end.columns.factor @ end.columns.factor.T


@pytest.mark.parametrize("angle", [1.2, 1.57])
def test_after_a_wild_start_the_covariance_has_what_the_linearisation_leaves_out(angle):
    """Where the sine is flat its slope is 0, and only its curvature moves the rate: by 25 · 0.6²/√2 a second."""
    model, H = pendulum(), 0.05
    xi, factor = np.array([angle, 0.0, 0.0, 0.0]), np.diag([0.6, 1e-3, 1e-3, 1e-3])
    random = np.random.default_rng(1)
    errors = random.normal(size=(3000, 4)) @ factor
    mean = predict_mean(model, xi, U, H)
    spread = np.mean([(predict_mean(model, xi + e, U, H) - mean)[1] ** 2 for e in errors])
    with_it = moved(model, xi, factor, H, starting=True)[1][1, 1]
    without = moved(model, xi, factor, H, starting=False)[1][1, 1]
    assert 0.7 < with_it / spread < 2.0
    assert without < 0.7 * spread


def test_a_step_over_which_the_slopes_change_much_is_as_good_as_many_short_ones():
    """A mass at a spring that becomes stiffer passes through its middle within the step."""
    model, H = pendulum(stiffness=0.0, cubic=60.0), 0.12
    xi, factor = np.array([1.0, 0.0, 0.0, 0.0]), np.diag([1e-4, 1e-3, 1e-3, 1e-3])
    once = moved(model, xi, factor, H, starting=False)
    often, count = (xi, factor @ factor.T), 60
    for _ in range(count):
        often = moved(model, often[0], np.linalg.cholesky(often[1]), H / count, starting=False)
    np.testing.assert_allclose(once[0], often[0], rtol=1e-8)
    size = np.sqrt(np.diag(often[1]))
    np.testing.assert_allclose(once[1] / np.outer(size, size), often[1] / np.outer(size, size), rtol=0, atol=0.05)
