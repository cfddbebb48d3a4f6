"""Masters that add their steps up: remainders of rounding size, steps that vary in their last bits, very short steps.

OMSimulator and many a script step with `while t < stop: h = min(H, stop - t)`.
"""

from __future__ import annotations

from contextlib import ExitStack
from functools import cache
from itertools import pairwise
from math import isfinite, isnan, ulp
from random import Random

import numpy as np
import pytest

from ndob_fmu.fmu.components import records
from ndob_fmu.runtime.blocks.encoder import Encoder
from ndob_fmu.runtime.blocks.sampled_measurement import Sampling
from tests.attacks.steps import adding_up, coupled, run, with_odd_steps
from tests.helpers.fmi_instance import OK, opened, unpacked

METHODS = {1: {"method": 1, "pi_end": 1e8, "pi_ramp_time": 0.2}, 2: {"method": 2}}
# The last step is a remainder of rounding size, or is short of H by that much.
ADDED = [
    (1e-3, 0.0, 2.0),
    (1e-3, 0.0, 1.0),
    (1e-2, 0.0, 1.1),
    (5e-3, 0.7, 1.9),
    (1e-3, 1e6, 1e6 + 0.25),
    (1e-2, 1.7e9, 1.7e9 + 1.0),
]


@pytest.fixture(scope="module")
def pair(flexible_joint):
    """The plant and the observer; `reset` takes both back."""
    with ExitStack() as stack:
        yield [stack.enter_context(opened(path)) for path in (flexible_joint.plant, flexible_joint.observer)]


def ran(pair, steps, **options):
    assert [part.reset() for part in pair] == [OK, OK]
    return coupled(*pair, list(steps), **options)


@pytest.fixture(scope="module")
def regular(pair):
    """Return the rows of so many steps of 1 ms from 0 with a method."""
    return cache(lambda method, count: ran(pair, [(k * 1e-3, 1e-3) for k in range(count)], **METHODS[method]))


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(("H", "start", "stop"), ADDED)
def test_a_master_that_adds_steps_up_sees_the_same_as_one_that_counts_them(pair, method, H, start, stop):
    """Where the doubles tell the times of the steps apart well enough; the covariance sees their rounding."""
    steps = list(adding_up(start, stop, H))
    full = round((stop - start) / H)
    assert abs(steps[full - 1][1] - H) <= 1e-4 * H
    assert len(steps) == full or steps[full][1] <= 1e-4 * H
    added = ran(pair, steps, start=start, stop=stop, **METHODS[method])
    counted = ran(pair, [(start + k * H, H) for k in range(full)], start=start, stop=stop + H, **METHODS[method])
    std = counted[-1][3]["load_torque_std"]
    for before, after in pairwise(added[full - 1 :]):
        assert after[3] == before[3]  # the remainder shows what the last full step showed
    if start < 1e6:
        differences = [
            abs(a[3]["load_torque_hat"] - b[3]["load_torque_hat"]) for a, b in zip(added, counted, strict=False)
        ]
        assert max(differences) <= 1e-4 * max(std, 1e-3)
    assert added[-1][3]["load_torque_std"] == pytest.approx(std, rel=1e-9)
    assert abs(added[-1][2]) <= 3.0 * std + 2.0 * abs(counted[-1][2])


def test_the_examples_of_masters_have_remainders_and_short_last_steps():
    last = [list(adding_up(start, stop, H))[-1][1] / H for H, start, stop in ADDED]
    assert any(part < 1e-6 for part in last)
    assert any(1e-16 < 1.0 - part < 1e-6 for part in last)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("short", [1e-16, 1e-13, 1e-10, 1e-8, 1e-6])
def test_short_steps_in_the_middle_leave_estimate_and_error_bar_as_they_are(pair, regular, method, short):
    H, n = 1e-3, 300
    undisturbed = regular(method, n + 60)
    steps, t = [], 0.0
    for h in [*[H] * n, *[short, *[H] * 20] * 3]:
        steps.append((t, h))
        t += h
    rows = ran(pair, steps, **METHODS[method])
    assert all(isfinite(float(value)) for row in rows for value in row[3].values())
    assert all(row[3]["valid"] for row in rows)
    largest = max(abs(row[2]) for row in undisturbed[n - 50 :])
    assert max(abs(row[2]) for row in rows[n:]) <= 1.5 * largest
    if method == 2:
        assert all(abs(row[2]) <= 3.0 * row[3]["load_torque_std"] for row in rows[n:])
        assert rows[-1][3]["load_torque_std"] <= 1.01 * undisturbed[-1][3]["load_torque_std"]


@pytest.mark.parametrize("short", [1e-16, 1e-12, 1e-7])
def test_a_first_step_that_is_very_short_does_not_set_the_pace_of_the_observer(pair, regular, short):
    H = 1e-3
    undisturbed = regular(2, 180)
    rows = ran(pair, [(0.0, short), *((short + k * H, H) for k in range(180))], **METHODS[2])
    assert rows[0][3]["load_torque_std"] == pytest.approx(5.0, rel=1e-3)
    np.testing.assert_allclose(
        [row[3]["load_torque_std"] for row in rows[100:]], undisturbed[-1][3]["load_torque_std"], rtol=0.01
    )
    assert max(abs(row[2]) for row in rows[100:]) <= 1.5 * max(abs(row[2]) for row in undisturbed[100:])


@pytest.mark.parametrize(
    "name",
    [*(f"FlexibleJoint{part}" for part in ("Plant", "Observer", "Controller")), *(one.name for one in records())],
)
def test_a_step_of_rounding_size_advances_the_time_of_an_fmu_and_nothing_else(shipped, name):
    H, start, steps = 1e-2, 0.3, 50
    with opened(shipped.fmus / f"{name}.fmu") as instance:
        inputs = [v.name for v in instance.variables.values() if v.causality == "input" and v.type == "Real"]
        records = []
        for remainder in (0.0, 2.0 * ulp(start + steps * H)):
            assert instance.reset() == OK
            instance.begin(start_time=start)
            t, shown = start, []
            for k in range(steps):
                shown.append(instance.step(t, H, **{each: 0.1 * np.sin(0.3 * k + i) for i, each in enumerate(inputs)}))
                t += H
                if remainder and k > 5:
                    assert instance.step(t, remainder, **dict.fromkeys(inputs, 7.0)) == shown[-1]
                    t += remainder
            records.append(shown)
            assert instance.said == []
        for one, other in zip(*records, strict=True):
            for key, value in one.items():
                assert other[key] == pytest.approx(value, rel=1e-9, abs=1e-12, nan_ok=True)


@pytest.mark.parametrize(("start", "H", "steps"), [(0.0, 1e-3, 2000), (1e5, 1e-3, 2000), (1.7e9, 1e-2, 1000)])
@pytest.mark.parametrize("every", [1, 4])
def test_an_encoder_takes_each_sample_in_the_step_that_it_is_due_in(start, H, steps, every):
    """Times as k H rounds them, and as a master adds them up, for as long as that errs by less than H / 1000."""
    sampling = Sampling(
        **dict.fromkeys(("noise_std", "bias", "delay", "dropout_probability", "resolution"), 0.0),
        **{"seed": 0, "sample_time": every * H},
        between_samples_nan=True,
        dropped_nan=False,
    )
    encoder = Encoder(sampling)
    for added in (False, True):
        state, t = encoder.init(0.0, start), start
        for k in range(1, steps + 1):
            t = t + H if added else start + k * H
            if added and abs(t - (start + k * H)) > 9e-4 * H:
                break
            state = encoder.step(state, float(k), t, H)
            assert isnan(state.shown) == (k % every != 0), (k, added)
            assert state.new == (k % every == 0)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("short", [1e-17, 1e-16, 1e-12, 1e-7])
def test_a_state_after_short_steps_comes_back_from_its_bytes(flexible_joint, method, short):
    H = 1e-3
    with unpacked(flexible_joint.observer) as instance:
        one, other = instance("one"), instance("other")
        for each in (one, other):
            each.begin(**METHODS[method])
        t = 0.0
        for h in [*[H] * 20, short, short, H, short, H]:
            one.step(t, h, motor_angle=1.0 + t, link_angle=1.0 - t)
            t += h
        status, state = other.from_bytes(one.bytes_of(one.state()))
        assert (status, other.setFMUState(state)) == (OK, OK), other.said
        for h in (short, H, H):
            shown = [each.step(t, h, motor_angle=1.0 + t, link_angle=1.0 - t) for each in (one, other)]
            assert shown[0] == shown[1]
            t += h


def test_random_masters_leave_finite_estimates_and_honest_error_bars(flexible_joint):
    assert run(25, 1, flexible_joint.plant.parent) == []


def test_random_steps_are_the_same_for_the_same_seed():
    one, other = (list(with_odd_steps(0.0, 1.0, 1e-2, Random("seed"), share=0.3)) for _ in range(2))
    assert one == other
    assert any(h < 1e-6 for _, h in one)
