"""A System that is written as a package comes back as it was."""

from __future__ import annotations

import re
import zipfile

import numpy as np
import pytest

from ndob_fmu.cosim import FmuComponent, System, check_ssp, open_ssp, simulate
from ndob_fmu.errors import CouplingError, UsageError
from ndob_fmu.packages import write_ssp
from tests.helpers.coupling_fmus import coupling_fmus
from tests.helpers.mock_components import constant
from tests.helpers.ssp_text import changed


@pytest.fixture(scope="module")
def fmus(tmp_path_factory):
    return coupling_fmus(tmp_path_factory.getbasetemp())


def spring(fmus, **gain):
    return (
        System()
        .add("gain", fmus / "Gain.fmu", {"k": -0.5, "b": 3.0, **gain})
        .add("mass", fmus / "MassSpring.fmu", {"stiffness": 2.0})
        .connect("mass.position", "gain.a")
        .connect("gain.y", "mass.force")
    )


def test_a_written_system_passes_all_checks_and_runs_to_the_bit_as_before(fmus, tmp_path):
    system = spring(fmus)
    path = write_ssp(system, tmp_path / "new" / "spring.ssp", start_time=1.0, stop_time=3.0, step_size=0.25)
    assert check_ssp(path).passed
    with open_ssp(path) as (read, experiment):
        assert (experiment.start_time, experiment.stop_time, experiment.step_size) == (1.0, 3.0, 0.25)
        assert read.start_values == system.start_values
        assert [c[:4] for c in read.connections] == [c[:4] for c in system.connections]
        assert list(read.components) == ["gain", "mass"]
    by_hand = simulate(system, start_time=1.0, stop_time=3.0, step_size=0.25)
    np.testing.assert_array_equal(simulate(path).columns, by_hand.columns)


def test_the_same_system_gives_the_same_bytes(fmus, tmp_path):
    first, second = (write_ssp(spring(fmus), tmp_path / name / "s.ssp", stop_time=1.0) for name in ("a", "b"))
    assert first.read_bytes() == second.read_bytes()


def test_every_component_has_an_fmu_of_its_own_named_after_both(fmus, tmp_path):
    system = System().add("gain", fmus / "Gain.fmu", {"a": 0.0, "b": 0.0})
    for name in ("one", "two"):
        system = system.add(name, fmus / "Integrator.fmu", {"u": 1.0})
    with zipfile.ZipFile(write_ssp(system, tmp_path / "s.ssp")) as package:
        names = [name for name in package.namelist() if name.endswith(".fmu")]
    assert names == [f"resources/{name}.fmu" for name in ("gain_Gain", "one_Integrator", "two_Integrator")]
    with open_ssp(tmp_path / "s.ssp") as (read, _), zipfile.ZipFile(write_ssp(read, tmp_path / "again.ssp")) as package:
        assert [name for name in package.namelist() if name.endswith(".fmu")] == names


LIKE_NAMES = ("a/b", "a?b", "A:B", "a_b_Integrator", "ä", "Ä", "nul", "x" * 300, "x" * 301, "s.boundary", "../up")


def test_no_file_overwrites_another_where_a_package_is_unpacked_by_file_name(fmus, tmp_path):
    """Into one folder, as OMSimulator and fmu-manipulation-toolbox do, also where a file system ignores case."""
    system = System()
    for number, name in enumerate(LIKE_NAMES):
        system = system.add(name, fmus / "Integrator.fmu", {"u": float(number)})
    system = system.expose("u", "a/b.u")
    path = write_ssp(system, tmp_path / "s.ssp")
    with zipfile.ZipFile(path) as package:
        names = [name.rsplit("/", 1)[-1] for name in package.namelist()]
    # a description, the values of the name at the boundary, and for each component an FMU and values but where "u" is
    assert len({name.lower() for name in names}) == len(names) == 2 * len(LIKE_NAMES) + 1
    assert all(re.fullmatch(r"[A-Za-z0-9._-]{1,120}", name) for name in names)
    assert not {"nul.ssv", "NUL.ssv"} & {*names}
    with open_ssp(path) as (read, _):
        assert read.start_values == system.start_values


def test_start_values_lie_in_the_fmus_too_for_tools_that_read_no_parameters(shipped, tmp_path):
    system = System()
    for seed in (1, 2):
        values = {"angle": 0.5, "seed": seed, "between_samples": 2, "sample_time": 0.25}
        system = system.add(f"encoder{seed}", shipped.fmus / "Encoder.fmu", values)
    path = write_ssp(system, tmp_path / "encoders.ssp")
    with zipfile.ZipFile(path) as package:
        package.extractall(tmp_path / "out")
    for seed in (1, 2):
        fmu = tmp_path / "out" / "resources" / f"encoder{seed}_Encoder.fmu"
        starts = {variable.name: variable.start for variable in FmuComponent(fmu).variables}
        assert [starts[name] for name in ("angle", "seed", "between_samples", "sample_time")] == [0.5, seed, 2, 0.25]


def test_values_of_every_type_come_back(fmus, tmp_path):
    values = {"label": "ä < b", "level_in": 0.1 + 0.2, "on_in": True, "count_in": -7}
    path = write_ssp(System().add("mirror", fmus / "Mirror.fmu", values), tmp_path / "m.ssp")
    with open_ssp(path) as (system, _):
        assert {port.variable: value for port, value in system.start_values.items()} == values


def test_conversions_are_written_out_for_tools_that_make_none(fmus, tmp_path):
    turned = changed(fmus / "Gain.fmu", tmp_path / "Turned.fmu", a="deg", y="rad")
    system = System().add("one", turned, {"a": 90.0, "b": 0.0, "k": 1.0}).add("two", turned, {"b": 0.0, "k": 1.0})
    path = write_ssp(system.connect("one.y", "two.a", factor=2.0, offset=1.0), tmp_path / "t.ssp")
    with zipfile.ZipFile(path) as package:
        assert b'suppressUnitConversion="true"' in package.read("SystemStructure.ssd")
    found = simulate(path, stop_time=1.0, step_size=1.0)
    assert found["two.y"][0] == pytest.approx(2.0 * np.degrees(90.0) + 1.0)


def test_steps_of_their_own_come_back(fmus, tmp_path):
    system = System().add("slow", fmus / "Integrator.fmu", {"u": 1.0}, step_ratio=3)
    path = write_ssp(system, tmp_path / "s.ssp", stop_time=3.0, step_size=0.1)
    with open_ssp(path) as (read, _):
        assert read.step_ratios == {"slow": 3}
    with pytest.raises(UsageError, match="step size: expected a number of seconds, for the step ratio 3 of slow"):
        write_ssp(system, tmp_path / "s.ssp")


def test_names_at_the_boundary_come_back(fmus, tmp_path):
    system = (
        spring(fmus)
        .expose("bias", "gain.b")
        .expose("stiffness", "mass.stiffness", "gain.k")
        .expose("position", "mass.position")
    )
    with pytest.raises(
        CouplingError, match=r"start value of gain\.k: expected 2\.0, as stiffness says, received -0\.5"
    ):
        write_ssp(system, tmp_path / "s.ssp")
    system = (spring(fmus, k=2.0).expose("bias", "gain.b").expose("stiffness", "mass.stiffness", "gain.k")).expose(
        "position", "mass.position"
    )
    path = write_ssp(system, tmp_path / "s.ssp", stop_time=1.0, step_size=0.5)
    assert check_ssp(path).passed
    with open_ssp(path) as (read, _):
        assert (read.inputs, read.outputs, read.start_values) == (system.inputs, system.outputs, system.start_values)
    with zipfile.ZipFile(path) as package:
        assert {"s.boundary.ssv", "s.parameters.ssv", "s.parameters.ssm"} < set(package.namelist())


def test_what_cannot_be_written_is_refused_and_leaves_no_file(tmp_path):
    with pytest.raises(CouplingError, match="component x: expected an FMU, received"):
        write_ssp(System().add("x", constant(1.0)), tmp_path / "s.ssp")
    assert not (tmp_path / "s.ssp").exists()


def test_a_package_says_the_start_value_of_an_input_that_nothing_drives(fmus, tmp_path, caplog):
    path = write_ssp(System().add("x", fmus / "Ramp.fmu", {"how": 0}), tmp_path / "s.ssp")
    assert [record.getMessage() for record in caplog.records] == [
        "nothing drives the input x.u; it keeps its own start value"
    ]
    with open_ssp(path) as (system, _):
        assert system.start_values == {("x", "u"): 1.0, ("x", "how"): 0}


def test_only_packages_are_written(fmus, tmp_path):
    with pytest.raises(UsageError, match=r"expected the path of an \.ssp"):
        write_ssp(spring(fmus), tmp_path / "spring.zip")
