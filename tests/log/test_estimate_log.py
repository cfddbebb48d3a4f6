"""`ndob-fmu estimate`: the observer over a log, the smoothed estimate, and what the residuals say."""

import json
from contextlib import contextmanager
from itertools import combinations

import numpy as np
import pytest

from ndob_fmu.cli import main
from ndob_fmu.codegen.compile_model import compile_model
from ndob_fmu.interface.model_variables import observer_variables
from ndob_fmu.interface.told_observer import told_observer
from ndob_fmu.log.diagnostics import OutputDiagnosis
from ndob_fmu.log.estimate_figures import Thinned, write_figures
from ndob_fmu.log.estimate_log import estimate_log
from ndob_fmu.log.made_log import Sensor, make_log
from ndob_fmu.log.told_values import told_values
from ndob_fmu.model.model import Model
from ndob_fmu.results import plots
from ndob_fmu.results.csv_files import read_csv
from ndob_fmu.results.recording import Recording
from ndob_fmu.results.shown_time import ShownTime
from tests.runtime.test_general_plants import DRIVE

NOISE = {"place": 1e-3, "rate": 5e-2}
CART = Model(
    name="Cart",
    states=["place", "rate"],
    inputs=["force"],
    outputs={"place": lambda x, u, p: x.place, "rate": lambda x, u, p: x.rate},
    disturbances=["wind"],
    dynamics=lambda x, u, d, p: [x.rate, (u.force - p.drag * x.rate * x.rate**2 + d.wind) / p.mass],
    parameters={"mass": 2.0, "drag": 0.1},
    units={"place": "m", "rate": "m/s", "force": "N", "wind": "N", "mass": "kg", "drag": "N.s3/m3"},
    ranges={"rate": (-5.0, 5.0)},
    noise_std=NOISE,
    disturbance_bound=3.0,
    x0=[0.0, 0.0],
    xhat0=[0.0, 0.0],
    xhat0_std=[0.1, 0.1],
)
EQUATIONS = compile_model(CART)
# As the disturbances of these logs move, which jump.
TUNED = {"disturbance_order": 1, "disturbance_rate": 2.0, "lag": 0.2}


def simulated(time, wind, noise, seed):
    """Return inputs (K,1) and samples (K,2) of the cart under a wind(t) that is held between two times."""
    random = np.random.default_rng(seed)
    x, force, rows = np.zeros(2), 2.0 * np.sin(1.5 * time), []
    for k, t in enumerate(time):
        rows.append(x)
        h = (time[k + 1] - t if k + 1 < len(time) else 0.0) / 4
        for _ in range(4):
            slopes = []
            for part in (0.0, 0.5, 0.5, 1.0):
                at = x + part * h * (slopes[-1] if slopes else 0.0)
                slopes.append(np.array(EQUATIONS.derivatives(at.tolist(), [force[k]], [wind[k]], [2.0, 0.1])))
            x = x + h / 6 * (slopes[0] + 2 * slopes[1] + 2 * slopes[2] + slopes[3])
    return force[:, None], np.array(rows) + random.standard_normal((len(time), 2)) * noise


def gusts(time):
    return np.where((time > 2.0) & (time < 4.5), 2.0, -0.5)


def write_log(path, time, inputs, outputs):
    rows = [
        ",".join("" if np.isnan(v) else repr(float(v)) for v in row) for row in np.column_stack([time, inputs, outputs])
    ]
    path.write_text("time,force,place,rate\n" + "\n".join(rows) + "\n")
    return path


@pytest.fixture(scope="module")
def usual(tmp_path_factory):
    """The folder of a log as a careful logger writes it, what was found in it, and the true wind."""
    folder = tmp_path_factory.mktemp("usual")
    time = 7.0 + 0.01 * np.arange(700)
    wind = gusts(time - 7.0)
    log = write_log(folder / "log.csv", time, *simulated(time, wind, [*NOISE.values()], 1))
    found = estimate_log(CART, log, folder / "out", start_values=TUNED)
    return folder / "out", found, wind


@pytest.fixture
def without_figures(monkeypatch):
    """Most of the time of a short log goes into drawing."""
    monkeypatch.setattr("ndob_fmu.log.estimate_log.write_figures", lambda *_, **__: None)


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


def test_the_rows_are_what_the_fmu_would_have_shown(usual):
    table = read_csv(usual[0] / "result.csv")
    values = told_values(EQUATIONS, TUNED)
    observer = told_observer(EQUATIONS, values.__getitem__, print)
    state = observer.init([0.0, 0.0])
    for k in range(60):
        y = [table["log.place"][k], table["log.rate"][k]]
        H = table.time[k + 1] - table.time[k]
        state, estimate = observer.step(state, [table["log.force"][k]], y, H)
        assert table["observer.wind_hat"][k + 1] == pytest.approx(estimate.d_hat[0], rel=1e-6, abs=1e-9)
        assert table["observer.wind_lagged_std"][k + 1] == pytest.approx(estimate.d_lagged_std[0], rel=1e-6)
        assert table["observer.place_residual"][k + 1] == pytest.approx(estimate.residual[0], rel=1e-6, abs=1e-9)


def test_the_table_has_the_outputs_of_the_fmu_and_the_smoothed_states(usual):
    names = read_csv(usual[0] / "result.csv").names
    outputs = [v.name for v in observer_variables(EQUATIONS) if v.causality == "output"]
    assert [name for name in names if name.startswith("observer.")] == [f"observer.{name}" for name in outputs]
    assert [name for name in names if name.startswith("smoother.")] == [
        *("smoother.place", "smoother.rate", "smoother.wind"),
        *("smoother.place_std", "smoother.rate_std", "smoother.wind_std"),
    ]


def test_later_samples_make_the_estimate_better_and_the_bar_says_how_good(usual):
    folder, _, wind = usual
    table, rows = read_csv(folder / "result.csv"), slice(50, -50)
    online, lagged, smoothed = (
        rms((table[name] - true)[rows])
        for name, true in (
            ("observer.wind_at_sample", np.append(wind[:1], wind[:-1])),
            ("observer.wind_lagged", np.append(wind[:21], wind[:-21])),
            ("smoother.wind", wind),
        )
    )
    assert smoothed < 0.8 * lagged < 0.4 * online
    inside = np.abs(table["smoother.wind"] - wind) < 2.0 * table["smoother.wind_std"]
    assert np.mean(inside[rows]) > 0.9
    assert np.median(table["smoother.wind_std"]) < 3.0 * smoothed


def test_the_bar_of_the_smoothed_estimate_holds_a_wrong_mass_of_which_it_is_told(tmp_path, without_figures):
    """A wrong mass acts as wind does: no sample, earlier or later, tells them apart."""
    time = 0.01 * np.arange(1500)
    wind = gusts(time % 7.0)
    log = write_log(tmp_path / "log.csv", time, *simulated(time, wind, [*NOISE.values()], 8))
    told = {**TUNED, "mass": 2.3, "mass_std": 0.2}
    estimate_log(CART, log, tmp_path, start_values=told)
    table, rows = read_csv(tmp_path / "result.csv"), slice(50, -50)
    inside = np.abs(table["smoother.wind"] - wind) < 2.0 * table["smoother.wind_std"]
    assert np.mean(inside[rows]) > 0.9
    assert np.median(table["smoother.wind_std"]) < rms((table["smoother.wind"] - wind)[rows])


def test_all_samples_together_tell_an_uncertain_parameter_that_acts_otherwise_than_the_disturbance(
    tmp_path, without_figures
):
    """The equations are linear about the parameter that the first pass finds, not about the one that was told."""
    noise = dict.fromkeys(("angle", "current"), Sensor(noise_std=1e-4))
    true, load = {"flux": 1.3, "inductance": 0.01}, {"load": lambda t: 0.5 * np.sin(2.0 * t)}
    drive = {"step": 0.01, "stop_time": 6.0, "disturbances": load, "sensors": noise, "parameters": true}
    truth = make_log(DRIVE, tmp_path / "log.csv", lambda t, _: [4.0 + 2.0 * np.sin(3.0 * t)], **drive)
    told = dict.fromkeys(("inertia_std", "friction_std", "inductance_std"), 0.0)
    told |= {"flux_std": 0.2, "inductance": 0.01, "angle_noise_std": 1e-4, "current_noise_std": 1e-4}
    estimate_log(DRIVE, tmp_path / "log.csv", tmp_path, start_values={**told, "disturbance_order": 2})
    table, rows = read_csv(tmp_path / "result.csv"), slice(30, -10)
    error = (table["smoother.load"] - read_csv(truth)["load"])[rows]
    assert np.mean(np.abs(error) < 2.0 * table["smoother.load_std"][rows]) > 0.9
    assert np.median(table["smoother.load_std"]) < 2.0 * rms(error)


def test_a_log_that_fits_the_settings_has_no_verdict(usual):
    _, found, _ = usual
    assert found.verdicts == ()
    assert (found.jumps, found.outliers) == (2, 0)
    assert found.valid == 1.0
    for diagnosis in found.diagnoses.values():
        assert abs(diagnosis.size - 1.0) < 0.25
        assert abs(diagnosis.correlation[0]) < 0.2


def test_the_summary_and_the_figures_are_there(usual):
    folder, found, _ = usual
    summary = json.loads((folder / "summary.json").read_text())
    assert summary["estimate"]["found"]["rows"] == 700
    assert summary["parameters"]["observer.lag"] == 0.2
    assert summary["step_size"] == pytest.approx(0.01)
    for name in ("fig1_disturbance", "fig2_outputs", "fig3_residuals"):
        assert (folder / f"{name}.png").stat().st_size > 10_000
    assert found.start_time == 7.0


@pytest.mark.parametrize("factor", [0.2, 5.0])
def test_a_wrong_noise_is_named_with_the_right_one(tmp_path, factor, without_figures):
    time = 0.01 * np.arange(1500)
    log = write_log(tmp_path / "log.csv", time, *simulated(time, gusts(time), [*NOISE.values()], 2))
    told = {**TUNED, "place_noise_std": 1e-3 * factor}
    (verdict,) = [v for v in estimate_log(CART, log, tmp_path, start_values=told).verdicts if "noise_std of place" in v]
    size, shown = (
        ("small", float(verdict.rsplit(" ", 2)[1])) if factor < 1 else ("large", float(verdict.rsplit(" ", 2)[1]))
    )
    assert f"× too {size}" in verdict
    assert shown == pytest.approx(1e-3, rel=0.2)


def test_a_disturbance_that_is_told_much_too_slow_is_noticed(tmp_path, without_figures):
    time = 0.01 * np.arange(1200)
    log = write_log(tmp_path / "log.csv", time, *simulated(time, 2.5 * np.sin(12.0 * time), [*NOISE.values()], 3))
    told = {"disturbance_order": 1, "disturbance_rate": 1e-3, "adapt_noise": "false"}
    verdicts = estimate_log(CART, log, tmp_path, start_values=told).verdicts
    assert any(
        "faster than disturbance_rate says" in line or "faster than disturbance_bound" in line for line in verdicts
    )


def test_jitter_gaps_a_slow_sensor_and_outliers_are_taken_as_they_are(tmp_path, without_figures):
    random = np.random.default_rng(4)
    time = 0.01 * np.arange(900) + random.uniform(-0.003, 0.003, 900)
    time = time[(time < 6.0) | (time > 6.4)]
    inputs, outputs = simulated(time, gusts(time), [*NOISE.values()], 5)
    outputs[np.arange(len(time)) % 5 > 0, 1] = np.nan
    outputs[[100, 333], 0] += 0.5
    found = estimate_log(CART, write_log(tmp_path / "log.csv", time, inputs, outputs), tmp_path, start_values=TUNED)
    table = read_csv(tmp_path / "result.csv")
    assert found.gaps == 1
    assert found.jitter == pytest.approx(0.003 / 0.01 * (2 / 3) ** 0.5, rel=0.15)
    assert found.found.missing_samples == int(np.isnan(outputs).sum())
    assert found.outliers == 2
    assert rms((table["smoother.wind"] - gusts(time))[50:-50]) < 0.35
    assert found.valid > 0.95


@pytest.mark.parametrize("rows", [2, 3, 12, 20])
def test_a_log_of_a_few_rows_has_an_estimate_but_no_verdict(tmp_path, without_figures, rows):
    time = 0.01 * np.arange(rows)
    log = write_log(tmp_path / "log.csv", time, *simulated(time, gusts(time), [*NOISE.values()], 7))
    verdicts = estimate_log(CART, log, tmp_path, start_values=TUNED).verdicts
    assert len(read_csv(tmp_path / "result.csv").time) == rows
    assert all("too few samples for a verdict" in line for line in verdicts)


def test_stretches_of_a_long_log_join_without_a_seam(tmp_path, monkeypatch, without_figures):
    time = 0.01 * np.arange(700)
    log = write_log(tmp_path / "log.csv", time, *simulated(time, gusts(time), [*NOISE.values()], 6))
    estimate_log(CART, log, tmp_path / "whole", start_values=TUNED)
    monkeypatch.setattr("ndob_fmu.log.read_log.read_log.__defaults__", (200,))
    monkeypatch.setattr("ndob_fmu.log.smooth.smooth_log._LOOK_AHEAD", 190)
    estimate_log(CART, log, tmp_path / "parts", start_values=TUNED)
    whole, parts = (read_csv(tmp_path / name / "result.csv") for name in ("whole", "parts"))
    np.testing.assert_array_equal(whole.time, parts.time)
    np.testing.assert_array_equal(whole["observer.wind_hat"], parts["observer.wind_hat"])
    np.testing.assert_allclose(parts["smoother.wind"], whole["smoother.wind"], atol=0.02)


REFUSED = {
    "no log": (["none.csv"], "none.csv: expected a readable CSV file"),
    "a column that is not there": (["log.csv", "--map", "windy=time"], "--map windy"),
    "a map without =": (["log.csv", "--map", "time"], "--map: expected COLUMN=NAME"),
    "an unknown start value": (["log.csv", "--start-values", "rate_noise", "1"], "did you mean 'rate_noise_std'?"),
    "an impossible start value": (["log.csv", "--start-values", "lag", "-1"], "start value of lag"),
    "method 1": (["log.csv", "--start-values", "method", "1"], "method: expected 2 for a log"),
    "no file of start values": (["log.csv", "--start-values-file", "none.json"], "expected a JSON file"),
    "text in the last row": (["bad.csv"], "bad.csv, row 3, column rate: expected a number, received 'x'"),
}


@pytest.mark.parametrize(("words", "part"), REFUSED.values(), ids=REFUSED)
def test_what_cannot_be_used_is_one_line_and_leaves_nothing(tmp_path, monkeypatch, capsys, words, part):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "log.csv").write_text("time,force,place,rate\n0,1,0,0\n0.001,1,0,0\n")
    (tmp_path / "bad.csv").write_text("time,force,place,rate\n0,1,0,0\n0.001,1,0,0\n0.002,1,0,x\n")
    (tmp_path / "cart.py").write_text(
        "from ndob_fmu import Model\n"
        "model = Model(name='Cart', states=['place', 'rate'], inputs=['force'], disturbances=['wind'],\n"
        "    dynamics=lambda x, u, d, p: [x.rate, u.force + d.wind], outputs=['place', 'rate'])\n"
    )
    assert main(["estimate", "cart.py", *words, "--out", "out"]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert part in lines[-1]
    assert not (tmp_path / "out").exists()


def test_the_command_says_what_it_found_and_where(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    time = 0.01 * np.arange(300)
    write_log(tmp_path / "log.csv", time, *simulated(time, gusts(time), [*NOISE.values()], 7))
    (tmp_path / "model.py").write_text("from tests.log.test_estimate_log import CART as model\n")
    (tmp_path / "fit.json").write_text(json.dumps({"disturbance_order": 1, "disturbance_rate": 2.0}))
    words = ["estimate", "model.py", "log.csv", "--start-values-file", "fit.json", "--start-values", "lag", "0.1"]
    assert main(words) == 0
    said = capsys.readouterr().out
    assert "300 rows, 0 to 2.99 s, usual step 0.01 s" in said
    assert "verdict:" in said
    summary = json.loads((tmp_path / "results" / "log" / "summary.json").read_text())
    assert (summary["parameters"]["observer.lag"], summary["parameters"]["observer.disturbance_rate"]) == (0.1, 2.0)


def test_times_of_a_clock_that_starts_far_from_0_are_shown_from_the_first_row(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    time = 0.01 * np.arange(300)
    write_log(tmp_path / "log.csv", 1.7e9 + time, *simulated(time, gusts(time), [*NOISE.values()], 7))
    (tmp_path / "model.py").write_text("from tests.log.test_estimate_log import CART as model\n")
    axes = []
    monkeypatch.setattr("ndob_fmu.log.estimate_log.write_figures", lambda *told, **__: axes.append(told[-1]))
    monkeypatch.setattr("ndob_fmu.log.estimate_log.begin", axes.append)
    assert main(["estimate", "model.py", "log.csv"]) == 0
    said = capsys.readouterr().out
    assert "300 rows, 0 to 2.99 s (times from the first row, at 1700000000 s), usual step 0.01 s" in said
    assert axes[0] == "estimating, 2.99 s of the log are done"
    assert axes[1].of(1.7e9 + time)[-1] == pytest.approx(2.99)
    assert axes[1].label == "time [s] from the first row, at 1700000000 s"
    assert read_csv(tmp_path / "results" / "log" / "result.csv").time[1] == pytest.approx(1.7e9 + 0.01, abs=1e-6)


def test_the_times_of_a_clock_that_starts_near_0_are_shown_as_they_are(usual):
    assert usual[1].shown_time.label == "time [s]"


@pytest.mark.parametrize("name", ["h1", "temperature_behind_the_second_heat_exchanger"])
def test_no_text_of_a_figure_is_cut_off_or_lies_on_another_or_on_a_curve(tmp_path, monkeypatch, name):
    drawn, original = [], plots.figure

    @contextmanager
    def figure(path, rows):
        with original(path, rows) as axes:
            yield drawn.append(axes) or axes

    monkeypatch.setattr("ndob_fmu.log.estimate_figures.plots.figure", figure)
    others = ["observer.force_hat", "observer.force_std", "smoother.force", "smoother.force_std"]
    others += [f"observer.{name}_residual", f"observer.{name}_residual_std"]
    kept = Thinned()
    kept.add(Recording(np.arange(50.0), (f"log.{name}", *others), np.random.default_rng(1).random((50, 7))))
    found = OutputDiagnosis(50, 1.0, 0.1, np.zeros(20), 0.1, 0.0, 1.0)
    pairs = [("force", "N")], [(name, "K")]
    write_figures(tmp_path, kept, pairs[0] * 2, pairs[1] * 2, {name: found, "other": found}, ShownTime(), smooths=True)
    assert len(drawn) == 3
    for axes in drawn:
        axes[0].figure.draw_without_rendering()
        (legend,) = [one.get_legend() for one in axes if one.get_legend()]
        texts = [legend, *(one.yaxis.label for one in axes), axes[-1].xaxis.label]
        boxes = [text.get_window_extent() for text in texts]
        whole = axes[0].figure.bbox
        assert all(whole.x0 <= box.x0 and box.x1 <= whole.x1 and whole.y0 <= box.y0 for box in boxes)
        assert not any(first.overlaps(second) for first, second in combinations(boxes, 2))
        assert not any(boxes[0].overlaps(one.bbox) for one in axes)
