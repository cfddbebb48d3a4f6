"""How fast the disturbance is taken to be, and what is said where that or the step is absurd for the plant."""

from dataclasses import replace

import numpy as np
import pytest

from ndob_fmu import Experiment, Model, ObserverDefaults, check, design
from ndob_fmu.codegen.compile_model import compile_model
from tests.helpers.general_plants import ARM
from tests.helpers.problems import MODELS


def lags(*rates, **fields):
    """A chain of first-order lags with these rates (1/s), driven at its end by d; its other end is measured."""
    n = len(rates)
    A = np.diag(-np.array(rates, dtype=float)) + np.diag(rates[:-1], 1)
    standard = {"disturbances": ["d"], "A": A, "C": np.eye(1, n), "G_d": np.eye(n)[:, -1:], "disturbance_bound": 2.0}
    states = [f"x{i}" for i in range(n)]
    return Model(name="Lags", states=states, outputs=["y"], **(standard | fields))


def pace(model):
    return check(model)["pace"].values


@pytest.mark.parametrize("order", [1, 2, 3])
def test_the_disturbance_is_as_fast_as_the_plant(order):
    model = lags(0.01, 1.0, observer=ObserverDefaults(disturbance_order=order, alpha=1e-3))
    assert compile_model(model).disturbance_rate == pytest.approx((2.0 * 0.1**order,), rel=0.01)


def test_it_scales_with_the_unit_of_time():
    slow, fast = (compile_model(lags(k * 0.3, k * 2.0)).disturbance_rate[0] for k in (1.0, 60.0))
    assert fast == pytest.approx(60.0**2 * slow, rel=0.01)


def test_integrators_and_what_the_disturbance_does_not_drive_have_no_pace():
    actuator = {"A": [[0, 1, 0], [0, -3, 1], [0, 0, -500]], "C": [[1, 0, 0]], "G_d": [[0], [1], [0]]}
    model = Model(name="Cart", states=["s", "v", "force"], outputs=["y"], disturbances=["d"], **actuator)
    assert compile_model(model).disturbance_rate == pytest.approx((9.0,))


def test_a_plant_of_integrators_has_the_pace_of_its_experiment():
    two = Model(
        name="Two",
        states=["s", "v"],
        outputs=["y"],
        disturbances=["d"],
        A=[[0, 1], [0, 0]],
        C=[[1, 0]],
        G_d=[[0], [1]],
        experiment=Experiment(stop_time=40.0),
    )
    assert compile_model(two).disturbance_rate == pytest.approx(((2.0 * np.pi / 4.0) ** 2,))


def test_a_rate_that_is_told_is_kept():
    assert compile_model(MODELS["flexible_joint"]).disturbance_rate == (5.0 * (2.0 * np.pi) ** 2,)


def test_other_orders_and_bounds_keep_the_pace():
    """Of an observer for which `design` is asked with another order or bound."""
    model = lags(3.0, 3.0, observer=ObserverDefaults(alpha=0.1))
    found = design(model, step_size=1e-2, disturbance_order=1, disturbance_bound=4.0)
    assert found.disturbance_rate == pytest.approx((12.0,), rel=0.01)


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        (
            {"observer": ObserverDefaults(alpha=1e-3, disturbance_rate=80.0)},
            "632 times the plant's fastest mode (0.01 1/s)",
        ),
        (
            {"observer": ObserverDefaults(alpha=1e-3, disturbance_rate=8.0), "experiment": Experiment(step_size=2.0)},
            "samples 2 s apart cannot follow",
        ),
        (
            {"experiment": Experiment(step_size=400.0)},
            "the step of 400 s is 4 times the plant's longest time constant (100 s)",
        ),
        ({"experiment": Experiment(step_size=1e-5)}, "1e-07 of the plant's shortest time constant"),
        ({"experiment": Experiment()}, "1e-05 of the plant's shortest time constant"),
    ],
)
def test_what_is_absurd_for_the_plant_is_said_by_check(fields, words):
    report = check(lags(0.01, 0.01, **({"observer": ObserverDefaults(alpha=1e-3)} | fields)))
    assert any(words in text for text in report["pace"].values["warnings"])
    assert words in str(report)
    assert report.passed


def test_what_is_absurd_for_the_plant_is_said_by_design():
    model = lags(0.01, 0.01, observer=ObserverDefaults(alpha=1e-3))
    assert any("times the plant's longest time constant" in text for text in design(model, step_size=400.0).warnings)
    assert not any("time constant" in text for text in design(model, step_size=1.0).warnings)


@pytest.mark.parametrize("name", MODELS)
def test_nothing_is_said_of_the_shipped_plants(name):
    assert pace(MODELS[name])["warnings"] == []


def test_a_plant_without_constant_matrices_has_a_pace_too():
    found = pace(ARM)
    assert 0.1 < found["slowest"] < found["fastest"] < 100.0


def test_a_step_is_not_too_short_for_a_disturbance_that_is_fast():
    model = lags(0.01, 0.01, observer=ObserverDefaults(alpha=1e-3, disturbance_rate=0.08))
    assert not any("take longer steps" in text for text in design(model, step_size=1e-3).warnings)


def test_check_says_which_field_sets_the_step_where_a_model_has_none_and_only_there():
    told, untold = lags(3.0, 3.0, experiment=Experiment(10.0, 1e-3)), lags(3.0, 3.0)
    assert "step 0.001 s, as the model has no experiment=Experiment(stop_time=..., step_size=...)" in str(check(untold))
    assert "step 0.001 s" in str(check(told))
    assert "experiment=" not in str(check(told))
    assert "experiment=" not in str(check(replace(told, description="told")))


def test_a_rate_is_told_by_name_and_the_disturbance_that_is_not_named_is_as_fast_as_the_plant():
    two = {"disturbances": ["d", "e"], "G_d": [[0, 1.0], [3.0, 0]]}
    own, named = (
        compile_model(lags(3.0, 3.0, **two, observer=ObserverDefaults(alpha=1e-3, disturbance_rate=rate)))
        for rate in (None, {"e": 80.0})
    )
    assert named.disturbance_rate == (own.disturbance_rate[0], 80.0)
