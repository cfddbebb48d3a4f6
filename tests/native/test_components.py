"""Native components beside the Python FMUs: the same bits, the same messages."""

from __future__ import annotations

from pathlib import Path
from random import Random

import fmpy
import numpy as np
import pytest

from ndob_fmu.fmu.components import records
from ndob_fmu.fmu.fmu_description import FmuDescription
from ndob_fmu.native.components import CODES
from ndob_fmu.native.package import package
from ndob_fmu.runtime.blocks.disturbance_source import SOURCE_KINDS
from tests.fuzz.library import Library
from tests.fuzz.walk import Walk
from tests.helpers.checkers import findings
from tests.helpers.fmi_instance import ERROR, unpacked
from tests.helpers.needs import FRONT

pytestmark = FRONT
RECORDS = {record.name: record for record in records()}
STEPS, H = 400, 0.01
SAMPLED = {"noise_std": 0.1, "bias": 0.02, "seed": 3, "dropout_probability": 0.2, "delay": 0.037}
CASES = [
    ("TorsionSpring", {"stiffness": 3.7}),
    *(("DisturbanceSource", {"kind": kind}) for kind in SOURCE_KINDS.values()),
    ("DisturbanceSource", {"kind": SOURCE_KINDS["profile"], "interpolation": 2}),
    ("DisturbanceSource", {"kind": SOURCE_KINDS["noise"], "seed": 5}),
    *((name, {}) for name in ("Sensor", "Encoder")),
    *((name, SAMPLED) for name in ("Sensor", "Encoder")),
    *((name, SAMPLED | {"sample_time": 0.025, "between_samples": 2}) for name in ("Sensor", "Encoder")),
    ("Sensor", SAMPLED | {"sample_time": 0.02, "resolution": 0.05, "dropped_sample": 1}),
    ("Encoder", SAMPLED | {"counts_per_revolution": 64}),
]


@pytest.fixture(scope="module")
def native(tmp_path_factory):
    """Return the native FMU of a component, in a version of FMI."""
    folder, known = tmp_path_factory.mktemp("components"), {}

    def build(name, fmi=2):
        if (name, fmi) not in known:
            record = RECORDS[name]
            fmu = FmuDescription(name, record.text, record.variables, record.experiment)
            path = folder / f"fmi{fmi}" / f"{name}.fmu"
            known[name, fmi] = package(path, fmu, CODES[name](record.variables), {}, platforms=["linux64"], fmi=fmi)
        return known[name, fmi]

    return build


@pytest.fixture(scope="module")
def profile(tmp_path_factory):
    path = tmp_path_factory.mktemp("profiles") / "wind ä.csv"
    path.write_text('\ufefftime,value\r\n0.0,1.5\r\n\r\n"0.5",-2.25,ignored\r\n1.7,3e-1\n', "utf-8")
    return str(path)


def run(fmu, profile, name, values):
    if name == "DisturbanceSource":
        values = {"amplitude": 1.3, "frequency": 0.7, "start_time": 0.333, "profile": profile} | values
        values = {f"disturbance.{key}": value for key, value in values.items()}
    inputs = [v.name for v in RECORDS[name].variables if v.causality == "input"]
    times = np.arange(STEPS + 1) * H
    columns = {"time": times} | {n: np.sin((0.03 + 0.01 * i) * np.arange(STEPS + 1)) for i, n in enumerate(inputs)}
    given = np.array(list(zip(*columns.values(), strict=True)), dtype=[(column, float) for column in columns])
    return fmpy.simulate_fmu(
        str(fmu),
        stop_time=STEPS * H,
        step_size=H,
        output_interval=H,
        input=given if inputs else None,
        start_values=values,
    )


@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize(("name", "values"), CASES)
def test_a_native_component_has_the_bits_of_the_python_fmu(native, components, profile, name, values, fmi):
    expected = run(components[name], profile, name, values)
    found = run(native(name, fmi), profile, name, values)
    for variable in expected.dtype.names:
        np.testing.assert_array_equal(found[variable], expected[variable], variable)


@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize("name", CODES)
def test_its_model_description_is_valid(native, name, fmi):
    assert findings(native(name, fmi)) == []


def test_every_component_that_fits_any_plant_is_there():
    assert set(CODES) == set(RECORDS)


def answer(fmu, path):
    """Return the status of initialization with a profile, and what is said."""
    library = Library(Path(fmpy.extract(str(fmu))))
    handle = library.new()
    references = {variable.name: variable.reference for variable in library.variables}
    assert library.set(handle, [references["disturbance.kind"]], [SOURCE_KINDS["profile"]], "Integer") == 0
    assert library.set(handle, [references["disturbance.profile"]], [str(path).encode()], "String") == 0
    library.setup(handle, 0.0)
    library.EnterInitializationMode(handle)
    status = library.ExitInitializationMode(handle)
    library.FreeInstance(handle)
    return status, [text for _, _, text in library.said]


@pytest.mark.parametrize(
    "text",
    ["", "time,value\n", "a,b\nc,d\n", "0,1\n1,\n", "0,1\n1,nan\n", "0,1\n0,2\n", "0\n", "time,value\n0,1\n1,x y\n"],
)
def test_a_profile_that_cannot_be_used_is_refused_in_the_words_of_the_python_fmu(native, components, tmp_path, text):
    path = tmp_path / "profile.csv"
    path.write_text(text)
    found, expected = (answer(fmu, path) for fmu in (native("DisturbanceSource"), components["DisturbanceSource"]))
    assert expected[0] == 3
    assert found == expected


@pytest.mark.parametrize("name", ["missing.csv", "", "."])
def test_a_profile_that_is_not_there_is_refused(native, tmp_path, name):
    status, (said,) = answer(native("DisturbanceSource"), tmp_path / name if name != "" else "")
    assert status == 3
    assert "expected the path of a CSV file" in said


def test_an_instance_stays_in_its_state_where_the_profile_of_another_is_gone(native, tmp_path):
    path = tmp_path / "profile.csv"
    path.write_text("0,1\n1,2\n")
    with unpacked(native("DisturbanceSource")) as instance:
        with_profile, constant = instance("one"), instance("other")
        with_profile.begin(**{"disturbance.kind": SOURCE_KINDS["profile"], "disturbance.profile": str(path)})
        constant.begin(**{"disturbance.kind": SOURCE_KINDS["constant"], "disturbance.amplitude": 3.0})
        state = with_profile.state()
        path.unlink()
        assert constant.setFMUState(state) == ERROR
        assert constant.step(0.0, 0.5)["disturbance"] == 3.0
        # The one with the profile still has its rows.
        assert with_profile.step(0.0, 0.5)["disturbance"] == 1.5


def test_a_delay_of_more_steps_than_are_kept_is_said(native):
    library = Library(Path(fmpy.extract(str(native("Sensor")))))
    handle = library.new()
    references = {variable.name: variable.reference for variable in library.variables}
    assert library.set(handle, [references["delay"]], [1e6]) == 0
    library.begin(handle)
    statuses = [library.step(handle, k * H, H) for k in range(1100)]
    library.FreeInstance(handle)
    assert statuses.index(2) == 1023
    assert library.said[0][2].startswith("delay: expected at most 1023 communication steps")


def test_random_calls_have_the_statuses_of_fmi(native):
    names = ("Sensor", "Encoder", "TorsionSpring")
    walk = Walk([Library(Path(fmpy.extract(str(native(name))))) for name in names], Random(4), lambda _: None)
    walk.wander(6000)
    walk.close()
    assert walk.made >= 6000


@pytest.mark.parametrize("size", [H, 1e10, 1e300])
def test_noise_has_the_bits_of_the_python_fmu_at_any_time(native, components, size):
    rows = []
    for fmu in (native("Sensor"), components["Sensor"]):
        library = Library(Path(fmpy.extract(str(fmu))))
        handle = library.new()
        references = {variable.name: variable.reference for variable in library.variables}
        assert library.set(handle, [references["noise_std"], references["sample_time"]], [0.1, H]) == 0
        library.begin(handle)
        statuses = [library.step(handle, k * size, size) for k in range(3)]
        rows.append((statuses, library.get(handle, library.references("Real", "output"))))
        library.FreeInstance(handle)
    assert rows[0] == rows[1]
    assert np.isfinite(rows[0][1][1]).all()
