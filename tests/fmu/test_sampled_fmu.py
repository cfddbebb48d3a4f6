"""The everyday method through the FMUs: the figures of the core, and which instant each output belongs to."""

from __future__ import annotations

import numpy as np
import pytest

from ndob_fmu.cosim import FmuComponent, System, simulate

SINE = 2.0 * np.pi


def coupled(fmus, *, first="plant"):
    parts = {"plant": FmuComponent(fmus.plant), "observer": FmuComponent(fmus.observer)}
    order = [first, *(name for name in parts if name != first)]
    return System(
        {name: parts[name] for name in order},
        connections=[
            (("plant", "motor_angle"), ("observer", "motor_angle")),
            (("plant", "link_angle"), ("observer", "link_angle")),
        ],
        start_values={
            ("plant", "motor_torque"): 0.0,
            ("plant", "load_torque"): 0.0,
            ("observer", "motor_torque"): 0.0,
        },
    )


def run(fmus, H, *, kind, order, frequency=1.0, amplitude=1.0, stop_time=2.5, scheme="jacobi", first="plant", **starts):
    rate = amplitude * (SINE * frequency) ** order
    return simulate(
        coupled(fmus, first=first),
        step_size=H,
        stop_time=stop_time,
        scheme=scheme,
        start_values={
            "plant.disturbance.kind": kind,
            "plant.disturbance.frequency": frequency,
            "plant.disturbance.amplitude": amplitude,
            "observer.method": 2,
            "observer.disturbance_order": order,
            "observer.disturbance_rate": rate,
            **starts,
        },
    )


@pytest.mark.parametrize(("H", "largest"), [(1e-3, 2e-7), (5e-3, 2e-5), (1e-2, 2e-4)])
def test_a_sine_of_1_hz_is_followed_through_the_fmus_as_through_the_core(flexible_joint, H, largest):
    recording = run(flexible_joint, H, kind=3, order=3)
    true, late = recording["plant.load_torque_total"], recording.time > 1.5
    at_sample = recording["observer.load_torque_at_sample"][1:] - true[:-1]
    ahead = recording["observer.load_torque_hat"] - true
    assert np.abs(at_sample[late[1:]]).max() <= largest
    assert np.abs(ahead[late]).max() <= 3.3 * H**3 * SINE**3


@pytest.mark.parametrize("H", [1e-3, 5e-3, 1e-2])
def test_the_estimate_starts_within_ten_samples_and_without_a_peak(flexible_joint, H):
    recording = run(flexible_joint, H, kind=1, order=2, amplitude=2.0, stop_time=60 * H)
    at_sample = recording["observer.load_torque_at_sample"][1:]
    outside = np.flatnonzero(np.abs(at_sample - 2.0) > 0.04)
    assert outside[-1] + 2 <= 10
    assert np.abs(recording["observer.load_torque_hat"]).max() <= 15.0


@pytest.mark.parametrize(
    ("scheme", "first", "shift"),
    [
        ("jacobi", "plant", 0),
        ("extrapolation", "plant", 0),
        ("gauss-seidel", "observer", 0),
        ("gauss-seidel", "plant", 1),
    ],
)
def test_a_master_that_steps_the_plant_first_moves_the_observers_clock_by_a_step(flexible_joint, scheme, first, shift):
    """FMI timing: inputs set before doStep(t) are values at t, outputs after it values at t + H."""
    H = 1e-2
    recording = run(flexible_joint, H, kind=3, order=3, scheme=scheme, first=first)
    late = slice(150, 240)
    t = recording.time
    # Row k + 1 holds what the step from t_k told: the estimate for the sample it was given, and for a step after that.
    at_sample, ahead = recording["observer.load_torque_at_sample"], recording["observer.load_torque_hat"]
    belongs_to = t + (shift - 1) * H
    assert np.abs(at_sample - np.sin(SINE * belongs_to))[late].max() <= 2e-4
    assert np.abs(ahead - np.sin(SINE * (belongs_to + H)))[late].max() <= 3.3 * H**3 * SINE**3
    if shift:
        assert np.abs(at_sample - np.sin(SINE * (belongs_to - H)))[late].max() > 0.05


def test_the_residual_is_the_sample_less_its_prediction(flexible_joint):
    recording = run(flexible_joint, 5e-3, kind=3, order=2)
    predicted = recording["observer.motor_angle_hat"][:-1]
    np.testing.assert_allclose(
        recording["observer.motor_angle_residual"][1:], recording["plant.motor_angle"][:-1] - predicted, atol=1e-12
    )


def test_the_error_bar_in_the_fmu_covers_the_error_from_the_first_sample_on(flexible_joint):
    noise = {f"observer.{angle}_noise_std": 1e-5 for angle in ("motor_angle", "link_angle")}
    recording = run(flexible_joint, 5e-3, kind=3, order=2, amplitude=2.0, **noise)
    error = np.abs(recording["observer.load_torque_hat"] - recording["plant.load_torque_total"])
    std = recording["observer.load_torque_std"]
    assert std[0] == 5.0
    assert std[-1] < 0.2
    assert np.mean(error <= 3.0 * std) > 0.99
