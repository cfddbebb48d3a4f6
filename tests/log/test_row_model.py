"""The equations of all rows at once are those that the observer uses row by row."""

import math

import numpy as np
import pytest
import sympy

from ndob_fmu import Model
from ndob_fmu.codegen.compile_model import compile_model
from ndob_fmu.codegen.row_functions import row_functions
from ndob_fmu.interface.told_observer import told_observer
from ndob_fmu.log.smooth.along import intensities
from ndob_fmu.log.smooth.row_model import RowModel
from ndob_fmu.log.smooth.row_steps import Motion
from ndob_fmu.log.told_values import told_values
from ndob_fmu.model.loading import load_model
from ndob_fmu.runtime.step.error_columns import joined
from ndob_fmu.runtime.step.time_update import predict
from tests.log.test_estimate_log import CART
from tests.runtime.test_general_plants import DRIVE

CASES = {
    "cart": (CART, {"estimate_parameters": True, "mass_std": 0.2, "place_bias_std": 0.1, "disturbance_order": 1}),
    "flexible joint": (load_model("flexible_joint"), {}),
}


@pytest.mark.parametrize("case", CASES)
# Over a longer step the slopes change, and both ways take their mean over parts of it, not the same ones.
@pytest.mark.parametrize(("H", "close"), [(1e-3, 1e-7), (0.02, 0.02)])
def test_a_step_of_all_rows_is_that_of_each_row(case, H, close):
    model, told = CASES[case]
    eq = compile_model(model)
    observer = told_observer(eq, told_values(eq, told).__getitem__, print)
    found = observer.tuned(1e-2).model
    rows, random = RowModel(found, row_functions(model)), np.random.default_rng(3)
    K, N = 7, found.layout.size
    start = found.layout.unpacked(observer.init(eq.xhat0).xi_hat)
    xi = start + random.standard_normal((K, N)) * np.append(
        found.start_std[: found.layout.n], 0.1 * start[found.layout.n :] + 0.1
    )
    xi[0, 1] += 20.0  # outside the range of the cart's rate
    u = random.standard_normal((K, len(eq.inputs)))
    intensity = np.ones(found.layout.q)
    sizes = np.broadcast_to(found.noise_sizes(intensity, H), (K, found.noise_directions.shape[1]))
    motion = Motion(rows, xi, u, np.full(K, H))
    steps = motion.steps(motion.plan(xi), found.noise_directions, sizes, apart=True)
    nothing = joined(np.zeros((N, N)), np.zeros((N, 0)), np.zeros((N, 0)))
    y, C = rows.output(xi, u), rows.output_slopes(xi, u)
    for k in range(K):
        one = predict(found, xi[k], nothing, u[k].tolist(), H, intensity, np.zeros(1), starting=False, model_error=0.0)
        scale = np.abs(one.xi).max()
        np.testing.assert_allclose(steps.end[k], one.xi, rtol=0, atol=1e-2 * close * scale)
        np.testing.assert_allclose(steps.Phi[k], one.Phi, rtol=0, atol=close * np.abs(one.Phi).max())
        covariance = steps.noise[k] @ steps.noise[k].T
        expected = one.columns.factor @ one.columns.factor.T
        std = np.sqrt(np.diag(expected))
        std[std == 0.0] = 1.0
        np.testing.assert_allclose(covariance / np.outer(std, std), expected / np.outer(std, std), rtol=0, atol=close)
        np.testing.assert_allclose(y[k], found.predicted_output(xi[k], u[k].tolist()), rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(C[k], found.output_slopes(xi[k], u[k].tolist()), rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("case", CASES)
def test_the_noise_of_all_steps_is_that_of_each_step(case):
    model, told = CASES[case]
    eq = compile_model(model)
    tuned = told_observer(eq, told_values(eq, told).__getitem__, print).tuned(1e-2)
    steps = np.array([1e-2, 2e-3, 0.0101, 0.3])
    found = RowModel(tuned.model, row_functions(model)).noise_sizes(intensities(tuned, steps), steps)
    as_told = [1.0] * len(eq.outputs)
    expected = [tuned.model.noise_sizes(tuned.intensity(H, as_told), H) for H in steps.tolist()]
    np.testing.assert_allclose(found, expected, rtol=1e-13)


def test_what_parameters_add_to_the_error_bar_of_all_rows_is_that_of_each_row():
    eq = compile_model(DRIVE)
    found = told_observer(eq, told_values(eq, {}).__getitem__, print).tuned(1e-2).model
    random, K = np.random.default_rng(4), 6
    xi, u = random.standard_normal((K, found.layout.size)), random.standard_normal((K, 1))
    xi[:, found.layout.parameters] = found.parameters
    added = RowModel(found, row_functions(DRIVE)).taken_for_disturbance(xi, u)
    expected = [found.taken_for_disturbance(one, of.tolist()) for one, of in zip(xi, u, strict=True)]
    assert np.min(expected) > 0.0
    np.testing.assert_allclose(added, expected, rtol=1e-12)


def test_equations_for_rows_have_the_functions_that_numpy_lacks():
    def dynamics(x, u, d, p):
        return [x.rate, d.force + sympy.erf(x.place) + sympy.Max(x.rate, 0.2) + sympy.tanh(u.push)]

    model = Model(
        name="Odd", states=["place", "rate"], inputs=["push"], outputs=["place"], disturbances=["force"],
        dynamics=dynamics, disturbance_bound=1.0,
    )  # fmt: skip
    x, u, d = np.array([[0.5, 0.1], [-0.3, 0.4], [2.0, 0.3]]), np.array([[0.1], [0.2], [0.3]]), np.ones((3, 1))
    found = row_functions(model).derivatives(x, u, d, np.empty((3, 0)))
    for row, (place, rate), (push,) in zip(found, x.tolist(), u.tolist(), strict=True):
        expected = [rate, 1.0 + math.erf(place) + max(rate, 0.2) + math.tanh(push)]
        np.testing.assert_allclose(row, expected, rtol=1e-14)
