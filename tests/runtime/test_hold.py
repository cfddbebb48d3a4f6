"""Between samples y is the polynomial through the latest of them: exact for polynomials, O(H^{k+1}) for the rest."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ndob_fmu.runtime.numerics.hold import empty_history

OUTPUTS = 3


def polynomial(degree, seed=0):
    """A polynomial of that degree for each of the outputs."""
    return np.polynomial.Polynomial(np.random.default_rng(seed).normal(size=degree + 1)), np.arange(1.0, OUTPUTS + 1.0)


def sampled(y, times, degree):
    """The history just after a sample at each of the times, the last of which is now."""
    history, now = empty_history(OUTPUTS), times[0]
    for t in times:
        history, now = history.aged(t - now).with_sample(y(t), degree), t
    return history.chosen(0.0, degree)


@settings(max_examples=100, deadline=None, derandomize=True)
@given(
    degree=st.integers(0, 3),
    steps=st.lists(st.floats(1e-3, 1.0), min_size=4, max_size=7),
    ahead=st.floats(-1.0, 1.0),
    seed=st.integers(0, 1000),
)
def test_a_polynomial_of_the_holds_degree_is_continued_exactly_from_samples_at_any_times(degree, steps, ahead, seed):
    shape, sizes = polynomial(degree, seed)
    times = np.cumsum(steps)
    history = sampled(lambda t: shape(t) * sizes, times, degree)
    assert history.samples.shape == (degree + 1, OUTPUTS)
    # The divided differences of short steps magnify rounding errors.
    scale = np.max(np.abs(history.samples)) * ((1.0 + abs(ahead)) / min(steps)) ** degree
    np.testing.assert_allclose(
        history.at(ahead), shape(times[-1] + ahead) * sizes, rtol=0, atol=1e-14 * (1.0 + scale) * 8
    )


def test_a_polynomial_of_higher_degree_is_not_continued_exactly():
    history = sampled(lambda t: np.full(OUTPUTS, t**3), [0.0, 1.0, 2.0, 3.0], degree=2)
    assert history.at(1.0)[0] == pytest.approx(64.0 - 6.0)  # short by the third difference


@pytest.mark.parametrize("degree", [0, 1, 2])
def test_the_error_of_the_continuation_falls_like_the_step_to_the_degree_plus_one(degree):
    steps = np.array([0.1, 0.05, 0.025, 0.0125, 0.00625])
    errors = []
    for H in steps:
        times = 1.0 + H * np.arange(-4.0, 1.0)
        history = sampled(lambda t: np.full(OUTPUTS, np.sin(2.0 * t)), times, degree)
        errors.append(abs(history.at(H)[1] - np.sin(2.0 * (1.0 + H))))
    assert np.polyfit(np.log(steps), np.log(errors), 1)[0] == pytest.approx(degree + 1, abs=0.15)


def test_at_the_samples_the_polynomial_is_the_samples():
    times = np.array([0.0, 0.3, 0.4, 1.1])
    values = np.random.default_rng(2).normal(size=(4, OUTPUTS))
    history = sampled(lambda t: values[np.searchsorted(times, t)], times, degree=2)
    for t, value in zip(times[1:], values[1:], strict=True):
        np.testing.assert_allclose(history.at(t - times[-1]), value, rtol=1e-13)


def test_after_one_sample_it_is_held_and_after_two_continued_by_a_line():
    y = np.array([1.0, -2.0, 5.0])
    history = empty_history(OUTPUTS).with_sample(y, 2)
    np.testing.assert_array_equal(history.at(0.7), y)
    history = history.aged(0.5).with_sample(2.0 * y, 2)
    np.testing.assert_allclose(history.at(0.25), 2.5 * y, rtol=1e-14)


def test_a_history_grows_older_without_forgetting():
    history = sampled(lambda t: np.full(OUTPUTS, t * t), [0.0, 1.0, 2.0], degree=2)
    np.testing.assert_array_equal(history.ages, [0.0, 1.0, 2.0])
    older = history.aged(0.25)
    np.testing.assert_array_equal(older.ages, [0.25, 1.25, 2.25])
    for s in (-1.0, 0.0, 0.5):
        np.testing.assert_allclose(older.at(s), history.at(s + 0.25), rtol=1e-14)
    np.testing.assert_array_equal(history.ages, [0.0, 1.0, 2.0])


def test_a_gap_in_the_samples_is_bridged_by_the_polynomial_of_those_that_came():
    history = sampled(lambda t: np.full(OUTPUTS, 1.0 - t + 3.0 * t * t), [0.0, 0.1, 0.7], degree=2)
    np.testing.assert_allclose(history.at(0.1), 1.0 - 0.8 + 3.0 * 0.64, rtol=1e-12)


def test_equal_steps_are_continued_through_the_newest_samples_and_twice_as_many_are_kept():
    history = empty_history(OUTPUTS)
    for k in range(10):
        history = history.aged(0.1).with_sample(np.full(OUTPUTS, float(k)), 1)
    np.testing.assert_array_equal(history.samples[:, 0], [9.0, 8.0, 7.0, 6.0])
    np.testing.assert_array_equal(history.chosen(0.1, 1).samples[:, 0], [9.0, 8.0])


@pytest.mark.parametrize("short", [1e-16, 1e-13, 1e-9, 1e-6])
@pytest.mark.parametrize("many", [1, 3, 1000])
def test_short_steps_do_not_spoil_the_continuation_over_the_full_step_after_them(short, many):
    """A parabola of size one with rounding errors of 1e-15, continued over 1 ms."""
    H, random = 1e-3, np.random.default_rng(0)

    def y(t):
        return np.full(OUTPUTS, 1.0 + 2.0 * t - 3.0 * t * t) * (1.0 + 1e-15 * random.normal())

    times = np.concatenate([H * np.arange(8), 7.0 * H + short * np.arange(1.0, many + 1.0)])
    history, now = empty_history(OUTPUTS), 0.0
    for t in times:
        history, now = history.aged(t - now).with_sample(y(t), 2), t
    held = history.chosen(H, 2)
    assert len(held.ages) == 3
    np.testing.assert_allclose(held.at(H), y(now + H), rtol=0, atol=1e-12)
