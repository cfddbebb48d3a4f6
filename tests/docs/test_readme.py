"""What the README shows must run, and must be what the Makefile does."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from ndob_fmu.cli import main
from ndob_fmu.cosim import open_ssp, simulate
from ndob_fmu.cosim.system.picture import draw_system
from ndob_fmu.demo import example_results
from tests.helpers.clean_process import ENVIRONMENT

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text("utf-8")
PENDULUM = re.search(r"```python\n(.*?)```", README, re.DOTALL)[1]


@pytest.fixture
def pendulum(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "pendulum.py"
    path.write_text(PENDULUM, "utf-8")
    return path


def test_the_plant_of_the_readme_runs_and_its_disturbance_is_found(pendulum):
    environment = ENVIRONMENT | {"PYTHONPATH": str(ROOT), "PYTHONIOENCODING": "utf-8"}
    command = [sys.executable, "-W", "error", pendulum]
    done = subprocess.run(command, env=environment, capture_output=True, encoding="utf-8", check=False)
    inputs = "plant.motor_torque, plant.wind_torque, observer.motor_torque"
    said = f"nothing drives the inputs {inputs}; they keep their own start values\n"
    assert (done.returncode, done.stderr) == (0, said)
    assert float(re.search(r"last second: (\S+) N·m", done.stdout)[1]) < 0.05
    assert Path("build/fmus/PendulumObserver.fmu").is_file()


@pytest.mark.parametrize("words", re.findall(r"ndob-fmu ((?:check|design|build) pendulum\.py[^#\n]*)", README))
def test_the_commands_of_the_readme_accept_its_plant(pendulum, words, capsys):
    assert main(words.split()) == 0
    assert capsys.readouterr().err == ""


def test_the_commands_for_windows_are_those_of_the_makefile():
    recipes = re.findall(r"^\t\$\(BIN\)/(.*)$", (ROOT / "Makefile").read_text("utf-8"), re.MULTILINE)
    assert len(recipes) >= 8
    for_linux = [
        recipe
        for recipe in recipes
        if recipe.startswith("python")
        and (" tests" in recipe or "native" in recipe or "zig" in recipe)
        and "kernels" not in recipe
    ]
    assert len(for_linux) >= 5
    recipes = [recipe for recipe in recipes if recipe not in for_linux]  # the front, and tools of Linux
    for recipe in recipes:
        assert f".venv\\Scripts\\{recipe.replace(' --quiet --disable-pip-version-check', '')}\n" in README


def test_the_files_that_the_readme_links_are_there():
    links = re.findall(r"\]\(([^)#]+)\)", README)
    assert len(links) >= 6
    assert [link for link in links if not (ROOT / link).exists()] == []


def test_contributing_names_every_folder_and_only_files_that_exist():
    text = (ROOT / "CONTRIBUTING.md").read_text("utf-8")
    layout = text.split("## Where what lives")[1].split("\n## ")[0]
    folders = {path.parent for path in (ROOT / "ndob_fmu").glob("*/__init__.py")}
    assert [folder.name for folder in folders if f"`ndob_fmu/{folder.name}/`" not in layout] == []
    named = re.findall(r"`((?:ndob_fmu|fmus|ssp|tests|docs|benchmarks)/[\w/.]*)`", text)
    assert len(named) >= 12
    assert [name for name in named if not (ROOT / name).exists()] == []


def test_the_figures_of_the_example_in_the_readme_are_those_of_the_demo(shipped):
    """The pace of the paper's estimate, its error later on, and the start of the sampled-data design."""
    seconds, error, since, samples = re.search(
        r"within 2 % of the unknown torque from ([\d.]+) s on.*?From (\d+) s on it stays within ([\d.]+) N·m.*?"
        r"within 2 % after (\d+) samples",
        README,
        re.DOTALL,
    ).group(1, 3, 2, 4)
    shown = example_results(simulate(shipped.systems / "open_loop.ssp"))
    assert shown.settling_time == pytest.approx(float(seconds), abs=0.05)
    assert shown.error[shown.time >= float(since)].max() <= float(error)
    tuning = (ROOT / "docs" / "tuning.md").read_text("utf-8")
    observer = (ROOT / "fmus" / "FlexibleJointObserver" / "README.md").read_text("utf-8")
    grows = re.search(r"From 1 to 10 ms the error in the example grows from ([\d.]+) to ([\d.]+) N·m", tuning).groups()
    within = re.search(r"At 1 ms d̂ stays within ([\d.]+) N·m, at 10 ms within ([\d.]+) N·m", observer).groups()
    coarse = example_results(simulate(shipped.systems / "open_loop.ssp", step_size=1e-2))
    for run, grown, bound in zip((shown, coarse), map(float, grows), map(float, within), strict=True):
        worst = run.error[run.time >= float(since)].max()
        assert grown == pytest.approx(worst, rel=0.15)
        assert worst <= bound
    assert within[0] == error
    sampled = simulate(
        shipped.systems / "open_loop.ssp", stop_time=1.0, start_values={"observer.method": "sampled_data"}
    )
    assert round(example_results(sampled).settling_time / 1e-3) == int(samples)


def test_the_system_of_the_page_about_systems_is_written_and_runs(pendulum):
    page = (ROOT / "docs" / "systems.md").read_text("utf-8")
    assert main(["build", "pendulum.py", "--out", ".", "--components"]) == 0
    exec(re.search(r"```python\n(.*?)```", page, re.DOTALL)[1], {})
    assert main(["check", "pendulum.ssp"]) == 0
    recording = simulate("pendulum.ssp", stop_time=1.0)
    error = (recording["observer.wind_torque_hat"] - recording["plant.wind_torque_total"])[500:]
    assert abs(error).max() < 0.1 * np.ptp(recording["plant.wind_torque_total"])


def test_the_picture_on_the_page_about_systems_is_that_of_the_system(shipped):
    with open_ssp(shipped.systems / "disturbance_rejection.ssp") as (system, _):
        assert (ROOT / "docs" / "disturbance_rejection.svg").read_bytes() == draw_system(
            system, "disturbance_rejection"
        )
