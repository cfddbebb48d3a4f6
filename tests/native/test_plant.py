"""Native plants beside the Python FMUs of the same models: the same bits, the same messages."""

from __future__ import annotations

from pathlib import Path
from random import Random

import fmpy
import numpy as np
import pytest

from ndob_fmu.codegen.compile_model import compile_model
from ndob_fmu.fmu.build import build_part
from ndob_fmu.fmu.fmu_description import FmuDescription
from ndob_fmu.interface.model_variables import plant_variables
from ndob_fmu.model.loading import load_model
from ndob_fmu.native.package import package
from ndob_fmu.native.plant import plant_code
from ndob_fmu.runtime.blocks.disturbance import KINDS
from tests.fuzz.library import Library
from tests.fuzz.walk import Walk
from tests.helpers.checkers import findings
from tests.helpers.needs import FRONT

pytestmark = FRONT
ROOT = Path(__file__).parents[2]
MODELS = [
    "flexible_joint",
    *(str(ROOT / "examples" / f"{name}.py") for name in ("tool_on_arm", "two_link_arm", "pmsm")),
]
STEPS = 300


@pytest.fixture(scope="module", params=MODELS, ids=lambda name: Path(name).stem)
def plant(request, tmp_path_factory):
    """Return a model, its plant as a Python FMU, and as native ones by FMI's version."""
    model, folder = load_model(request.param), tmp_path_factory.mktemp("plants")
    variables = plant_variables(compile_model(model))
    fmu = FmuDescription(f"{model.name}Plant", model.description, variables, model.experiment)
    code = plant_code(model)
    native = {
        fmi: package(folder / f"fmi{fmi}" / f"{fmu.name}.fmu", fmu, code, {}, platforms=["linux64"], fmi=fmi)
        for fmi in (2, 3)
    }
    return model, build_part(model, "Plant", folder / "python"), native


def run(fmu, model, **start_values):
    eq, H = compile_model(model), model.experiment.step_size
    times = np.arange(STEPS + 1) * H
    columns = {"time": times}
    for i, name in enumerate(eq.inputs):
        low, high = eq.ranges.get(name, (-1.0, 1.0))
        columns[name] = 0.5 * (low + high) + 0.1 * (high - low) * np.sin((0.05 + 0.01 * i) * np.arange(STEPS + 1))
    for i, name in enumerate(eq.disturbances):
        columns[name] = eq.disturbance_nominal[i] + 0.3 * eq.disturbance_bound[i] * np.sin(0.03 * np.arange(STEPS + 1))
    inputs = np.array(list(zip(*columns.values(), strict=True)), dtype=[(name, float) for name in columns])
    return fmpy.simulate_fmu(
        str(fmu), stop_time=STEPS * H, step_size=H, output_interval=H, input=inputs, start_values=start_values
    )


def test_a_native_plant_has_the_bits_of_the_python_fmu(plant):
    model, python, native = plant
    of_python = run(python, model)
    for fmu in native.values():
        found = run(fmu, model)
        for name in of_python.dtype.names:
            np.testing.assert_array_equal(found[name], of_python[name], name)
    assert any(np.ptp(of_python[name]) > 0.0 for name in of_python.dtype.names if name != "time")


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "none"])
def test_each_kind_of_disturbance_has_the_bits_of_the_python_fmu(plant, kind):
    model, python, native = plant
    (first, *_) = compile_model(model).disturbances
    prefix = "disturbance" if len(compile_model(model).disturbances) == 1 else f"disturbance.{first}"
    H = model.experiment.step_size
    values = {"kind": KINDS[kind], "amplitude": 0.4, "frequency": 0.01 / H, "start_time": 77.3 * H}
    given = {f"{prefix}.{name}": value for name, value in values.items()}
    of_python, found = run(python, model, **given), run(native[2], model, **given)
    for name in of_python.dtype.names:
        np.testing.assert_array_equal(found[name], of_python[name], name)


def test_both_versions_of_fmi_are_valid(plant):
    for fmu in plant[2].values():
        assert findings(fmu) == []


def said_in(fmu, *calls):
    """Make some calls on an instance in step mode and return statuses, messages and outputs."""
    library = Library(Path(fmpy.extract(str(fmu))))
    handle = library.new(logging=1)
    library.begin(handle)
    statuses = [call(library, handle) for call in calls]
    outputs = library.get(handle, library.references("Real", "output"))[1]
    library.FreeInstance(handle)
    return statuses, library.said, outputs


def test_what_a_host_does_wrong_is_answered_as_by_the_python_fmu(plant):
    model, python, native = plant
    H, nan = model.experiment.step_size, float("nan")
    calls = [
        lambda fmu, handle: fmu.step(handle, 0.0, H),
        lambda fmu, handle: fmu.set(handle, [0], [nan]),
        lambda fmu, handle: fmu.step(handle, H, H),
        lambda fmu, handle: fmu.step(handle, H, H),
        lambda fmu, handle: fmu.step(handle, 2 * H, -1.0),
        lambda fmu, handle: fmu.step(handle, 2 * H, 1e-300),
        lambda fmu, handle: fmu.set(handle, fmu.references("Real", "parameter")[:1], [2.5]),
        lambda fmu, handle: fmu.set(handle, [0], [0.25]),
        lambda fmu, handle: fmu.step(handle, 2 * H, H),
    ]
    expected, found = said_in(python, *calls), said_in(native[2], *calls)
    assert len(expected[1]) == 5
    assert found == expected


def test_a_plant_whose_equations_have_no_value_is_discarded_with_the_words_of_the_python_fmu(plant):
    model, python, native = plant

    def spoilt(fmu):
        library = Library(Path(fmpy.extract(str(fmu))))
        handle = library.new()
        starts = [v.reference for v in library.variables if v.name.endswith("_start")]
        assert library.set(handle, starts, [1e200] * len(starts)) == 0
        library.setup(handle, 0.0)
        library.EnterInitializationMode(handle)
        statuses = [library.ExitInitializationMode(handle), library.step(handle, 0.0, model.experiment.step_size)]
        library.FreeInstance(handle)
        return statuses, library.said

    assert spoilt(native[2]) == spoilt(python)


@pytest.mark.parametrize("plant", MODELS[:1], ids=["flexible_joint"], indirect=True)
def test_random_legal_and_illegal_calls_have_the_statuses_of_fmi(plant, components):
    _, _, native = plant
    folders = [Path(fmpy.extract(str(fmu))) for fmu in (native[2], components["Encoder"], components["Sensor"])]
    walk = Walk([Library(folder) for folder in folders], Random(2), lambda _: None)
    walk.wander(6000)
    walk.close()
    assert walk.made >= 6000
