"""Outputs that contradict each other through a wrong equation do not drive the estimate away."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.estimator import faults
from benchmarks.estimator.ours import parameters_of
from benchmarks.estimator.plants import JOINT, MOTOR
from benchmarks.estimator.records import simulate
from ndob_fmu.codegen.compile_model import compile_model
from ndob_fmu.runtime.design.doubtful import doubtful_equations
from ndob_fmu.runtime.step.sampled_observer import sampled_observer
from ndob_fmu.runtime.step.settings import observer_settings

H = 5e-3
ROWS = 200


def estimates_of(plant, sigma, factors, seed=1, told=1.0, steps=H):
    """d̂ − d over D₀, `valid` and the part of the equations that is noise, along a record of such a plant.

    sigma: of the samples, of which the observer is told a part; factors: of the true parameters
    steps: the true ones (s); the observer is told H
    """
    true = {key: np.array([value * by]) for (key, value), by in zip(plant.parameters.items(), factors, strict=True)}
    noise = np.full(len(plant.C), sigma)
    record = simulate(plant, steps, (seed,), sigma=noise, parameters=true, stop_time=ROWS * H)
    eq = compile_model(plant.model())
    fmu = parameters_of(plant)
    settings = observer_settings(
        eq,
        noise_std=tuple(told * noise),
        disturbance_bound=tuple(plant.bounds),
        disturbance_rate=tuple(plant.rates(2)),
        x_std=tuple(plant.x_std),
        order=int(fmu["disturbance_order"]),
    )
    observer = sampled_observer(eq, tuple(eq.parameters.values()), settings, tuple(plant.x_hat))
    state = observer.init(tuple(plant.x_hat))
    error, valid, part = np.empty(ROWS), np.empty(ROWS, dtype=bool), np.empty(ROWS)
    for k in range(ROWS):
        state, estimate = observer.step(state, tuple(record.U[0, k]), tuple(record.Y[0, k]), H)
        error[k] = abs(estimate.d_at_sample[0] - record.d[k, 0]) / plant.bounds[0]
        valid[k], part[k] = estimate.valid, state.memory.model_error
    return error, valid, part


@pytest.mark.parametrize("sigma", [1e-3, 1e-6])
@pytest.mark.parametrize("seed", [1, 2, 4])
def test_a_motor_whose_parameters_are_off_by_up_to_15_percent_keeps_its_estimate(sigma, seed):
    """Angle and current contradict each other where the flux is wrong; d̂ ran to 28 to 1600 times its bound.

    What makes their equations noise is a d̂ of more than five times its bound.
    """
    factors = 1.0 + 0.15 * np.random.default_rng([seed, 7]).uniform(-1.0, 1.0, len(MOTOR.parameters))
    error, valid, _ = estimates_of(MOTOR, sigma, factors, seed)
    assert np.all(valid[60:])
    assert np.max(error[60:]) < 5.0


@pytest.mark.parametrize("seed", [1, 4, 8])
def test_a_motor_whose_steps_jitter_by_30_percent_untold_finds_its_load_soon_after_the_start(seed):
    """Only the angle's samples are at odds with the rest: that is its noise, not a wrong equation of the current.

    Noise on that equation held the estimate at four times its bound for a second.
    """
    steps = faults.jittering(H, ROWS * H, seed)
    error, valid, _ = estimates_of(MOTOR, 1e-3, np.ones(len(MOTOR.parameters)), seed, steps=steps)
    assert np.all(valid[120:])
    assert np.sqrt(np.mean(error[120:] ** 2)) < 0.12


def test_an_estimate_far_beyond_its_bound_is_invalid():
    factors = 1.0 + 0.15 * np.random.default_rng([4, 7]).uniform(-1.0, 1.0, len(MOTOR.parameters))
    error, valid, _ = estimates_of(MOTOR, 1e-6, factors, 4)
    assert np.any(error > 10.0)
    assert not np.any(valid[10:] & (error[10:] > 10.0))


@pytest.mark.parametrize("told", [1.0, 0.1])
@pytest.mark.parametrize("plant", [JOINT, MOTOR], ids=lambda plant: plant.name)
def test_where_the_model_is_right_no_equation_becomes_noise(plant, told):
    _, valid, part = estimates_of(plant, 1e-4, np.ones(len(plant.parameters)), told=told)
    assert np.all(valid)
    assert np.all(part == 0.0)


def test_equations_without_the_disturbance_are_doubtful_where_more_outputs_than_disturbances_are_measured():
    """x = [angle, rate, current] of a motor: the angle's equation is exact, the disturbance drives that of the rate."""
    A = np.array([[0.0, 1.0, 0.0], [0.0, -1.0, 3.0], [0.0, -7.0, -50.0]])
    B, G_d, quiet = np.array([[0.0], [0.0], [50.0]]), np.array([[0.0], [1.0], [0.0]]), np.zeros(3, dtype=bool)
    both, angle = np.eye(3)[[0, 2]], np.eye(3)[[0]]
    assert doubtful_equations(A, B, both, G_d, quiet).tolist() == [False, False, True]
    assert not np.any(doubtful_equations(A, B, angle, G_d, quiet))
    assert not np.any(doubtful_equations(A, B, both, G_d, np.array([False, False, True])))


def test_an_equation_of_one_state_is_exact_but_where_an_input_acts_too():
    A, B = np.array([[0.0, 3.0], [0.0, 0.0]]), np.array([[0.0], [1.0]])
    nothing = np.zeros((2, 1))
    found = [doubtful_equations(A, B * by, np.eye(2), nothing, np.zeros(2, dtype=bool)).tolist() for by in (1.0, 0.0)]
    assert found == [[False, True], [False, True]]
    driven = doubtful_equations(A, B[::-1], np.eye(2), nothing, np.zeros(2, dtype=bool))
    assert driven.tolist() == [True, True]
