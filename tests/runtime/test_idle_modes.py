"""Modes that no disturbance reaches and that do not decay leave the estimate of the disturbance as it is."""

from __future__ import annotations

import numpy as np
import pytest

from ndob_fmu.runtime.base_errors import DesignError
from ndob_fmu.runtime.design.augmented import augment
from ndob_fmu.runtime.design.idle_modes import idle_directions
from ndob_fmu.runtime.design.stationary_design import stationary_design
from ndob_fmu.runtime.design.tuning import Knowledge, predicted_error, tuned_intensities
from ndob_fmu.runtime.linear_part import LinearPart

H = 5e-3


def craft(idle, coupling=0.0, outputs=(0, 2)):
    """Return a mass under an unknown force, beside two states that only an input drives."""
    A = np.zeros((4, 4))
    A[0, 1] = 1.0
    A[2:, 2:] = idle
    A[1, 2] = coupling
    G_d = np.array([[0.0], [1.0], [0.0], [0.0]])
    C = np.eye(4)[list(outputs)]
    return LinearPart(A=A, B=np.zeros((4, 0)), C=C, G_f=np.zeros((4, 0)), G_d=G_d, matched=True)


MASS = LinearPart(
    A=np.array([[0.0, 1.0], [0.0, 0.0]]),
    B=np.zeros((2, 0)),
    C=np.array([[1.0, 0.0]]),
    G_f=np.zeros((2, 0)),
    G_d=np.array([[0.0], [1.0]]),
    matched=True,
)


def predicted(linear, order=2):
    p = len(linear.C)
    known = Knowledge(1e-3 * np.eye(p), np.array([3.0]), np.array([3.0 * np.pi**order]))
    system = augment(linear, order, np.full(p, 1e-3))
    found = stationary_design(system, H, known.R_factor, tuned_intensities(system, H, 1.0, known), 1.0)
    return np.concatenate(predicted_error(found, known.disturbance_rate))


@pytest.mark.parametrize("order", [1, 2, 3])
@pytest.mark.parametrize("coupling", [0.0, -11.0])
@pytest.mark.parametrize(
    "idle",
    [[[0.0, 1.0], [0.0, 0.0]], [[0.0, 3.0], [-3.0, 0.0]], [[0.2, 0.0], [0.0, -1.0]]],
    ids=["two integrators", "an oscillator", "an unstable state"],
)
def test_beside_states_that_nothing_drives_the_force_is_estimated_as_well_as_without_them(idle, coupling, order):
    np.testing.assert_allclose(predicted(craft(idle, coupling), order), predicted(MASS, order), rtol=0.02)


def test_what_decays_or_is_driven_is_not_idle():
    ones = np.ones(4)
    decaying = craft([[-1.0, 1.0], [0.0, -2.0]])
    assert idle_directions(decaying.A, decaying.G_d, ones).shape == (4, 0)
    resting = craft([[0.0, 1.0], [0.0, 0.0]])
    assert idle_directions(resting.A, np.hstack([resting.G_d, np.eye(4)[:, 3:]]), ones).shape == (4, 0)
    np.testing.assert_allclose(np.abs(idle_directions(resting.A, resting.G_d, ones)), np.eye(4)[:, 2:], atol=1e-12)


def test_where_no_observer_can_be_tuned_that_is_said():
    """An integrator that no output shows moves the mass: no observer can tell it from the force."""
    hidden = craft([[0.0, 1.0], [0.0, 0.0]], coupling=1.0, outputs=(0,))
    with pytest.raises(DesignError, match="tuning of the observer: expected a stationary gain"):
        predicted(hidden)
