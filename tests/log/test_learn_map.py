"""A map of the disturbance is learned where the disturbance depends on the states, and nowhere else."""

import json

import numpy as np
import pytest
import sympy

from ndob_fmu import Model
from ndob_fmu.codegen.compile_model import compile_model
from ndob_fmu.command_line.log_commands import _fit_text
from ndob_fmu.log.fit.fit_log import fit_log
from ndob_fmu.log.fit.learn_map import learn
from ndob_fmu.log.made_log import Sensor, make_log, steps
from ndob_fmu.results.csv_files import read_csv

ROWS = 3000


def motion(seed=0):
    """Return places and rates (K,) of a drive that moves in several frequencies over 20 s."""
    random, t = np.random.default_rng(seed), np.linspace(0.0, 20.0, ROWS)
    tones = [(f, random.uniform(0.0, 6.0)) for f in (0.13, 0.37, 0.71, 1.1)]
    place = sum(np.sin(2.0 * np.pi * f * t + phase) / (1.0 + f) for f, phase in tones)
    return place, np.gradient(place, t)


def parts(place, rate):
    """Return functions of the rate and of the place."""
    of_rate = [np.tanh(rate / scale) for scale in (3.0, 1.0, 0.1)]
    of_place = [np.tanh((place - at) / 0.4) for at in np.linspace(-1.2, 1.2, 6)]
    return [np.column_stack([*of_rate, *(one**2 for one in of_rate)]), np.column_stack(of_place)]


def explained(learned, functions):
    return np.concatenate(functions, axis=1) @ learned.coefficients


def noise(seed):
    return 0.05 * np.random.default_rng([seed, 1]).standard_normal(ROWS)


def test_friction_is_found_and_the_place_left_out_that_says_nothing():
    place, rate = motion()
    friction = np.tanh(rate / 0.1) + 0.3 * rate
    found = learn(parts(place, rate), friction + noise(0))
    assert found.parts == (0,)
    assert np.std(explained(found, parts(place, rate)) - friction) < 0.1 * np.std(friction)
    assert found.after < 0.1 * found.before


def test_what_depends_on_the_place_too_is_found_beside_friction():
    place, rate = motion()
    whole = np.tanh(rate / 0.1) + 0.8 * np.sin(2.0 * place)
    found = learn(parts(place, rate), whole + noise(1))
    assert set(found.parts) == {0, 1}
    # Each function may hold a constant that another one lacks.
    assert np.std(explained(found, parts(place, rate)) - whole) < 0.1 * np.std(whole)


@pytest.mark.parametrize("kind", ["walk", "jumps", "noise"])
def test_a_disturbance_that_does_not_depend_on_the_states_is_rarely_learned(kind):
    learned = 0
    for seed in range(10):
        random = np.random.default_rng(seed)
        if kind == "walk":
            d = np.cumsum(random.standard_normal(ROWS)) * 0.05
        elif kind == "jumps":
            d = np.repeat(random.uniform(-1.0, 1.0, 20), ROWS // 20)
        else:
            d = noise(seed)
        learned += bool(learn(parts(*motion(seed)), d).parts)
    assert learned <= 2


def test_pulses_stay_out_of_the_map_of_friction():
    place, rate = motion(2)
    friction, pulses = np.tanh(rate / 0.1), np.zeros(ROWS)
    for begin, sign in ((300, 1.0), (800, -1.0), (1300, 1.0), (2000, 1.0), (2500, -1.0)):
        pulses[begin : begin + 90] = 20.0 * sign
    found = learn(parts(place, rate), friction + pulses + noise(2))
    assert found.parts == (0,)
    assert np.std(explained(found, parts(place, rate)) - friction) < 0.1 * np.std(friction)


def test_a_place_that_comes_once_is_not_told_from_the_time():
    place = np.linspace(-1.0, 1.0, ROWS)
    assert learn([parts(place, place)[1]], 3.0 * place + noise(3)).parts == ()


def test_two_parts_that_say_the_same_are_named():
    place, rate = motion()
    functions = parts(place, rate)
    found = learn([functions[0], functions[0][:, ::-1]], np.tanh(rate / 0.1) + noise(4))
    assert len(found.parts) == 1
    assert found.as_well == ((found.parts[0], 1 - found.parts[0]),)


DRIVE = {
    "name": "Drive",
    "states": ["angle", "rate"],
    "inputs": ["torque"],
    "outputs": ["angle"],
    "disturbances": ["load"],
    "units": {"load": "N.m"},
    "noise_std": {"angle": 1e-4},
    "disturbance_bound": 0.5,
    "x0": [0.0, 0.0],
    "xhat0": [0.0, 0.0],
    "xhat0_std": [0.1, 0.1],
}


def drive(**changes):
    """Return a drive without friction."""
    return Model(**DRIVE, dynamics=lambda x, u, d, p: [x.rate, (u.torque + d.load) / 2e-3], **changes)


def rubbing():
    """Return a drive with friction."""
    return Model(
        **DRIVE,
        dynamics=lambda x, u, d, p: [x.rate, (u.torque + d.load - 0.05 * sympy.tanh(5.0 * x.rate)) / 2e-3],
    )


class Follow:
    """A controller that takes the rate from the last two samples of the angle."""

    def __init__(self):
        self.before = 0.0

    def __call__(self, t, y):
        angle, rate = np.sin(2.1 * t) + 0.3 * np.sin(7.3 * t), 2.1 * np.cos(2.1 * t) + 2.19 * np.cos(7.3 * t)
        measured, self.before = (y[0] - self.before) / 5e-3, y[0]
        return [1.0 * (angle - y[0]) + 0.05 * (rate - measured)]


MODEL = drive(disturbance_map={"load": {"rate": "friction", "angle": "place"}})


@pytest.fixture(scope="module")
def fitted(tmp_path_factory):
    """The folder of a log of a drive with friction and a load that jumps, and what was found there."""
    folder = tmp_path_factory.mktemp("drive")
    make_log(
        rubbing(),
        folder / "log.csv",
        Follow(),
        step=5e-3,
        stop_time=8.0,
        disturbances={"load": steps(size=0.05, pace=0.4, seed=2, stop_time=8.0)},
        sensors={"angle": Sensor(noise_std=1e-4)},
    )
    return folder, fit_log(MODEL, folder / "log.csv", folder / "fit")


def test_fit_learns_the_friction_that_the_model_lacks(fitted):
    _, found = fitted
    assert found.maps["load"].depends_on[0] == "friction of rate"
    assert found.maps["load"].explained > 0.8
    p = MODEL.parameter_values({name: found.start_values[name] for name in MODEL.parameters})
    rates = np.linspace(-2.0, 2.0, 81)
    said = [2e-3 * compile_model(MODEL).derivatives([0.0, rate], [0.0], [0.0], p)[1] for rate in rates]
    friction = -0.05 * np.tanh(5.0 * rates)
    assert np.std(said - friction) < 0.2 * np.std(friction)


def test_a_map_is_0_in_the_mean_so_that_a_constant_load_stays_in_the_estimate(fitted):
    folder, _ = fitted
    truth = read_csv(folder / "log_truth.csv")
    _, found = fitted
    p = MODEL.parameter_values({name: found.start_values[name] for name in MODEL.parameters})
    states = zip(truth["angle"], truth["rate"], strict=True)
    said = [2e-3 * compile_model(MODEL).derivatives(x, [0.0], [0.0], p)[1] for x in states]
    assert abs(np.mean(said)) < 1e-3


def test_a_map_that_is_told_stays_as_it_is(fitted, tmp_path):
    _, found = fitted
    told = {name: value for name, value in found.start_values.items() if name.startswith("load_map_")}
    make_log(rubbing(), tmp_path / "log.csv", Follow(), step=5e-3, stop_time=2.5)
    again = fit_log(MODEL, tmp_path / "log.csv", tmp_path / "again", start_values=told)
    assert again.maps == {}
    assert {name: again.start_values[name] for name in told} == told


def test_the_summary_says_what_the_map_explains(fitted):
    folder, found = fitted
    summary = json.loads((folder / "fit" / "fit_summary.json").read_text())
    assert summary["maps"]["load"]["rms_with"] == found.maps["load"].rms_with < 0.5 * found.maps["load"].rms_without
    assert "map of load: friction of rate" in _fit_text(found, MODEL.units)
