"""The shipped references: fmpy, in a process without this package, must reproduce them with the built FMUs."""

from __future__ import annotations

import csv
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from clean_process import fmpy as fmpy_command
from fmpy.util import read_csv

FMUS = Path(__file__).parents[1] / "fmus"


def reference(name, suffix="_ref"):
    return read_csv(FMUS / name / f"{name}{suffix}.csv")


def options(name):
    with (FMUS / name / f"{name}_ref.opt").open() as file:
        return {key: float(value) for key, value in csv.reader(file)}


def run(fmu, folder, *words):
    """Run `fmpy simulate` as the .opt file says; its communication step is what it calls the output interval."""
    opt, result = options(fmu.stem), folder / "result.csv"
    done = fmpy_command(
        *("simulate", fmu, "--start-time", str(opt["StartTime"]), "--stop-time", str(opt["StopTime"])),
        *("--output-interval", str(opt["StepSize"]), "--output-file", result, *words),
        cwd=folder,
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    every = round(opt["OutputIntervalHint"] / opt["StepSize"])
    # fmpy writes Booleans as words that it cannot read itself.
    result.write_text(result.read_text().replace("True", "1").replace("False", "0"))
    return read_csv(result)[::every]


def test_the_plant_reproduces_its_reference(flexible_joint, tmp_path):
    expected, got = reference("FlexibleJointPlant"), run(flexible_joint.plant, tmp_path)
    tolerance = options("FlexibleJointPlant")["RelTol"]
    assert tolerance <= 1e-8
    assert set(expected.dtype.names) <= set(got.dtype.names)
    for name in expected.dtype.names:
        np.testing.assert_allclose(got[name], expected[name], rtol=0, atol=tolerance, err_msg=name)


@pytest.mark.parametrize(("suffix", "starts"), [("_ref", []), ("_paper_ref", ["--start-values", "method", "1"])])
def test_the_observer_reproduces_its_references(flexible_joint, tmp_path, suffix, starts):
    inputs = FMUS / "FlexibleJointObserver" / "FlexibleJointObserver_in.csv"
    got = run(flexible_joint.observer, tmp_path, "--input-file", inputs, *starts)
    expected = reference("FlexibleJointObserver", suffix)
    tolerance = options("FlexibleJointObserver")["RelTol"]
    assert tolerance <= 1e-6
    assert set(expected.dtype.names) <= set(got.dtype.names)
    for name in expected.dtype.names:
        span = np.ptp(expected[name])
        np.testing.assert_allclose(got[name], expected[name], rtol=0, atol=tolerance * (span or 1.0), err_msg=name)


@pytest.mark.parametrize(("suffix", "settled", "error"), [("_ref", 0.1, 1e-6), ("_paper_ref", 12.0, 0.1)])
def test_the_references_show_the_disturbance_found(suffix, settled, error):
    """At ten times the default step, at which the paper's observer is off by 3 % at most."""
    plant, observer = reference("FlexibleJointPlant"), reference("FlexibleJointObserver", suffix)
    late = observer["time"] >= settled
    assert np.abs(observer["load_torque_hat"][late] - 2.0).max() < error
    final = [plant[state][-1] - observer[f"{state}_hat"][-1] for state in ("link_angle", "motor_angle", "motor_rate")]
    assert np.linalg.norm(final) < 5e-3


def test_the_references_are_what_their_generator_writes(tmp_path):
    subprocess.run([sys.executable, FMUS / "regenerate.py", tmp_path], check=True, capture_output=True)
    committed = sorted(path for folder in ("*_ref.csv", "*_in.csv", "*.opt") for path in FMUS.glob(f"*/{folder}"))
    assert [path.relative_to(FMUS) for path in committed] == sorted(
        (path.relative_to(tmp_path) for path in tmp_path.glob("*/*")), key=lambda path: committed.index(FMUS / path)
    )
    for path in committed:
        new = tmp_path / path.relative_to(FMUS)
        if path.suffix == ".opt":
            assert new.read_text() == path.read_text()
            continue
        old_table, new_table = read_csv(path), read_csv(new)
        assert old_table.dtype.names == new_table.dtype.names
        for name in old_table.dtype.names:
            # Not to the last bit: another machine's arithmetic unit may round the steps of the solver otherwise.
            np.testing.assert_allclose(new_table[name], old_table[name], rtol=0, atol=1e-7, err_msg=f"{path} {name}")


@pytest.mark.parametrize("path", sorted(FMUS.glob("*/*")), ids=lambda path: path.name)
def test_no_reference_file_is_large(path):
    assert path.stat().st_size < 300_000
