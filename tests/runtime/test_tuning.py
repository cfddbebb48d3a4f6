"""From noise and pace to a gain: the choice is the best there is, and does not depend on units."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ndob_fmu.codegen.compile_model import linear_part
from ndob_fmu.runtime.design.augmented import augment, discretise
from ndob_fmu.runtime.design.gains import paper_gains
from ndob_fmu.runtime.design.stationary_design import stationary_design
from ndob_fmu.runtime.design.tuning import (
    _SLOWER,
    Knowledge,
    _minimise,
    at_bandwidth,
    from_pi,
    predicted_error,
    tuned_intensities,
)
from ndob_fmu.runtime.linear_part import LinearPart
from ndob_fmu.runtime.numerics.kalman import converged_factor
from tests.helpers.problems import MODELS, RANDOM

LINK = linear_part(MODELS["flexible_joint"])
SINE = 2.0 * np.pi


def knowledge(p, sigma, rate, bound=(5.0,)):
    return Knowledge(np.eye(p) * sigma, np.array(bound), np.array(rate, dtype=float))


def errors(system, H, intensities, known, alpha=1.0):
    """Return bias and noise of d̂ in units of D₀."""
    found = stationary_design(system, H, known.R_factor, intensities, alpha)
    bias, noise = predicted_error(found, known.disturbance_rate)
    return bias / known.disturbance_bound, noise / known.disturbance_bound


def mean_square(bias, noise):
    """Return J: of a bias that lies anywhere within its bounds, and the noise."""
    return float(np.sum(bias**2 / 3.0 + noise**2))


def largest(bias, noise):
    return float(np.sum(bias + noise))


@pytest.mark.parametrize("order", [0, 1, 2, 3])
@pytest.mark.parametrize("H", [1e-3, 1e-2])
@pytest.mark.parametrize("sigma", [1e-4, 1e-6, 1e-15])
def test_no_other_intensity_predicts_a_smaller_error(order, H, sigma):
    system, known = augment(LINK, order), knowledge(2, sigma, [SINE ** max(order, 1)])
    chosen = errors(system, H, tuned_intensities(system, H, 1.0, known), known)
    others = [errors(system, H, at_bandwidth(system, H, w, known), known) for w in np.geomspace(2.0, 4.0 / H, 25)]
    assert mean_square(*chosen) <= 1.002 * min(mean_square(*other) for other in others)


@pytest.mark.parametrize(
    ("order", "sigma", "best"), [(2, 1e-4, 0.130), (3, 1e-4, 0.093), (2, 1e-6, 0.0165), (3, 1e-6, 0.0075)]
)
def test_for_a_sine_of_1_hz_at_1_ms_bias_and_noise_together_are_near_the_least_over_all_intensities(order, sigma, best):
    """Their mean square is what the tuning minimises; their sum is least at an intensity a little larger."""
    system, known = augment(LINK, order), knowledge(2, sigma, [SINE**order])
    assert largest(*errors(system, 1e-3, tuned_intensities(system, 1e-3, 1.0, known), known)) * 5.0 <= 1.15 * best


def test_the_choice_does_not_depend_on_the_units_of_states_outputs_and_time():
    """Angles in mrad, time in ms: the same gain in the new units."""
    problem = RANDOM[5]
    linear, H, order = problem.linear, 5e-3, 2
    n, _, p, _ = problem.shape
    random = np.random.default_rng(0)
    S, length, ms = np.exp2(random.integers(-8, 8, n)), 1e3, 1e3
    other = LinearPart(
        A=linear.A * S / S[:, None] / ms,
        B=linear.B,
        C=linear.C * S * length,
        G_f=linear.G_f / S[:, None] / ms,
        G_d=linear.G_d / S[:, None] / ms,
        matched=True,
    )
    known = knowledge(p, 1e-4, [40.0], bound=[2.0])
    changed = knowledge(p, 1e-4 * length, [40.0 / ms**order], bound=[2.0])
    one, two = augment(linear, order), augment(other, order)
    first = stationary_design(one, H, known.R_factor, tuned_intensities(one, H, 0.1, known), 0.1)
    second = stationary_design(
        two, H * ms, changed.R_factor, tuned_intensities(two, H * ms, 0.1 / ms, changed), 0.1 / ms
    )
    T = np.concatenate([S, [1.0, ms]])
    np.testing.assert_allclose(
        second.K * T[:, None] * length, first.K, rtol=1e-5, atol=1e-5 * np.max(np.abs(first.K), axis=1).min()
    )


def test_pi_is_the_ratio_of_the_intensities_of_disturbance_and_measurement_noise():
    for order in (0, 1, 2):
        system, known, H, pi = augment(LINK, order), knowledge(2, 3e-5, [1.0]), 2e-3, 1e9
        found = from_pi(system, H, pi, known)
        assert found.disturbance[-1] == pytest.approx(pi * 3e-5**2 * H)


def test_without_an_order_the_gain_over_the_step_goes_to_the_papers_at_order_one():
    """Eqs. (7), (8): K/H → L and M_H → M as H → 0, also for p > q and unmatched systems."""
    for linear in (LINK, RANDOM[6].linear, RANDOM[7].linear):
        p, alpha, pi = len(linear.C), 0.3, 1e6
        paper = paper_gains(linear, pi=pi, alpha=alpha)
        q = linear.G_d.shape[1]
        system, known = augment(linear, 0), knowledge(p, 1e-4, [1.0] * q, bound=[1.0] * q)
        errors = []
        steps = np.array([4e-6, 2e-6, 1e-6])
        for H in steps:
            found = stationary_design(system, H, known.R_factor, from_pi(system, H, pi, known), alpha)
            M = linear.selector @ paper.M
            errors.append(
                [
                    np.max(np.abs(found.K / H - paper.L)) / np.max(np.abs(paper.L)),
                    np.max(np.abs(found.M_H - M)) / np.max(np.abs(M)),
                ]
            )
        slopes = np.diff(np.log(errors), axis=0) / np.diff(np.log(steps))[:, None]
        np.testing.assert_allclose(slopes, 1.0, atol=0.1)


def test_the_fastest_design_does_not_ring():
    """Poles for π → ∞ go to −0.268 and 0 (r = 0); none comes near the sampling zero at −1."""
    known = knowledge(2, 1e-15, [1.0])
    system = augment(LINK, 0)
    found = stationary_design(system, 1e-3, known.R_factor, at_bandwidth(system, 1e-3, 4e4, known), 1.0)
    poles = np.sort(np.linalg.eigvals(found.error_dynamics).real)
    assert poles[0] == pytest.approx(-0.268, abs=5e-3)
    for order in (1, 2, 3):
        system = augment(LINK, order)
        found = stationary_design(system, 1e-3, known.R_factor, at_bandwidth(system, 1e-3, 4e3, known), 1.0)
        assert np.max(np.abs(np.linalg.eigvals(found.error_dynamics))) < 0.7


@pytest.mark.parametrize("order", [0, 1, 2, 3])
def test_predicted_noise_and_bias_are_those_of_the_error_system_simulated(order):
    system, known, H = augment(LINK, order), knowledge(2, 1e-4, [SINE ** max(order, 1)]), 5e-3
    found = stationary_design(system, H, known.R_factor, tuned_intensities(system, H, 1.0, known), 1.0)
    random = np.random.default_rng(order)
    steps = 40_000
    v = 1e-4 * random.normal(size=(steps, 2))
    at_sample, ahead = _run(found, v, np.zeros(steps), H)
    late = slice(steps // 10, None)
    assert np.std(at_sample[late]) == pytest.approx(found.noise_std()[0], rel=0.1)
    assert np.std(ahead[late]) == pytest.approx(found.noise_std(ahead=True)[0], rel=0.1)
    at_sample, ahead = _run(found, np.zeros((1500, 2)), np.ones(1500), H)
    assert abs(at_sample[-1]) == pytest.approx(found.bias_gain()[0, 0], rel=1e-4)
    assert abs(ahead[-1]) == pytest.approx(found.bias_gain(ahead=True)[0, 0], rel=1e-4)


def _run(found, v, rate, H):
    """Simulate plant (from rest, d with a given r-th derivative) and filter; return d̂ − d at the sample and ahead."""
    true = found.system if found.system.order else augment(found.system.linear, 1)
    step = discretise(true, H, 1.0)
    x, z = np.zeros(len(true.A)), np.zeros(len(found.K))
    select = np.eye(len(true.A))[4]
    at_sample, ahead = [], []
    for noise, w in zip(v, rate, strict=True):
        e = true.C @ x + noise - found.system.C @ z
        z = z + found.K @ e
        d_hat = (found.M_H @ e)[0] if found.M_H is not None else z[4]
        at_sample.append(d_hat - select @ x)
        x, z = step.Phi @ x + step.drive[:, 0] * w, found.discrete.Phi @ z
        ahead.append((d_hat if found.M_H is not None else z[4]) - select @ x)
    return np.array(at_sample), np.array(ahead)


def test_disturbances_a_million_times_apart_in_size_are_each_followed_at_their_own_scale():
    problem = RANDOM[7]
    linear, (_, _, p, q) = problem.linear, problem.shape
    scale = np.array([1e3, 1e-3])
    scaled = replace(linear, G_f=linear.G_f / scale, G_d=linear.G_d / scale)
    H, order = 5e-3, 2
    plain, apart = augment(linear, order), augment(scaled, order)
    known = knowledge(p, 1e-4, [30.0] * q, bound=[2.0] * q)
    known_apart = knowledge(p, 1e-4, 30.0 * scale, bound=2.0 * scale)
    one = stationary_design(plain, H, known.R_factor, tuned_intensities(plain, H, 0.1, known), 0.1)
    two = stationary_design(apart, H, known.R_factor, tuned_intensities(apart, H, 0.1, known_apart), 0.1)
    assert q == 2
    for first, second in zip(
        predicted_error(one, known.disturbance_rate), predicted_error(two, 30.0 * scale), strict=True
    ):
        np.testing.assert_allclose(second / scale, first, rtol=1e-4)


def test_the_filters_covariance_of_pure_noise_is_the_stationary_one():
    system, known = augment(LINK, 2), knowledge(2, 1e-4, [40.0])
    found = stationary_design(system, 1e-3, known.R_factor, tuned_intensities(system, 1e-3, 1.0, known), 1.0)
    rest = np.eye(6) - found.K @ system.C
    whole = converged_factor(found.error_dynamics, np.hstack([rest @ found.noise_factor, found.K @ known.R_factor]))
    np.testing.assert_allclose(np.linalg.norm(whole, axis=1), np.linalg.norm(found.update.factor, axis=1), rtol=1e-6)


@pytest.mark.parametrize("noise", [1e-9, 1e-12])
def test_rounding_errors_of_the_costs_move_their_minimum_no_further_than_in_proportion(noise):
    """A search by comparisons is led astray by the square root of it, and anywhere on the flat side of a cost."""
    random = np.random.default_rng(0)
    for flat in (0.0, 1.0):

        def cost(x, tried, flat=flat):
            return np.log(np.exp(-2.0 * x) + (1.0 if flat else np.exp(x))) + noise * random.normal(), tried

        found = [_minimise(cost, -4.0, 6.6, [])[0] for _ in range(5)]
        # A flat cost is followed until its slope is this small: there an error counts in proportion to its reciprocal.
        least_slope = _SLOWER if flat else 1.0
        assert np.ptp(found) < 100.0 * noise / least_slope
        assert found[0] == pytest.approx(0.5 * np.log(2.0 / _SLOWER) if flat else np.log(2.0) / 3.0, abs=0.1)
