"""The paper's example from one command: its files, and that they show what the paper shows."""

from __future__ import annotations

import json
import os
import re
from pathlib import Path

import numpy as np
import pytest
from fmpy.util import read_csv

from ndob_fmu.cli import main
from ndob_fmu.command_line.model_commands import build_native_demo
from ndob_fmu.command_line.simulation_commands import _builds_compared
from ndob_fmu.demo import example_results, run_demo
from ndob_fmu.native import compile as compilers
from ndob_fmu.results.recording import Recording
from tests.helpers.needs import C_COMPILER, found_c_compiler

PUBLISHED = ["fig1_disturbance.svg", "fig2_state_error.svg", "fig3_peaking.svg", "fig4_start_up.svg"]
DATA = ["result.csv", "summary.json", "system.svg"]
FIGURES = ["fig1_disturbance.png", "fig2_state_error.png", "fig3_peaking.png", "fig4_start_up.png"]
STATES = ("link_angle", "link_rate", "motor_angle", "motor_rate")


@pytest.fixture(scope="module")
def demo(tmp_path_factory):
    """Run `ndob-fmu demo` in an empty folder; return the folder."""
    folder, here = tmp_path_factory.mktemp("demo"), Path.cwd()
    os.chdir(folder)
    try:
        assert main(["demo"]) == 0
    finally:
        os.chdir(here)
    return folder


@pytest.fixture(scope="module")
def summary(demo):
    return json.loads((demo / "results" / "flexible_joint" / "summary.json").read_text("utf-8"))


@pytest.fixture(scope="module")
def table(demo):
    return read_csv(demo / "results" / "flexible_joint" / "result.csv")


def test_the_demo_leaves_the_fmus_the_systems_and_the_results(demo, shipped):
    found = sorted(str(path.relative_to(demo)) for path in demo.rglob("*") if path.is_file())
    expected = [f"results/flexible_joint/{name}" for name in (*FIGURES, *PUBLISHED, *DATA)]
    expected += [f"build/fmus/{path.name}" for path in shipped.fmus.glob("*.fmu")]
    expected += [f"build/ssp/{path.name}" for path in shipped.systems.iterdir()]
    if found_c_compiler():
        native = ("fmus/FlexibleJointPlant.fmu", "fmus/FlexibleJointObserver.fmu", "ssp/open_loop.ssp")
        expected += [f"build/native/{name}" for name in native]
    assert found == sorted(str(Path(name)) for name in expected)


def test_the_estimate_settles_and_stays_as_in_the_paper(summary):
    """Paper: about 4 s; measured with a continuous output: 4.5 s, final estimate 1.99717, final state error 2.83e-3."""
    assert summary["settling_time_2_percent"] <= 6.5
    assert summary["max_disturbance_error_from_12_s"] <= 0.01
    assert summary["final_disturbance_error"] <= 0.01
    assert summary["final_state_error"] <= 5e-3
    assert summary["peak_estimate"] <= 10.0


def test_without_the_schedule_the_estimate_peaks(summary):
    assert summary["peak_estimate_without_schedule"] > 1e5


def test_the_everyday_method_needs_neither_seconds_nor_a_schedule(summary):
    everyday = summary["sampled_data"]
    assert everyday["settling_time_2_percent"] <= 10 * summary["step_size"]
    assert everyday["peak_estimate"] <= 15.0
    assert everyday["final_disturbance_error"] <= 1e-7


@pytest.fixture(scope="module")
def without_compiler(flexible_joint, tmp_path_factory):
    """Run a short demo where nothing compiles native FMUs; return the folder and the summary."""
    folder = tmp_path_factory.mktemp("short")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(compilers.importlib.util, "find_spec", lambda _: None)
        patch.setattr(compilers.shutil, "which", lambda _: None)
        summary = run_demo(
            flexible_joint.system, folder / "r", native=lambda: build_native_demo(folder / "native"), stop_time=0.1
        )
    return folder, summary


@C_COMPILER
def test_native_fmus_give_the_same_signals_in_less_time(summary):
    """Without noise; the times are processor times, and include loading the FMUs."""
    for run in summary["native"].values():
        assert run["difference"] <= 1e-6
        assert run["native_seconds"] <= run["python_seconds"] / 3


def test_where_nothing_compiles_native_fmus_the_demo_says_so_in_one_line(without_compiler):
    folder, summary = without_compiler
    line = _builds_compared(summary["native"])
    assert line.startswith("  not compared with native FMUs: --platforms ")
    assert "received none; likely cause: the extra is not installed: pip install 'ndob-fmu[native]'" in line
    assert len(line.splitlines()) == 1
    assert [path for path in (folder / "native").rglob("*") if path.is_file()] == []


def test_the_summary_tells_how_it_was_made(summary):
    assert summary["step_size"] == 1e-3
    assert summary["stop_time"] == 20.0
    assert summary["wall_time"] > 0.0
    assert {"python", "ndob-fmu", "fmpy", "pythonfmu", "numpy"} <= set(summary["versions"])
    assert isinstance(summary["method"], str)


def test_the_summary_agrees_with_the_table(summary, table):
    error = np.abs(table["observer.load_torque_hat"] - table["plant.load_torque_total"])
    outside = np.flatnonzero(error > 0.02 * 2.0)
    assert summary["settling_time_2_percent"] == table["time"][outside[-1] + 1]
    assert summary["max_disturbance_error_from_12_s"] == error[table["time"] >= 12.0].max()
    assert summary["final_disturbance_error"] == error[-1]
    state_error = np.linalg.norm([table[f"plant.{x}"] - table[f"observer.{x}_hat"] for x in STATES], axis=0)
    assert summary["final_state_error"] == pytest.approx(state_error[-1], rel=1e-12)
    assert summary["max_state_error"] == pytest.approx(state_error.max(), rel=1e-12)


def test_the_table_has_a_row_per_communication_point_and_time_first(table):
    assert table.dtype.names[0] == "time"
    assert {name.split(".")[0] for name in table.dtype.names[1:]} == {"plant", "observer"}
    np.testing.assert_array_equal(table["time"], np.arange(20001) * 1e-3)
    assert [table[f"plant.{state}"][0] for state in STATES] == [1.0] * 4
    assert [table[f"observer.{state}_hat"][0] for state in STATES] == [-1.0] * 4
    assert set(table["plant.load_torque_total"]) == {2.0}
    assert set(table["observer.valid"]) == {1.0}


@pytest.mark.parametrize("name", FIGURES)
def test_the_figures_are_images_of_a_size_for_a_report(demo, name):
    data = (demo / "results" / "flexible_joint" / name).read_bytes()
    assert data.startswith(b"\x89PNG")
    assert 10_000 < len(data) < 300_000


@pytest.mark.parametrize("name", PUBLISHED)
def test_the_figures_are_also_vectors_whose_labels_are_text_with_units(demo, name):
    drawing = (demo / "results" / "flexible_joint" / name).read_text("utf-8")
    assert drawing.startswith("<?xml")
    assert re.search(r"<text[^>]*>time \[s\]</text>", drawing)
    assert len(drawing) < 1_000_000


def test_the_summary_has_every_parameter_and_unit(summary):
    assert summary["parameters"]["observer.method"] == "paper"
    assert summary["parameters"]["plant.disturbance.amplitude"] == 2.0
    assert summary["units"]["plant.load_torque_total"] == "N.m"


def test_a_shorter_run_leaves_out_what_it_cannot_know(flexible_joint, tmp_path):
    results = tmp_path / "new" / "folder"
    summary = run_demo(flexible_joint.system, results, stop_time=0.5, step_size=5e-3)
    assert summary["settling_time_2_percent"] is None
    assert summary["max_disturbance_error_from_12_s"] is None
    assert (summary["step_size"], summary["stop_time"]) == (5e-3, 0.5)
    assert sorted(path.name for path in results.iterdir()) == sorted([*FIGURES, *PUBLISHED, *DATA])
    written = json.loads((results / "summary.json").read_text("utf-8"))
    assert written.keys() == {*summary, "result_sha256", "sha256"}
    assert len(read_csv(results / "result.csv")) == 101


def test_the_same_run_gives_the_same_table(flexible_joint, without_compiler, tmp_path):
    run_demo(flexible_joint.system, tmp_path, stop_time=0.1)
    assert (tmp_path / "result.csv").read_bytes() == (without_compiler[0] / "r" / "result.csv").read_bytes()


@pytest.mark.parametrize(
    ("estimate", "settled"),
    [
        ([2.0, 2.0, 2.0, 2.0], 0.0),
        ([0.0, 2.0, 1.9, 2.03], 3.0),
        ([0.0, 1.97, 2.03, 2.0], 1.0),
        ([2.0, 2.0, 2.0, 0.0], None),
    ],
)
def test_settling_is_the_time_after_which_the_error_never_leaves_its_band(estimate, settled):
    signals = {f"plant.{state}": np.zeros(4) for state in STATES}
    signals |= {f"observer.{state}_hat": np.zeros(4) for state in STATES}
    signals |= {"plant.load_torque_total": np.full(4, 2.0), "observer.load_torque_hat": np.array(estimate)}
    recording = Recording(np.arange(4.0), tuple(signals), np.column_stack(list(signals.values())))
    assert example_results(recording).settling_time == settled
