"""The built Sensor.fmu: it shows what its mathematics says, adds no delay of its own, and fits every unit."""

from __future__ import annotations

import math

import numpy as np
import pytest

from ndob_fmu.cosim import System, simulate
from ndob_fmu.runtime.blocks.sampled_measurement import Sampling
from ndob_fmu.runtime.blocks.sensor import Sensor
from tests.helpers.fmi_instance import ERROR, OK, opened, unpacked

H = 0.01
NOISY = {
    "resolution": 1e-3,
    "noise_std": 1e-2,
    "bias": 0.1,
    "seed": 3,
    "sample_time": 0.02,
    "delay": 0.055,
    "dropout_probability": 0.3,
}


@pytest.fixture(scope="module")
def fmu(shipped):
    return shipped.fmus / "Sensor.fmu"


def test_it_is_its_mathematics(fmu):
    device = Sensor(Sampling(between_samples_nan=False, dropped_nan=True, **NOISY))
    state = device.init(0.25, 0.0)
    with opened(fmu) as instance:
        assert instance.setupExperiment(startTime=0.0) == OK
        assert [instance.set(name, value) for name, value in {**NOISY, "value": 0.25}.items()] == [OK] * 8
        assert instance.enterInitializationMode() == OK
        assert instance.get() == {"measured_value": state.shown, "new_sample": True}
        assert instance.exitInitializationMode() == OK
        for k in range(200):
            state = device.step(state, math.sin(k), H * k + H, H)
            got = instance.step(H * k, H, value=math.sin(k))
            np.testing.assert_equal(got, {"measured_value": state.shown, "new_sample": state.new})


def test_in_initialization_mode_the_output_follows_the_value_at_once(fmu):
    with opened(fmu) as instance:
        assert instance.setupExperiment(startTime=0.0) == OK
        assert instance.set("bias", 0.5) == OK
        assert instance.enterInitializationMode() == OK
        for value in (1.0, -3.0):
            assert instance.set("value", value) == OK
            assert instance.get()["measured_value"] == value + 0.5


def test_a_missing_sample_is_nan_and_enumerations_choose_what_is_shown(fmu):
    for dropped, between, expected in (
        (2, 1, [1.0, math.nan, 1.0, math.nan]),
        (1, 1, [1.0] * 4),
        (2, 2, [math.nan] * 4),
    ):
        with opened(fmu) as instance:
            instance.begin(
                value=1.0, dropout_probability=1.0, sample_time=0.02, dropped_sample=dropped, between_samples=between
            )
            # A sample is due at the end of every second step.
            got = [instance.step(H * k, H, value=5.0)["measured_value"] for k in range(4)]
            np.testing.assert_equal(got, expected)


def test_a_state_that_is_restored_in_another_instance_goes_on_to_the_bit(fmu):
    with unpacked(fmu) as instances:
        first, second = instances("first"), instances("second")
        first.begin(**NOISY)
        for k in range(23):
            first.step(H * k, H, value=0.1 * k)
        data = first.bytes_of(first.state())
        expected = [first.step(H * k, H, value=0.1 * k) for k in range(23, 60)]
        second.begin()  # with other parameters, which the state brings along
        status, state = second.from_bytes(data)
        assert status == OK
        second.fmu.setFMUState(state)
        np.testing.assert_equal([second.step(H * k, H, value=0.1 * k) for k in range(23, 60)], expected)


@pytest.mark.parametrize(
    ("name", "value"), [("dropout_probability", 1.5), ("delay", -1.0), ("dropped_sample", 3), ("resolution", -0.1)]
)
def test_a_parameter_out_of_its_range_is_refused(fmu, name, value):
    with opened(fmu) as instance:
        assert instance.setupExperiment(startTime=0.0) == OK
        assert instance.set(name, value) == ERROR
        assert name in instance.said[-1]


def test_behind_its_source_it_adds_no_delay_and_with_jacobi_one_step(shipped, fmu):
    """A ramp from the source, so that a delay shows as a difference."""
    ramp = {"disturbance.kind": 2}
    for options, late in (({"scheme": "gauss-seidel"}, 0.0), ({"scheme": "jacobi"}, H)):
        system = System().add("source", shipped.fmus / "DisturbanceSource.fmu", ramp).add("sensor", fmu)
        system.connect("source.disturbance", "sensor.value")
        recording = simulate(system, stop_time=0.2, step_size=H, **options)
        expected = np.maximum(np.array(recording.time) - late, 0.0)
        np.testing.assert_allclose(recording["sensor.measured_value"], expected, atol=1e-12)


def test_it_fits_a_quantity_of_any_unit(shipped, fmu):
    """An angle in rad from the plant goes through the sensor to the observer, without a conversion."""
    system = System().add("plant", shipped.fmus / "FlexibleJointPlant.fmu").add("sensor", fmu)
    system.connect("plant.link_angle", "sensor.value")
    recording = simulate(system, stop_time=0.1, step_size=H, scheme="gauss-seidel")
    np.testing.assert_array_equal(recording["sensor.measured_value"], recording["plant.link_angle"])
