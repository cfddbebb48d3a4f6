"""What lies in the built FMUs and in the built wheel, and what is refused before anything is built."""

from __future__ import annotations

import hashlib
import re
import subprocess
import sys
import zipfile
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import fmpy
import numpy as np
import pytest
import sympy

import ndob_fmu
from ndob_fmu import Model, NdobError, build
from ndob_fmu.codegen.compile_model import compile_model
from ndob_fmu.cosim import System, simulate
from ndob_fmu.cosim.fmi.fmu_component import FmuComponent
from ndob_fmu.errors import AssumptionError, ModelError, UsageError
from ndob_fmu.fmu.bundle import bundle
from ndob_fmu.runtime.design.schedule import PiSchedule
from ndob_fmu.runtime.equations import SignalDefaults
from ndob_fmu.runtime.step.paper_observer import paper_observer
from tests.helpers.clean_process import ENVIRONMENT, run_clean
from tests.helpers.problems import EXAMPLES, MODELS

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="session")
def built(tmp_path_factory):
    """Return a function from the name of a model to its two FMUs, each built once."""
    folder = tmp_path_factory.mktemp("fmus")
    done = {}

    def of(name):
        if name not in done:
            done[name] = build(MODELS[name], folder)
        return done[name]

    return of


def description(fmu):
    return fmpy.read_model_description(str(fmu))


def two_channels(**changes):
    """Two carts on a spring, each pushed by an unknown force, and a filtered speed: n, m, p, q1, q2 = 5, 1, 3, 1, 2."""
    s = sympy.Symbol("stiffness")
    fields = {
        "name": "TwoCarts",
        "states": ["x1", "v1", "x2", "v2", "filtered"],
        "inputs": ["push"],
        "outputs": ["second_place", "x1", "gauge"],
        "disturbances": ["wind", "slope"],
        "A": [[0, 1, 0, 0, 0], [-s, -1, s, 0, 0], [0, 0, 0, 1, 0], [s, 0, -s, -1, 0], [0, 1, 0, 0, -4]],
        "B": [[0], [1], [0], [0], [0]],
        "C": [[0, 0, 1, 0, 0], [1, 0, 0, 0, 0], [0, 0, 0, 0, 1]],
        "G_f": [[0], [0], [0], [0], [1]],
        "G_d": [[0, 0], [1, 0], [0, 0], [0, 1], [0, 0]],
        "f": lambda x, u, p: [p.hardening * sympy.sin(x.x1 - x.x2)],
        "parameters": {"stiffness": 2.0, "hardening": 0.5},
        "units": {"x1": "m", "wind": "N", "stiffness": "kg/s2"},
        "x0": [0.1, -0.2, 0.3, 0.4, 0.0],
        "disturbance": SignalDefaults(kind="sine", amplitude=0.5),
        "lipschitz": 0.8,
    }
    return Model(**(fields | changes))


BUILD = """
import os, sys
os.umask(0o077)
from ndob_fmu import build, load_model
build(load_model("flexible_joint"), sys.argv[1])
"""


def build_elsewhere(folder, **environment):
    """Build the example in a process of its own, from another folder, and return the two FMUs."""
    command = [sys.executable, "-c", BUILD, "some where else"]
    own = ENVIRONMENT | {"PYTHONPATH": str(ROOT)} | environment
    subprocess.run(command, cwd=folder, check=True, env=own, capture_output=True)
    return sorted((folder / "some where else").iterdir(), reverse=True)


def test_two_builds_give_the_same_bytes_whatever_differs_around_them(flexible_joint, tmp_path):
    """Folder, process, time and its zone, seed of the hashes, umask, language, and the user's style for figures."""
    (tmp_path / "matplotlibrc").write_text("font.size: 30\nsavefig.dpi: 300\n")
    environment = {"PYTHONHASHSEED": "4711", "TZ": "Asia/Kathmandu", "LC_ALL": "C", "SOURCE_DATE_EPOCH": "1"}
    for other, fmu in zip(
        build_elsewhere(tmp_path, **environment), (flexible_joint.plant, flexible_joint.observer), strict=True
    ):
        assert hashlib.sha256(other.read_bytes()).digest() == hashlib.sha256(fmu.read_bytes()).digest(), fmu.name


def test_the_guid_does_not_depend_on_what_this_machine_compiles(flexible_joint, tmp_path):
    """An FMU built where there is no compiler is the same model."""
    plant, observer = build_elsewhere(tmp_path, CC="no-such-compiler")
    for other, fmu in ((plant, flexible_joint.plant), (observer, flexible_joint.observer)):
        with zipfile.ZipFile(other) as archive, zipfile.ZipFile(fmu) as expected:
            assert len(archive.namelist()) < len(expected.namelist())
            assert archive.read("modelDescription.xml") == expected.read("modelDescription.xml")


def test_a_changed_line_of_the_code_inside_gets_another_guid(flexible_joint, tmp_path, monkeypatch):
    def changed(*arguments):
        done = bundle(*arguments)
        return replace(done, files={**done.files, "ndob_note.py": "# another line\n"})

    monkeypatch.setattr(sys.modules["ndob_fmu.fmu.build"], "bundle", changed)  # the name stands for its function
    other = build(MODELS["flexible_joint"], tmp_path)[0]
    assert description(other).guid != description(flexible_joint.plant).guid


def test_another_model_gets_another_guid(flexible_joint, tmp_path):
    changed = two_channels(name="FlexibleJoint")
    assert description(build(changed, tmp_path)[0]).guid != description(flexible_joint.plant).guid


# -- the model description


def test_the_plant_has_the_variables_of_the_contract(flexible_joint):
    variables = description(flexible_joint.plant).modelVariables
    names = {c: [v.name for v in variables if v.causality == c] for c in ("input", "output", "parameter")}
    assert names == {
        "input": ["motor_torque", "load_torque"],
        "output": ["motor_angle", "link_angle", "link_rate", "motor_rate", "load_torque_total"],
        "parameter": [
            *("gravity_torque", "joint_stiffness", "motor_damping"),
            *("link_angle_start", "link_rate_start", "motor_angle_start", "motor_rate_start"),
            *("disturbance.kind", "disturbance.amplitude", "disturbance.frequency", "disturbance.start_time"),
        ],
    }


def test_the_observer_has_the_variables_of_the_contract(flexible_joint):
    variables = description(flexible_joint.observer).modelVariables
    names = {c: {v.name for v in variables if v.causality == c} for c in ("input", "output", "parameter")}
    assert names["input"] == {"motor_torque", "motor_angle", "link_angle"}
    states = ("link_angle", "link_rate", "motor_angle", "motor_rate")
    assert names["output"] >= {
        *(f"{state}_hat" for state in states),
        *("load_torque_hat", "load_torque_at_sample", "load_torque_std"),
        *("motor_angle_residual", "link_angle_residual", "valid"),
    }
    assert names["parameter"] >= {
        *("gravity_torque", "joint_stiffness", "motor_damping", *(f"{state}_hat_start" for state in states)),
        *("method", "alpha", "pi_start", "pi_end", "pi_ramp_time"),
        *("disturbance_order", "disturbance_bound", "disturbance_rate"),
        *("motor_angle_noise_std", "link_angle_noise_std"),
    }


def test_the_start_values_are_the_papers_example(flexible_joint):
    start = {
        v.name: float(v.start)
        for fmu in (flexible_joint.plant, flexible_joint.observer)
        for v in description(fmu).modelVariables
        if v.causality == "parameter" and v.type != "Boolean"
    }
    assert {start[name] for name in start if name.endswith("_start") and "hat" not in name} >= {1.0}
    assert [start[f"{state}_hat_start"] for state in ("link_angle", "link_rate", "motor_angle", "motor_rate")] == [
        -1.0
    ] * 4
    assert (start["disturbance.kind"], start["disturbance.amplitude"]) == (1.0, 2.0)
    assert start["alpha"] == 1.0
    assert (start["pi_start"], start["pi_end"], start["pi_ramp_time"]) == (1.0, 1e12, 10.0)
    experiment = description(flexible_joint.observer).defaultExperiment
    assert (float(experiment.startTime), float(experiment.stopTime), float(experiment.stepSize)) == (0.0, 20.0, 1e-3)


@pytest.mark.parametrize("name", MODELS)
def test_every_unit_is_defined_and_every_variable_has_the_unit_of_what_it_is_about(built, name):
    model = MODELS[name]
    for fmu in built(name):
        read = description(fmu)
        defined = {unit.name for unit in read.unitDefinitions}
        assert {v.unit for v in read.modelVariables if v.unit} <= defined
        for variable in read.modelVariables:
            subject = re.sub(r"_(hat|start|hat_start|total|at_sample|residual)$", "", variable.name)
            assert variable.unit == model.units.get(subject, variable.unit), variable.name


def test_units_are_reduced_to_base_units(tmp_path):
    units = ["kg.m2/s3", "deg", "degC", "cm2.5/s", "Ohm", "N.m^2"]
    model = two_channels(units=dict(zip(["x1", "v1", "x2", "v2", "filtered", "push"], units, strict=True)))
    with zipfile.ZipFile(build(model, tmp_path)[0]) as archive:
        root = ElementTree.fromstring(archive.read("modelDescription.xml"))
    base = {unit.get("name"): (unit[0].attrib if len(unit) else None) for unit in root.iterfind("UnitDefinitions/Unit")}
    assert {name: base[name] for name in units} == {
        "kg.m2/s3": {"kg": "1", "m": "2", "s": "-3"},
        "deg": {"rad": "1", "factor": "0.017453292519943295"},
        "degC": {"K": "1", "offset": "273.15"},
        "cm2.5/s": None,
        "Ohm": {"kg": "1", "m": "2", "s": "-3", "A": "-2"},
        "N.m^2": {"kg": "1", "m": "3", "s": "-2"},
    }


def test_enumerations_are_declared_with_their_items(flexible_joint):
    kinds = {
        t.name: {item.name: int(item.value) for item in t.items}
        for t in description(flexible_joint.plant).typeDefinitions
        if t.items
    }
    assert kinds == {
        "DisturbanceKind": {"none": 0, "constant": 1, "ramp": 2, "sine": 3, "step": 4, "chirp": 5},
    }
    methods = {
        t.name: {item.name: int(item.value) for item in t.items}
        for t in description(flexible_joint.observer).typeDefinitions
    }
    assert sorted(methods["Method"].values()) == [1, 2]
    assert methods["Method"]["paper"] == 1


@pytest.mark.parametrize("name", MODELS)
def test_outputs_depend_on_nothing_while_stepping_and_on_parameters_and_samples_at_the_start(built, name):
    model = MODELS[name]
    samples = {
        **{f"{d}_hat": model.outputs for d in model.disturbances},
        **{f"{d}_at_sample": model.outputs for d in model.disturbances},
        **{f"{d}_lagged": model.outputs for d in model.disturbances},
        **{f"{y}_residual": [y] for y in model.outputs},
        **{f"{d}_total": [d] for d in model.disturbances},
        "valid": model.outputs,
    }
    for fmu in built(name):
        read = description(fmu)
        outputs = [v.name for v in read.modelVariables if v.causality == "output"]
        parameters = {v.name for v in read.modelVariables if v.causality == "parameter"}
        # An empty list says "on nothing"; a missing one would say "on everything", an algebraic loop to an importer.
        assert [(u.variable.name, u.dependencies) for u in read.outputs] == [(name, []) for name in outputs]
        assert [u.variable.name for u in read.initialUnknowns] == outputs
        for unknown in read.initialUnknowns:
            expected = parameters | set(samples.get(unknown.variable.name, ()))
            assert {v.name for v in unknown.dependencies} == expected, unknown.variable.name


def test_every_output_declares_its_variability_and_no_input_derivatives_are_claimed(flexible_joint):
    for fmu in (flexible_joint.plant, flexible_joint.observer):
        read = description(fmu)
        for variable in read.modelVariables:
            if variable.causality == "output":
                assert variable.variability == ("discrete" if variable.type == "Boolean" else "continuous")
        assert not read.coSimulation.canInterpolateInputs


def test_a_model_of_two_disturbances_has_all_its_variables(tmp_path):
    plant, observer = build(two_channels(), tmp_path)
    names = {c: [v.name for v in description(plant).modelVariables if v.causality == c] for c in ("input", "output")}
    assert names["input"] == ["push", "wind", "slope"]
    assert names["output"] == ["second_place", "x1", "gauge", "v1", "x2", "v2", "filtered", "wind_total", "slope_total"]
    parameters = [v.name for v in description(plant).modelVariables if v.causality == "parameter"]
    assert parameters[-8:] == [
        f"disturbance.{d}.{field}"
        for d in ("wind", "slope")
        for field in ("kind", "amplitude", "frequency", "start_time")
    ]
    estimates = [v.name for v in description(observer).modelVariables if v.causality == "output"]
    for expected in ("x1_hat", "filtered_hat", "wind_hat", "slope_hat", "slope_at_sample", "second_place_residual"):
        assert expected in estimates


def test_the_outputs_of_an_observer_of_pairwise_different_sizes_are_the_right_fields_of_its_core(tmp_path):
    model = two_channels()
    observer = FmuComponent(build(model, tmp_path)[1])
    outputs = [v.name for v in observer.variables if v.causality == "output"]
    eq, values, tuning = compile_model(model), [3.0, 0.25], PiSchedule(10.0, 1e5, 0.5)
    core = paper_observer(eq, values, tuning, alpha=0.7)
    state = core.init([0.5, 0.4, 0.3, 0.2, 0.1])
    starts = dict(zip((f"{s}_hat_start" for s in model.states), [0.5, 0.4, 0.3, 0.2, 0.1], strict=True))
    starts |= {
        "method": 1,
        "stiffness": 3.0,
        "hardening": 0.25,
        "alpha": 0.7,
        "pi_start": 10.0,
        "pi_end": 1e5,
        "pi_ramp_time": 0.5,
    }
    got = np.empty(len(outputs))
    inputs = ["gauge", "push", "second_place", "x1"]
    try:
        observer.setup(0.0, 1.0, starts, inputs)
        observer.initialize()
        for k in range(5):
            sample = {"second_place": 0.3 + 0.1 * k, "x1": 0.2 - 0.1 * k, "gauge": 0.05 * k, "push": 0.7}
            observer.set_inputs(np.array([sample[name] for name in inputs]))
            observer.step(0.01 * k, 0.01)
            y = [sample[name] for name in model.outputs]
            state, estimate = core.step(state, [sample["push"]], y, 0.01)
        observer.get_outputs(got)
    finally:
        observer.close()
    value = dict(zip(outputs, got, strict=True))
    fields = {
        **{f"{s}_hat": estimate.x_hat[i] for i, s in enumerate(model.states)},
        **{f"{d}_hat": estimate.d_hat[i] for i, d in enumerate(model.disturbances)},
        **{f"{d}_at_sample": estimate.d_at_sample[i] for i, d in enumerate(model.disturbances)},
        **{f"{d}_lagged": estimate.d_lagged[i] for i, d in enumerate(model.disturbances)},
        **{f"{y}_residual": estimate.residual[i] for i, y in enumerate(model.outputs)},
        "valid": 1.0,
        "consistency": estimate.consistency,
    }
    assert {name: value[name] for name in fields} == fields


def test_generators_of_two_disturbances_act_on_their_own_channel(tmp_path):
    plant = FmuComponent(build(two_channels(), tmp_path)[0], "plant")
    starts = {
        ("plant", "disturbance.wind.kind"): 1,
        ("plant", "disturbance.wind.amplitude"): 3.0,
        ("plant", "disturbance.slope.kind"): 2,
        ("plant", "disturbance.slope.amplitude"): -2.0,
        **{("plant", name): value for name, value in (("push", 0.0), ("wind", 0.25), ("slope", 0.0))},
    }
    recording = simulate(System({"plant": plant}, start_values=starts), stop_time=1.0, step_size=0.5)
    np.testing.assert_array_equal(recording["plant.wind_total"], [3.25, 3.25, 3.25])
    np.testing.assert_array_equal(recording["plant.slope_total"], [0.0, -1.0, -2.0])


# -- what is bundled


def test_the_bundled_code_is_named_by_its_content(flexible_joint, tmp_path):
    """All FMUs of one process share an interpreter: different code under one name would silently be the first one's."""

    def packages(fmu):
        names = zipfile.ZipFile(fmu).namelist()
        return {
            found[1] for found in (re.match(r"resources/(ndob_[a-z]+_[0-9a-f]{16})", name) for name in names) if found
        }

    plant, observer = packages(flexible_joint.plant), packages(flexible_joint.observer)
    assert plant == observer
    assert len(plant) == 2
    other = packages(build(two_channels(), tmp_path)[0])
    assert [name for name in other if "runtime" in name] == [name for name in plant if "runtime" in name]
    assert [name for name in other if "equations" in name] != [name for name in plant if "equations" in name]


def test_the_entry_has_a_function_without_which_pythonfmu_crashes_at_a_later_load(flexible_joint):
    for fmu in (flexible_joint.plant, flexible_joint.observer):
        with zipfile.ZipFile(fmu) as archive:
            entry = archive.read("resources/slavemodule.txt").decode().strip()
            assert "def __init__" in archive.read(f"resources/{entry}.py").decode()


def test_nothing_of_this_machine_is_in_an_fmu(flexible_joint):
    for fmu in (flexible_joint.plant, flexible_joint.observer):
        with zipfile.ZipFile(fmu) as archive:
            assert not [name for name in archive.namelist() if "__pycache__" in name]
            for name in archive.namelist():
                if name.startswith("resources/ndob") or name == "modelDescription.xml":
                    assert str(ROOT).encode() not in archive.read(name)
                    assert archive.getinfo(name).date_time == (1980, 1, 1, 0, 0, 0)


LOAD_AGAIN_AND_AGAIN = """
import sys
from fmpy import simulate_fmu
for _ in range(5):
    for fmu in sys.argv[1:]:
        assert len(simulate_fmu(fmu, stop_time=0.02, output_interval=0.01)) == 3
print("done")
"""


def test_fmus_can_be_loaded_one_after_the_other_many_times_in_one_process(flexible_joint, tmp_path):
    """Each time from another folder, which is gone at the next; without any part of this package at hand."""
    done = run_clean(LOAD_AGAIN_AND_AGAIN, flexible_joint.plant, flexible_joint.observer, cwd=tmp_path)
    assert (done.returncode, done.stdout) == (0, "done\n"), done.stderr


# -- what is refused


def assert_refused(error, *words):
    message = str(error.value)
    assert "\n" not in message
    for word in words:
        assert word in message


def test_a_model_whose_zero_lies_on_the_right_is_refused_and_leaves_no_file(tmp_path):
    bad = two_channels(
        states=["a", "b"],
        outputs=["y"],
        disturbances=["d"],
        inputs=[],
        B=None,
        A=[[0, 1], [-2, -3]],
        C=[[-1, 1]],
        G_f=None,
        G_d=[[0], [1]],
        f=None,
        parameters={},
        units={},
        x0=None,
    )
    with pytest.raises(AssumptionError) as error:
        build(bad, tmp_path / "out")
    assert_refused(error, "zero")
    assert list(tmp_path.iterdir()) == []


def test_a_unit_that_is_none_is_refused_and_leaves_no_file(tmp_path):
    with pytest.raises(ModelError) as error:
        build(two_channels(units={"x1": "bananas"}), tmp_path / "out")
    assert_refused(error, "bananas", "expected")
    assert list(tmp_path.glob("out/*")) == []


def test_a_folder_that_cannot_be_written_is_refused(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(UsageError) as error:
        build(MODELS["flexible_joint"], tmp_path / "file" / "out")
    assert_refused(error, "FlexibleJointPlant.fmu", "file that can be written")


def test_an_fmu_that_exists_survives_a_build_that_fails(flexible_joint, tmp_path):
    before = b"an older build"
    (tmp_path / "TwoCartsPlant.fmu").write_bytes(before)
    with pytest.raises(NdobError):
        build(two_channels(units={"x1": "bananas"}), tmp_path)
    assert (tmp_path / "TwoCartsPlant.fmu").read_bytes() == before
    assert len(list(tmp_path.iterdir())) == 1


def test_building_leaves_the_process_as_it_was(tmp_path):
    path, modules = list(sys.path), set(sys.modules)
    build(MODELS["flexible_joint"], tmp_path)
    assert sys.path == path
    assert {name for name in set(sys.modules) - modules if "ndob_runtime" in name or "FlexibleJoint" in name} == set()


# -- the wheel


@pytest.fixture(scope="module")
def unpacked_wheel(tmp_path_factory):
    folder = tmp_path_factory.mktemp("wheel")
    command = [sys.executable, "-m", "pip", "wheel", "--no-deps", "--no-build-isolation", "--wheel-dir", folder, ROOT]
    subprocess.run(command, check=True, capture_output=True, cwd=folder)
    (wheel,) = folder.glob("*.whl")
    assert wheel.name.startswith(f"ndob_fmu-{ndob_fmu.__version__}-py3-none-any")
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(folder / "site")
    return folder / "site"


def test_the_wheel_carries_slaves_systems_and_types(unpacked_wheel):
    for name in ("_fmus/slave_base.py", "_fmus/plant_slave.py", "_ssp/open_loop/SystemStructure.ssd", "py.typed"):
        assert (unpacked_wheel / "ndob_fmu" / name).is_file()
    assert not list(unpacked_wheel.rglob("*.fmu"))


def test_the_wheel_carries_every_module(unpacked_wheel):
    """A pattern of .gitignore that fits a folder of the package would keep it out."""
    modules = {path.relative_to(ROOT) for path in (ROOT / "ndob_fmu").rglob("*.py")}
    assert {path for path in modules if not (unpacked_wheel / path).is_file()} == set()


AS_INSTALLED = """
from ndob_fmu.cli import main
from ndob_fmu.packages import build_ssp
from ndob_fmu.support.shipped import shipped_folder
assert main(["build", "flexible_joint", "--out", "fmus"]) == 0
build_ssp(shipped_folder("ssp") / "open_loop", "fmus", "ssp")
"""


def test_the_package_from_the_wheel_builds_the_same_fmus_and_system(unpacked_wheel, flexible_joint, tmp_path):
    done = subprocess.run(
        [sys.executable, "-c", AS_INSTALLED],
        cwd=tmp_path,
        env=ENVIRONMENT | {"PYTHONPATH": str(unpacked_wheel)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0
    assert [line for line in done.stderr.splitlines() if not line.startswith("ndob-fmu: still ")] == []
    for fmu in (flexible_joint.plant, flexible_joint.observer):
        assert (tmp_path / "fmus" / fmu.name).read_bytes() == fmu.read_bytes()
    assert (tmp_path / "ssp" / "open_loop.ssp").read_bytes() == flexible_joint.system.read_bytes()


def test_the_examples_are_all_built(built):
    assert len(EXAMPLES) >= 3
    for path in EXAMPLES:
        assert [fmu.name for fmu in built(path.stem)] == [
            f"{MODELS[path.stem].name}{part}.fmu" for part in ("Plant", "Observer")
        ]
