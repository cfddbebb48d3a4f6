"""What samples themselves say about their noise."""

from __future__ import annotations

import numpy as np
import pytest

from ndob_fmu.runtime.step.adaptive_noise import of_rounding, smallest_change


def variance(samples, repeat_rate=0.0):
    """Return what is known of the rounding of samples (K,)."""
    resolution, alike = np.inf, 0.0
    for change in np.abs(np.diff(samples)):
        resolution, alike = smallest_change(resolution, alike, float(change))
    return of_rounding(resolution, alike, repeat_rate)


def test_rounding_is_seen_by_the_smallest_change_and_noise_shows_none():
    noisy, width = 3.0 + np.random.default_rng(1).normal(size=200), 0.37
    assert variance(np.round(noisy / width) * width) == pytest.approx(width**2 / 12.0, rel=1e-9)
    assert variance(noisy) == 0.0


def test_a_sensor_that_repeats_samples_now_and_then_is_not_taken_for_a_rounded_one():
    random = np.random.default_rng(2)
    samples = random.normal(size=200)
    for k in 1 + np.flatnonzero(random.random(199) < 0.3):
        samples[k] = samples[k - 1]
    assert variance(samples, 0.3) == 0.0


def test_samples_in_a_row_tell_as_much_of_a_rounding_error_as_one():
    once, often = (of_rounding(1.0, 4.0, rate) for rate in (0.0, 0.9))
    assert often / once == pytest.approx(10.0)
