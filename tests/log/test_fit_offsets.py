"""Constant offsets of sensors: found in a log where another sensor shows them, refused where a disturbance does."""

import json
from dataclasses import replace
from math import sin

import numpy as np
import pytest

from ndob_fmu import load_model
from ndob_fmu.cli import main
from ndob_fmu.errors import UsageError
from ndob_fmu.interface.told_observer import told_observer
from ndob_fmu.log.estimate_log import estimate_log
from ndob_fmu.log.fit.fit_log import fit_log
from ndob_fmu.log.made_log import Sensor, make_log, sines, steps, walk
from ndob_fmu.log.smooth.along import in_layout
from ndob_fmu.log.told_values import told_values
from ndob_fmu.results.csv_files import read_csv
from tests.log.test_estimate_log import CART
from tests.log.test_estimate_log import EQUATIONS as CART_EQUATIONS
from tests.log.test_fit_parameters import SPRING, write_sine_log

BIAS, STOP = 0.2, 16.0
TOLD = {"place_noise_std": 2e-3, "rate_noise_std": 3e-2, "disturbance_rate": 2.0}
JOINT = load_model("flexible_joint")
JOINT_TOLD = {**{f"{name}_noise_std": 1e-3 for name in JOINT.outputs}, "disturbance_rate": 3.0}
WINDS = {
    "steps": lambda seed: steps(2.0, 0.5, seed, STOP),
    "sines": lambda seed: sines(2.0, 0.7, seed),
    "walk": lambda seed: walk(0.5, 1.0, seed, STOP),
}


def drive(t, _):
    return [2.0 * sin(1.5 * t) + 1.5 * sin(7.0 * t + 1.0)]


def cart_log(path, kind="steps", seed=1, bias=BIAS):
    """Write a log of the cart whose sensor of the rate has an offset."""
    sensors = {"place": Sensor(2e-3), "rate": Sensor(3e-2, bias=bias)}
    make_log(
        CART,
        path,
        drive,
        step=0.01,
        stop_time=STOP,
        disturbances={"wind": WINDS[kind](seed)},
        sensors=sensors,
        seed=seed,
    )
    return path


@pytest.mark.parametrize("kind", WINDS)
@pytest.mark.parametrize("seed", [1, 2])
def test_an_offset_of_one_of_two_sensors_is_found_within_its_error_bar(tmp_path, kind, seed):
    fitted = fit_log(CART, cart_log(tmp_path / "log.csv", kind, seed), tmp_path, free=["rate_bias"], start_values=TOLD)
    found = fitted.parameters["rate_bias"]
    assert abs(found.value - BIAS) < 2.0 * found.std < 0.2 * BIAS
    # What the offset left in the samples without being known is no noise.
    assert fitted.noise_std["rate"].value == pytest.approx(3e-2, rel=0.1)


def joint_log(path, bias):
    """Write a log of the flexible joint whose sensor of the link has an offset."""
    make_log(
        JOINT,
        path,
        drive,
        step=0.01,
        stop_time=STOP,
        disturbances={"load_torque": sines(1.0, 0.4, 3)},
        sensors={"motor_angle": Sensor(1e-3), "link_angle": Sensor(1e-3, bias=bias)},
    )
    return path


def test_an_offset_is_found_behind_a_spring_whose_stiffness_is_told_wrong(tmp_path):
    stiffness = JOINT.parameters["joint_stiffness"]
    told, free = {**JOINT_TOLD, "joint_stiffness": 1.1 * stiffness}, ["link_angle_bias", "joint_stiffness"]
    log = joint_log(tmp_path / "log.csv", bias=0.02)
    found = fit_log(JOINT, log, tmp_path, free=free, start_values=told).parameters
    for name, true in (("link_angle_bias", 0.02), ("joint_stiffness", stiffness)):
        assert abs(found[name].value - true) < 2.0 * found[name].std < 0.1 * true


@pytest.fixture(scope="module")
def estimated(tmp_path_factory):
    """The folders of two estimates of a log with an offset: by what `fit` found, and by that without the offset."""
    folder = tmp_path_factory.mktemp("offset")
    log = cart_log(folder / "log.csv")
    fit_log(CART, log, folder / "fit", free=["rate_bias"], start_values=TOLD)
    found = json.loads((folder / "fit" / "fit.json").read_text())
    estimate_log(CART, log, folder / "with", start_values=found)
    estimate_log(CART, log, folder / "without", start_values={**found, "rate_bias_std": 0.0})
    return folder


def errors(estimated, name):
    """Errors of the smoothed wind behind the start, and their error bars."""
    found, truth = (read_csv(estimated / part) for part in (f"{name}/result.csv", "log_truth.csv"))
    late = slice(50, None)
    return (found["smoother.wind"] - truth["wind"])[late], found["smoother.wind_std"][late]


def test_what_fit_found_lets_estimate_tell_the_offset_and_the_disturbance_apart(estimated):
    summary = json.loads((estimated / "with" / "summary.json").read_text())
    found, offset = read_csv(estimated / "with" / "result.csv"), summary["estimate"]["offsets"]["rate"]
    assert abs(offset["value"] - BIAS) < 2.0 * offset["std"] < 0.05 * BIAS
    assert offset["value"] == pytest.approx(found["smoother.rate_bias"][-1], rel=1e-6)
    assert summary["units"]["smoother.rate_bias_std"] == "m/s"
    error, std = errors(estimated, "with")
    assert np.mean(np.abs(error) < 2.0 * std) > 0.9
    without, _ = errors(estimated, "without")
    assert np.sqrt(np.mean(error**2)) < 0.8 * np.sqrt(np.mean(without**2))


def test_an_offset_that_the_samples_do_not_tell_stays_in_the_error_bars_of_the_disturbance(tmp_path):
    """With the only sensor of a mass on a spring an offset b looks like a force of 200 N/m · b."""
    write_sine_log(tmp_path / "log.csv", 1, load=0.5)
    told = {"disturbance_order": 1, "disturbance_rate": 2.0, "place_bias_std": 2e-3}
    estimated = estimate_log(SPRING, tmp_path / "log.csv", tmp_path / "out", start_values=told)
    found = read_csv(tmp_path / "out" / "result.csv")
    for name in ("observer.load_std", "smoother.load_std"):
        assert np.median(found[name]) == pytest.approx(200.0 * 2e-3, rel=0.2)
    assert estimated.offsets["place"].std == pytest.approx(2e-3, rel=0.1)


def test_an_offset_that_drifts_is_found_as_a_state_of_the_model(tmp_path):
    path, told = cart_log(tmp_path / "log.csv", bias=0.0), {"disturbance_order": 1, "disturbance_rate": 2.0}
    header, *rows = (line.split(",") for line in path.read_text().splitlines())
    rate, drift = header.index("rate"), [0.1 + 0.1 * sin(0.4 * float(row[0])) for row in rows]
    for row, by in zip(rows, drift, strict=True):
        row[rate] = repr(float(row[rate]) + by)
    path.write_text("\n".join(map(",".join, [header, *rows])) + "\n")
    drifting = replace(
        CART,
        states=["place", "rate", "drift"],
        outputs={"place": lambda x, u, p: x.place, "tacho": lambda x, u, p: x.rate + x.drift},
        dynamics=lambda x, u, d, p: [x.rate, (u.force - p.drag * x.rate * x.rate**2 + d.wind) / p.mass, 0],
        noise_std={"place": 2e-3, "tacho": 3e-2},
        x0=[0.0, 0.0, 0.0],
        xhat0=[0.0, 0.0, 0.0],
        xhat0_std=[0.1, 0.1, 0.3],
        state_noise={"drift": 0.02},
    )
    estimate_log(drifting, path, tmp_path / "out", names={"rate": "tacho"}, start_values=told)
    found, truth = read_csv(tmp_path / "out" / "result.csv"), read_csv(tmp_path / "log_truth.csv")
    error, std = found["smoother.drift"] - drift, found["smoother.drift_std"]
    assert np.mean(np.abs(error) < 2.0 * std) > 0.9
    assert std.max() < 0.02
    wind = found["smoother.wind"] - truth["wind"]
    assert np.mean(np.abs(wind) < 2.0 * found["smoother.wind_std"]) > 0.9


def test_an_offset_that_looks_like_the_disturbance_is_refused_in_a_line_that_names_both(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "spring.py").write_text("from tests.log.test_fit_parameters import SPRING as model\n")
    assert main(["fit", "spring.py", "no_log.csv", "--free", "place_bias"]) == 2
    said = capsys.readouterr().err.strip()
    assert "\n" not in said
    for name in ("place_bias", " load", "place_bias_std"):
        assert name in said


def test_two_offsets_of_which_each_alone_is_told_are_refused_together(tmp_path):
    with pytest.raises(UsageError, match=r"--free motor_angle_bias.*load_torque.*another offset"):
        fit_log(JOINT, tmp_path / "log.csv", tmp_path, free=["link_angle_bias", "motor_angle_bias"])


def test_an_offset_that_the_log_tells_no_better_than_the_user_stays_as_told(tmp_path):
    told = {**TOLD, "rate_bias_std": 1e-5}
    fitted = fit_log(CART, cart_log(tmp_path / "log.csv", bias=0.0), tmp_path, free=["rate_bias"], start_values=told)
    assert "rate_bias" not in fitted.parameters
    assert fitted.start_values["rate_bias_std"] == 1e-5
    assert any("rate_bias" in line and "wind" in line for line in fitted.warnings)


def test_the_command_prints_the_offset_with_its_unit(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("ndob_fmu.log.estimate_log.write_figures", lambda *_, **__: None)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "model.py").write_text("from tests.log.test_estimate_log import CART as model\n")
    cart_log(tmp_path / "log.csv")
    assert main(["estimate", "model.py", "log.csv", "--start-values", "rate_bias_std", "0.3"]) == 0
    (line,) = [line for line in capsys.readouterr().out.splitlines() if "offset" in line]
    words = line.split()
    assert [*words[:2], words[-1]] == ["rate:", "offset", "m/s"]
    assert float(words[2]) == pytest.approx(BIAS, rel=0.1)


def test_a_trajectory_keeps_its_offsets_and_parameters_in_a_layout_with_others():
    def layout(**told):
        values = told_values(CART_EQUATIONS, {"disturbance_order": 2, "disturbance_rate": 2.0, **told})
        return told_observer(CART_EQUATIONS, values.__getitem__, lambda line: None).layout

    old = layout(rate_bias_std=0.1, mass_std=0.1)
    new = layout(rate_bias_std=0.1, place_bias_std=0.1, mass_std=0.1, disturbance_order=1, disturbance_rate=2.0)
    none = layout(mass_std=0.1)
    xi = np.arange(1.0, 1.0 + old.size)[None]
    np.testing.assert_array_equal(in_layout(xi, old, new), [[1.0, 2.0, 3.0, 0.0, 5.0, 6.0]])
    np.testing.assert_array_equal(in_layout(xi, old, none), [[1.0, 2.0, 3.0, 4.0, 6.0]])


def test_an_event_in_the_last_row_which_no_piece_of_the_record_holds_does_not_end_the_fit(tmp_path):
    """Held-out rows are cut into other pieces than all rows are."""
    lines = cart_log(tmp_path / "log.csv", bias=0.0).read_text().splitlines()[:1502]
    last = lines[-1].split(",")
    place = lines[0].split(",").index("place")
    lines[-1] = ",".join([*last[:place], repr(float(last[place]) + 1.0), *last[place + 1 :]])
    (tmp_path / "log.csv").write_text("\n".join(lines) + "\n")
    assert fit_log(CART, tmp_path / "log.csv", tmp_path, start_values=TOLD).rows == 1501
