"""What a study file says: the points, the measures, and one line for each mistake."""

from __future__ import annotations

import logging
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ndob_fmu.cosim import FmuComponent, System, simulate
from ndob_fmu.cosim.fmi import fmu_component
from ndob_fmu.errors import CouplingError, UsageError
from ndob_fmu.packages import write_ssp
from ndob_fmu.results.recording import Recording
from ndob_fmu.study import read_study
from ndob_fmu.study.measures import TAKES, Measure
from ndob_fmu.study.points import Points, Range, grid, latin_hypercube, listed, random
from ndob_fmu.study.session import Session
from ndob_fmu.study.store import Store, read_runs
from ndob_fmu.study.workers import StudyPlugin
from tests.helpers.coupling_fmus import coupling_fmus
from tests.helpers.needs import C_COMPILER
from tests.helpers.study_files import SLOW, WALK, write


@pytest.fixture(scope="session")
def fmus(tmp_path_factory):
    return coupling_fmus(tmp_path_factory.getbasetemp())


def test_a_grid_has_every_combination_and_a_list_its_rows_and_tables_multiply():
    points = Points((grid({"a": [1, 2], "b": ["x", "y", "z"]}), listed({"c": [10, 20], "d": [True, False]})))
    assert len(points) == 12
    assert points[0] == {"a": 1, "b": "x", "c": 10, "d": True}
    assert points[1] == {"a": 1, "b": "x", "c": 20, "d": False}
    assert points[11] == {"a": 2, "b": "z", "c": 20, "d": False}
    assert len({tuple(points[run].items()) for run in range(12)}) == 12


def test_a_latin_hypercube_has_one_point_in_each_slice_of_every_range():
    ranges = {"a": Range(1e-6, 1e-2, log=True), "b": Range(-3.0, 5.0)}
    points = np.array(latin_hypercube(ranges, 40, seed=7).rows)
    slices = {"a": np.log(points[:, 0] / 1e-6) / np.log(1e4) * 40, "b": (points[:, 1] + 3.0) / 8.0 * 40}
    for positions in slices.values():
        assert sorted(positions.astype(int)) == list(range(40))


def test_a_hypercube_and_random_draws_of_one_study_are_independent():
    ranges = {"a": Range(0.0, 1.0)}
    cube, drawn = (np.array(draw(ranges, 400, seed=5).rows)[:, 0] for draw in (latin_hypercube, random))
    assert abs(np.corrcoef(cube, drawn)[0, 1]) < 4 / np.sqrt(400)
    within = cube * 400 % 1
    assert abs(np.corrcoef(within, drawn)[0, 1]) < 4 / np.sqrt(400)


def test_random_draws_have_the_distribution_that_is_asked_for():
    ranges = {"normal": Range(5.0, 2.0, normal=True), "log": Range(1.0, 100.0, log=True)}
    normal, log = np.array(random(ranges, 4000, seed=3).rows).T
    assert normal.mean() == pytest.approx(5.0, abs=4 * 2.0 / np.sqrt(4000))
    assert normal.std() == pytest.approx(2.0, rel=0.06)
    assert np.log10(log).mean() == pytest.approx(1.0, abs=4 * 0.58 / np.sqrt(4000))
    assert (log.min() >= 1.0) & (log.max() <= 100.0)


@pytest.mark.parametrize("draw", [latin_hypercube, random])
def test_the_seed_decides_what_is_drawn(draw):
    ranges = {"a": Range(0.0, 1.0), "b": Range(0.0, 1.0)}
    assert draw(ranges, 5, seed=1) == draw(ranges, 5, seed=1)
    assert draw(ranges, 5, seed=1) != draw(ranges, 5, seed=2)


def recording():
    time = np.array([0.0, 1.0, 2.0, 3.0])
    return Recording(time, ("p.d", "o.d"), np.array([[2.0, -5.0], [2.0, 2.5], [2.0, 2.01], [2.0, 1.98]]))


@pytest.mark.parametrize(
    ("take", "expected"),
    [
        ("final", -0.02),
        ("min", -7.0),
        ("max", 0.5),
        ("mean", (-7.0 + 0.5 + 0.01 - 0.02) / 4),
        ("max_abs", 7.0),
        ("rms", np.sqrt((49.0 + 0.25 + 1e-4 + 4e-4) / 4)),
        ("std", np.std([-7.0, 0.5, 0.01, -0.02])),
        ("settling_time", 2.0),
    ],
)
def test_a_measure_is_the_number_it_names(take, expected):
    assert Measure("o.d", take, "p.d")(recording()) == pytest.approx(expected, rel=1e-12)


def test_every_measure_there_is_has_been_tried():
    tried = test_a_measure_is_the_number_it_names.pytestmark[0].args[1]
    assert {take for take, _ in tried} == set(TAKES)


def test_measures_begin_where_they_are_told_and_know_no_number_of_what_is_not_finite():
    assert Measure("o.d", "max_abs", "p.d", after=2.0)(recording()) == pytest.approx(0.02)
    assert np.isnan(Measure("o.d", "mean", after=9.0)(recording()))
    lost = Recording(np.array([0.0, 1.0]), ("o.d",), np.array([[np.nan], [1.0]]))
    assert np.isnan(Measure("o.d", "max")(lost))
    assert Measure("o.d", "settling_time", "p.d", within=1e-3)(recording()) == np.inf
    assert Measure("o.d", "settling_time", within=0.3)(recording()) == 1.0


def test_a_study_file_is_read_with_its_units_and_dots_and_paths(flexible_joint, tmp_path):
    text = """
system = "SYSTEM"
seed = 3
record = ["observer.load_torque_hat"]
[simulation]
stop_time = 0.2
[fixed.observer]
method = 2
[grid]
plant.disturbance.kind = ["sine", "step"]
"observer.disturbance_order" = [1, 2]
step_size = [1e-3, 5e-3]
[random]
runs = 2
plant.joint_stiffness = { mean = 1.0, std = 0.1 }
[measures.error]
of = "observer.load_torque_hat"
minus = "plant.load_torque_total"
take = "rms"
"""
    (tmp_path / "s.toml").write_text(text.replace("SYSTEM", str(flexible_joint.system)), "utf-8")
    study = read_study(tmp_path / "s.toml")
    assert study.fixed == {"observer.method": 2}
    assert len(study.points) == 16
    first = study.points[0]
    assert list(first)[:3] == ["plant.disturbance.kind", "observer.disturbance_order", "step_size"]
    assert first["plant.joint_stiffness"] == study.points[2]["plant.joint_stiffness"]  # the same draws everywhere
    assert study.units["error"] == "N.m"
    assert study.units["step_size"] == "s"
    assert study.record == ("observer.load_torque_hat",)


@C_COMPILER
def test_a_session_loads_each_fmu_once_and_again_only_after_a_failure(fmus, tmp_path, monkeypatch):
    make, folders = fmu_component.instantiate, []
    monkeypatch.setattr(
        fmu_component, "instantiate", lambda folder, *given: (folders.append(folder), make(folder, *given))[1]
    )
    text = SLOW.split("[fixed]")[0] + '[list]\nhow = ["", "discard", "", "raise", ""]\n'
    study = read_study(write(tmp_path, "s", text, fmus))
    session = Session(study, {study.system: Path(study.system)})
    rows = [session.run(run) for run in range(5)]
    session.close()
    assert [row["failed"] for row in rows] == [False, False, False, True, False]
    assert len(folders) == 2
    assert not any(folder.exists() for folder in folders)


RAMP = """
system = "{fmus}/Ramp.fmu"
[simulation]
tolerance = 1e-9
strict = true
[fixed]
how = 0
[grid]
u = [1.0, 2.0]
[measures]
tolerance = {{ of = "Ramp.tolerance", take = "final" }}
"""


@C_COMPILER
def test_the_tolerance_of_a_study_gets_to_the_fmus(fmus, tmp_path):
    study = read_study(write(tmp_path, "s", RAMP, fmus))
    session = Session(study, {study.system: Path(study.system)})
    assert [session.run(run)["tolerance"] for run in range(2)] == [1e-9, 1e-9]
    session.close()


@C_COMPILER
def test_inputs_that_nothing_drives_are_named_once_for_a_study_and_refused_where_it_is_strict(fmus, tmp_path, caplog):
    undriven = RAMP.replace("u = [1.0, 2.0]", "how = [0]").replace("[fixed]\nhow = 0\n", "")
    with pytest.raises(CouplingError, match=r"s\.toml, \[simulation\]: input Ramp\.u: expected a connection"):
        read_study(write(tmp_path, "s", undriven, fmus))
    caplog.clear()
    study = read_study(write(tmp_path, "s", undriven.replace("strict = true", ""), fmus))
    assert [record.getMessage() for record in caplog.records] == [
        "nothing drives the input Ramp.u; it keeps its own start value"
    ]
    session = Session(
        replace(study, simulation=replace(study.simulation, strict=True)), {study.system: fmus / "Ramp.fmu"}
    )
    assert "input Ramp.u: expected a connection" in session.run(0)["reason"]
    session.close()


@C_COMPILER
def test_workers_do_not_repeat_warnings_run_by_run(fmus, tmp_path):
    study = read_study(write(tmp_path, "s", RAMP, fmus))
    log, plugin = logging.getLogger("ndob_fmu.cosim"), StudyPlugin(study, own=False)
    before = log.level
    try:
        plugin.setup(None)
        assert not logging.getLogger("ndob_fmu.cosim.simulation").isEnabledFor(logging.WARNING)
    finally:
        plugin.teardown(None)
        log.setLevel(before)


@C_COMPILER
@pytest.mark.parametrize("tolerance", ["0", "-1e-6", "nan", "inf", "true", '"fine"'])
def test_a_tolerance_of_a_study_that_is_not_a_positive_number_is_refused(fmus, tmp_path, tolerance):
    with pytest.raises(UsageError, match=r"\[simulation\], tolerance: expected a (finite )?number > 0"):
        read_study(write(tmp_path, "s", RAMP.replace("1e-9", tolerance), fmus))


def test_components_keep_their_own_step_where_the_communication_step_varies(fmus, tmp_path):
    system = System().add("slow", fmus / "Integrator.fmu", {"u": 1.0}, step_ratio=2)
    system = system.add("fast", fmus / "Integrator.fmu", {"u": 1.0})
    path = write_ssp(system, tmp_path / "rates.ssp", stop_time=2.0, step_size=0.25)
    text = f'system = "{path}"\n[grid]\nstep_size = [0.25, 0.125, 0.5]\n'
    study = read_study(write(tmp_path, "rates", text.replace("{", "{{").replace("}", "}}"), fmus))
    session = Session(study, {study.system: path})
    monitored = ("slow.y", "fast.y", "slow.half")
    for run, step_size in enumerate((0.25, 0.125, 0.5)):
        row, recording = session.run(run), simulate(path, step_size=step_size)
        assert [row[name] for name in monitored] == [recording[name][-1] for name in monitored], row
        assert session.system_for(step_size).step_ratios.get("slow", 1) == round(0.5 / step_size)
    session.close()
    with pytest.raises((UsageError, CouplingError), match=r"0\.2"):
        read_study(write(tmp_path, "odd", text.replace("0.125", "0.2"), fmus))


def test_whatever_a_run_dies_of_is_the_reason_of_that_run_only(fmus, tmp_path, monkeypatch):
    study = read_study(write(tmp_path, "walk", WALK, fmus))
    session = Session(study, {study.system: Path(study.system)})

    def broken(*_):
        raise OSError("access violation reading 0x0")

    with monkeypatch.context() as patched:
        patched.setattr(FmuComponent, "step", broken)
        assert session.run(3)["reason"] == "OSError: access violation reading 0x0"
    assert session.run(4)["failed"] is False
    session.close()


def test_failed_runs_that_are_done_again_take_no_other_run_of_their_shard_away(fmus, tmp_path):
    study = read_study(write(tmp_path, "walk", WALK, fmus))

    def row(run, failed):
        return {"run": run, **study.points[run], "end": float(run), "least": 0.0, "failed": failed, "wall_time": 0.1}

    store = Store(tmp_path / "r", study)
    store.save([row(run, run in (0, 4)) for run in range(5)])
    store = Store(tmp_path / "r", study)
    assert np.flatnonzero(store.failed).tolist() == [0, 4]
    store.forget_failures()
    assert np.flatnonzero(store.finished).tolist() == [1, 2, 3]
    store.save([row(0, False), row(4, True)])
    store = Store(tmp_path / "r", study)
    assert np.flatnonzero(store.finished).tolist() == [0, 1, 2, 3, 4]
    assert np.flatnonzero(store.failed).tolist() == [4]
    rows = read_runs(tmp_path / "r").to_pylist()
    assert [(row["run"], row["failed"]) for row in rows] == [(0, False), (1, False), (2, False), (3, False), (4, True)]


def test_the_example_study_is_one(flexible_joint, tmp_path):
    text = (Path(__file__).parents[2] / "examples" / "tuning_study.toml").read_text("utf-8")
    assert "../build/ssp/open_loop.ssp" in text
    path = tmp_path / "tuning_study.toml"
    path.write_text(text.replace("../build/ssp/open_loop.ssp", str(flexible_joint.system)), "utf-8")
    study = read_study(path)
    assert len(study.points) == 120  # as README.md says
    assert set(study.measures) == {"error", "worst", "settling"}


def test_without_measures_the_last_value_of_every_output_is_kept(fmus, tmp_path):
    study = read_study(write(tmp_path, "walk", WALK.split("[measures]")[0], fmus))
    assert set(study.measures) == {"Integrator.y", "Integrator.half", "Integrator.positive"}


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("stop_time = 1.0", "stop_time = = 1", ["expected TOML", "line 4"]),
        ("stop_time", "stop_tim", ["[simulation]", "'stop_tim'", "did you mean 'stop_time'?"]),
        ("[grid]", "[gird]", ["'gird'", "did you mean 'grid'?"]),
        ("u = [", "uu = [", ["'uu'", "Integrator"]),
        ("u = [1.0, 2.0, -3.0]", "u = 1.0", ["[grid], u", "a list of values", "belongs in [fixed]"]),
        ("u = [1.0, 2.0, -3.0]", 'u = [1.0, "fast"]', ["u: expected a number", "'fast'"]),
        ("u = [1.0, 2.0, -3.0]", "u = [1.0, nan]", ["finite"]),
        ("u = [1.0, 2.0, -3.0]", "u = [1.0, 1.0]", ["different values"]),
        ("u = [1.0, 2.0, -3.0]", "half = [1.0]", ["takes a start value", "output"]),
        ("u = [1.0, 2.0, -3.0]", "y = [1.0]", ["y in one place"]),
        ("step_size = [0.125, 0.25]", "step_size = [0.125, 0.3]", ["whole number of steps", "0.3"]),
        ("runs = 4", "", ["[latin_hypercube]", "runs"]),
        ("runs = 4", "runs = 0", ["runs", "from 1 to 1000000", "0"]),
        ("runs = 4", "runs = 10_000_000", ["runs", "from 1 to 1000000"]),
        ("runs = 4", "runs = 1_000_000", ["at most 1000000 runs", "6000000"]),
        ("runs = 4", "runs = 1e4", ["runs: expected a whole number", "10000.0"]),
        ("u = [1.0, 2.0, -3.0]", "u = {{ from = 0, to = 1, values = 1e12 }}", ["u, values: expected a whole number"]),
        ("u = [1.0, 2.0, -3.0]", "u = {{ from = 0, to = 1, values = 1_000_000_000_000 }}", ["from 2 to 1000000"]),
        ("u = [1.0, 2.0, -3.0]", "u = {{ from = -1e308, to = 1e308, values = 3 }}", ["u, to", "finite distance"]),
        ("u = [1.0, 2.0, -3.0]", f"u = [{'9' * 5000}]", ["at most 64 bits"]),
        ("u = [1.0, 2.0, -3.0]", f"u = [{'9' * 100}]", ["at most 64 bits"]),
        ("u = [1.0, 2.0, -3.0]", f"u = {'[' * 5000}{']' * 5000}", ["nested at most 20 levels"]),
        ("u = [1.0, 2.0, -3.0]", f"u = {'[' * 50}{']' * 50}", ["nested at most 20 levels"]),
        ("u = [1.0, 2.0, -3.0]", f"{'u.' * 5000}u = 1", ["nested at most 20 levels"]),
        (
            "u = [1.0, 2.0, -3.0]",
            "u = [1.0, 2.0]\nIntegrator.u = [3.0, 4.0]",
            ["one name that sets it"],
        ),
        ("[simulation]", "seed = -5\n[simulation]", ["seed: expected a whole number from 0", "-5"]),
        ("[simulation]", "order = [1, 2]\nscheme = 'gauss-seidel'", ["'order'"]),
        ("stop_time = 1.0", "stop_time = 1.0\norder = [1, 2]", ["order: expected a list of components", "[1, 2]"]),
        ("stop_time = 1.0", "stop_time = 1.0\nstep_size = 0.0", ["expected step_size in one place"]),
        ("stop_time = 1.0", "stop_time = nan", ["stop_time: expected a number of seconds that is finite"]),
        ("stop_time = 1.0", 'stop_time = 1.0\ninput_file = "a\\u0000b"', ["input_file: expected the path"]),
        ("[simulation]", "record = ['y', 'y']\n[simulation]", ["record: expected a list of signals, each once"]),
        ("[grid]", "[fixed]\nhalf = [1.0]\n[grid]", ["[fixed], half: expected one number"]),
        ("[grid]", "[fixed]\nhalf = nan\n[grid]", ["[fixed], half: expected a finite number"]),
        ('y = {{ from = 1.0, to = 100.0, scale = "log" }}', "y = {{ mean = nan, std = 1 }}", ["y, mean", "finite"]),
        ('y = {{ from = 1.0, to = 100.0, scale = "log" }}', "y = {{ mean = 1, std = inf }}", ["y, std", "finite"]),
        ("after = 0.75", "after = 1.25", ["[least], after: expected a time up to the last row, 1.0 s", "1.25 s"]),
        ("after = 0.75", "within = nan", ["[least], within", "finite"]),
        ("after = 0.75", "within = -0.1", ["[least], within: expected a positive share"]),
        ("from = 1.0", "from = -1.0", ["positive number", "logarithmic"]),
        ("to = 100.0", "too = 100.0", ["'too'", "did you mean 'to'?"]),
        ("to = 100.0", "to = 0.5", ["above 1.0"]),
        ('"log"', '"ln"', ["'linear' or 'log'", "'ln'"]),
        ('take = "final"', 'take = "last"', ["take", "final, min", "'last'"]),
        ('of = "Integrator.y", t', 'of = "Integrator.yy", t', ["measure end", "did you mean 'y'?"]),
        ('of = "Integrator.y", t', 'of = "Integrator.u", t', ["measure end", "a numeric output"]),
        ("least", "reason", ["new name", "'reason'"]),
        ("Integrator.fmu", "Integrater.fmu", ["Integrater.fmu", "can be read"]),
    ],
)
def test_a_mistake_in_a_study_file_is_answered_in_one_line(fmus, tmp_path, old, new, words):
    assert old in WALK
    path = write(tmp_path, "walk", WALK.replace(old, new, 1), fmus)
    with pytest.raises((UsageError, CouplingError)) as refused:
        read_study(path)
    message = str(refused.value)
    assert "\n" not in message
    assert all(word in message for word in words), message
    if "Integrater" not in new:
        assert "walk.toml" in message


def test_a_list_needs_as_many_values_for_each_name(fmus, tmp_path):
    path = write(tmp_path, "s", SLOW.replace('how = "slow"', "").replace("[list]", '[list]\nhow = ["", "slow"]'), fmus)
    with pytest.raises(UsageError, match=r"as many values for each name, received 2 for how, 60 for fails_at"):
        read_study(path)


def test_a_study_that_varies_nothing_and_one_that_is_not_there_are_refused(fmus, tmp_path):
    with pytest.raises(UsageError, match=r"one of the tables \[grid\], .*received none"):
        read_study(write(tmp_path, "s", WALK.split("[grid]")[0], fmus))
    with pytest.raises(UsageError, match=r"absent\.toml: expected a study file that can be read"):
        read_study(tmp_path / "absent.toml")
