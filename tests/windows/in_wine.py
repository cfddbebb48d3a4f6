"""What ships for Windows, run there as far as wine is Windows: in fmpy and in a native host, from any folder.

pytest tests/windows/in_wine.py      after python -m tests.windows.machine; the usual run does not collect it
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ndob_fmu.fmu.components import records
from ndob_fmu.model.loading import load_model
from ndob_fmu.native.build import build_native, build_native_components
from tests.helpers.component_settings import moved
from tests.helpers.native_experiments import NAMES as EXPERIMENTS
from tests.helpers.native_experiments import native_experiments
from tests.helpers.played import Loaded, Machine, this_machine
from tests.windows.machine import HOST, PYTHON, ROOT, awake, environment, run, what_is_missing, windows_path, wine

FMUS = sorted((ROOT / "build" / "fmus").glob("*.fmu"))
NAMES = [path.stem for path in FMUS]
FEW_STEPS = 200
FOLDERS = ["plain", "a b", "ä", "x#y", "it's", "日本", "100%25", "[+],("]
# Of a signal's range. NumPy on Windows has a BLAS of its own: another kernel changes the last digits of the observer's
# gain, and the estimate by 1e-11 where samples are noisy. As it is delivered, for samples without noise, the observer
# makes 1e-8 N·m of 1e-15 rad.
EQUAL, EQUAL_FOR_ANOTHER_KERNEL, EQUAL_AT_HIGHEST_GAIN = 1e-11, 1e-10, 1e-8
# `consistency` is made of residuals over their standard deviation. As it is delivered, that deviation is 1e-15 rad, and
# a fourth of it once 200 samples have shown that there is no noise: the last digit of the residual is 0.1 to 0.4 of it.
EQUAL_CONSISTENCY_WITHOUT_NOISE = 1e-5
# Native FMUs, with noise of the samples or without.
NATIVE, NATIVE_AT_HIGHEST_GAIN = 1e-9, 1e-6
SINE = {"disturbance.kind": 3, "disturbance.amplitude": 1.5, "disturbance.frequency": 0.8}
OBSERVER = "FlexibleJointObserver"
RECORDS = {record.name: record for record in records()}
VARIANTS = {
    **{record.name: {"": moved(record.variables)} for record in records()},
    "FlexibleJointPlant": {"": SINE},
    "DisturbanceSource": {"": SINE, ", noise": SINE | {"disturbance.kind": 6}},
    OBSERVER: {
        "": {},
        ", noise": {"motor_angle_noise_std": 1e-6, "link_angle_noise_std": 1e-5},
        ", method 1": {"method": 1, "pi_end": 1e6, "pi_ramp_time": 0.5},
    },
}
RUN = ("new fmu", "setup 0", "enter", "exit", "run 200 0.001 {inputs} {outputs}", "terminate", "free")
EXECUTABLE = windows_path(PYTHON / "python.exe")

if missing := what_is_missing():
    pytest.exit(missing, returncode=1)


@pytest.fixture(scope="module")
def unpacked(tmp_path_factory):
    """The observer, unpacked into a folder of each name."""
    root = tmp_path_factory.mktemp("unpacked")
    for name in FOLDERS:
        with zipfile.ZipFile(ROOT / "build" / "fmus" / "FlexibleJointObserver.fmu") as archive:
            archive.extractall(root / name)
    return root


@pytest.fixture(scope="module")
def trajectories(unpacked, tmp_path_factory):
    """On Windows and on Linux: name of an FMU or a folder → variable → column."""
    work = tmp_path_factory.mktemp("trajectories")
    script = ROOT / "tests" / "windows" / "simulate.py"
    every = {
        path.stem + variant: (path, values)
        for path in FMUS
        for variant, values in VARIANTS.get(path.stem, {"": {}}).items()
    }
    jobs = {"linux": every, "recorded": {"FlexibleJointPlant": every["FlexibleJointPlant"]}}
    jobs["windows"] = every | {folder: (unpacked / folder, {}, FEW_STEPS) for folder in FOLDERS}
    for name, job in jobs.items():
        named = windows_path if name == "windows" else str
        text = json.dumps({key: (named(path), *more) for key, (path, *more) in job.items()})
        (work / f"{name}.json").write_text(text, "utf-8")
    recorded = work / "recorded.npz"
    subprocess.run([sys.executable, script, work / "recorded.json", recorded], check=True, timeout=300)
    subprocess.run([sys.executable, script, work / "linux.json", work / "linux.npz", recorded], check=True, timeout=300)
    words = [windows_path(path) for path in (script, work / "windows.json", work / "windows.npz", recorded)]
    done = run(PYTHON / "python.exe", *words)
    assert (done.returncode, done.stderr) == (0, "")
    return [read(work / name) for name in ("windows.npz", "linux.npz")]


def read(path):
    found = {}
    with np.load(path) as columns:
        for name in columns.files:
            fmu, variable = name.split("/")
            found.setdefault(fmu, {})[variable] = columns[name]
    return found


def scale(columns, variable):
    """The range of a signal; that of the sample for its residual, which is a difference of such numbers."""
    column = columns.get(variable.replace("_residual", "_hat"), columns[variable])
    return max(np.nanmax(column) - np.nanmin(column), np.nanmax(np.abs(column)))


@pytest.mark.parametrize("name", [name + variant for name in NAMES for variant in VARIANTS.get(name, {"": {}})])
def test_each_fmu_gives_linuxs_trajectories_in_fmpy(trajectories, name):
    assert len(NAMES) == 7
    on_windows, on_linux = (found[name] for found in trajectories)
    assert set(on_windows) == set(on_linux)
    equal = {OBSERVER: EQUAL_AT_HIGHEST_GAIN, f"{OBSERVER}, noise": EQUAL_FOR_ANOTHER_KERNEL}.get(name, EQUAL)
    for variable, column in on_linux.items():
        found, measured = on_windows[variable], ~np.isnan(column)
        np.testing.assert_array_equal(~np.isnan(found), measured, variable)  # a sample that was lost is NaN
        error = np.max(np.abs(found - column)[measured])
        without_noise = (name, variable) == (OBSERVER, "consistency")
        bound = EQUAL_CONSISTENCY_WITHOUT_NOISE if without_noise else equal
        assert error <= bound * scale(on_linux, variable), variable
    assert any(np.nanmax(column) > np.nanmin(column) for variable, column in on_linux.items() if variable != "time")


@pytest.mark.parametrize("folder", FOLDERS)
def test_the_folder_that_an_fmu_is_unpacked_in_changes_nothing_in_fmpy(trajectories, folder):
    found, _ = trajectories
    for variable, column in found[OBSERVER].items():
        np.testing.assert_array_equal(found[folder][variable], column[: FEW_STEPS + 1])


@pytest.fixture(scope="module")
def native_fmus(tmp_path_factory):
    """Native FMUs by name and by FMI's version: plant, observer and components in FMI 2, components in FMI 3."""
    folder, platforms = tmp_path_factory.mktemp("native"), ["linux64", "win64"]
    fmus = [(fmu, 2) for fmu in build_native(load_model("flexible_joint"), folder, platforms=platforms)]
    for fmi in (2, 3):
        built = build_native_components(folder / str(fmi), platforms=platforms, fmi=fmi)
        fmus += [(fmu, fmi) for fmu in built]
    return {(fmu.stem, fmi): fmu for fmu, fmi in fmus}


@pytest.fixture(scope="module")
def played(native_fmus, tmp_path_factory):
    """Return what the C host gives on Linux and on Windows, by the name of the experiment."""
    folder = tmp_path_factory.mktemp("played")
    linux = this_machine(folder)
    windows = Machine(("win64", ".dll"), (str(wine()), windows_path(HOST)), windows_path, environment())
    found = {}
    with awake():
        for name, experiment in native_experiments(folder).items():
            here = Loaded.unpacked(linux, native_fmus[experiment.fmu, 2], folder / str(len(found)))
            found[name] = [replace(here, machine=machine).play(experiment) for machine in (linux, windows)]
    return found


@pytest.mark.parametrize("name", EXPERIMENTS)
def test_a_native_fmu_gives_linuxs_trajectories_in_a_c_host(played, name):
    """The reference experiments and hard ones; another libm changes the last digits."""
    on_linux, on_windows = played[name]
    assert on_windows.said == on_linux.said
    for variable, expected, found in zip(on_linux.names, on_linux.rows[0].T, on_windows.rows[0].T, strict=True):
        if (name, variable) == (OBSERVER, "consistency"):
            continue  # of residuals that are rounding errors
        np.testing.assert_array_equal(np.isnan(found), np.isnan(expected), variable)
        error = np.nanmax(np.abs(found - expected), initial=0.0)
        bound = NATIVE_AT_HIGHEST_GAIN if name == OBSERVER else NATIVE
        assert error <= bound * scale({variable: expected}, variable), variable


def test_native_components_in_fmi_3_give_linuxs_trajectories_in_fmpy(native_fmus, tmp_path):
    jobs = {name: (fmu, moved(RECORDS[name].variables)) for (name, fmi), fmu in native_fmus.items() if fmi == 3}
    script, found = ROOT / "tests" / "windows" / "simulate.py", []
    for name, named in (("linux", str), ("windows", windows_path)):
        (tmp_path / f"{name}.json").write_text(json.dumps({k: (named(f), v) for k, (f, v) in jobs.items()}), "utf-8")
        words = [named(path) for path in (script, tmp_path / f"{name}.json", tmp_path / f"{name}.npz")]
        if name == "linux":
            subprocess.run([sys.executable, *words], check=True, timeout=300)
        else:
            done = run(PYTHON / "python.exe", *words)
            assert (done.returncode, done.stderr) == (0, "")
        found.append(read(tmp_path / f"{name}.npz"))
    on_linux, on_windows = found
    assert set(on_linux) == set(RECORDS)
    for job, columns in on_linux.items():
        for variable, column in columns.items():
            error = np.nanmax(np.abs(on_windows[job][variable] - column))
            assert error <= NATIVE * scale(columns, variable), (job, variable)


def test_a_native_binary_for_windows_shows_nothing_but_fmi_and_needs_nothing_but_windows(native_fmus, tmp_path):
    for (name, fmi), fmu in native_fmus.items():
        with zipfile.ZipFile(fmu) as archive:
            folder = {2: "win64", 3: "x86_64-windows"}[fmi]
            library = Path(archive.extract(f"binaries/{folder}/{name}.dll", tmp_path / str(fmi)))
        needed, exported = described(library)
        assert needed <= {"kernel32.dll", "msvcrt.dll"}
        assert f"fmi{fmi}DoStep" in exported
        own = ["ndobManySteps", "ndobTuning"] if fmi == 2 and name.endswith("Observer") else []
        assert sorted(symbol for symbol in exported if not symbol.startswith(f"fmi{fmi}")) == own


class Native:
    """An FMU in a folder, and the C host under wine."""

    def __init__(self, folder):
        (self.library,) = set(folder.glob("binaries/win64/*")) - {folder / "binaries/win64/pythonfmu-export.dll"}
        self.text = (folder / "resources" / "front.txt").read_text("utf-8")
        self.guid = re.findall("guid=(.*)", self.text)[0]
        self.uri = (folder / "resources").as_uri().replace("file:///", "file:///Z:/")

    def references(self, *names):
        variables = re.findall(r"variable=.. (.*)", self.text)
        return ",".join(str(variables.index(name)) for name in names)

    def run(self, *commands, uri=None, guid=None, **environment):
        words = (windows_path(self.library), uri or self.uri, guid or self.guid)
        return run(HOST, *words, text="".join(f"{command}\n" for command in commands), **environment)


def observer_run(native):
    inputs = native.references("motor_angle", "link_angle")
    outputs = native.references("motor_angle_hat", "load_torque_hat")
    return [command.format(inputs=inputs, outputs=outputs) for command in RUN]


@pytest.mark.parametrize("folder", FOLDERS)
def test_a_native_host_runs_an_fmu_in_any_folder_with_the_python_that_the_variable_names(unpacked, folder):
    native = Native(unpacked / folder)
    done = native.run(*observer_run(native), NDOB_FMU_PYTHON=EXECUTABLE)
    *_, result, terminated, freed = done.stdout.splitlines()
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith("new OK\nsetup OK\nenter OK\nexit OK\n")
    assert (terminated, freed) == ("terminate OK", "free OK")
    *numbers, verb, status = result.split()
    assert (verb, status) == ("run", "OK")
    assert np.all(np.isfinite([float(number) for number in numbers]))
    assert numbers == expected(unpacked)


def expected(unpacked, known=[]):  # noqa: B006 # the first folder's result, which all share
    if not known:
        native = Native(unpacked / FOLDERS[0])
        done = native.run(*observer_run(native), NDOB_FMU_PYTHON=EXECUTABLE)
        known.extend(done.stdout.splitlines()[-3].split()[:-2])
    return known


def test_without_the_variable_the_python_on_path_serves_and_without_both_one_line_says_so(unpacked):
    native = Native(unpacked / "ä")
    assert native.run("new fmu", "free", WINEPATH=windows_path(PYTHON)).stdout == "new OK\nfree OK\n"
    done = native.run("new fmu")
    message, reply = done.stdout.splitlines()
    assert reply == "new NULL"
    assert "expected a Python of 3.10 or later with NumPy" in message
    assert "set NDOB_FMU_PYTHON" in message
    assert done.returncode == 0


def test_the_front_refuses_what_a_host_must_not_do(unpacked):
    native = Native(unpacked / "plain")
    output, parameter = native.references("load_torque_hat"), native.references("link_angle_noise_std")
    done = native.run(
        "new fmu {wrong-guid}",
        "new fmu",
        "step 0 0.001",
        "setup 0",
        "enter",
        "exit",
        "step 0 -1",
        f"setR {output} 1",
        f"setR {parameter} 1",
        "setR 999 1",
        "save",
        "step 0 0.001",
        "restore",
        "step 0 0.001",
        "last",
        "reset",
        "free",
        "free",
        NDOB_FMU_PYTHON=EXECUTABLE,
    )
    replies = [line for line in done.stdout.splitlines() if not line.startswith("log ")]
    assert replies == [
        "new NULL",
        "new OK",
        "step Error",
        "setup OK",
        "enter OK",
        "exit OK",
        "step Discard",
        "setR Error",
        "setR Error",
        "setR Error",
        "save OK",
        "step OK",
        "restore OK",
        "step OK",
        "0.001 last OK".replace("0.001", f"{0.001:.17g}"),
        "reset OK",
        "free OK",
        "free OK",
    ]
    assert done.returncode == 0
    assert "fmuGUID: expected {" in done.stdout


def test_two_fmus_in_one_process_and_two_threads(unpacked):
    native = Native(unpacked / "plain")
    both = ["new one", "setup 0", "enter", "exit", "new other", "setup 0", "enter", "exit"]
    done = native.run(*both, "threads 200", "storm 5", NDOB_FMU_PYTHON=EXECUTABLE)
    assert [line for line in done.stdout.splitlines() if not line.endswith(" OK")] == []
    assert done.returncode == 0


@pytest.mark.parametrize("name", NAMES)
def test_a_binary_for_windows_shows_nothing_but_fmi_and_needs_nothing_but_windows(name, tmp_path):
    with zipfile.ZipFile(ROOT / "build" / "fmus" / f"{name}.fmu") as archive:
        archive.extract(f"binaries/win64/{name}.dll", tmp_path)
    needed, exported = described(Path(tmp_path, "binaries", "win64", f"{name}.dll"))
    assert needed <= {"kernel32.dll", "msvcrt.dll"}
    assert {"fmi2Instantiate", "fmi2DoStep"} <= exported
    assert [symbol for symbol in exported if not symbol.startswith("fmi2")] == []


def described(library):
    """Return the names of the DLLs that a library needs, and of the functions that it shows."""
    command = ["x86_64-w64-mingw32-objdump", "-p", str(library)]
    said = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    needed = {line.split()[-1].lower() for line in said.splitlines() if "DLL Name" in line}
    return needed, set(re.findall(r"^\s*\[ *\d+\] (?:\+base\[ *\d+\] *\w+ )?(\w+)$", said, re.MULTILINE))
