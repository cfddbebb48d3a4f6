"""A state that nothing drives follows its sensor where its equation is wrong, at no cost where it is right."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ndob_fmu.codegen.compile_model import compile_model
from ndob_fmu.model.model import Model
from ndob_fmu.runtime.design.augmented import augment, discretise
from ndob_fmu.runtime.design.stationary_design import scaled_noise
from ndob_fmu.runtime.design.tuning import Knowledge, tuned_intensities
from ndob_fmu.runtime.design.undriven_noise import undriven_noise
from ndob_fmu.runtime.linear_part import LinearPart
from ndob_fmu.runtime.numerics.exponential import exponential
from ndob_fmu.runtime.numerics.kalman import stationary, update
from ndob_fmu.runtime.step.sampled_observer import sampled_observer
from ndob_fmu.runtime.step.settings import observer_settings

SIGMA = np.array([1e-5, 1e-3])
PACE = 2.0 * np.pi
# x = [position, speed, current]; the current lags behind the voltage by 20 ms and moves a mass against d.
INDUCTANCE, FORCE_PER_CURRENT = 0.02, 5.0


def actuator(resistance=1.0, outputs=(0, 2)):
    A = np.array([[0.0, 1.0, 0.0], [0.0, -1.0, FORCE_PER_CURRENT], [0.0, 0.0, -resistance / INDUCTANCE]])
    return LinearPart(
        A=A,
        B=np.array([[0.0], [0.0], [1.0 / INDUCTANCE]]),
        C=np.eye(3)[list(outputs)],
        G_f=np.zeros((3, 0)),
        G_d=np.array([[0.0], [1.0], [0.0]]),
        matched=False,
    )


def error_of(H, resistance, outputs=(0, 2), *, noisy=True):
    """The RMS of d̂ − d over D₀ = 1, d a sine of D₀/2 at 1 Hz, under a voltage of 1 + 2 sin(4.4 t) V."""
    told, true = actuator(outputs=outputs), actuator(resistance, outputs)
    system, R = augment(told, 2), np.diag(SIGMA[: len(outputs)])
    known = Knowledge(R, np.array([1.0]), np.array([PACE**2]))
    step, intensities = discretise(system, H, 1.0), tuned_intensities(system, H, 1.0, known)
    noise = [scaled_noise(step, intensities)]
    if noisy:
        on_states = undriven_noise(told.A, told.C, told.G_d, np.ones(3), np.zeros(3), H)
        assert list(on_states > 0.0) == [False, False, True]
        # Spread over the step, by its middle: at an end its correlation with the speed would be wrong.
        white = np.vstack([np.diag(np.sqrt(on_states * H)), np.zeros((2, 3))])
        noise.append(intensities.scale * exponential(system.A * 0.5 * H) @ white)
    R = intensities.scale * R
    K = update(stationary(step.Phi, system.C, np.hstack(noise), R), system.C, R).K

    # [x, u, d, ḋ/2π] of the plant, [x, d, ḋ, u] of the filter
    plant, model = np.zeros((6, 6)), np.zeros((6, 6))
    plant[:3] = np.hstack([true.A, true.B, true.G_d, np.zeros((3, 1))])
    plant[4, 5], plant[5, 4] = PACE, -PACE
    model[:3, :5], model[3, 4], model[:3, 5] = system.A[:3], 1.0, told.B[:, 0]
    plant, model = exponential(plant * H), exponential(model * H)
    x, z, errors = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.5]), np.zeros(5), []
    random = np.random.default_rng(3)
    steps = round(4.0 / H)
    for k in range(steps):
        x[3] = u = 1.0 + 2.0 * np.sin(4.4 * k * H)
        y = true.C @ x[:3] + SIGMA[: len(outputs)] * random.normal(size=len(outputs))
        z = z + K @ (y - system.C @ z)
        errors.append(z[3] - x[4])
        x, z = plant @ x, (model @ np.append(z, u))[:5]
    return float(np.sqrt(np.mean(np.square(errors[steps // 3 :]))))


@pytest.mark.parametrize(("H", "most"), [(2e-3, 0.03), (1e-2, 0.07)])
def test_a_measured_current_is_right_although_the_resistance_is_not(H, most):
    """Without the noise the error is a constant part of the force: 1.4 D₀."""
    assert error_of(H, 1.2, noisy=False) > 1.0
    assert error_of(H, 1.2) < most


@pytest.mark.parametrize("outputs", [(0, 2), (0,)], ids=["measured", "not measured"])
@pytest.mark.parametrize("H", [2e-3, 1e-2])
def test_where_the_model_is_right_the_noise_costs_next_to_nothing(H, outputs):
    assert error_of(H, 1.0, outputs) < 1.02 * error_of(H, 1.0, outputs, noisy=False)


def test_what_a_disturbance_reaches_through_other_states_gets_no_noise():
    plant = actuator()
    behind = np.array([[0.0], [0.0], [1.0]])
    assert not np.any(undriven_noise(plant.A, plant.C, behind, np.ones(3), np.zeros(3), 1e-2))
    only_position = np.array([[1.0], [0.0], [0.0]])
    found = undriven_noise(plant.A, plant.C, only_position, np.ones(3), np.zeros(3), 1e-2)
    np.testing.assert_allclose(found, [0.0, 0.005**2 * 26.0 * 1e-2, 0.02**2 * 2500.0 * 1e-2])


def test_the_noise_scales_with_the_units_of_states_and_time():
    plant, size = actuator(), np.array([1.0, 2.0, 3.0])
    channels = np.zeros((3, 0))
    found = undriven_noise(plant.A, plant.C, channels, size, np.zeros(3), 1e-2)
    S, ms = np.array([10.0, 0.5, 1e3]), 1e3
    other = undriven_noise(plant.A * S[:, None] / S / ms, plant.C / S, channels, size * S, np.zeros(3), 1e-2 * ms)
    np.testing.assert_allclose(other, found * S**2 / ms)


def test_the_noise_of_a_state_that_keeps_its_value_is_zero():
    A = np.diag([-1.0, 0.0])
    found = undriven_noise(A, np.eye(2), np.zeros((2, 0)), np.ones(2), np.zeros(2), 1e-2)
    np.testing.assert_allclose(found, [0.02**2 * 1e-2, 0.0])


def test_a_state_that_only_inputs_drive_gets_noise_by_the_size_of_their_terms():
    """As the rate of a body behind its thrusters."""
    A = np.array([[0.0, 1.0], [0.0, 0.0]])
    found = undriven_noise(A, np.eye(2), np.zeros((2, 0)), np.array([1.0, 2.0]), np.array([0.0, 30.0]), 1e-2)
    np.testing.assert_allclose(found, [0.02**2 * 4.0 * 1e-2, 0.02**2 * 900.0 * 1e-2])


def test_a_start_that_is_as_uncertain_as_it_is_large_makes_its_state_no_larger():
    """The torque of a generator behind its command: it is as large as it starts, whatever is said of the start."""
    model = Model(
        name="Generator",
        states=["rate", "torque"],
        inputs=["command"],
        outputs=["rate", "torque"],
        disturbances=["wind"],
        A=[[-0.1, -1.0], [0.0, -10.0]],
        B=[[0.0], [10.0]],
        C=np.eye(2),
        G_d=[[1.0], [0.0]],
        x0=[1.0, 300.0],
    )
    unsaid, known = (
        sampled_observer(eq, (), observer_settings(eq), eq.xhat0).undriven
        for eq in map(compile_model, (model, replace(model, xhat0_std=[1.0, 0.1])))
    )
    assert unsaid[1] > 0.0
    np.testing.assert_allclose(unsaid, known)
