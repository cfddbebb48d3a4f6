"""The stationary design for any plant: whatever its coordinates, its zeros and its relative degrees."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg
from hypothesis import given, settings
from hypothesis import strategies as st

from ndob_fmu.runtime.design.augmented import augment
from ndob_fmu.runtime.design.stationary_design import stationary_design
from ndob_fmu.runtime.design.tuning import Knowledge, at_bandwidth, predicted_error, tuned_intensities
from ndob_fmu.runtime.linear_part import LinearPart
from ndob_fmu.runtime.numerics.kalman import gain_change, predict, update
from tests.helpers.problems import RANDOM, minimum_phase_systems

RATE = 2.0 * np.pi
# Those that are hard on the numbers: slow zeros, relative degrees up to three and of different sizes, more outputs.
HARD = [RANDOM[i] for i in (0, 3, 4, 5, 7)]
hard_problem = pytest.mark.parametrize("problem", HARD, ids=lambda problem: problem.name)


def knowledge(linear: LinearPart, sigma: float, order: int) -> Knowledge:
    p, q = len(linear.C), linear.G_d.shape[1]
    rate = np.arange(1.0, q + 1.0) * RATE ** max(order, 1)
    return Knowledge(sigma * np.diag(np.arange(1.0, p + 1.0)), np.arange(1.0, q + 1.0), rate)


def tuned(linear, *, H, order, sigma, alpha=0.3):
    system, known = augment(linear, order), knowledge(linear, sigma, order)
    found = stationary_design(system, H, known.R_factor, tuned_intensities(system, H, alpha, known), alpha)
    return found, known


def in_coordinates(linear: LinearPart, T) -> LinearPart:
    """The same plant with states z of x = T z."""
    back = np.linalg.inv(T)
    return replace(
        linear, A=back @ linear.A @ T, B=back @ linear.B, C=linear.C @ T, G_f=back @ linear.G_f, G_d=back @ linear.G_d
    )


def outputs_first(linear: LinearPart) -> LinearPart:
    """The same plant with its outputs as the first states."""
    rest = scipy.linalg.null_space(linear.C).T
    changed = in_coordinates(linear, np.linalg.inv(np.vstack([linear.C, rest])))
    return replace(changed, C=np.eye(*linear.C.shape))


def heat_rod(nodes: int) -> LinearPart:
    """A rod with an unknown heat flow and a thermometer at one end, a second one in the middle, cooled at the other."""
    A = 25.0 * (np.eye(nodes, k=1) + np.eye(nodes, k=-1) - 2.0 * np.eye(nodes))
    A[0, 0], A[-1, -1] = -25.0, -25.1
    C = np.eye(nodes)[[0, nodes // 2]]
    return LinearPart(A, np.eye(nodes)[:, -1:], C, np.zeros((nodes, 0)), np.eye(nodes)[:, :1], matched=True)


@pytest.mark.parametrize(("H", "bandwidth"), [(0.1, 1.0), (0.1, 10.0)])
def test_states_that_nearly_determine_each_other_leave_a_gain_that_the_recursion_comes_to(H, bandwidth):
    """Along a rod the covariance is singular to all digits, and no coordinates make it I."""
    rod = heat_rod(60)
    system, known = augment(rod, 2), knowledge(rod, 1e-6, 2)
    found = stationary_design(system, H, known.R_factor, at_bandwidth(system, H, bandwidth, known), alpha=0.3)
    factor = np.eye(len(system.A))
    for _ in range(4000):
        factor = predict(update(factor, system.C, known.R_factor).factor, found.discrete.Phi, found.noise_factor)
    assert gain_change(found.update, update(factor, system.C, known.R_factor)) < 1e-5
    np.testing.assert_allclose(
        np.max(np.abs(found.poles)), np.max(np.abs(np.linalg.eigvals(found.error_dynamics))), rtol=1e-9
    )


@hard_problem
@pytest.mark.parametrize("order", [0, 1, 2, 3])
def test_every_plant_has_a_gain_that_forgets_its_errors_fast_without_noise_and_slow_with_much(problem, order):
    for H, sigma in ((1e-3, 1e-15), (0.1, 1e-2)):
        found, known = tuned(problem.linear, H=H, order=order, sigma=sigma)
        assert np.max(np.abs(found.poles)) < 1.0
        bias, noise = predicted_error(found, known.disturbance_rate)
        assert np.all(np.isfinite(bias + noise))
        if sigma < 1e-9:
            assert np.all(noise < bias)


def rounded_anew(linear: LinearPart, seed: int) -> LinearPart:
    """The same plant with other last bits in all of its numbers, as another processor might leave them."""
    random = np.random.default_rng(seed)

    def other(M):
        return M * (1.0 + np.finfo(float).eps * random.choice([-1.0, 1.0], M.shape))

    G_d = other(linear.G_d)
    return replace(
        linear, A=other(linear.A), C=other(linear.C), G_d=G_d, G_f=G_d if linear.matched else other(linear.G_f)
    )


@hard_problem
@pytest.mark.parametrize("order", [0, 1, 2, 3])
def test_last_bits_of_the_plant_decide_nothing_and_change_the_gain_in_its_last_digits(problem, order):
    """What three integrators leave of fast signals is as small as the rounding of dense states: hence the digits."""
    for H, bandwidth, digits in ((1e-4, 0.01, 1e-9), (1e-4, 1.0, 1e-6), (1e-3, 0.01, 1e-11), (1e-3, 1.0, 1e-8)):
        for sigma in (1e-15, 1e-2):
            gains, predictions = [], []
            for linear in (problem.linear, rounded_anew(problem.linear, 1), rounded_anew(problem.linear, 2)):
                system, known = augment(linear, order), knowledge(linear, sigma, order)
                found = stationary_design(system, H, known.R_factor, at_bandwidth(system, H, bandwidth / H, known), 0.3)
                gains.append(found.update)
                predictions.append(predicted_error(found, known.disturbance_rate))
            assert max(gain_change(gains[0], other) for other in gains[1:]) < digits
            for other in predictions[1:]:
                np.testing.assert_allclose(other, predictions[0], rtol=100.0 * digits)


@hard_problem
@pytest.mark.parametrize("order", [0, 3])
def test_what_is_predicted_does_not_depend_on_the_coordinates_of_the_states(problem, order):
    """Dense coordinates, in which small outputs are differences of large states, and those with outputs as states."""
    dense, known = tuned(problem.linear, H=5e-3, order=order, sigma=1e-6)
    again, _ = tuned(outputs_first(problem.linear), H=5e-3, order=order, sigma=1e-6)
    first, second = (np.sum(predicted_error(found, known.disturbance_rate), axis=0) for found in (dense, again))
    np.testing.assert_allclose(first, second, rtol=1e-3)


@settings(max_examples=12, deadline=None, derandomize=True)
@given(problem=minimum_phase_systems(), order=st.integers(1, 3), H=st.sampled_from([1e-3, 1e-2]))
def test_the_gain_of_any_minimum_phase_plant_is_that_of_the_riccati_equation(problem, order, H):
    found, _ = tuned(outputs_first(problem.linear), H=H, order=order, sigma=1e-3)
    # In units in which the covariance is near one, where SciPy's general solver can be trusted.
    scale = np.linalg.norm(found.prior_factor, axis=1)
    Phi, C = found.discrete.Phi * scale / scale[:, None], np.linalg.solve(found.sample_factor, found.system.C * scale)
    Q = found.noise_factor / scale[:, None]
    exact = scipy.linalg.solve_discrete_are(Phi.T, C.T, Q @ Q.T, np.eye(len(C)))
    own = found.prior_factor / scale[:, None]
    np.testing.assert_allclose(own @ own.T, exact, atol=1e-5)


@pytest.mark.parametrize("problem", RANDOM, ids=lambda problem: problem.name)
def test_without_an_order_constant_disturbances_are_read_exactly_from_the_output_error(problem):
    """M_H makes d of the steady error of the outputs, for p > q by a left inverse, and nothing of f's share in it."""
    found, _ = tuned(problem.linear, H=1e-2, order=0, sigma=1e-4)
    linear, C, K, Phi = found.system.linear, found.system.C, found.K, found.discrete.Phi
    q = linear.G_d.shape[1]
    forgets = Phi @ (np.eye(len(K)) - K @ C)
    steps = int(25.0 / -np.log(np.max(np.abs(found.poles))))
    for source, wanted in ((linear.G_d, np.eye(q)), (linear.G_f, np.zeros((q, linear.G_f.shape[1])))):
        if linear.matched and source is linear.G_f:
            continue
        held = scipy.linalg.expm(
            np.block([[linear.A, source], [np.zeros((source.shape[1], len(K) + source.shape[1]))]]) * 1e-2
        )
        error = np.zeros((len(K), source.shape[1]))
        for _ in range(steps):
            error = forgets @ error + held[: len(K), len(K) :]
        np.testing.assert_allclose(found.M_H @ C @ error, wanted, atol=1e-6)
