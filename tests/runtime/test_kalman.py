"""The covariance recursion on square roots is the textbook's, and rests where the Riccati equation says."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg

from ndob_fmu.errors import DesignError
from ndob_fmu.runtime.design.augmented import augment, discretise
from ndob_fmu.runtime.linear_part import LinearPart
from ndob_fmu.runtime.numerics.kalman import converged_factor, gain_change, predict, stationary, update

N, P, Q = 5, 2, 3


def system(seed):
    random = np.random.default_rng(seed)
    Phi = random.normal(size=(N, N)) * 0.6
    return Phi, random.normal(size=(P, N)), random.normal(size=(N, Q)), np.diag(random.uniform(0.1, 2.0, P)), random


@pytest.mark.parametrize("seed", range(5))
def test_one_step_on_square_roots_equals_the_joseph_form(seed):
    Phi, C, noise, R_factor, random = system(seed)
    factor = random.normal(size=(N, N))
    before, R = factor @ factor.T, R_factor @ R_factor.T
    S = C @ before @ C.T + R
    K = before @ C.T @ np.linalg.inv(S)
    rest = np.eye(N) - K @ C
    joseph = rest @ before @ rest.T + K @ R @ K.T
    step = update(factor, C, R_factor)
    np.testing.assert_allclose(step.K, K, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(step.factor @ step.factor.T, joseph, rtol=1e-8, atol=1e-11)
    np.testing.assert_allclose(step.innovation_factor @ step.innovation_factor.T, S, rtol=1e-10)
    ahead = predict(step.factor, Phi, noise)
    np.testing.assert_allclose(ahead @ ahead.T, Phi @ joseph @ Phi.T + noise @ noise.T, rtol=1e-8, atol=1e-11)


@pytest.mark.parametrize("seed", range(5))
def test_the_recursion_rests_where_the_riccati_equation_says(seed):
    Phi, C, noise, R_factor, _ = system(seed)
    factor = stationary(Phi, C, noise, R_factor)
    exact = scipy.linalg.solve_discrete_are(Phi.T, C.T, noise @ noise.T, R_factor @ R_factor.T)
    np.testing.assert_allclose(factor @ factor.T, exact, rtol=1e-7, atol=1e-9)


def test_slow_and_fast_modes_rest_after_one_call_where_the_recursion_needs_thousands_of_steps():
    Phi = np.array([[1.0, 1e-3, 0.0], [0.0, 1.0, 1e-3], [0.0, 0.0, 1.0]])
    C, noise, R_factor = np.array([[1.0, 0.0, 0.0]]), np.array([[0.0], [0.0], [1e-2]]), np.array([[1.0]])
    found = update(stationary(Phi, C, noise, R_factor), C, R_factor)
    factor = np.eye(3)
    for _ in range(12_000):
        factor = predict(update(factor, C, R_factor).factor, Phi, noise)
    assert gain_change(update(factor, C, R_factor), found) < 1e-7


def test_between_samples_good_to_1e_15_and_disturbances_of_1e3_no_digit_is_lost():
    # An angle, its rate, and a disturbance with two derivatives, of which the last is white noise.
    linear = LinearPart(
        np.eye(2, k=1), np.zeros((2, 1)), np.eye(1, 2), np.zeros((2, 0)), np.eye(2)[:, 1:], matched=True
    )
    sampled = discretise(augment(linear, 3), 1e-3, alpha=1.0)
    Phi, noise = sampled.Phi, 1e3 * sampled.noise_factor
    C, R_factor = np.eye(1, 5), np.array([[1e-15]])
    factor = stationary(Phi, C, noise, R_factor)
    step = update(factor, C, R_factor)
    again = update(predict(step.factor, Phi, noise), C, R_factor)
    assert gain_change(step, again) <= 1e-9
    assert np.max(np.abs(np.linalg.eigvals(Phi @ (np.eye(5) - step.K @ C)))) < 1.0


def test_a_growing_mode_that_no_output_sees_is_refused():
    Phi, C = np.diag([1.2, 0.5]), np.array([[0.0, 1.0]])
    with pytest.raises(DesignError, match="sampled-data gain: expected a stationary covariance"):
        stationary(Phi, C, np.eye(2), np.eye(1))


@pytest.mark.parametrize("seed", range(3))
def test_the_covariance_of_a_stable_system_solves_lyapunovs_equation(seed):
    random = np.random.default_rng(seed)
    F = random.normal(size=(N, N))
    F *= 0.97 / np.max(np.abs(np.linalg.eigvals(F)))
    inputs = random.normal(size=(N, Q))
    exact = scipy.linalg.solve_discrete_lyapunov(F, inputs @ inputs.T)
    factor = converged_factor(F, inputs)
    np.testing.assert_allclose(factor @ factor.T, exact, rtol=1e-9, atol=1e-9 * np.max(exact))
