"""What samples themselves say about their noise."""

from __future__ import annotations

import numpy as np

from ndob_fmu.runtime.step.adaptive_noise import of_rounding, smallest_change


def after(samples):
    resolution, alike = np.full(samples.shape[1], np.inf), np.zeros(samples.shape[1])
    for change in np.abs(np.diff(samples, axis=0)):
        resolution, alike = smallest_change(resolution, alike, change)
    return resolution, alike


def test_rounding_is_seen_by_the_smallest_change_and_noise_shows_none():
    random = np.random.default_rng(1)
    noisy = 3.0 + random.normal(size=(200, 1))
    width = 0.37
    samples = np.hstack([np.round(noisy / width) * width, noisy])
    resolution, alike = after(samples)
    assert abs(resolution[0] / width - 1.0) < 1e-9
    variance = of_rounding(resolution, alike, np.array([0.0, 0.0]))
    np.testing.assert_allclose(variance, [width**2 / 12.0, 0.0], rtol=1e-9)


def test_a_sensor_that_repeats_samples_now_and_then_is_not_taken_for_a_rounded_one():
    random = np.random.default_rng(2)
    samples = random.normal(size=(200, 1))
    again = 1 + np.flatnonzero(random.random(199) < 0.3)
    for k in again:
        samples[k] = samples[k - 1]
    assert of_rounding(*after(samples), np.array([0.3])) == 0.0


def test_samples_in_a_row_tell_as_much_of_a_rounding_error_as_one():
    once, often = (float(of_rounding(np.array([1.0]), np.array([4.0]), np.array([rate]))[0]) for rate in (0.0, 0.9))
    assert abs(often / once - 10.0) < 1e-9
