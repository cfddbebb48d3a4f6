"""A filter that knows f: tuned at a linearisation, and compared there with the gain that counts f as noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.estimator.plants import CYLINDER, JOINT, MOTOR
from ndob_fmu.codegen.compile_model import compile_model
from ndob_fmu.runtime.design.augmented import augment
from ndob_fmu.runtime.design.stationary_design import stationary_design
from ndob_fmu.runtime.design.tracking_design import cost_at, linearised, tracking_design
from ndob_fmu.runtime.design.tuning import Knowledge, squared_errors, tuned_intensities
from tests.helpers.problems import MODELS

H = 0.02


def designed(plant, order=2, **changes):
    equations = replace(compile_model(plant.model()), **changes)
    parameters = list(equations.parameters.values())
    known = Knowledge(
        np.diag(plant.sigma), np.array([plant.bound]), np.array([plant.rate(order)]), lipschitz=equations.lipschitz
    )
    u = [0.0] * len(equations.inputs)
    found = tracking_design(
        equations, parameters, known, order=order, H=H, alpha=1.0, pi=1e8, x=plant.x_hat.tolist(), u=u
    )
    as_noise = augment(equations.linear_part(parameters), order)
    frozen = stationary_design(as_noise, H, known.R_factor, tuned_intensities(as_noise, H, 1.0, known), 1.0)
    return found, frozen, known


def test_the_linearisation_has_the_slope_of_f_in_the_place_of_f():
    """Flexible joint: f = −10 sin x₁ in the second equation."""
    equations = compile_model(MODELS["flexible_joint"])
    parameters = list(equations.parameters.values())
    plain = equations.linear_part(parameters)
    found = linearised(equations, parameters, [0.7, 0.1, 0.2, 0.3], [0.5])
    slope = np.zeros((4, 4))
    slope[1, 0] = -10.0 * np.cos(0.7)
    np.testing.assert_allclose(found.A, plain.A + slope, rtol=1e-14, atol=1e-14)
    np.testing.assert_array_equal(found.C, plain.C)
    np.testing.assert_array_equal(found.G_d, plain.G_d)
    assert found.G_f.shape == (4, 0)


@pytest.mark.parametrize("plant", [JOINT, CYLINDER, MOTOR], ids=lambda plant: plant.name)
@pytest.mark.parametrize("order", [1, 2, 3])
def test_a_gain_costs_what_its_design_predicts_also_with_a_measured_state_that_no_noise_reaches(plant, order):
    """The motor's current i_d is measured and driven by nothing at its start."""
    found, _, known = designed(plant, order)
    assert found.knows_f
    assert cost_at(found.stationary, found.stationary.system, known) == pytest.approx(found.cost, rel=1e-9)


@pytest.mark.parametrize(("plant", "least", "most"), [(JOINT, 0.99, 1.01), (CYLINDER, 10.0, 20.0), (MOTOR, 3.0, 4.0)])
def test_the_frozen_gain_is_as_good_where_f_does_not_hide_the_disturbance(plant, least, most):
    found, frozen, known = designed(plant)
    assert least <= cost_at(frozen, found.stationary.system, known) / found.cost <= most


def test_without_a_slope_of_f_the_plant_is_designed_with_f_as_noise():
    def no_slope(x, u, d, p):
        raise ZeroDivisionError

    found, frozen, known = designed(CYLINDER, linearisation=no_slope)
    assert not found.knows_f
    assert found.stationary.intensities.f > 0.0
    least = float(np.sqrt(np.sum(squared_errors(frozen, known))))
    assert least < found.cost < 1.05 * least


def test_an_error_that_grows_at_the_linearisation_has_no_finite_cost():
    found, frozen, known = designed(JOINT)
    unstable = found.stationary.system.linear
    unstable = augment(replace(unstable, A=unstable.A + 500.0 * np.eye(4)), 2)
    assert cost_at(frozen, unstable, known) == np.inf


def test_where_the_rate_is_unknown_pi_sets_the_intensity():
    equations = compile_model(JOINT.model())
    known = Knowledge(np.diag(JOINT.sigma), np.array([5.0]), np.array([0.0]), lipschitz=10.0)
    found = tracking_design(
        equations,
        list(equations.parameters.values()),
        known,
        order=2,
        H=H,
        alpha=1.0,
        pi=1e8,
        x=JOINT.x_hat.tolist(),
        u=[0.0],
    )
    np.testing.assert_allclose(found.stationary.intensities.disturbance, 1e8 * 1e-8 * H)
