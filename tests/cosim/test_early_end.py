"""Runs that an FMU ends before the stop time, and what is kept of runs that fail."""

from __future__ import annotations

import json

import numpy as np
import pytest

from ndob_fmu.cli import main
from ndob_fmu.cosim import FmuComponent, System, simulate
from ndob_fmu.cosim.component import Ended
from ndob_fmu.errors import SimulationError
from ndob_fmu.results.csv_files import read_csv
from tests.helpers.coupling_fmus import coupling_fmus
from tests.helpers.mock_components import Mock, constant, integrator, ramp
from tests.helpers.needs import C_COMPILER

pytestmark = C_COMPILER

SCHEMES = ["jacobi", "gauss-seidel", "extrapolation"]
END, END_WITHOUT_TIME, DISCARD, FAIL, WITHHOLD, END_TOO_LATE, END_AT_NAN, SILENT = range(1, 9)  # what Ramp.fmu does


@pytest.fixture(scope="session")
def fmus(tmp_path_factory):
    return coupling_fmus(tmp_path_factory.getbasetemp())


@pytest.fixture(autouse=True)
def own_folder(nothing_left_behind, tmp_path, monkeypatch):
    (tmp_path / "own").mkdir()
    monkeypatch.chdir(tmp_path / "own")


def clock_until(end, **more):
    """y = t, that ends the simulation at `end`."""

    def advance(x, u, t, h):
        return min(t + h, end)

    def ends(t, h):
        return Ended(end, "the top is reached") if t + h >= end - 1e-12 else None

    return Mock([], ["y"], output=lambda x, u: [x], step=advance, ends=ends, x=0.0, **more)


@pytest.mark.parametrize("order", [("a", "end", "b"), ("end", "a", "b"), ("a", "b", "end")])
@pytest.mark.parametrize("scheme", SCHEMES)
def test_a_component_that_ends_inside_a_step_is_in_the_last_row_and_the_others_where_they_last_met(scheme, order):
    parts = {"a": ramp(), "end": clock_until(0.35), "b": ramp()}
    recording = simulate(System({name: parts[name] for name in order}), stop_time=1.0, step_size=0.1, scheme=scheme)
    np.testing.assert_allclose(recording.time, [0, 0.1, 0.2, 0.3, 0.35], rtol=1e-15)
    np.testing.assert_allclose(recording["end.y"], [0, 0.1, 0.2, 0.3, 0.35], rtol=1e-15)
    for name in ("a", "b"):
        np.testing.assert_allclose(recording[f"{name}.y"], [0, 0.1, 0.2, 0.3, 0.3], rtol=1e-15)
    assert recording.ended_early == "component end ended the simulation at t = 0.35 s: the top is reached"
    assert [part.calls[-1] for part in parts.values()] == ["close"] * 3


@pytest.mark.parametrize("scheme", SCHEMES)
def test_a_component_that_ends_at_a_communication_point_adds_no_row_and_all_others_get_there(scheme):
    """Also where the component has added its steps up, and is off by rounding."""
    system = System({"a": ramp(), "end": clock_until(0.1 + 0.2), "b": ramp()})
    recording = simulate(system, stop_time=1.0, step_size=0.1, scheme=scheme)
    assert len(recording.time) == 4
    for name in ("a", "end", "b"):
        np.testing.assert_allclose(recording[f"{name}.y"], recording.time, rtol=1e-15)
    assert recording.ended_early


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize(("end", "met"), [(0.75, 0.75), (0.8, 0.75)])
def test_between_two_recorded_rows_the_last_one_is_that_of_the_ending(scheme, end, met):
    system = System({"a": ramp(), "end": clock_until(end)})
    recording = simulate(system, stop_time=1.0, step_size=0.125, output_interval=0.5, scheme=scheme)
    np.testing.assert_array_equal(recording.time, [0, 0.5, end])
    np.testing.assert_array_equal(recording["end.y"], [0, 0.5, end])
    np.testing.assert_array_equal(recording["a.y"], [0, 0.5, met])


def test_an_end_after_the_last_recorded_row_at_the_stop_time_is_no_early_one():
    recording = simulate(
        System({"a": ramp(), "end": clock_until(0.875)}), stop_time=0.875, step_size=0.125, output_interval=0.25
    )
    np.testing.assert_array_equal(recording.time, [0, 0.25, 0.5, 0.75])
    assert recording.ended_early == ""  # it ended with the run


@pytest.mark.parametrize("end", [0.5, 0.6, 0.8])
def test_a_slow_component_may_end_later_than_the_step_of_the_others(end):
    system = System({"end": clock_until(end), "a": ramp()}, step_ratios={"end": 4})
    recording = simulate(system, stop_time=2.0, step_size=0.1)
    whole = [k for k in range(9) if k * 0.1 <= end + 1e-9]
    assert recording.time[-1] == pytest.approx(end)
    np.testing.assert_allclose(recording["a.y"][: len(whole)], np.multiply(whole, 0.1), atol=1e-15)
    # Its outputs appear at the end of its steps, 0.4 s, and where it has ended.
    np.testing.assert_allclose(recording["end.y"], [0, 0, 0, 0, *[0.4] * (len(recording.time) - 5), end], atol=1e-15)


def test_rows_that_the_others_have_made_after_the_end_are_dropped():
    """With gauss-seidel a slow component steps when the others have got to the end of its step."""
    system = System({"a": ramp(), "end": clock_until(0.25)}, step_ratios={"end": 4})
    recording = simulate(system, stop_time=2.0, step_size=0.1, scheme="gauss-seidel")
    np.testing.assert_allclose(recording.time, [0, 0.1, 0.2, 0.25], rtol=1e-15)
    np.testing.assert_allclose(recording["a.y"], [0, 0.1, 0.2, 0.2], rtol=1e-15)
    np.testing.assert_allclose(recording["end.y"], [0, 0, 0, 0.25], rtol=1e-15)


def test_an_end_at_the_stop_time_is_no_early_one():
    recording = simulate(System({"end": clock_until(1.0)}), stop_time=1.0, step_size=0.25)
    np.testing.assert_array_equal(recording["end.y"], [0, 0.25, 0.5, 0.75, 1.0])
    assert recording.ended_early == ""


# -- FMUs


def test_an_fmu_that_ends_the_simulation_is_asked_when_and_ends_the_run_normally(fmus, caplog):
    recording = simulate(fmus / "Ramp.fmu", step_size=0.1, start_values={"u": 2, "how": END, "ends_at": 0.35})
    np.testing.assert_allclose(recording.time, [0, 0.1, 0.2, 0.3, 0.35], rtol=1e-15)
    np.testing.assert_allclose(recording["Ramp.x"], 2 * recording.time, rtol=1e-15)
    said = "component Ramp ended the simulation at t = 0.35 s: the top is reached"
    assert recording.ended_early == said
    assert [record.getMessage() for record in caplog.records] == [said]


@pytest.mark.parametrize(("how", "end"), [(END_WITHOUT_TIME, 0.3), (END_AT_NAN, 0.3), (END_TOO_LATE, 0.4)])
def test_an_fmu_that_says_no_time_or_one_outside_its_step_has_ended_within_the_step(fmus, how, end):
    recording = simulate(fmus / "Ramp.fmu", start_values={"u": 1, "how": how, "ends_at": 0.35})
    assert recording.time[-1] == pytest.approx(end)
    assert recording.ended_early == f"component Ramp ended the simulation at t = {end} s: the top is reached"


def test_an_fmu_that_gives_no_values_at_its_end_leaves_the_rows_before(fmus):
    recording = simulate(fmus / "Ramp.fmu", start_values={"u": 1, "how": WITHHOLD, "ends_at": 0.35})
    np.testing.assert_allclose(recording.time, [0, 0.1, 0.2, 0.3], rtol=1e-15)
    assert "t = 0.35 s" in recording.ended_early


def test_an_fmu_of_pythonfmu_that_returns_false_has_ended_the_simulation(fmus):
    """It answers fmi2Terminated with true, and fmi2LastSuccessfulTime with the beginning of the step."""
    system = System({"a": ramp(), "bearing": FmuComponent(fmus / "Fragile.fmu")})
    starts = {"bearing.how": "discard", "bearing.fails_at": 0.25}
    recording = simulate(system, stop_time=1.0, step_size=0.1, start_values=starts)
    np.testing.assert_allclose(recording["a.y"], [0, 0.1, 0.2, 0.3], rtol=1e-15)
    assert recording.ended_early == (
        "component bearing ended the simulation at t = 0.3 s: step too long for the contact"
    )


@pytest.mark.parametrize("how", [DISCARD, SILENT])
def test_a_step_that_is_discarded_for_another_reason_is_a_failure(fmus, how):
    with pytest.raises(SimulationError, match=r"component Ramp at t = 0\.3 s: .*received discard.*the top is reached"):
        simulate(fmus / "Ramp.fmu", start_values={"u": 1, "how": how, "ends_at": 0.35})


def test_an_fmu_that_ended_one_run_makes_the_next_one(fmus):
    component = FmuComponent(fmus / "Ramp.fmu", "r")
    run = {"stop_time": 1.0, "step_size": 0.1}
    with component.kept():
        for how, rows in ((END, 5), (0, 11), (WITHHOLD, 4), (0, 11)):
            starts = {"r.u": 1, "r.how": how, "r.ends_at": 0.35}
            assert len(simulate(System({"r": component}), start_values=starts, **run).time) == rows


# -- failures


@pytest.mark.parametrize("scheme", SCHEMES)
def test_a_step_that_fails_leaves_what_was_recorded_before_in_the_error(fmus, scheme):
    system = System({"one": constant(1.0), "sum": integrator(), "ramp": FmuComponent(fmus / "Ramp.fmu")})
    system = System(system.components, ((("one", "y"), ("sum", "u")),), outputs={"total": (("sum", "y"), 2.0, 0.0)})
    starts = {"ramp.u": 1, "ramp.how": FAIL, "ramp.ends_at": 0.35}
    with pytest.raises(SimulationError) as failed:
        simulate(system, stop_time=1.0, step_size=0.1, start_values=starts, scheme=scheme)
    recording = failed.value.recording
    np.testing.assert_allclose(recording.time, [0, 0.1, 0.2, 0.3], rtol=1e-15)
    np.testing.assert_allclose(recording["ramp.x"], recording.time, rtol=1e-15)
    np.testing.assert_allclose(recording["total"], 2 * recording.time, rtol=1e-15)


def test_a_run_that_fails_before_its_first_row_leaves_nothing(fmus):
    with pytest.raises(SimulationError) as failed:
        simulate(fmus / "Fragile.fmu", stop_time=1.0, step_size=0.1, start_values={"how": "initialization"})
    assert failed.value.recording is None


# -- the command


def values(how, end="0.35"):
    return ["--start-values", "u", "1", "how", str(how), "ends_at", end]


def test_the_command_writes_the_rows_up_to_the_end_says_so_in_one_line_and_succeeds(fmus, capfd, caplog):
    assert main(["simulate", str(fmus / "Ramp.fmu"), *values(END), "--output-file", "out.csv"]) == 0
    assert capfd.readouterr().out == "out.csv: 5 rows of 2 signals, 0 to 0.35 s\n"
    assert [record.getMessage() for record in caplog.records] == [
        "component Ramp ended the simulation at t = 0.35 s: the top is reached"
    ]
    np.testing.assert_allclose(read_csv("out.csv")["Ramp.x"], [0, 0.1, 0.2, 0.3, 0.35], rtol=1e-15)


def test_the_command_writes_the_rows_before_a_failure_and_fails(fmus, capsys):
    assert main(["simulate", str(fmus / "Ramp.fmu"), *values(FAIL), "--output-file", "out.csv"]) == 1
    said = capsys.readouterr()
    assert said.out == "out.csv: 4 rows of 2 signals, 0 to 0.3 s, as far as the simulation came\n"
    assert said.err.count("\n") == 1
    assert "component Ramp at t = 0.3 s: expected fmi2DoStep to succeed, received error" in said.err
    np.testing.assert_allclose(read_csv("out.csv").time, [0, 0.1, 0.2, 0.3], rtol=1e-15)


@pytest.mark.parametrize(
    ("how", "end", "code", "stop_time"),
    [
        (END, "0.35", 0, 0.35),
        (FAIL, "0.35", 1, 0.3),
        (END, "0.0", 0, 0.0),
        (END, "0.05", 0, 0.05),
        (FAIL, "0.0", 1, 0.0),
    ],
)
def test_a_folder_of_results_says_how_the_run_ended(fmus, tmp_path, how, end, code, stop_time):
    (tmp_path / "own/u.csv").write_text("time,u\n0,1\n0.2,1\n")
    command = ["simulate", str(fmus / "Ramp.fmu"), *values(how, end), "--input-file", "u.csv", "--results", "r"]
    assert main(command) == code
    summary = json.loads((tmp_path / "own/r/summary.json").read_text())
    assert (summary["step_size"], summary["stop_time"]) == (0.1, pytest.approx(stop_time))
    assert "output_interval" not in summary
    assert (summary["ended_early"] is None, summary["failed"] is None) == (how != END, how == END)
    assert read_csv("r/result.csv").time[-1] == pytest.approx(stop_time)
    assert (tmp_path / "own/r/signals.png").exists()
    assert main(["report", "r"]) == 0


def test_the_command_passes_the_tolerance_on(fmus):
    words = ["--start-values", "u", "0", "--tolerance", "1e-7", "--output-file", "out.csv"]
    assert main(["simulate", str(fmus / "Ramp.fmu"), *words]) == 0
    assert read_csv("out.csv")["Ramp.tolerance"][0] == 1e-7
