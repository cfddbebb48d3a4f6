"""Native controllers beside the Python FMUs of the same models: the same commands, the same messages."""

from __future__ import annotations

from pathlib import Path
from random import Random

import fmpy
import numpy as np
import pytest

from ndob_fmu.codegen.compile_model import compile_model
from ndob_fmu.fmu.controller import build_controller
from ndob_fmu.model.loading import load_model
from ndob_fmu.model.model import Model
from ndob_fmu.native.build import build_native_controller
from tests.fuzz.library import Library
from tests.fuzz.walk import Walk
from tests.helpers.checkers import findings
from tests.helpers.needs import FRONT

pytestmark = FRONT
ROOT = Path(__file__).parents[2]
STEPS = 300
# Regulates a sum of states, which is none of them.
VESSELS = Model(
    name="Vessels",
    states=["first", "second", "third"],
    inputs=["inflow"],
    outputs=["both", "third"],
    disturbances=["leak"],
    A=[[-1, 1, 0], [1, -2, 1], [0, 1, -3]],
    B=[[1], [0], [0]],
    C=[[1, 1, 0], [0, 0, 1]],
    G_d=[[1], [0], [0]],
    G_f=[[1], [0], [0]],
    f=lambda x, u, p: [-0.1 * x.first**2],
    parameters={},
    x0=[0.5, 0.5, 0.2],
)
CASES = {
    "FlexibleJoint": lambda: load_model("flexible_joint"),
    "ToolOnArm": lambda: load_model(str(ROOT / "examples" / "tool_on_arm.py")),
    "MagneticLevitator": lambda: load_model(str(ROOT / "examples" / "magnetic_levitator.py")),
    "Vessels": lambda: VESSELS,
}
REGULATED = {"Vessels": ["both"]}


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """Return a model, its controller as a Python FMU, and as a native one of a version of FMI."""
    folder, known = tmp_path_factory.mktemp("controllers"), {}

    def build(name, fmi=2):
        if (name, fmi) not in known:
            model, chosen = CASES[name](), {"regulated": REGULATED.get(name)}
            known[name, fmi] = (
                model,
                build_controller(model, folder / "python", **chosen),
                build_native_controller(model, folder / f"fmi{fmi}", fmi=fmi, **chosen),
            )
        return known[name, fmi]

    return build


def given(model, fmu):
    """Return references and estimates about the start of the plant; some are not finite for a while."""
    eq, H = compile_model(model), model.experiment.step_size
    at = {
        **{name: (x, 0.05 * (abs(x) + 0.1)) for name, x in zip(eq.states, eq.x0, strict=True)},
        **{
            name: (nominal, 0.3 * bound)
            for name, nominal, bound in zip(eq.disturbances, eq.disturbance_nominal, eq.disturbance_bound, strict=True)
        },
    }
    times = np.arange(STEPS + 1) * H
    columns = {"time": times}
    for i, variable in enumerate(fmpy.read_model_description(str(fmu)).modelVariables):
        if variable.causality != "input":
            continue
        middle, swing = at.get(variable.name.rsplit("_", 1)[0], (1.0, 0.2))
        columns[variable.name] = middle + swing * np.sin((0.02 + 0.01 * i) * np.arange(STEPS + 1))
        columns[variable.name][100 + i : 110] = np.nan
    return np.array(list(zip(*columns.values(), strict=True)), dtype=[(name, float) for name in columns])


def run(fmu, log, H, **values):
    return fmpy.simulate_fmu(
        str(fmu), stop_time=STEPS * H, step_size=H, output_interval=H, input=log, start_values=values
    )


@pytest.mark.parametrize("name", CASES)
def test_a_native_controller_gives_the_commands_of_the_python_fmu(built, name):
    model, python, native = built(name)
    log, H, (u, *_) = given(model, python), model.experiment.step_size, model.inputs
    free = run(python, log, H)
    for values in ({}, {f"{u}_limit": 0.5 * np.max(np.abs(free[u])), "compensation": False}):
        expected, found = (run(fmu, log, H, **values) for fmu in (python, native))
        np.testing.assert_array_equal(found["saturated"], expected["saturated"])
        assert expected["saturated"].any() == bool(values)
        for command in model.inputs:
            assert np.max(np.abs(found[command] - expected[command])) <= 1e-9 * np.ptp(expected[command])


def test_fmi_3_gives_the_bits_of_fmi_2(built):
    model, python, native = built("FlexibleJoint")
    log, H = given(model, python), model.experiment.step_size
    runs = [run(fmu, log, H) for fmu in (native, built("FlexibleJoint", 3)[2])]
    for variable in runs[0].dtype.names:
        np.testing.assert_array_equal(runs[1][variable], runs[0][variable])


@pytest.mark.parametrize("fmi", [2, 3])
def test_the_model_description_is_valid(built, fmi):
    assert findings(built("FlexibleJoint", fmi)[2]) == []


def answer(fmu, values):
    """Return the status of initialization, and what is said."""
    library = Library(Path(fmpy.extract(str(fmu))))
    references = {variable.name: variable.reference for variable in library.variables}
    handle = library.new()
    assert library.set(handle, [references[name] for name in values], list(values.values())) == 0
    library.setup(handle, 0.0)
    library.EnterInitializationMode(handle)
    status = library.ExitInitializationMode(handle)
    library.FreeInstance(handle)
    return status, [text for _, _, text in library.said]


def test_a_plant_without_a_rest_position_is_refused_in_the_words_of_the_python_fmu(built):
    _, python, native = built("FlexibleJoint")
    expected, found = (answer(fmu, {"joint_stiffness": 0.0}) for fmu in (python, native))
    assert expected[0] == 3
    assert "rest position" in expected[1][0]
    assert found == expected


def test_random_calls_have_the_statuses_of_fmi(built, components):
    fmus = [built("FlexibleJoint")[2], components["Encoder"]]
    walk = Walk([Library(Path(fmpy.extract(str(fmu)))) for fmu in fmus], Random(6), lambda _: None)
    walk.wander(3000)
    walk.close()
    assert walk.made >= 3000
