"""The shell of native FMUs, around a component written for these tests: in both versions of FMI, as hosts meet it."""

from __future__ import annotations

import ctypes
import os
import re
import shlex
import subprocess
import sys
import zipfile
from pathlib import Path
from random import Random

import fmpy
import numpy as np
import pytest
from fmpy.build import build_platform_binary

from ndob_fmu.errors import UsageError
from ndob_fmu.fmu.components import records
from ndob_fmu.fmu.fmu_description import FmuDescription
from ndob_fmu.interface.variables import Enumeration, Variable, parameter
from ndob_fmu.native import compile as compilers
from ndob_fmu.native.package import package
from ndob_fmu.native.sources import HEADERS, ComponentCode
from ndob_fmu.runtime.equations import Experiment
from tests.fuzz.library import Library
from tests.fuzz.walk import Walk
from tests.helpers.checkers import findings
from tests.helpers.needs import C_COMPILER, CMAKE, WINDOWS_COMPILER

pytestmark = [
    C_COMPILER,
    pytest.mark.skipif(sys.platform != "linux", reason="expected Linux, for which the tests compile"),
]
SPRING = {record.name: record for record in records()}["TorsionSpring"]
SPRING_CODE = ComponentCode("""
typedef struct { double stiffness; } Core;
typedef struct { char nothing; } State;

static bool start(const Call *call, double time) {
    (void)time;
    ((Core *)call->core)->stiffness = call->values[4];
    return true;
}

static bool show(const Call *call) {
    double torque = ((Core *)call->core)->stiffness * (call->values[1] - call->values[0]);
    call->outputs[0] = torque;
    call->outputs[1] = -torque;
    return true;
}

static bool step(const Call *call, double time, double step_size) { return (void)time, (void)step_size, show(call); }

static bool possible(const Call *call, double begin, double now) { return (void)call, (void)begin, (void)now, true; }
""")
COUNTER = FmuDescription(
    "Counter",
    "Counts steps: a component with a state and with variables of every type",
    (
        Variable("by", "input", "Added in each step", start=1.0),
        Variable("sum", "output", "The sum"),
        Variable("odd", "output", "Whether the number of steps is odd", type="Boolean"),
        parameter("from", 2, "Where it begins", type="Integer", minimum=0, maximum=9),
        parameter("rule", 1, "Rule", enumeration=Enumeration("Rule", {"up": 1, "down": 2}, {"up": "+", "down": "-"})),
        parameter("stays", False, "Whether nothing is added", type="Boolean"),
        parameter("limit", 1e3, "No sum is larger", positive=True, maximum=1e6),
        parameter("note", "one “note”", "Any text", type="String"),
    ),
    Experiment(stop_time=1.0, step_size=0.1),
)
COUNTER_CODE = ComponentCode("""
typedef struct { double sign; } Core;
typedef struct { double sum, steps; } State;

static bool show(const Call *call) {
    const State *state = call->state;
    call->outputs[0] = state->sum;
    call->outputs[1] = fmod(state->steps, 2.0);
    return true;
}

static bool start(const Call *call, double time) {
    State first = {call->values[3], 0.0};
    (void)time;
    ((Core *)call->core)->sign = call->values[4] == 1.0 ? 1.0 : -1.0;
    *(State *)call->state = first;
    return true;
}

static bool step(const Call *call, double time, double step_size) {
    State *state = call->state;
    double sum = state->sum + (call->values[5] != 0.0 ? 0.0 : ((Core *)call->core)->sign * call->values[0]);
    (void)time, (void)step_size;
    if (!(fabs(sum) <= call->values[6])) {
        say(call->instance, DISCARD, "sum", "a sum within its limit", "a larger one", "steps that are too large");
        return false;
    }
    state->sum = sum;
    state->steps += 1.0;
    return show(call);
}

static bool possible(const Call *call, double begin, double now) {
    const State *state = call->state;
    (void)begin, (void)now;
    return finite_number(state->sum) && state->steps >= 0.0;
}
""")


COMPONENTS = {
    "TorsionSpring": (FmuDescription(SPRING.name, SPRING.text, SPRING.variables, SPRING.experiment), SPRING_CODE),
    "Counter": (COUNTER, COUNTER_CODE),
}
SHOWN = ("sum", "odd")


@pytest.fixture(scope="module", params=[2, 3])
def fmi(request):
    return request.param


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """Return the FMU of a component, in a version of FMI."""
    known = {}

    def build(name, fmi):
        if (name, fmi) not in known:
            folder = tmp_path_factory.mktemp(f"fmi{fmi}")
            known[name, fmi] = package(folder / f"{name}.fmu", *COMPONENTS[name], {}, platforms=["linux64"], fmi=fmi)
        return known[name, fmi]

    return build


@pytest.mark.parametrize("name", COMPONENTS)
def test_the_model_description_is_valid_and_every_function_of_fmi_is_there(built, name, fmi):
    fmu = built(name, fmi)
    assert findings(fmu) == []
    assert fmpy.read_model_description(str(fmu)).fmiVersion == f"{fmi}.0"
    (path,) = Path(fmpy.extract(str(fmu))).glob(f"binaries/*/{name}.so")
    library = ctypes.CDLL(str(path))
    header = (HEADERS / f"fmi{fmi}Functions.h").read_text("utf-8")
    if fmi == 2:  # there a function for model exchange need not exist
        header = re.sub(r"(?s)Functions for FMI2 for Model Exchange.*?Functions for FMI2 for Co-Simulation", "", header)
    functions = set(re.findall(rf"\b(fmi{fmi}[A-Z]\w+)TYPE\b", header))
    assert f"fmi{fmi}DoStep" in functions
    assert [function for function in functions if not hasattr(library, function)] == []


def counted(fmu, **start_values):
    """Return the outputs of a run of the counter that counts by 0.5, and its messages."""
    said = []
    result = fmpy.simulate_fmu(
        str(fmu),
        stop_time=0.5,
        step_size=0.1,
        output_interval=0.1,
        start_values={"by": 0.5, **start_values},
        output=SHOWN,
        logger=lambda *arguments: said.append(arguments[-1].decode()),
    )
    return [[float(row[name]) for row in result] for name in SHOWN], said


def test_variables_of_each_type_reach_the_component(built, fmi):
    fmu = built("Counter", fmi)
    odd = [0.0, 1.0, 0.0, 1.0, 0.0, 1.0]
    assert counted(fmu) == ([[2.0, 2.5, 3.0, 3.5, 4.0, 4.5], odd], [])
    assert counted(fmu, rule=2)[0] == [[2.0, 1.5, 1.0, 0.5, 0.0, -0.5], odd]
    assert counted(fmu, **{"from": 7, "stays": True})[0] == [[7.0] * 6, odd]
    assert counted(fmu, note="100 % “ä”")[0] == counted(fmu)[0]


def test_a_parameter_that_cannot_be_used_is_named_with_what_is_expected(built, fmi):
    for name, value, expected in (
        ("from", 10, "from: expected a finite number of at least 0 and at most 9, received 10"),
        ("rule", 3, "rule: expected one of 1 (up), 2 (down), received 3"),
        ("limit", 0.0, "limit: expected a finite number > 0 and at most 1e+06, received 0.0"),
    ):
        with pytest.raises(Exception, match=r"fmi\dSet"):
            counted(built("Counter", fmi), **{name: value})
        assert messages_of(built("Counter", fmi), fmi, name, value) == [expected]


def messages_of(fmu, fmi, name, value):
    """Set a parameter of a fresh instance and return what it says."""
    description, said = fmpy.read_model_description(str(fmu)), []
    variable = next(variable for variable in description.modelVariables if variable.name == name)
    instance = fmpy.instantiate_fmu(fmpy.extract(str(fmu)), description, logger=lambda *a: said.append(a[-1].decode()))
    kinds = {2: {"Integer": "Integer", "Enumeration": "Integer"}, 3: {"Enumeration": "Int64"}}[fmi]
    with pytest.raises(Exception, match=r"fmi\dSet"):
        getattr(instance, f"set{kinds.get(variable.type, variable.type)}")([variable.valueReference], [value])
    instance.freeInstance()
    return said


def test_a_step_that_fails_is_discarded_with_its_message_and_changes_nothing(built):
    library = Library(Path(fmpy.extract(str(built("Counter", 2)))))
    handle = library.new()
    library.begin(handle)
    assert library.step(handle, 0.0, 0.1) == 0
    assert library.set(handle, [0], [1e5]) == 0
    assert library.step(handle, 0.1, 0.1) == 2
    message = "sum: expected a sum within its limit, received a larger one; likely cause: steps that are too large"
    assert library.said == [("instance", 2, message)]
    assert library.get(handle, [1])[1] == (3.0,)
    assert library.set(handle, [0], [1.0]) == 0
    assert library.step(handle, 0.1, 0.1) == 0
    assert library.get(handle, [1])[1] == (4.0,)
    library.FreeInstance(handle)


def test_the_spring_has_the_bits_of_the_python_fmu(built, fmi, components):
    time = np.linspace(0.0, 1.0, 101)
    inputs = np.array(
        list(zip(time, np.sin(7.0 * time), np.cos(5.0 * time), strict=True)),
        dtype=[("time", float), ("angle_a", float), ("angle_b", float)],
    )
    rows = [
        fmpy.simulate_fmu(
            str(fmu), stop_time=1.0, step_size=0.01, output_interval=0.01, input=inputs, start_values={"stiffness": 3.7}
        )
        for fmu in (components["TorsionSpring"], built("TorsionSpring", fmi))
    ]
    np.testing.assert_array_equal(*rows)
    assert np.ptp(rows[0]["torque_a"]) > 1.0


def test_random_legal_and_illegal_calls_have_the_statuses_of_fmi(built, components, flexible_joint, tmp_path):
    """A native component beside Python ones: each must refuse the handles and states of the others."""
    folders = []
    for fmu in (built("TorsionSpring", 2), components["Encoder"], flexible_joint.plant):
        folders.append(tmp_path / fmu.stem)
        with zipfile.ZipFile(fmu) as archive:
            archive.extractall(folders[-1])
    walk = Walk([Library(folder) for folder in folders], Random(1), lambda _: None)
    walk.wander(4000)
    walk.close()
    assert walk.made >= 4000


def flags(*more):
    return ["-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Werror", *more]


@pytest.mark.parametrize("standard", ["c99", "c11"])
def test_the_sources_compile_as_one_command_and_without_a_warning(built, fmi, standard, tmp_path):
    with zipfile.ZipFile(built("Counter", fmi)) as archive:
        archive.extractall(tmp_path)
    folder = tmp_path / "sources"
    files = [path.name for path in folder.glob("*.c")]
    compiler = shlex.split(os.environ.get("CC", "cc"))
    options = [f"-std={standard}", "-O2", "-shared", "-fPIC", *flags("-Wno-strict-prototypes")]
    subprocess.run([*compiler, *options, *files, "-o", "model.so", "-lm"], cwd=folder, check=True)


@CMAKE
def test_fmpy_compiles_the_sources_to_a_binary_with_the_same_results(built, fmi, tmp_path):
    fmu = built("Counter", fmi)
    with zipfile.ZipFile(fmu) as archive:
        archive.extractall(tmp_path)
    (binary,) = tmp_path.glob("binaries/*/*.so")
    binary.unlink()
    work = tmp_path / "work"
    work.mkdir()
    build_platform_binary(tmp_path, work)
    assert binary.exists()
    assert counted(tmp_path) == counted(fmu)


def test_the_same_fmu_has_the_same_bytes_in_another_folder(built, fmi, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "another cache"))  # so that it is compiled again
    again = package(tmp_path / "ä b" / "Counter.fmu", *COMPONENTS["Counter"], {}, platforms=["linux64"], fmi=fmi)
    assert again.read_bytes() == built("Counter", fmi).read_bytes()


def test_what_a_compiler_made_of_the_same_sources_is_kept(tmp_path, monkeypatch):
    """Another text, another option or another compiler is compiled anew."""
    calls, run = [], subprocess.run
    monkeypatch.setattr(
        compilers.subprocess, "run", lambda command, **more: calls.append(command) or run(command, **more)
    )
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))

    def text(value):
        return {"model.c": f"int answer(void);\nint answer(void) {{ return {value}; }}\n"}

    first = compilers.binary("model", text(1), "linux64")
    assert compilers.binary("model", text(1), "linux64") == first
    assert len(calls) == 1
    assert compilers.binary("model", text(2), "linux64") != first
    monkeypatch.setenv("CC", "cc -DOTHER")
    compilers.binary("model", text(1), "linux64")
    assert len(calls) == 3


def test_an_fmu_that_is_up_to_date_can_be_kept_without_a_compiler(built, fmi, monkeypatch):
    fmu, compiled = built("Counter", fmi), []
    known = fmu.read_bytes()
    monkeypatch.setattr("ndob_fmu.native.package.binary", lambda *_: compiled.append("") or b"")
    package(fmu, *COMPONENTS["Counter"], {}, platforms=["linux64"], fmi=fmi, keep=True)
    assert (fmu.read_bytes(), compiled) == (known, [])
    changed = (COMPONENTS["Counter"][0], ComponentCode(COUNTER_CODE.text + "enum { NEW };\n"))
    other = fmu.with_name("Other.fmu")
    for contents, platforms in ((changed, ["linux64"]), (COMPONENTS["Counter"], ["linux64", "win64"])):
        other.write_bytes(known)
        package(other, *contents, {}, platforms=platforms, fmi=fmi, keep=True)
        assert compiled
        assert other.read_bytes() != known
        compiled.clear()


@WINDOWS_COMPILER
def test_the_same_fmu_for_windows_has_the_same_bytes_in_another_folder(tmp_path, monkeypatch):
    made = []
    for folder in ("one", "ä b"):
        monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / f"cache of {folder}"))
        made.append(package(tmp_path / folder / "Counter.fmu", *COMPONENTS["Counter"], {}, platforms=["win64"]))
    first, again = made
    assert again.read_bytes() == first.read_bytes()


def test_a_platform_without_a_compiler_is_refused_and_leaves_nothing(tmp_path, monkeypatch):
    monkeypatch.setattr(compilers.importlib.util, "find_spec", lambda _: None)
    monkeypatch.setattr(compilers.shutil, "which", lambda name: name if name in ("cc", "gcc") else None)
    with pytest.raises(UsageError) as refused:
        package(tmp_path / "Counter.fmu", *COMPONENTS["Counter"], {}, platforms=["linux64", "win64"])
    assert str(refused.value) == (
        "--platforms win64: expected zig's compiler or x86_64-w64-mingw32-gcc, received none; "
        "likely cause: the extra is not installed: pip install 'ndob-fmu[native]'"
    )
    assert list(tmp_path.iterdir()) == []
