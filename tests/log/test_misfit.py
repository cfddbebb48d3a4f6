"""A log of a plant whose parameter is wrong in a way that no disturbance makes up for."""

from math import sin

import numpy as np
import pytest

from ndob_fmu.log.estimate_log import estimate_log
from ndob_fmu.log.made_log import Sensor, make_log, steps
from ndob_fmu.log.tune.workbench import Workbench
from ndob_fmu.model.model import Model
from ndob_fmu.results.csv_files import read_csv

# The wind moves the load; the force, over a mass that is told wrong, the trolley; the trolley's rate, a bit, the load.
TROLLEY = Model(
    name="Trolley",
    states=["place", "speed", "sway", "sway_rate"],
    inputs=["force"],
    outputs=["place", "sway"],
    disturbances=["wind"],
    dynamics=lambda x, u, d, p: [
        x.speed,
        u.force / p.mass - x.speed,
        x.sway_rate,
        d.wind - 4.0 * x.sway - 0.2 * x.sway_rate + 0.1 * x.speed,
    ],
    parameters={"mass": 2.0},
    units={"place": "m"},
    noise_std=1e-3,
    disturbance_bound=3.0,
)
STEP, ROWS, OUTLIERS = 5e-3, 2000, 8
WIND = steps(1.5, 0.3, 1, STEP * ROWS)
TOLD = {"disturbance_order": 1, "disturbance_rate": 3.0}
WRONG = {"mass": 2.3}


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    path = tmp_path_factory.mktemp("misfit") / "log.csv"
    make_log(
        TROLLEY,
        path,
        lambda t, _: [30.0 * sin(2.0 * t) + 20.0 * sin(7.0 * t)],
        step=STEP,
        stop_time=STEP * (ROWS - 1),
        disturbances={"wind": WIND},
        sensors={name: Sensor(1e-3, outliers=0.002, outlier_size=0.05) for name in TROLLEY.outputs},
    )
    return path


@pytest.fixture(scope="module")
def found(log, tmp_path_factory):
    """Return what was estimated, and the error of the smoothed wind and its bar, with a right and a wrong mass."""

    def estimated(**wrong):
        folder = tmp_path_factory.mktemp("estimated")
        said = estimate_log(TROLLEY, log, folder / "out", start_values={**TOLD, **wrong})
        table = read_csv(folder / "out" / "result.csv")
        error = table["smoother.wind"] - [WIND(t) for t in table.time]
        return said, error, table["smoother.wind_std"]

    return estimated(), estimated(**WRONG)


def test_an_error_that_is_there_all_the_time_is_no_outlier(found):
    for said, *_ in found:
        assert said.outliers <= 2 * OUTLIERS


def test_what_the_disturbance_cannot_make_up_for_does_not_spoil_it(found):
    (_, error, _), (_, with_wrong_mass, std) = found
    assert np.sqrt(np.mean(with_wrong_mass**2)) < 2.0 * np.sqrt(np.mean(error**2))
    assert np.mean(np.abs(with_wrong_mass) < 2.0 * std) > 0.9


def test_a_warning_names_the_output_that_the_model_cannot_follow(found):
    (right, *_), (wrong, *_) = found
    assert right.warnings == ()
    (line,) = wrong.warnings
    assert line.startswith("place: the model cannot follow it with its disturbances")
    assert " m in 1 s beside it (a parameter is wrong" in line


def test_the_page_of_tune_counts_the_samples_in_the_same_way(log):
    bench = Workbench(TROLLEY, log, start_values={**TOLD, **WRONG})
    assert any(line.startswith("place: the model cannot follow it") for line in bench.warnings)
    bench.find_jumps(bench.told)
    assert bench.shown(bench.told).outliers <= 2 * OUTLIERS


# A piston that a pressure and a load move. Both place and pressure are measured; what fills the chamber is told wrong.
PISTON = Model(
    name="Piston",
    states=["place", "speed", "pressure"],
    inputs=["valve"],
    outputs=["place", "pressure"],
    disturbances=["load"],
    dynamics=lambda x, u, d, p: [
        x.speed,
        x.pressure - 2.0 * x.speed + d.load,
        p.flow * u.valve - 5.0 * x.speed - 0.5 * x.pressure,
    ],
    parameters={"flow": 40.0},
    noise_std={"place": 1e-4, "pressure": 1e-2},
    disturbance_bound=5.0,
)
LOAD = steps(3.0, 0.5, 3, STEP * ROWS)


def test_a_sensor_is_believed_where_the_model_of_what_it_shows_is_wrong(tmp_path):
    """The pressure that is measured tells the load, however it came there. Its samples counted as errors of 3."""
    make_log(
        PISTON,
        tmp_path / "log.csv",
        lambda t, _: [sin(2.0 * t) + 0.5 * sin(7.0 * t)],
        step=STEP,
        stop_time=STEP * (ROWS - 1),
        disturbances={"load": LOAD},
        sensors={"place": Sensor(1e-4), "pressure": Sensor(1e-2)},
    )

    def smoothed(flow):
        told = {"disturbance_order": 1, "disturbance_rate": 5.0, "flow": flow}
        said = estimate_log(PISTON, tmp_path / "log.csv", tmp_path / f"{flow:g}", start_values=told)
        table = read_csv(tmp_path / f"{flow:g}" / "result.csv")
        return said, table["smoother.load"] - [LOAD(t) for t in table.time], table["smoother.load_std"]

    (_, with_right, _), (said, with_wrong, std) = smoothed(40.0), smoothed(46.0)
    (line,) = said.warnings
    assert line.startswith("pressure: the model cannot follow it")
    assert np.sqrt(np.mean(with_wrong**2)) < 1.5 * np.sqrt(np.mean(with_right**2))
    assert np.mean(np.abs(with_wrong) < 2.0 * std) > 0.9
