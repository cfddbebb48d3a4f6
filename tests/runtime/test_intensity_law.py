"""Intensities tuned once serve other steps and noises by a power law, at next to no loss."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ndob_fmu.codegen.compile_model import linear_part
from ndob_fmu.runtime.design.augmented import augment, discretise
from ndob_fmu.runtime.design.intensity_law import law_from_pi, tuned_law
from ndob_fmu.runtime.design.stationary_design import design_for
from ndob_fmu.runtime.design.tuning import Knowledge, fastest_bandwidth, squared_errors, tuned_intensities
from tests.helpers.problems import MODELS, RANDOM

PLANTS = {
    "flexible joint": linear_part(MODELS["flexible_joint"]),
    "degree 1": RANDOM[0].linear,
    "two disturbances": RANDOM[7].linear,
}
STEP = 1e-2


def knowledge(linear, order, noise_scale=1.0):
    q = linear.G_d.shape[1]
    sigma = 1e-4 * noise_scale * np.arange(1.0, len(linear.C) + 1.0)
    return Knowledge(np.diag(sigma), np.full(q, 5.0), np.full(q, 5.0 * (2.0 * np.pi) ** order))


def cost(system, H, disturbance, tuned, known):
    found = design_for(system, discretise(system, H, 1.0), known.R_factor, replace(tuned, disturbance=disturbance), 1.0)
    return float(np.sqrt(np.sum(squared_errors(found, known))))


@pytest.mark.parametrize("plant", PLANTS)
@pytest.mark.parametrize("order", [1, 2, 3])
def test_the_law_costs_at_most_a_tenth_more_than_a_tuning_of_its_own(plant, order):
    """At H = 10 ms and r = 1 the step limits two of these plants, so that the law must come from a larger noise."""
    linear = PLANTS[plant]
    system = augment(linear, order)
    law = tuned_law(system, STEP, 1.0, knowledge(linear, order))
    for step, noise_scale in ((0.7, 1.0), (1.3, 1.0), (1.0, 1.0), (2.0, 0.3), (0.5, 10.0), (1.0, 100.0)):
        H, known = step * STEP, knowledge(linear, order, noise_scale)
        tuned = tuned_intensities(system, H, 1.0, known)
        least = cost(system, H, tuned.disturbance, tuned, known)
        assert cost(system, H, law.at(H, noise_scale), tuned, known) <= 1.1 * least


@pytest.mark.parametrize("order", [1, 2, 3])
def test_where_the_samples_resolve_the_optimum_the_exponent_is_that_of_bias_and_noise(order):
    """κ = 1/(2 r + 2 ρ + 1), ρ = 2 for the flexible joint."""
    linear = PLANTS["flexible joint"]
    law = tuned_law(augment(linear, order), 1e-3, 1.0, knowledge(linear, order))
    assert law.exponent == pytest.approx(1.0 / (2 * order + 5), rel=0.03)
    np.testing.assert_allclose(law.at(1e-3, 10.0) / law.at(1e-3), 100.0**law.exponent)
    np.testing.assert_allclose(law.at(2e-3) / law.at(1e-3), 2.0**law.exponent)


def test_without_noise_the_intensity_stays_where_it_still_changes_the_gain():
    linear = PLANTS["degree 1"]
    system, known = augment(linear, 2), knowledge(linear, 2)
    law = tuned_law(system, STEP, 1.0, known)
    for step, noise_scale in ((1.0, 1e-8), (0.5, 1e-8), (0.5, 1e-9)):
        found, told = law.at(step * STEP, noise_scale), knowledge(linear, 2, noise_scale)
        fastest = tuned_law(system, step * STEP, 1.0, told).limit
        np.testing.assert_allclose(found, fastest, rtol=1e-9)
        assert fastest_bandwidth(system, step * STEP, told) == pytest.approx(1e6 ** (1.0 / 6.0) / (step * STEP))


def test_pi_stays_the_ratio_of_the_intensities_at_every_step_and_noise():
    linear = PLANTS["flexible joint"]
    law = law_from_pi(augment(linear, 2), STEP, 1e9, knowledge(linear, 2))
    for H, noise_scale in ((STEP, 1.0), (3e-3, 7.0)):
        np.testing.assert_allclose(law.at(H, noise_scale), 1e9 * (1e-4 * noise_scale) ** 2 * H)
