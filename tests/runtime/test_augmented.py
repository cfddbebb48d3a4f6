"""The sampled model is the exact solution of the continuous one over a step."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.integrate
import scipy.linalg

from ndob_fmu.runtime.design.augmented import augment, discretise
from tests.helpers.problems import RANDOM

H = 0.03
CASES = [(problem, order) for problem in (RANDOM[1], RANDOM[6], RANDOM[7], RANDOM[8]) for order in (0, 1, 3)]


def names(case):
    return f"{case[0].name}, r = {case[1]}"


@pytest.mark.parametrize("case", CASES, ids=names)
def test_the_disturbance_is_a_chain_of_integrators_in_front_of_its_channel(case):
    problem, order = case
    linear, (n, _, _, _) = problem.linear, problem.shape
    system = augment(linear, order)
    q = linear.G_d.shape[1]
    assert system.A.shape == (n + order * q,) * 2
    s = 0.7 + 1.1j
    from_noise = system.C @ np.linalg.solve(s * np.eye(len(system.A)) - system.A, system.noise)
    channel = linear.G_d if order else linear.G
    direct = linear.C @ np.linalg.solve(s * np.eye(n) - linear.A, channel) / s**order
    np.testing.assert_allclose(from_noise, direct, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("case", CASES, ids=names)
def test_a_step_is_the_integral_of_the_continuous_model(case):
    problem, order = case
    system = augment(problem.linear, order)
    alpha = 0.8
    step = discretise(system, H, alpha)
    shift = alpha * np.eye(len(system.A)) if order == 0 else 0.0
    np.testing.assert_allclose(step.Phi, scipy.linalg.expm(system.A * H), rtol=1e-11, atol=1e-13)
    np.testing.assert_allclose(step.filter_phi, scipy.linalg.expm((system.A + shift) * H), rtol=1e-11, atol=1e-13)
    drive = scipy.integrate.quad_vec(lambda t: scipy.linalg.expm(system.A * t) @ system.noise, 0.0, H)[0]
    np.testing.assert_allclose(step.drive, drive, rtol=1e-9, atol=1e-14)
    linear = problem.linear
    held = scipy.integrate.quad_vec(lambda t: scipy.linalg.expm(linear.A * t) @ linear.G_d, 0.0, H)[0]
    np.testing.assert_allclose(step.held_disturbance, held, rtol=1e-9, atol=1e-14)

    def spread(t):
        g = scipy.linalg.expm((system.A + shift) * t) @ system.noise
        return g @ g.T

    covariance = scipy.integrate.quad_vec(spread, 0.0, H, epsabs=0.0, epsrel=1e-11)[0]
    found = step.noise_factor @ step.noise_factor.T
    size = np.sqrt(np.outer(np.diag(covariance), np.diag(covariance)))
    assert np.max(np.abs(found - covariance) / np.where(size > 0, size, 1.0)) < 1e-9


def test_the_smallest_entries_of_the_noise_keep_their_digits_where_van_loans_product_loses_them():
    """Three integrators behind a chain of two: entry (0, 0) is H⁹/(9·4!²), 1e-31 at 1 ms."""
    problem = RANDOM[1]
    step = discretise(augment(problem.linear, 3), 1e-3, 1.0)
    row = problem.linear.C @ step.noise_factor[: problem.shape[0]]
    gain = float((problem.linear.C @ problem.linear.A @ problem.linear.G_d)[0, 0])
    expected = gain**2 * 1e-3**9 / (9 * 24.0**2)
    assert float((row @ row.T)[0, 0]) == pytest.approx(expected, rel=1e-2)
