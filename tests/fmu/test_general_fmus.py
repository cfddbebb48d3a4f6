"""FMUs of plants as in a textbook: feed-through, nominal disturbances, ranges and the pace, as hosts see them."""

from __future__ import annotations

from dataclasses import replace

import fmpy
import numpy as np
import pytest

from ndob_fmu import ObserverDefaults, System, build, simulate
from tests.helpers.fmi_instance import ERROR, OK, unpacked
from tests.helpers.general_plants import CART
from tests.runtime.test_general_plants import tank


@pytest.fixture(scope="module")
def cart(tmp_path_factory):
    """Plant and observer, with one slowly changing disturbance."""
    model = replace(CART, observer=ObserverDefaults(disturbance_order=1, disturbance_rate=2.0))
    return build(model, tmp_path_factory.mktemp("cart"))


@pytest.fixture(scope="module")
def tanks(tmp_path_factory):
    model = tank(350.0, observer=ObserverDefaults(alpha=0.1, disturbance_rate=2e6))
    return build(model, tmp_path_factory.mktemp("tank"))


def test_plant_and_observer_with_nonlinear_sensors_work_together(cart):
    plant, observer = cart
    system = System()
    system.add("plant", plant, {"disturbance.kind": "sine", "disturbance.amplitude": 1.0, "disturbance.frequency": 0.2})
    system.add("observer", observer)
    for name in ("distance", "acceleration"):
        system.connect(f"plant.{name}", f"observer.{name}")
    found = simulate(system, stop_time=3.0, step_size=1e-2)
    error = found["observer.drag_hat"] - found["plant.drag"]
    assert np.max(np.abs(error[found.time > 1.0])) < 0.05
    assert np.all(found["observer.valid"])


def test_the_description_says_which_output_follows_an_input_in_initialization(cart):
    description = fmpy.read_model_description(cart[0])
    follows = {
        one.variable.name: [known.name for known in one.dependencies if known.causality == "input"]
        for one in description.initialUnknowns
    }
    assert (follows["acceleration"], follows["distance"]) == (["force"], [])


def test_method_1_ends_initialization_in_one_line(cart):
    with unpacked(cart[1]) as instance:
        one = instance()
        assert one.set("method", 1) == OK
        assert one.setupExperiment(startTime=0.0) == OK
        assert one.enterInitializationMode() == OK
        assert one.exitInitializationMode() == ERROR
        assert any("for method 1: expected y = C x and constant directions" in text for text in one.said)


def test_the_nominal_value_is_a_parameter_and_the_estimate_includes_it(tanks):
    plant, observer = (fmpy.read_model_description(fmu) for fmu in tanks)
    starts = {variable.name: variable.start for variable in (*plant.modelVariables, *observer.modelVariables)}
    assert float(starts["disturbance_nominal"]) == 350.0
    assert float(starts["feed"]) == 350.0
    with unpacked(tanks[1]) as instance:
        for nominal in (350.0, 360.0):
            one = instance()
            one.begin(disturbance_nominal=nominal, disturbance_rate=10.0)
            row = one.step(0.0, 0.02, heater=0.0, temperature=350.0)
            assert row["feed_hat"] == pytest.approx(nominal, abs=1.0)


def test_an_estimate_outside_its_range_is_logged_once(tmp_path):
    _, observer = build(tank(350.0, ranges={"temperature": (340.0, 360.0)}), tmp_path)
    with unpacked(observer) as instance:
        one = instance()
        one.begin()
        for k in range(20):
            one.step(0.02 * k, 0.02, heater=0.0, temperature=370.0 + 0.01 * (-1) ** k)
        said = [text for text in one.said if "is outside its range, 340 to 360" in text]
        assert len(said) == 1


def test_a_rate_that_is_absurd_for_the_plant_is_logged_in_the_first_step(tanks):
    with unpacked(tanks[1]) as instance:
        one = instance()
        one.begin()
        one.step(0.0, 0.02, heater=0.0, temperature=350.0)
        one.step(0.02, 0.02, heater=0.0, temperature=350.0)
        said = [text for text in one.said if "disturbance_rate lets feed change at 447 rad/s" in text]
        assert len(said) == 2  # too fast for the plant, and for the samples
