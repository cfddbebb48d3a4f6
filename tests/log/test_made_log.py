"""Made logs: what a recorded one has, with a truth that is known."""

import csv
import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ndob_fmu.errors import UsageError
from ndob_fmu.log.estimate_log import estimate_log
from ndob_fmu.log.made_log import Sensor, make_log, sines, steps, walk
from ndob_fmu.log.servo_drive import servo_drive
from ndob_fmu.model.model import Model
from ndob_fmu.results.csv_files import read_csv
from ndob_fmu.runtime.base_errors import IntegrationError

MASS = Model(
    name="Mass",
    states=["place", "rate"],
    inputs=["push"],
    outputs=["rate", "place"],
    disturbances=["wind"],
    dynamics=lambda x, u, d, p: [x.rate, (u.push + d.wind) / p.mass],
    parameters={"mass": 2.0},
    noise_std={"place": 1e-4, "rate": 1e-2},
    disturbance_bound=1.5,
)


def columns(path):
    with path.open() as file:
        rows = list(csv.reader(file))
    found = zip(*([math.nan if text == "" else float(text) for text in row] for row in rows[1:]), strict=True)
    return {name: np.array(column) for name, column in zip(rows[0], found, strict=True)}


def made(folder, name="log.csv", **changes):
    """Return the columns of a log of a mass under a force of 1, and its truth."""
    told = {"step": 0.01, "stop_time": 10.0} | changes
    truth = make_log(MASS, folder / name, lambda t, _: [1.0], **told)
    return columns(folder / name), read_csv(truth)


def test_without_sensors_the_log_has_the_motion_that_newton_says(tmp_path):
    log, truth = made(tmp_path, disturbances={"wind": lambda t: 3.0}, parameters={"mass": 8.0})
    assert truth["place"] == pytest.approx(0.25 * log["time"] ** 2, abs=1e-9)
    assert log["rate"] == pytest.approx(0.5 * log["time"], abs=1e-9)
    assert list(log["place"]) == list(truth["place"])
    assert set(truth["wind"]) == {3.0}
    assert list(log["push"]) == [1.0] * 1001


def test_a_disturbance_acts_at_the_time_that_the_truth_says(tmp_path):
    log, truth = made(tmp_path, disturbances={"wind": lambda t: math.sin(t)}, jitter=0.1)
    rate = (log["time"] + 1.0 - np.cos(log["time"])) / 2.0
    assert truth["rate"] == pytest.approx(rate, abs=1e-5)
    assert list(truth["wind"]) == [math.sin(t) for t in log["time"]]


def test_each_sensor_has_its_noise_rate_resolution_and_losses(tmp_path):
    sensors = {"place": Sensor(resolution=0.01, missing=0.2), "rate": Sensor(noise_std=0.05, every=2)}
    log, truth = made(tmp_path, sensors=sensors)
    place, rate = log["place"] - truth["place"], log["rate"] - truth["rate"]
    got = np.isfinite(place)
    assert np.mean(got) == pytest.approx(0.8, abs=0.04)
    assert np.max(np.abs(place[got])) <= 0.005 + 1e-9
    assert log["place"][got] / 0.01 == pytest.approx(np.round(log["place"][got] / 0.01), abs=1e-6)
    assert list(np.isfinite(rate)) == [k % 2 == 0 for k in range(1001)]
    assert np.std(rate[::2]) == pytest.approx(0.05, rel=0.15)


def test_outliers_change_no_other_sample(tmp_path):
    clean, _ = made(tmp_path, sensors={"rate": Sensor(noise_std=0.05)})
    log, _ = made(tmp_path, sensors={"rate": Sensor(noise_std=0.05, outliers=0.05, outlier_size=2.0)})
    off = np.abs(log["rate"] - clean["rate"])
    assert np.mean(off > 0.0) == pytest.approx(0.05, abs=0.02)
    assert np.min(off[off > 0.0]) > 0.99
    assert np.max(off) < 2.01


def test_rows_have_jitter_and_gaps_and_stay_in_order(tmp_path):
    log, truth = made(tmp_path, jitter=0.1, gaps=[(2.0, 3.0)])
    intervals = np.diff(log["time"])
    assert np.sum(intervals > 0.9) == 1
    assert np.std(intervals[intervals < 0.1]) == pytest.approx(0.1 * 0.01 * 2**0.5, rel=0.15)
    assert np.min(intervals) > 0.0
    assert list(truth.time) == list(log["time"])


def test_the_same_arguments_write_the_same_bytes_and_another_seed_others(tmp_path):
    told = {"sensors": {"rate": Sensor(noise_std=0.05, missing=0.1)}, "jitter": 0.1}
    for name, seed in (("a", 1), ("b", 1), ("c", 2)):
        made(tmp_path, f"{name}.csv", seed=seed, **told)
    a, b, c = ((tmp_path / f"{name}.csv").read_bytes() for name in "abc")
    assert a == b != c
    assert (tmp_path / "a_truth.csv").read_bytes() == (tmp_path / "b_truth.csv").read_bytes()


def test_the_classes_of_disturbances_are_what_they_say():
    t = np.linspace(0.0, 50.0, 5001)
    sine, step = (np.array([d(one) for one in t]) for d in (sines(2.0, 0.5, 4), steps(2.0, 0.5, 4, 50.0)))
    walks = np.array([[w(one) for one in t[::10]] for w in (walk(2.0, 0.5, seed, 50.0) for seed in range(40))])
    assert 1.0 < np.max(np.abs(sine)) <= 2.0
    assert np.max(np.abs(np.diff(sine))) < 2.0 * 2.0 * np.pi * 0.5 * 0.01
    assert 13 < np.count_nonzero(np.diff(step)) < 40
    assert 1.0 < np.max(np.abs(step)) <= 2.0
    # 20 samples of the walk are 1/pace.
    assert np.std(walks[:, 20:] - walks[:, :-20]) == pytest.approx(2.0, rel=0.1)


def test_estimate_finds_the_disturbance_of_a_made_log_within_its_error_bar(tmp_path):
    sensors = {"place": Sensor(resolution=3e-4), "rate": Sensor(noise_std=1e-2, every=3)}
    _, truth = made(tmp_path, disturbances={"wind": steps(1.0, 0.5, 3, 10.0)}, sensors=sensors, jitter=0.05)
    tuned = {"disturbance_order": 1, "disturbance_rate": 0.5}
    estimate_log(MASS, tmp_path / "log.csv", tmp_path / "out", start_values=tuned)
    found = read_csv(tmp_path / "out" / "result.csv")
    error = np.abs(found["smoother.wind"] - truth["wind"])[50:]
    assert np.median(error) < 0.1
    assert np.mean(error < 2.0 * found["smoother.wind_std"][50:]) > 0.9


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"sensors": {"plac": Sensor()}}, "did you mean 'place'"),
        ({"disturbances": {"gust": math.sin}}, "disturbance gust"),
        ({"parameters": {"mas": 1.0}}, "did you mean 'mass'"),
        ({"jitter": 0.5}, "jitter: expected a share of the step from 0 to 0.2"),
        ({"step": 20.0}, "step: expected a time above 0"),
        ({"sensors": {"place": Sensor(every=0)}}, "every ≥ 1"),
        ({"sensors": {"place": Sensor(missing=1.5)}}, "from 0 to 1"),
    ],
)
def test_what_cannot_be_made_is_refused_in_one_line(tmp_path, changes, expected):
    with pytest.raises(UsageError, match=expected) as error:
        made(tmp_path, **changes)
    assert len(str(error.value)) < 300
    assert not list(tmp_path.iterdir())


def test_a_drive_with_another_number_of_inputs_is_refused(tmp_path):
    with pytest.raises(UsageError, match="drive: expected 1 inputs, received 2"):
        make_log(MASS, tmp_path / "log.csv", lambda t, _: [1.0, 2.0], step=0.01, stop_time=1.0)


def test_a_controller_has_the_latest_samples_of_the_log(tmp_path):
    had = []

    def drive(t, y):
        had.append(y)
        return [1.0 - y[1] - y[0]]

    sensors = {"place": Sensor(resolution=0.01, missing=0.3), "rate": Sensor(noise_std=0.05, every=3, outliers=0.1)}
    make_log(MASS, tmp_path / "log.csv", drive, step=0.01, stop_time=10.0, sensors=sensors, seed=3)
    log = columns(tmp_path / "log.csv")
    assert np.mean(np.isnan(log["rate"])) > 0.6
    for samples, name in zip(np.transpose(had), ("rate", "place"), strict=True):
        held = np.maximum.accumulate(np.where(np.isnan(log[name]), 0, np.arange(1001)))
        assert list(samples) == list(log[name][held])
    assert list(log["push"]) == [1.0 - place - rate for rate, place in had]


def test_a_controller_has_the_output_at_the_start_until_a_sample_comes(tmp_path):
    had = []

    def drive(t, y):
        had.append(y)
        return [1.0]

    started = replace(MASS, x0=[5.0, 3.0])
    make_log(started, tmp_path / "log.csv", drive, step=0.01, stop_time=0.1, sensors={"rate": Sensor(missing=1.0)})
    assert {rate for rate, _ in had} == {3.0}
    assert [place for _, place in had] == list(columns(tmp_path / "log.csv")["place"])


def test_a_controller_has_the_samples_of_a_gap_in_which_only_the_logger_rests(tmp_path):
    times = []

    def drive(t, y):
        times.append(t)
        return [1.0]

    make_log(MASS, tmp_path / "log.csv", drive, step=0.01, stop_time=1.0, gaps=[(0.2, 0.6)])
    assert len(times) == 101
    assert len(columns(tmp_path / "log.csv")["time"]) < 70


def test_a_sample_with_feed_through_shows_the_input_until_its_row(tmp_path):
    """As `estimate` takes it. A controller cannot change what it has measured."""
    had = []

    def drive(t, y):
        had.append(y[0])
        return [1.0 + y[0]]

    battery = Model(
        name="Battery", states=["charge"], inputs=["current"], disturbances=["leak"], x0=[3.0],
        dynamics=lambda x, u, d, p: [d.leak], outputs={"voltage": lambda x, u, p: x.charge + 2 * u.current},
    )  # fmt: skip
    make_log(battery, tmp_path / "log.csv", drive, step=0.1, stop_time=0.5)
    log = columns(tmp_path / "log.csv")
    current, voltage = log["current"].tolist(), log["voltage"].tolist()
    assert had == [3.0, *voltage[1:]]
    assert current == [1.0 + y for y in had]
    assert voltage == [3.0 + 2.0 * i for i in [current[0], *current[:-1]]]


CYLINDER = Model(
    name="Cylinder",
    states=["place", "rate", "pressure_1", "pressure_2"],
    inputs=["valve"],
    outputs=["place", "pressure_1", "pressure_2"],
    disturbances=["load"],
    dynamics=lambda x, u, d, p: [
        x.rate,
        (8e-4 * (x.pressure_1 - x.pressure_2) - 60.0 * x.rate + d.load) / 5.0,
        (2.5e-3 * u.valve * (7e5 - x.pressure_1) - 8e-4 * x.rate * x.pressure_1) / (2e-5 + 8e-4 * x.place),
        (2.5e-3 * u.valve * (1e5 - x.pressure_2) + 8e-4 * x.rate * x.pressure_2) / (2e-5 + 8e-4 * (0.5 - x.place)),
    ],
    ranges={"place": (0.0, 0.5)},
    x0=[0.25, 0.0, 7e5, 1e5],
)


def test_a_piston_without_an_end_stop_is_said_to_be_where_its_chamber_vanishes(tmp_path):
    """The error told the time within a part of a step, "t = 0.0003 s", and no state."""
    with pytest.raises(IntegrationError) as error:
        make_log(CYLINDER, tmp_path / "log.csv", lambda t, _: [1.0], step=0.01, stop_time=1.0)
    said = re.fullmatch(
        r"plant at (\S+) s: its equations cannot be followed from place = (\S+), rate = .*; "
        r"likely cause: place is (\S+), outside its range 0 to 0.5",
        str(error.value),
    )
    assert float(said[1]) > 0.1
    # Its dead volume ends at 0.525 m.
    assert 0.5 < float(said[2]) == float(said[3]) <= 0.525
    assert not list(tmp_path.iterdir())


def test_the_example_in_the_pages_makes_its_log(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    page = (Path(__file__).parents[2] / "docs" / "logs.md").read_text("utf-8")
    exec(re.search(r"```python\n(.*?)```", page, re.DOTALL)[1], {})
    assert capsys.readouterr().out == "log_truth.csv\n"
    assert len(columns(tmp_path / "log.csv")["angle"]) == len(read_csv("log_truth.csv").time) > 2400


def of_drive(folder, torque):
    truth = make_log(servo_drive(), folder / "log.csv", lambda t, _: [torque], step=0.01, stop_time=4.0)
    return read_csv(truth)


def test_the_servo_drive_sticks_below_the_breakaway_torque(tmp_path):
    truth = of_drive(tmp_path, 0.04)
    assert abs(truth["rate"][-1]) < 1e-3
    # The bristles hold the torque: 0.04 N·m over 20 N·m/rad.
    assert truth["bristle"][-1] == pytest.approx(0.04 / 20.0, rel=1e-3)


def test_the_servo_drive_slides_at_the_rate_that_friction_allows(tmp_path):
    truth = of_drive(tmp_path, 0.08)
    rate = truth["rate"][-1]
    # 0.08 N·m = coulomb + viscous ω, far above the Stribeck rate; the last of it is 1 − exp(−4 s · viscous/inertia).
    assert rate == pytest.approx((0.08 - 0.05) / 2e-3, rel=0.05)
    assert truth["bristle"][-1] == pytest.approx(0.05 / 20.0, rel=1e-3)
