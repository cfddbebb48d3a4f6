"""What samples themselves say about their noise."""

from __future__ import annotations

import numpy as np
import pytest

from ndob_fmu.runtime.step.adaptive_noise import common_step, of_rounding


def variance(samples, repeat_rate=0.0):
    """Return what is known of the rounding of samples (K,)."""
    step, multiples = np.inf, 0.0
    for change in np.abs(np.diff(samples)):
        step, multiples = common_step(step, multiples, float(change), repeats=repeat_rate > 0.0)
    return of_rounding(step, multiples, repeat_rate)


def test_rounding_is_seen_by_the_common_step_of_all_changes_and_noise_shows_none():
    noisy, width = 3.0 + np.random.default_rng(1).normal(size=200), 0.37
    assert variance(np.round(noisy / width) * width) == pytest.approx(width**2 / 12.0, rel=1e-9)
    assert variance(noisy) < 1e-30  # only that of the numbers themselves


@pytest.mark.parametrize("speed", [0.03, 1.7, 52.3, 4321.0])
def test_rounding_is_seen_however_fast_the_output_moves(speed):
    k, width = np.arange(300), 2.0 * np.pi / 2**14
    motion = width * (speed * k + 0.2 * speed * 40.0 * np.sin(k / 40.0))
    repeat_rate = 0.9 if speed < 1.0 else 0.0
    expected = width**2 / 12.0 / (1.0 - repeat_rate)
    assert variance(np.round(motion / width) * width, repeat_rate) == pytest.approx(expected, rel=1e-6)


def test_a_motion_with_equal_changes_is_not_taken_for_a_rounding():
    assert variance(0.25 * np.arange(100.0)) == 0.0


def test_a_sensor_that_repeats_samples_now_and_then_is_not_taken_for_a_rounded_one():
    random = np.random.default_rng(2)
    samples = random.normal(size=200)
    for k in 1 + np.flatnonzero(random.random(199) < 0.3):
        samples[k] = samples[k - 1]
    assert variance(samples, 0.3) < 1e-30


def test_samples_in_a_row_tell_as_much_of_a_rounding_error_as_one():
    once, often = (of_rounding(1.0, 4.0, rate) for rate in (0.0, 0.9))
    assert often / once == pytest.approx(10.0)


def test_a_change_far_below_the_step_is_the_next_candidate():
    assert common_step(1e-3, 4.0, 1e-12, repeats=False) == (1e-12, 0.0)


def test_a_step_that_vanishes_beside_a_change_is_none():
    assert common_step(5e-324, 4.0, 0.5, repeats=False) == (0.5, 0.0)
