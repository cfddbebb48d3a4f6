"""The sensor: what is shown of a known signal, sample by sample."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest

from ndob_fmu.runtime.base_errors import IntegrationError
from ndob_fmu.runtime.blocks.encoder import Encoder
from ndob_fmu.runtime.blocks.sampled_measurement import SampledState, Sampling
from ndob_fmu.runtime.blocks.sensor import Sensor

IDEAL = {
    "noise_std": 0.0,
    "bias": 0.0,
    "seed": 0,
    "sample_time": 0.0,
    "delay": 0.0,
    "dropout_probability": 0.0,
    "between_samples_nan": False,
    "dropped_nan": True,
    "resolution": 0.0,
}
H = 0.01


def sensor(**options):
    return Sensor(Sampling(**{**IDEAL, **options}))


def states(device, signal, times):
    """Return the states at these times, for the value that the signal has at each."""
    found = [device.init(signal(times[0]), times[0])]
    for before, t in pairwise(times):
        found.append(device.step(found[-1], signal(t), t, t - before))
    return found


def shown(device, signal, times):
    return np.array([state.shown for state in states(device, signal, times)])


def evenly(n, step_size=H, start=0.0):
    return [start + k * step_size for k in range(n + 1)]


def line(t):
    return 3.0 - 2.0 * t


def test_an_ideal_sensor_shows_the_value_with_no_delay():
    times = evenly(50)
    assert shown(sensor(), math.sin, times).tolist() == [math.sin(t) for t in times]


def test_the_noise_has_the_moments_of_a_normal_one_and_is_white():
    noise = shown(sensor(noise_std=0.3, seed=4), lambda t: 0.0, evenly(20_000))
    n = len(noise)
    assert abs(noise.mean()) < 4.0 * 0.3 / math.sqrt(n)
    assert abs(noise.var() / 0.09 - 1.0) < 4.0 * math.sqrt(2.0 / n)
    assert abs((noise**4).mean() / 0.09**2 - 3.0) < 4.0 * math.sqrt(96.0 / n)
    for lag in (1, 2, 7):
        assert abs(np.mean(noise[lag:] * noise[:-lag])) < 4.0 * 0.09 / math.sqrt(n)


def test_equal_seeds_err_alike_and_different_ones_independently():
    first, again, other = (shown(sensor(noise_std=1.0, seed=s), math.sin, evenly(4000)) for s in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    truth = np.sin(evenly(4000))
    assert abs(np.corrcoef(first - truth, other - truth)[0, 1]) < 4.0 / math.sqrt(4000)


def test_samples_are_multiples_of_the_resolution_and_err_by_half_of_it_at_most():
    resolution = 0.03
    errors = shown(sensor(resolution=resolution), lambda t: 1.7 * t - 4.0, evenly(9973)) - (
        1.7 * np.array(evenly(9973)) - 4.0
    )
    counts = shown(sensor(resolution=resolution), line, evenly(500)) / resolution
    np.testing.assert_allclose(counts, np.round(counts), atol=1e-9)
    assert np.abs(errors).max() <= 0.5 * resolution * (1.0 + 1e-9)
    assert errors.std() == pytest.approx(resolution / math.sqrt(12.0), rel=0.02)


def test_bias_and_noise_come_before_rounding():
    assert shown(sensor(resolution=1.0, bias=0.4), lambda t: 0.2, evenly(1)).tolist() == [1.0, 1.0]
    rounded = shown(sensor(resolution=0.5, noise_std=1.0, seed=3), line, evenly(200))
    np.testing.assert_allclose(
        rounded, np.floor(shown(sensor(noise_std=1.0, seed=3), line, evenly(200)) / 0.5 + 0.5) * 0.5
    )


@pytest.mark.parametrize("start", [0.0, 0.3, 1e4])
@pytest.mark.parametrize("steps", [0.25, 0.5, 1.0, 2.75, 10.0])
def test_a_delay_of_any_fraction_of_a_step_is_exact_on_a_line(start, steps):
    times = evenly(40, start=start)
    delay = steps * H
    values = shown(sensor(delay=delay), line, times)
    expected = [line(max(t - delay, start)) for t in times]
    np.testing.assert_allclose(values, expected, rtol=1e-12, atol=1e-8 * H * abs(start))


def test_a_delay_of_part_of_a_step_errs_on_a_curve_by_no_more_than_the_line_does():
    times, delay = evenly(400), 2.5 * H
    errors = shown(sensor(delay=delay), math.sin, times)[5:] - [math.sin(t - delay) for t in times[5:]]
    assert 0.5 * H**2 / 8.0 < np.abs(errors).max() <= H**2 / 8.0 * 1.001


def test_the_delay_is_exact_on_steps_of_changing_size():
    sizes = np.random.default_rng(3).uniform(0.2 * H, 2.0 * H, 300)
    times = [0.0, *np.cumsum(sizes).tolist()]
    values = shown(sensor(delay=1.7 * H), line, times)
    np.testing.assert_allclose(values, [line(max(t - 1.7 * H, 0.0)) for t in times], rtol=1e-12)


def test_the_first_sample_is_shown_until_the_first_delay_is_over():
    assert shown(sensor(delay=0.035), line, evenly(3)).tolist() == [3.0] * 4
    nothing = shown(sensor(delay=0.035, between_samples_nan=True), line, evenly(4))
    np.testing.assert_allclose(nothing, [3.0, math.nan, math.nan, math.nan, line(0.005)])


@pytest.mark.parametrize("start", [0.0, 0.3])
def test_between_samples_the_last_one_is_held_or_nothing_is_shown(start):
    times = evenly(7, start=start)
    held = shown(sensor(sample_time=0.03), lambda t: round((t - start) / H), times)
    assert held.tolist() == [0.0, 0.0, 0.0, 3.0, 3.0, 3.0, 6.0, 6.0]
    nothing = shown(sensor(sample_time=0.03, between_samples_nan=True), lambda t: round((t - start) / H), times)
    np.testing.assert_equal(nothing, [0.0, math.nan, math.nan, 3.0, math.nan, math.nan, 6.0, math.nan])
    new = [state.new for state in states(sensor(sample_time=0.03), line, times)]
    assert new == [True, False, False, True, False, False, True, False]


@pytest.mark.parametrize("delay", [0.0, 0.013])
def test_a_sample_that_is_taken_between_two_steps_has_the_value_of_its_own_time(delay):
    """An encoder would take that of the end of the step."""
    Ts, times = 0.025, evenly(40)
    values = shown(sensor(sample_time=Ts, delay=delay), line, times)
    expected = [line(Ts * max(math.floor((t - delay) / Ts + 1e-9), 0)) for t in times]
    np.testing.assert_allclose(values, expected, rtol=1e-12)


def test_of_several_samples_in_a_step_the_last_one_is_shown():
    values = shown(sensor(sample_time=0.3 * H), line, evenly(20))
    expected = [line(0.3 * H * math.floor(t / (0.3 * H) + 1e-9)) for t in evenly(20)]
    np.testing.assert_allclose(values, expected, rtol=1e-12)


NOISY = {"noise_std": 0.1, "seed": 7, "sample_time": 0.04, "delay": 0.04, "dropout_probability": 0.2}


def test_equal_seeds_give_equal_samples_on_any_step_that_divides_the_sample_time():
    fine, coarse, whole = (
        shown(sensor(resolution=1e-3, **NOISY), math.sin, evenly(round(4.0 / step), step))[:: round(0.04 / step)]
        for step in (0.005, 0.01, 0.04)
    )
    np.testing.assert_array_equal(fine, coarse)
    np.testing.assert_array_equal(fine, whole)
    assert np.isnan(fine).any()


def test_equal_seeds_give_equal_samples_of_a_line_on_any_step():
    def samples(times):
        return {state.index: state.shown for state in reversed(states(sensor(**NOISY), line, times))}

    jitter = np.random.default_rng(2).uniform(0.002, 0.035, 300)
    even, uneven = samples(evenly(400)), samples([0.0, *np.cumsum(jitter).tolist()])
    both = sorted(set(even) & set(uneven))
    assert len(both) == len(even) > 90
    np.testing.assert_allclose([uneven[k] for k in both], [even[k] for k in both], rtol=1e-9)


def test_with_whole_steps_it_shows_what_an_encoder_without_counts_shows():
    options = {**IDEAL, "noise_std": 0.1, "seed": 2, "sample_time": 0.02, "delay": 0.04, "dropout_probability": 0.3}
    encoder = Encoder(Sampling(**options))
    np.testing.assert_array_equal(
        shown(sensor(**options), math.sin, evenly(300)), shown(encoder, math.sin, evenly(300))
    )


@pytest.mark.parametrize("probability", [0.05, 0.5])
@pytest.mark.parametrize("dropped_nan", [True, False])
def test_as_many_samples_are_lost_as_the_probability_says(probability, dropped_nan):
    n = 4000
    values = shown(sensor(dropout_probability=probability, dropped_nan=dropped_nan, seed=5), line, evenly(n))
    lost = np.isnan(values) if dropped_nan else values != [line(t) for t in evenly(n)]
    assert abs(lost.sum() - n * probability) < 4.0 * math.sqrt(n * probability * (1.0 - probability))
    assert not lost[0]
    if not dropped_nan:
        np.testing.assert_array_equal(values[1:][lost[1:]], values[:-1][lost[1:]])


def test_no_sample_is_lost_without_and_all_but_the_first_with_certain_dropouts():
    assert np.isfinite(shown(sensor(), line, evenly(100))).all()
    assert np.isnan(shown(sensor(dropout_probability=1.0), line, evenly(100))[1:]).all()


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_value_that_is_not_finite_is_a_lost_sample_and_spoils_its_two_neighbours_only(value):
    def broken(t):
        return value if abs(t - 5 * H) < 1e-9 else line(t)

    exact = shown(sensor(), broken, evenly(20))
    assert np.flatnonzero(np.isnan(exact)).tolist() == [5]
    between = shown(sensor(delay=1.5 * H), broken, evenly(20))
    assert np.flatnonzero(np.isnan(between)).tolist() == [6, 7]
    whole = shown(sensor(delay=2.0 * H), broken, evenly(20))
    assert np.flatnonzero(np.isnan(whole)).tolist() == [7]


def test_a_delay_of_whole_steps_is_exact_also_where_the_host_adds_up_its_times():
    device, t = sensor(delay=0.3), 0.0
    state, values = device.init(0.0, t), [0.0]
    for k in range(1, 20):
        t += 0.1
        state = device.step(state, float(k), t, 0.1)
        values.append(state.shown)
    assert values == [0.0, 0.0, 0.0, *map(float, range(17))]


def test_it_remembers_no_more_than_the_delay():
    device = sensor(delay=5.5 * H, sample_time=0.03)
    assert {len(state.times) for state in states(device, line, evenly(200))[20:]} == {7}
    assert len(states(sensor(), line, evenly(200))[-1].times) == 1


def test_every_state_it_comes_to_is_possible_and_others_are_not():
    device, times = sensor(delay=2.5 * H, sample_time=0.02), evenly(60)
    for t, state in zip(times, states(device, line, times), strict=True):
        assert device.possible(state, t)
    (*_, (t, state)) = zip(times, states(device, line, times), strict=True)

    def changed(**fields):
        return SampledState(**{**vars(state), **fields})

    assert not device.possible(state, t + 1.0)
    assert not device.possible(changed(times=(), values=()), t)
    assert not device.possible(changed(times=state.times[::-1]), t)
    assert not device.possible(changed(times=(0.0, 0.1, *state.times), values=(1.0, 1.0, *state.values)), t)
    assert not device.possible(changed(values=state.values[1:]), t)
    assert not device.possible(changed(index=-1.0), t)
    assert not device.possible(changed(index=0.5), t)
    assert not device.possible(changed(good=-math.inf), t)
    assert not device.possible(changed(shown=math.inf), t)


def test_a_sample_time_of_more_samples_than_can_be_counted_is_refused():
    device = sensor(sample_time=1e-300)
    with pytest.raises(IntegrationError, match="sample_time: expected at least 1"):
        device.step(device.init(1.0, 0.0), 1.0, H, H)
