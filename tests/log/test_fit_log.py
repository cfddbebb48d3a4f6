"""`ndob-fmu fit`: noise, class and pace of the disturbance, and parameters, from logs with a known truth."""

import json
import shlex
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from ndob_fmu.cli import main
from ndob_fmu.codegen.compile_model import compile_model
from ndob_fmu.errors import UsageError
from ndob_fmu.interface.told_observer import told_observer
from ndob_fmu.log.fit import noise_fit
from ndob_fmu.log.fit.class_fit import ClassFit, fit_class
from ndob_fmu.log.fit.error_bars import widened
from ndob_fmu.log.fit.fit_log import fit_log
from ndob_fmu.log.fit.likelihood import likelihood
from ndob_fmu.log.fit.noise_fit import NoiseFit, NoiseLikelihood, moved
from ndob_fmu.log.fit.noise_slopes import noise_slopes
from ndob_fmu.log.fit.parameter_step import most_likely
from ndob_fmu.log.fit.setup import Setup
from ndob_fmu.log.read_log import read_log
from ndob_fmu.log.smooth.events import Events
from ndob_fmu.log.smooth.smoother import forward
from ndob_fmu.log.told_values import told_values
from tests.log.made_logs import made_log
from tests.log.test_estimate_log import CART, simulated, write_log

EQUATIONS = compile_model(CART)
# Half of the true noise of the places, and more than that of the rates.
WRONG = {"place_noise_std": 1e-3, "rate_noise_std": 5e-2}
NOISE = {"place": 2e-3, "rate": 3e-2}


def setup(free=(), **values):
    return Setup(CART, EQUATIONS, told_values(EQUATIONS, {**WRONG, **values}), free, 0.3, None)


def linearised(problem, trajectory):
    """Return a log about a trajectory."""
    course = problem.course(trajectory, problem.told)
    return problem.about(course, course.plan)


def pieces(problem, trajectory):
    """Return a log about a trajectory in pieces, and where events may be in it."""
    return linearised(problem, trajectory).pieces(slice(None))


def test_pieces_are_as_likely_as_the_record_as_a_whole(tmp_path):
    """What each of them begins with is forgotten in rows that the piece before it counts."""
    made_log(tmp_path / "log.csv", "walk", 3, rows=1500)
    told = setup()
    run = told.online(tmp_path / "log.csv", None, None)
    problem = told.problem(run, 1)
    trajectory = told.trajectory(run, problem)
    about = linearised(problem, trajectory)
    cut, search = about.pieces(slice(None))
    noise = noise_fit.fit_noise(cut, search, problem.layout, None)
    assert len(cut.pieces.first) > 5
    kept = cut.pieces.own[-1]
    whole = forward(noise.applied(about.record, problem.layout)).log_likelihoods[:kept].sum()
    assert noise.events == Events()
    assert noise.value == pytest.approx(whole, abs=0.2 * len(cut.pieces.first))


@pytest.mark.parametrize("rows", [700, 3000])  # with 3000 of them a compiled library filters their beginnings, too
def test_the_slopes_of_the_likelihood_are_its_differences(tmp_path, rows):
    made_log(tmp_path / "log.csv", "steps", 3, rows=rows)
    told = setup()
    run = told.online(tmp_path / "log.csv", None, None)
    problem = told.problem(run, 2)
    record, search = pieces(problem, told.trajectory(run, problem))
    events = Events({200: True, 350: False}, frozenset({(120, 1), (201, 0)}))

    def at(logs):
        return likelihood(*moved(record, problem.layout, search.columns, logs), events)

    centre, step = np.array([0.4, -0.3, 1.0]), 1e-4
    back = NoiseLikelihood(record, problem.layout, search.columns).at(centre, events)
    assert back.value == pytest.approx(at(centre).value, rel=1e-13)
    for i, slope in enumerate(at(centre).slopes):
        up, down = (at(centre + sign * step * np.eye(3)[i]).value for sign in (1.0, -1.0))
        assert (up - down) / (2.0 * step) == pytest.approx(slope, rel=1e-3)
        assert (up - down) / (2.0 * step) == pytest.approx(back.slopes[i], rel=1e-5)


@pytest.mark.parametrize(("kind", "order"), [("walk", 1), ("sine", 2)])
def test_a_noise_that_is_told_far_too_large_is_found_in_a_few_steps(tmp_path, monkeypatch, kind, order):
    """Its likelihood is nearer to a parabola of the variance than of the logarithm, of which it takes twice as many."""
    made_log(tmp_path / "log.csv", kind, 3, rows=700)
    told = replace(setup(place_noise_std=0.1, rate_noise_std=1.0), hold=0.0)
    run = told.online(tmp_path / "log.csv", None, None)
    problem, calls = told.problem(run, order), []
    record, search = pieces(problem, told.trajectory(run, problem))
    monkeypatch.setattr(noise_fit, "noise_slopes", lambda *one: calls.append(one) or noise_slopes(*one))
    monkeypatch.setattr(noise_fit, "_MOST_TURNS", 1)
    found = noise_fit.fit_noise(record, search, problem.layout, None)
    std = np.array([0.1, 1.0]) * np.exp(0.5 * found.log_variance)
    np.testing.assert_allclose(std, [*NOISE.values()], rtol=0.15)
    assert len(calls) <= 20  # two in each step: along the pieces, and along what they begin with


def test_the_information_about_the_noise_is_not_taken_anew_where_the_noise_is_known_already(tmp_path, monkeypatch):
    """It costs a pass for each logarithm, and a step towards the most likely noise two."""
    made_log(tmp_path / "log.csv", "walk", 3, rows=700)
    told = setup()
    run = told.online(tmp_path / "log.csv", None, None)
    problem, taken = told.problem(run, 1), []
    record, search = pieces(problem, told.trajectory(run, problem))
    known = noise_fit.fit_noise(record, search, problem.layout, None)
    monkeypatch.setattr(noise_fit, "likelihood", lambda *one: taken.append(one) or likelihood(*one))
    off = replace(known, log_variance=known.log_variance + 0.2, log_intensity=known.log_intensity - 0.3)
    found = noise_fit.fit_noise(record, search, problem.layout, off)
    assert not taken
    np.testing.assert_allclose(found.logs, known.logs, atol=0.2 * known.std.min())


def fitted_to_a_jump(folder, at):
    """Return the fit of all rows to a log whose wind jumps once, the wind (900,) and the true noise (2,)."""
    time, noise = 0.01 * np.arange(900), np.array([2e-4, 3e-3])
    wind = np.where(np.arange(900) < at, 0.5, 2.5)
    write_log(folder / "log.csv", time, *simulated(time, wind, noise, 3))
    told = replace(setup(place_noise_std=1e-4, rate_noise_std=5e-3), hold=0.0)
    run = told.online(folder / "log.csv", None, None)
    problem = told.problem(run, 1)
    return fit_class(problem, told.trajectory(run, problem), most_likely), wind, noise


@pytest.mark.parametrize("at", [601, 602])
def test_a_jump_right_behind_the_cut_between_two_pieces_is_in_the_smoothed_disturbance(tmp_path, at):
    """A piece of 150 rows begins with a wide covariance, which explains a jump in its first rows as well."""
    found, wind, noise = fitted_to_a_jump(tmp_path, at)
    np.testing.assert_allclose(found.disturbance[:, 0], wind[-len(found.disturbance) :], rtol=0, atol=0.1)
    std = np.array([1e-4, 5e-3]) * np.exp(0.5 * found.noise.log_variance)
    np.testing.assert_allclose(std, noise, rtol=0.05)


def test_a_jump_in_the_first_rows_is_found_as_one(tmp_path):
    assert fitted_to_a_jump(tmp_path, 9)[0].noise.events == Events({9: False})


def test_what_stands_between_jumps_or_ends_a_few_rows_apart_does_not_count_as_the_largest_disturbance(
    tmp_path,
):
    made_log(tmp_path / "log.csv", "walk", 3, rows=700)
    told = replace(setup(), hold=0.0)
    run = told.online(tmp_path / "log.csv", None, None)
    problem = told.problem(run, 1)
    trajectory = np.zeros_like(told.trajectory(run, problem))
    trajectory[300:305, problem.layout.disturbance] = -9.0
    trajectory[500:, problem.layout.disturbance] = 2.0

    def largest(*jumps):
        events = Events(dict.fromkeys(jumps, False))
        noise = NoiseFit(np.zeros(2), np.zeros(1), np.eye(3), events, 0.0)
        about = linearised(problem, trajectory)
        return ClassFit(about, noise, np.zeros(0), np.zeros((0, 0)), trajectory, events).largest(np.full(1, 0.5))

    assert largest(300, 305, 500) == 1.5
    assert largest(300, 500) == 9.5
    trajectory[695:, problem.layout.disturbance] = 7.0
    assert largest(300, 305, 500, 695) == 1.5


def bars(answer, left):
    """Return the factor on the error bar of a parameter with an answer (R,), where `left` (R,) is left over."""
    inverse = np.array([[1.0 / np.sum(answer**2)]])
    return np.sqrt(widened(inverse, inverse, answer[None, None], left[None])[0, 0] / inverse[0, 0])


def test_an_error_bar_stays_where_many_rows_tell_it_and_what_is_left_over_is_white():
    random = np.random.default_rng(1)
    assert 1.0 <= bars(random.standard_normal(3000), random.standard_normal(3000)) < 1.1


def test_an_error_bar_grows_where_what_is_left_over_is_like_the_drive():
    random, row = np.random.default_rng(2), np.arange(3000)
    answer = sum(np.sin(2.0 * np.pi * f * row / 3000 + f) for f in range(40, 80))
    like, unlike = (3.0 * np.sin(2.0 * np.pi * f * row / 3000) for f in (60.5, 300.5))
    white = random.standard_normal(3000)
    assert bars(answer, white + like) > 3.0
    assert bars(answer, white + unlike) < 1.5


def test_an_error_bar_is_that_of_a_small_sample_where_few_rows_or_frequencies_tell_it():
    white, row = np.random.default_rng(3).standard_normal(3000), np.arange(3000)
    for answer in (np.sin(2.0 * np.pi * 50 * row / 3000), np.where(row < 3, 1.0, 0.0)):
        assert bars(answer, white) > 1.5


@pytest.fixture(scope="module", params=["sine", "steps", "walk"])
def fitted(request, tmp_path_factory):
    """A class of disturbances, the folder of its log, and what was found there."""
    folder = tmp_path_factory.mktemp(request.param)
    made_log(folder / "log.csv", request.param, 11)
    return request.param, folder, fit_log(CART, folder / "log.csv", folder, free=["mass"], start_values=WRONG)


def test_the_noise_of_each_output_is_found(fitted):
    for name, true in NOISE.items():
        found = fitted[2].noise_std[name]
        assert found.value == pytest.approx(true, rel=0.05)
        assert abs(found.value - true) < 3.0 * found.std < 0.15 * true


def test_noise_of_a_right_model_has_no_warning(fitted):
    assert not any("follow one another" in line for line in fitted[2].warnings)


def test_an_output_that_the_model_cannot_follow_has_a_warning_that_its_noise_is_none(tmp_path):

    def dynamics(x, u, d, p):
        return [1.3 * x.rate, (u.force - p.drag * x.rate * x.rate**2 + d.wind) / p.mass]

    made_log(tmp_path / "log.csv", "sine", 3, rows=900)
    wrong = replace(CART, name="Wrong", dynamics=dynamics)
    found = fit_log(wrong, tmp_path / "log.csv", tmp_path / "out", start_values=WRONG)
    too_large = {name for name, true in NOISE.items() if found.noise_std[name].value > 2.0 * true}
    assert too_large
    said = {line.partition(":")[0] for line in found.warnings if "residuals follow one another" in line}
    assert said == too_large


def test_the_class_of_the_disturbance_is_found(fitted):
    kind, _, found = fitted
    assert found.is_jumping == (kind == "steps")
    assert found.order == (2 if kind == "sine" else 1)


def test_a_parameter_is_found_within_its_error_bar(fitted):
    mass = fitted[2].parameters["mass"]
    assert abs(mass.value - 2.0) < 2.0 * mass.std < 0.2


def test_what_a_wrong_mass_adds_to_the_disturbance_does_not_raise_its_bound(tmp_path):
    made_log(tmp_path / "log.csv", "sine", 3, rows=1500)
    told = {"mass": 5.0, "disturbance_bound": 3.2}
    found = fit_log(CART, tmp_path / "log.csv", tmp_path / "out", free=["mass"], start_values=told)
    assert found.parameters["mass"].value == pytest.approx(2.0, rel=0.1)
    assert found.start_values["disturbance_bound"] == 3.2
    assert not any("is raised" in line for line in found.warnings)


def test_a_parameter_that_looks_like_the_disturbance_stays_as_told_with_its_error_bar(tmp_path):
    """A tilt is a constant force, and a wind that wanders has any mean."""

    def dynamics(x, u, d, p):
        return [x.rate, (u.force - p.drag * x.rate * x.rate**2 + p.tilt + d.wind) / p.mass]

    tilted = replace(CART, name="Tilted", dynamics=dynamics, parameters={**CART.parameters, "tilt": 0.3})
    made_log(tmp_path / "log.csv", "walk", 12, rows=1500)
    told = {"tilt_std": 0.2}
    found = fit_log(tilted, tmp_path / "log.csv", tmp_path / "out", free=["tilt"], start_values=told)
    assert found.parameters == {}
    assert found.start_values["tilt_std"] == 0.2
    assert any(
        line.startswith("tilt: the log cannot tell it from wind; it stays as told, and tilt_std tells the error bars")
        for line in found.warnings
    )


def test_the_observer_tunes_itself_to_the_pace_that_was_found(fitted):
    kind, folder, found = fitted
    values = told_values(EQUATIONS, json.loads((folder / "fit.json").read_text()))
    observer = told_observer(EQUATIONS, values.__getitem__, print)
    tuned, pace = observer.tuned(0.01).intensity(0.01, [1.0, 1.0])[0], found.intensity["wind"].value
    # Of a disturbance that jumps, the rate is tried (`test_tried_rates`).
    assert kind == "steps" or tuned == pytest.approx(pace, rel=0.06)


def test_estimate_takes_what_was_found_and_has_no_verdict_on_the_noise(fitted, capsys):
    _, folder, _ = fitted
    log, values = str(folder / "log.csv"), str(folder / "fit.json")
    model = folder / "cart.py"
    model.write_text("from tests.log.test_estimate_log import CART as model\n")
    assert main(["estimate", str(model), log, "--start-values-file", values, "--out", str(folder / "out")]) == 0
    assert "noise_std of" not in capsys.readouterr().out


def test_the_command_says_what_it_found_and_how_sure_it_is(tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))  # which has no native observer
    made_log(tmp_path / "log.csv", "walk", 4, rows=900)
    model = tmp_path / "cart.py"
    model.write_text("from tests.log.test_estimate_log import CART as model\n")
    log, out = tmp_path / "log.csv", tmp_path / "out"
    log.write_text(log.read_text().replace("place", "Place [mm]", 1))
    told = ["--map", "Place [mm]=place", "--unit", "Place [mm]=m"]
    assert main(["fit", str(model), str(log), *told, "--start-values", "lag", "0.1", "--out", str(out)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "900 rows, along which the Python observer ran"
    assert lines[1].startswith("noise_std: place 0.00")
    assert "±" in lines[1]
    assert "disturbance wanders: disturbance_order 1" in lines[2]
    assert lines[3] == "parameters: none fitted"
    assert lines[4] == "± is two standard deviations; an entry <name>_std of fit.json is one"
    assert lines[-1].endswith("` uses it")
    command = shlex.split(lines[-1].split("`")[1])
    assert command == [
        "ndob-fmu",
        "estimate",
        str(model),
        str(log),
        *told,
        "--start-values-file",
        str(out / "fit.json"),
    ]
    found = json.loads((tmp_path / "out" / "fit.json").read_text())
    assert found["lag"] == 0.1
    assert set(found) > {"place_noise_std", "rate_noise_std", "disturbance_order", "disturbance_rate"}


def test_nothing_need_be_held_out_and_what_was_is_fitted_too_once_the_order_is_chosen(tmp_path):
    made_log(tmp_path / "log.csv", "walk", 4, rows=700)
    found, other = (fit_log(CART, tmp_path / "log.csv", tmp_path / "out", hold=hold) for hold in (0.0, 0.3))
    assert (found.rows, found.held_out, found.held_out_values) == (700, 0, {1: None, 2: None})
    assert (other.rows, other.held_out, other.order) == (700, 210, 1)
    for name, one in found.noise_std.items():
        assert other.noise_std[name].value == pytest.approx(one.value, rel=1e-2)
        assert other.noise_std[name].std == pytest.approx(one.std, rel=1e-2)


def test_a_log_with_more_rows_than_are_fitted_is_named(tmp_path, monkeypatch):
    monkeypatch.setattr("ndob_fmu.log.first_block.read_log", partial(read_log, block=600))
    made_log(tmp_path / "log.csv", "walk", 4, rows=650)
    found = fit_log(CART, tmp_path / "log.csv", tmp_path / "out", hold=0.0)
    assert found.warnings == ("the first 599 rows of the log are fitted, the others are not read",)


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"free": ["mas"]}, "did you mean 'mass'"),
        ({"hold": 0.95}, "--hold: expected a share of the rows from 0 to 0.9"),
        (
            {"start_values": {"place_delay": 0.1, "disturbance_order": 0}},
            "outputs without a delay, and disturbance_order 1 or more, received place_delay",
        ),
        ({}, "at least 500 rows"),
    ],
)
def test_what_cannot_be_fitted_is_refused_and_leaves_nothing_behind(tmp_path, changes, expected):
    made_log(tmp_path / "log.csv", "walk", 4, rows=60)
    with pytest.raises(UsageError, match=expected) as error:
        fit_log(CART, tmp_path / "log.csv", tmp_path / "out", **changes)
    assert len(str(error.value)) < 300
    assert not (tmp_path / "out").exists()
