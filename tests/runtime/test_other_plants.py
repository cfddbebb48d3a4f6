"""Method 2 on the plants of the benchmark, for seeds with which it has once been wrong: errors in units of D₀."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.estimator import faults
from benchmarks.estimator.ours import ours_of
from benchmarks.estimator.plants import CYLINDER, JOINT, MOTOR
from benchmarks.estimator.records import simulate
from benchmarks.estimator.scores import score
from benchmarks.estimator.statement_rows import EXACT_SIGMA, drawn, told_noise


def test_noise_that_is_larger_than_told_is_not_taken_for_jumps_of_the_disturbance():
    """The pressure shows every jump at once. With the noise told right the error is 0.0016."""
    record = simulate(CYLINDER, 5e-3, (1,))
    found = score(record, ours_of(record, **told_noise(CYLINDER, 0.1 * CYLINDER.sigma)))
    assert found.rms <= 0.003
    assert found.covered >= 0.9


@pytest.mark.parametrize(
    ("plant", "H", "seeds", "limit"), [(MOTOR, 2e-2, (1, 2), 0.008), (CYLINDER, 5e-3, (2,), 0.006)]
)
def test_samples_that_are_rounded_are_no_worse_than_with_that_much_noise(plant, H, seeds, limit):
    """An extended Kalman filter that knows nothing of the rounding has .0065 and .009."""
    record = faults.quantised(simulate(plant, H, seeds))
    found = score(record, ours_of(record))
    assert found.rms <= limit
    assert found.covered >= 0.9


def test_a_rounded_sensor_that_stands_still_most_of_the_time_is_believed_when_it_moves():
    """The position repeats nine samples out of ten. Every change would look like an outlier otherwise."""
    record = simulate(CYLINDER, 5e-3, (1,))
    Y = record.Y.copy()
    Y[..., 0] = np.round(Y[..., 0] / 0.01) * 0.01
    found = score(record, ours_of(record.with_samples(Y)))
    assert found.rms <= 0.003
    assert found.covered >= 0.9
    assert found.valid == 1.0


def test_a_rare_run_of_good_samples_is_not_published_as_a_jump():
    """One run in ten of innovations looks like a small jump at some time."""
    record = simulate(JOINT, 1e-3, (12,), stop_time=2.4)
    assert score(record, ours_of(record)).peak <= 0.2


@pytest.mark.parametrize("seed", [5, 6, 9, 12])
def test_a_disturbance_that_is_calmer_than_its_bounds_does_not_make_the_noise_smaller(seed):
    """Innovations are a fifth of their standard deviations. With a third of the noise good samples are refused."""
    record = simulate(CYLINDER, 2e-2, (seed,))
    assert score(record, ours_of(record)).rms <= 0.0032


@pytest.mark.parametrize("seed", [5, 7, 13])
def test_samples_that_only_a_wrong_model_makes_look_faulty_are_used(seed):
    """Four plants with parameters 10 % off that nobody told. Innovations of 30 standard deviations come gradually.

    An extended Kalman filter that uses every sample has .003 to .0045.
    """
    record = drawn(CYLINDER, (seed,))
    told = told_noise(CYLINDER, np.full(len(CYLINDER.C), EXACT_SIGMA))
    found = score(record, ours_of(record, **told))
    assert found.rms <= 0.006
    assert found.covered >= 0.9
    assert found.valid == 1.0


def test_with_order_0_the_disturbance_in_the_innovations_is_not_taken_for_faulty_samples():
    """Each innovation carries all of d. Refused samples left an error of 0.8 with `valid` false in a tenth of them."""
    record = simulate(MOTOR, 2e-2, (1, 2, 3))
    found = score(record, ours_of(record, disturbance_order=0))
    assert found.rms <= 0.1
    assert found.covered >= 0.9
    assert found.valid == 1.0
