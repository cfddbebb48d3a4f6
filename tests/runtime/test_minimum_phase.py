"""An FMU's parameters may move the zeros after the build: its observer looks at them again."""

from __future__ import annotations

import numpy as np
import pytest

from ndob_fmu.codegen.compile_model import compile_model
from ndob_fmu.errors import AssumptionError, DesignError
from ndob_fmu.runtime.design.minimum_phase import require_zeros_left_of
from ndob_fmu.runtime.design.schedule import PiSchedule
from ndob_fmu.runtime.step.paper_observer import paper_observer
from tests.helpers.observers import sampled_observer
from tests.helpers.problems import BAD, MODELS, RANDOM, to_model

MOTOR = MODELS["dc_motor"]


def paper(model, alpha):
    return paper_observer(compile_model(model), model.parameter_values(), PiSchedule(1.0, 1e4, 0.0), alpha=alpha)


def sampled(model, alpha, order):
    eq = compile_model(model)
    return sampled_observer(
        eq,
        model.parameter_values(),
        order=order,
        noise_std=[1e-4] * len(eq.outputs),
        disturbance_bound=eq.disturbance_bound,
        disturbance_rate=eq.disturbance_rate,
        x_hat=eq.xhat0,
        x_std=eq.xhat0_std,
        alpha=alpha,
        pi=1e4,
    )


@pytest.mark.parametrize("make", [paper, lambda model, alpha: sampled(model, alpha, 0)])
def test_alpha_beyond_the_zero_at_minus_500_is_refused_where_the_design_has_alpha_in_it(make):
    make(MOTOR, 499.0)
    with pytest.raises(AssumptionError, match=r"left of -501 1/s, received one at -500"):
        make(MOTOR, 501.0)


def test_with_a_disturbance_order_alpha_has_no_part_in_the_design():
    sampled(MOTOR, 501.0, 2)


@pytest.mark.parametrize("alpha", [0.0, -1.0, float("nan")])
def test_an_alpha_that_is_no_rate_is_refused(alpha):
    with pytest.raises(DesignError, match="alpha: expected a finite number > 0"):
        paper(MOTOR, alpha)


@pytest.mark.parametrize("order", [0, 1, 3])
def test_a_plant_that_is_not_minimum_phase_is_refused_at_any_order(order):
    bad = next(problem for problem in BAD if problem.name == "a zero on the right")
    with pytest.raises(AssumptionError, match=r"received one at 0\.25"):
        sampled(to_model(bad.linear), 0.1, order)


@pytest.mark.parametrize("problem", [p for p in RANDOM if p.zeros], ids=lambda p: p.name)
def test_the_margin_is_that_of_the_zero_nearest_to_the_axis(problem):
    nearest = -max(np.real(problem.zeros))
    require_zeros_left_of(problem.linear, nearest * (1.0 - 1e-6))
    with pytest.raises(AssumptionError):
        require_zeros_left_of(problem.linear, nearest * (1.0 + 1e-6))
