"""Method 2 on the plants of the benchmark, for seeds with which it has once been wrong: errors in units of D₀."""

from __future__ import annotations

from benchmarks.estimator import faults
from benchmarks.estimator.ours import ours_of
from benchmarks.estimator.plants import CYLINDER, JOINT, MOTOR
from benchmarks.estimator.records import simulate
from benchmarks.estimator.scores import score
from benchmarks.estimator.statement_rows import told_noise


def test_noise_that_is_larger_than_told_is_not_taken_for_jumps_of_the_disturbance():
    """The pressure shows every jump at once. With the noise told right the error is 0.0016."""
    record = simulate(CYLINDER, 5e-3, (1,))
    found = score(record, ours_of(record, **told_noise(CYLINDER, 0.1 * CYLINDER.sigma)))
    assert found.rms <= 0.003
    assert found.covered >= 0.9


def test_rounded_samples_are_not_taken_for_jumps_of_the_disturbance():
    record = faults.quantised(simulate(MOTOR, 1e-3, (1, 2), stop_time=1.0))
    found = score(record, ours_of(record))
    assert found.rms <= 0.006
    assert found.covered >= 0.9


def test_a_rare_run_of_good_samples_is_not_published_as_a_jump():
    """One run in ten of innovations looks like a small jump at some time."""
    record = simulate(JOINT, 1e-3, (12,), stop_time=2.4)
    assert score(record, ours_of(record)).peak <= 0.2
