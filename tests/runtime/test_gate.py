"""The innovation gate on its own: which samples it lets through, which it rejects, and when it starts anew."""

from __future__ import annotations

import numpy as np
import pytest

from ndob_fmu.codegen.compile_model import compile_model
from ndob_fmu.runtime.step.gate import MOST_REJECTIONS, accepted_unjudged, gate, judge, jump_gate
from ndob_fmu.runtime.step.sampled_observer import sampled_observer
from tests.helpers.problems import MODELS

H = 5e-3


@pytest.fixture(scope="module")
def design():
    model = MODELS["flexible_joint"]
    eq = compile_model(model)
    observer = sampled_observer(
        eq,
        model.parameter_values(),
        order=2,
        noise_std=[1e-5] * len(eq.outputs),
        disturbance_bound=[2.0],
        disturbance_rate=[80.0],
        x_hat=eq.xhat0,
        x_std=eq.xhat0_std,
        alpha=1.0,
        pi=1e8,
    )
    return observer.designs.at(H)


def verdict(design, innovation, *, rejected=0, finite=True):
    S_factor = design.stationary.update.innovation_factor
    return judge(np.array(innovation), np.zeros(2), rejected, S_factor, design, finite=finite)


def gates(design):
    S_factor = design.stationary.update.innovation_factor
    return gate(S_factor, design), jump_gate(np.zeros(2), S_factor, design)


def test_the_gate_is_six_standard_deviations_and_twice_the_steady_innovation(design):
    stationary = design.stationary
    sigma = np.linalg.norm(stationary.update.innovation_factor, axis=1) / stationary.intensities.scale
    expected = 6.0 * sigma + 2.0 * stationary.steady_innovation @ [80.0]
    np.testing.assert_allclose(gates(design)[0], expected, rtol=1e-12)


def test_a_sample_inside_the_gate_or_explained_by_a_jump_is_used(design):
    inside, jump = gates(design)
    assert np.all(jump > inside)
    assert np.max(jump / inside) > 2.0
    for innovation in (0.999 * inside, -0.999 * inside, 0.999 * jump):
        found = verdict(design, innovation, rejected=3)
        assert (found.used, found.restart, found.rejected) == (True, False, 0)
        np.testing.assert_array_equal(found.innovation, innovation)


@pytest.mark.parametrize("output", [0, 1])
def test_a_sample_that_one_output_puts_beyond_every_jump_is_rejected_and_counted(design, output):
    jump = gates(design)[1]
    innovation = np.zeros(2)
    innovation[output] = 1.001 * jump[output]
    found = verdict(design, innovation, rejected=3)
    assert (found.used, found.restart, found.rejected) == (False, False, 4)
    np.testing.assert_array_equal(found.innovation, jump)


def test_after_ten_rejections_in_a_row_the_next_sample_is_used_by_a_fresh_start(design):
    far = 100.0 * gates(design)[1]
    assert verdict(design, far, rejected=MOST_REJECTIONS - 1).rejected == MOST_REJECTIONS
    found = verdict(design, far, rejected=MOST_REJECTIONS)
    assert (found.used, found.restart, found.rejected) == (True, True, 0)


def test_a_sample_that_is_not_finite_is_never_used_and_is_no_rejection(design):
    found = verdict(design, [0.0, 0.0], rejected=3, finite=False)
    assert (found.used, found.restart, found.rejected) == (False, False, 0)
    np.testing.assert_array_equal(found.innovation, gates(design)[1])
    assert not accepted_unjudged(np.zeros(2), finite=False).used


def test_during_the_start_up_every_finite_sample_is_used(design):
    assert accepted_unjudged(1e6 * gates(design)[1], finite=True).used
