"""The systems of ssp/: as their generator makes them, the same in every tool, and what compensation is worth there."""

from __future__ import annotations

import re
import sys
import zipfile
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from fmpy.ssp.simulation import simulate_ssp
from fmpy.ssp.ssd import read_ssd

from ndob_fmu.cosim import check_ssp, open_ssp, simulate
from ndob_fmu.cosim.ssp.schema import NAMESPACES
from ssp import regenerate
from tests.helpers.needs import ECOS
from tests.importers.importer_runs import TOLERANCE, difference, in_python
from tests.importers.importer_studies import as_one_block, reference
from tests.importers.importers import Study

ROOT = Path(__file__).parents[2]
# With step size (s) and steps after which there is something to see in all components: disturbances begin at 1 s.
PORTABLE = {
    "open_loop": (1e-3, 400),
    "disturbance_rejection": (5e-3, 240),
    "noisy_encoder": (5e-3, 240),
    "two_joints": (1e-3, 400),
}
VARIANTS = {
    "open_loop_heavy_arm": (1e-3, 200),
    "two_joints_detuned": (1e-3, 200),
    "disturbance_rejection_uncompensated": (5e-3, 240),
}


def test_the_descriptions_are_those_that_the_authoring_function_makes(shipped):
    made = regenerate.descriptions(shipped.fmus)
    kept = {path.relative_to(ROOT / "ssp").as_posix(): path.read_bytes() for path in (ROOT / "ssp").glob("*/**/*.ss?")}
    assert kept == made


def test_every_system_and_every_parameter_set_is_built(shipped):
    names = {
        name if one == "nominal" else f"{name}_{one}"
        for name, (_, _, sets) in regenerate.SYSTEMS.items()
        for one in sets
    }
    assert {path.stem for path in shipped.systems.glob("*.ssp")} == names | {"two_joints_full"}
    assert {*PORTABLE, *VARIANTS, "disturbance_rejection_full"} < names


def test_no_file_of_a_package_has_the_name_of_another(shipped):
    """OMSimulator and fmu-manipulation-toolbox unpack all FMUs into one folder, by file name."""
    for path in shipped.systems.glob("*.ssp"):
        with zipfile.ZipFile(path) as package:
            files = [entry.rsplit("/", 1)[-1].lower() for entry in package.namelist()]
            components = re.findall(r'Component name="(\w+)" source="resources/(\w+)\.fmu"', _description(package))
        assert len({*files}) == len(files), path.name
        assert len({source for _, source in components}) == sum(file.endswith(".fmu") for file in files)
        assert all(f"{name}_" in source for name, source in components)


def test_every_component_says_that_it_is_an_fmu(shipped):
    """SSP's default, but OMSimulator passes over components without a type."""
    for path in shipped.systems.glob("*.ssp"):
        with zipfile.ZipFile(path) as package:
            components = re.findall(r"<ssd:Component [^>]*>", _description(package))
        said = 'type="application/x-fmu-sharedlibrary" implementation="CoSimulation"'
        assert components
        assert all(said in component for component in components), path.name


def _description(package):
    return package.read("SystemStructure.ssd").decode()


def test_every_package_passes_all_checks(shipped):
    for path in shipped.systems.glob("*.ssp"):
        report = check_ssp(path)
        assert report.passed, report


@pytest.mark.parametrize("name", PORTABLE)
def test_a_portable_system_keeps_to_what_all_tools_read(shipped, name):
    """Both ends of every connection at a component, every connector used, bare names, one name for all sets."""
    path = shipped.systems / f"{name}.ssp"
    system = read_ssd(str(path)).system
    assert {b.name for e in system.elements for p in e.parameterBindings for b in p.parameterValues} == {"nominal"}
    assert all(c.startElement and c.endElement for c in system.connections)
    inputs = {(e.name, c.name) for e in system.elements for c in e.connectors if c.kind == "input"}
    assert inputs == {(c.endElement, c.endConnector) for c in system.connections}
    with zipfile.ZipFile(path) as package:
        texts = [package.read(entry).decode() for entry in package.namelist() if not entry.endswith(".fmu")]
    assert all("SystemGeometry" not in text and "Enumeration" not in text for text in texts)
    for text in texts:  # libcosim looks for these prefixes, whatever they stand for
        assert dict(re.findall(r'xmlns:(ss\w)="(\S+)"', text)).items() <= NAMESPACES.items()
    assert sum("org.openmodelica" in text and "osp:FixedStepAlgorithm" in text for text in texts) == 1


def real_outputs(package):
    """Return the name of every Real output of every component."""
    with open_ssp(package) as (system, _):
        return tuple(
            f"{part}.{v.name}"
            for part, component in system.components.items()
            for v in component.variables
            if v.causality == "output" and v.type == "Real"
        )


def study(shipped, name):
    step_size, steps = (PORTABLE | VARIANTS)[name]
    path = shipped.systems / f"{name}.ssp"
    shown = real_outputs(path)
    parameter_set = "nominal" if name in PORTABLE else next(s for s in shipped.sets if name.endswith(f"_{s}"))
    return Study(package=str(path), parameter_set=parameter_set, shown=shown, step_size=step_size, steps=steps)


@pytest.fixture(scope="module")
def ours():
    return {}


@pytest.mark.skipif(sys.platform != "linux", reason="libcosim and ecos are run on Linux")
@pytest.mark.parametrize("tool", ["libcosimpy", pytest.param("ecospy", marks=ECOS)])
@pytest.mark.parametrize("name", [*PORTABLE, *VARIANTS])
def test_a_portable_system_gives_the_same_trajectories_in_every_tool(shipped, ours, tmp_path, tool, name):
    """Rows at equal times are compared."""
    what = study(shipped, name)
    if name not in ours:
        ours[name] = reference(what)
    found = difference(in_python(tool, what, tmp_path), ours[name])
    print(f"{name} in {tool}: largest difference {found:.1e}")  # pytest -rP shows it
    assert found <= 1e-6


def test_a_heavier_arm_falls_faster_and_a_wrong_stiffness_misleads_the_observer(shipped):
    nominal, heavy, detuned = (
        simulate(shipped.systems / f"open_loop{suffix}.ssp", stop_time=0.2) for suffix in ("", "_heavy_arm", "_detuned")
    )
    assert heavy["plant.link_angle"][-1] < nominal["plant.link_angle"][-1] - 0.1
    np.testing.assert_array_equal(detuned["plant.link_angle"], nominal["plant.link_angle"])
    assert not np.array_equal(detuned["observer.link_angle_hat"], nominal["observer.link_angle_hat"])


@pytest.mark.parametrize("name", PORTABLE)
def test_a_portable_system_starts_in_fmpys_own_simulation_as_it_should(shipped, name):
    """It reads no parameter sets: the FMUs have them. It stamps rows one step early, and exchanges nothing at first."""
    path = shipped.systems / f"{name}.ssp"
    result, ours = simulate_ssp(str(path), stop_time=0.02, step_size=1e-3), simulate(path, stop_time=0.02)
    shown = [column for column in result.dtype.names if column in ours.names]
    assert {column.partition(".")[0] for column in shown} >= {"plant" if name != "two_joints" else "plant_a"}
    # Only the torque of the spring has to be exchanged before the first step: 2 N·m come 1 ms late.
    tolerance = 1e-12 if name != "two_joints" else 1e-4
    for column in shown if name != "two_joints" else (c for c in shown if c.startswith("plant")):
        np.testing.assert_allclose(result[column][:20], ours[column][1:], rtol=0.0, atol=tolerance, err_msg=column)


# -- what compensation is worth


@pytest.fixture(scope="module")
def compensated(shipped):
    """Return the recording of a system, 2 s long, with or without compensation."""

    @cache
    def run(name, compensation):
        starts = {"controller.compensation": compensation}
        return simulate(shipped.systems / f"{name}.ssp", stop_time=2.0, start_values=starts)

    return run


@pytest.fixture(scope="module")
def factors(compensated):
    """RMS of the link's angle without and with compensation, from the step at 1 s on, over a period of the sine."""

    def rms(name, compensation):
        recording = compensated(name, compensation)
        return np.sqrt(np.mean(recording["plant.link_angle"][recording.time >= 1.0] ** 2))

    names = ("disturbance_rejection", "disturbance_rejection_detuned", "noisy_encoder")
    return {name: rms(name, False) / rms(name, True) for name in names}


def test_compensation_reduces_the_error_of_the_link_twentyfold(factors):
    assert factors["disturbance_rejection"] >= 20.0


def test_it_does_so_with_a_wrong_stiffness_and_with_noisy_encoders_too(factors):
    assert factors["disturbance_rejection_detuned"] >= 20.0
    assert factors["noisy_encoder"] >= 20.0


def test_compensation_can_be_switched_off_by_the_parameter_set(shipped, compensated):
    switched = compensated("disturbance_rejection", False)
    chosen = simulate(shipped.systems / "disturbance_rejection_uncompensated.ssp", stop_time=1.2)
    np.testing.assert_array_equal(chosen.columns, switched.columns[: len(chosen.time)])


# -- with names at the boundary


def boundary(shipped, name):
    return shipped.systems / f"{name}_boundary.ssp"


@pytest.mark.parametrize("name", PORTABLE)
def test_every_system_has_a_form_with_names_at_its_boundary(shipped, name):
    """In the place that SSP has for them, so that they need a package of their own: libcosim and ecos refuse it."""
    system = read_ssd(str(boundary(shipped, name))).system
    kinds = {kind: {c.name for c in system.connectors if c.kind == kind} for kind in ("input", "output")}
    assert kinds["input"] == {c.startConnector for c in system.connections if not c.startElement} != set()
    assert kinds["output"] == {c.endConnector for c in system.connections if not c.endElement}
    for seen in ("link_angle", "link_angle_hat", "load_torque_total", "load_torque_hat", "load_torque_std", "valid"):
        assert {output.removesuffix("_a") for output in kinds["output"]} >= {seen}
    ours, portable = (
        simulate(path, stop_time=0.02) for path in (boundary(shipped, name), shipped.systems / f"{name}.ssp")
    )
    np.testing.assert_array_equal(ours.columns[:, : len(portable.names)], portable.columns)
    assert {*ours.names[len(portable.names) :]} == kinds["output"]


@pytest.mark.parametrize("name", ["disturbance_rejection", "noisy_encoder", "two_joints"])  # open_loop: test_importers
def test_a_container_of_such_a_package_has_its_inputs_its_outputs_and_its_trajectories(shipped, tmp_path, name):
    what = as_one_block(boundary(shipped, name))
    found, expected = in_python("fmucontainer", what, tmp_path), reference(what)
    # The container does not solve loops through the boundary of an FMU at the start: of two joints the spring's.
    first = 1 if name == "two_joints" else 0
    # In SI units the signals are of the order of 1; without a disturbance the estimate is zero but for rounding.
    np.testing.assert_allclose(found[first:], expected[first:], rtol=0.0, atol=TOLERANCE)


# -- the full form


def test_the_full_form_is_the_portable_one_with_names_at_its_boundary(shipped, compensated):
    full = simulate(shipped.systems / "disturbance_rejection_full.ssp", stop_time=1.2)
    portable = compensated("disturbance_rejection", True)
    assert full.names[: len(portable.names)] == portable.names
    np.testing.assert_array_equal(full.columns[:, : len(portable.names)], portable.columns[: len(full.time)])
    assert full.names[len(portable.names) :] == ("link_angle", "disturbance_estimate")
    np.testing.assert_array_equal(full["link_angle"], full["plant.link_angle"])


def test_a_shared_parameter_is_said_once(shipped):
    path = shipped.systems / "disturbance_rejection_full.ssp"
    parts = ("plant", "observer", "controller")
    each = {f"{part}.joint_stiffness": 2.0 for part in parts} | {"controller.link_angle_reference": 0.1}

    def columns(starts):
        return simulate(path, stop_time=0.1, start_values=starts).columns

    once = columns({"joint_stiffness": 2.0, "reference": 0.1})
    np.testing.assert_array_equal(once, columns(each))
    for name in each:
        assert not np.array_equal(once, columns({other: value for other, value in each.items() if other != name}))


def test_the_full_form_of_the_joints_is_the_portable_one_in_two_systems(shipped):
    """Nested systems, a signal dictionary and a mapping."""
    full, portable = (simulate(shipped.systems / f"two_joints{suffix}.ssp", stop_time=0.2) for suffix in ("_full", ""))
    for name in portable.names:
        part, variable = name.split(".")
        kind, _, joint = part.partition("_")
        nested = f"joint_{joint}.{kind}.{variable}" if joint else name
        np.testing.assert_array_equal(full[nested], portable[name], err_msg=nested)
    np.testing.assert_array_equal(full["load_torque_hat_a"], portable["observer_a.load_torque_hat"])
