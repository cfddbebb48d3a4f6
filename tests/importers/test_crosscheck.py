"""The cross-check: fmpy, in a process without this package, reproduces the references; a tube tells if it does not."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fmus.tools.regression import WIDER, excess, experiments, main, read_columns
from ndob_fmu import build, load_model
from tests.helpers.clean_process import ENVIRONMENT
from tests.helpers.clean_process import fmpy as fmpy_command

ROOT = Path(__file__).parents[2]
BY_STEM = {experiment.stem: experiment for experiment in experiments()}


def test_each_fmu_has_inputs_reference_and_options_in_the_cross_checks_form():
    assert set(BY_STEM) == {f"FlexibleJoint{part}{which}" for part in ("Plant", "Observer") for which in ("", "_paper")}
    for experiment in BY_STEM.values():
        options = experiment.options
        assert set(options) >= {"StartTime", "StopTime", "StepSize", "RelTol"}
        assert 0.0 < options["RelTol"] <= 1e-6
        times = experiment.reference["time"]
        assert (times[0], times[-1]) == (options["StartTime"], options["StopTime"])
    for part in ("Plant", "Observer"):
        inputs = read_columns(ROOT / "fmus" / f"FlexibleJoint{part}" / f"FlexibleJoint{part}_in.csv")
        assert np.ptp(inputs["motor_torque"]) > 1.0
        step = BY_STEM[f"FlexibleJoint{part}"].options["StepSize"]
        np.testing.assert_allclose(np.diff(inputs["time"]), step, rtol=1e-9)


@pytest.mark.parametrize("stem", BY_STEM)
def test_the_built_fmus_stay_in_the_tubes_of_all_references(stem, flexible_joint, tmp_path):
    experiment, result = BY_STEM[stem], tmp_path / "result.csv"
    _, *words = experiment.command(flexible_joint.plant.parent, result)
    done = fmpy_command(*words, cwd=tmp_path)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    found = excess(experiment.reference, read_columns(result), experiment.options["RelTol"])
    assert len(found) == len(experiment.reference) - 1
    assert found == dict.fromkeys(found, 0.0)


@pytest.mark.parametrize("stem", BY_STEM)
def test_a_trajectory_that_is_slightly_wrong_leaves_its_tube_and_no_other_does(stem):
    reference, tolerance = BY_STEM[stem].reference, BY_STEM[stem].options["RelTol"]
    for name in [name for name in reference if name != "time"]:
        width = WIDER.get(name, 1.0) * tolerance * (np.ptp(reference[name]) or np.abs(reference[name]).max() or 1.0)
        alone = {"time": reference["time"], name: reference[name]}
        for widths, expected, among in ((0.5, 0.0, alone), (3.0, 2.0, reference), (-3.0, 2.0, alone)):
            wrong = reference[name].copy()
            wrong[137] += widths * width  # at one point of 401
            found = excess(among, among | {name: wrong}, tolerance)
            assert found[name] == pytest.approx(expected, abs=0.05)
            assert {other for other in found if found[other] > 0} <= {name}


def test_a_delay_of_one_row_leaves_the_tube():
    """As of a master that stamps its rows one step early."""
    reference = BY_STEM["FlexibleJointPlant"].reference
    late = {name: column if name == "time" else np.roll(column, 1) for name, column in reference.items()}
    assert min(excess(reference, late, 1e-3).values()) > 0.0


def test_what_is_missing_or_no_number_is_outside():
    reference = BY_STEM["FlexibleJointPlant"].reference
    without = {name: column for name, column in reference.items() if name != "link_rate"}
    assert excess(reference, without, 1e-8)["link_rate"] == np.inf
    bad = reference["link_rate"].copy()
    bad[5] = np.nan
    assert excess(reference, reference | {"link_rate": bad}, 1e-8)["link_rate"] == np.inf
    short = {name: column[:-1] for name, column in reference.items()}
    assert set(excess(reference, short, 1e-8).values()) == {np.inf}


def test_the_script_tells_a_plant_with_another_parameter_from_the_right_one(
    flexible_joint, tmp_path, monkeypatch, capsys
):
    """Gravity off by a millionth."""
    monkeypatch.setattr("fmus.tools.regression.experiments", lambda: [BY_STEM["FlexibleJointPlant_paper"]])
    assert main(flexible_joint.plant.parent) == 0
    assert "OUTSIDE" not in capsys.readouterr().out
    model = load_model("flexible_joint")
    build(replace(model, parameters={**model.parameters, "gravity_torque": 10.00001}), tmp_path)
    assert main(tmp_path) == 1
    said = capsys.readouterr().out
    assert re.search(r"link_angle +OUTSIDE the tube by \S+ times", said)
    assert re.search(r"load_torque_total +inside the tube", said)


def test_the_script_says_what_is_wrong_where_there_are_no_fmus(tmp_path):
    command = [sys.executable, ROOT / "fmus" / "tools" / "regression.py", "nowhere"]
    done = subprocess.run(command, cwd=tmp_path, env=ENVIRONMENT, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert done.stdout.count("FAILED: ") == len(BY_STEM)
    assert "FlexibleJointPlant.fmu" in done.stdout


def test_the_commands_on_the_pages_are_those_that_are_run(monkeypatch):
    for name in ("FlexibleJointPlant", "FlexibleJointObserver"):
        page = (ROOT / "fmus" / name / "README.md").read_text("utf-8")
        shown = [shlex.split(line) for line in re.findall(r"^    (fmpy simulate .*)$", page, flags=re.MULTILINE)]
        run = [
            [word.removeprefix(f"{ROOT}/") for word in experiment.command(Path("build/fmus"), Path("result.csv"))]
            for experiment in BY_STEM.values()
            if experiment.fmu == name
        ]
        assert sorted(shown) == sorted(run)
