"""Parameters of a plant from a log: beside events that they explain themselves, and beside loads that it follows."""

from dataclasses import replace

import numpy as np
import pytest

from ndob_fmu.codegen.compile_model import compile_model
from ndob_fmu.log.fit.class_fit import fit_class
from ndob_fmu.log.fit.fit_log import fit_log
from ndob_fmu.log.fit.likelihood import Likelihood
from ndob_fmu.log.fit.needed_events import needed_events
from ndob_fmu.log.fit.noise_fit import NoiseFit
from ndob_fmu.log.fit.parameter_step import most_likely
from ndob_fmu.log.fit.setup import Setup
from ndob_fmu.log.smooth.events import Events
from ndob_fmu.log.told_values import told_values
from ndob_fmu.model.model import Model

ROWS, SIZE = 40, 5.0
FIRST = np.array([0, ROWS])


def pieces(answer, left, events, columns):
    """The likelihood of two pieces of white samples (2·ROWS,), less θ times `answer`; events add columns to them."""
    values, surprise, told = [], [], []
    for first in FIRST:
        rows = slice(first, first + ROWS)
        there = [columns[k][rows] for k in sorted(events.jumps) if first <= k < first + ROWS]
        covariance = np.eye(ROWS) + sum((SIZE**2 * np.outer(one, one) for one in there), np.zeros((ROWS, ROWS)))
        factor = np.linalg.cholesky(covariance)
        white = np.linalg.solve(factor, left[rows])
        values.append(-0.5 * white @ white - np.log(np.diag(factor)).sum())
        surprise.append(white)
        told.append(-np.linalg.solve(factor, answer[rows]))
    silent = np.zeros(2 * ROWS)
    return Likelihood(
        np.array(values), np.array([np.concatenate(surprise), silent]), np.array([[np.concatenate(told), silent]])
    )


def kept(theta_off, jump, share=0.0):
    """Which of two events are needed: one that looks like a wrong θ, and one that does not and is there or not."""
    random, row = np.random.default_rng(1), np.arange(2 * ROWS)
    pulse, later = np.where((row >= 3) & (row < 9), 1.0, 0.0), np.where(row >= 60, 1.0, 0.0)
    answer = 3.0 * pulse + share * later
    left = random.standard_normal(2 * ROWS) + theta_off * answer + jump * later
    columns = {3: pulse, 60: later}
    events = Events(dict.fromkeys(columns, False))
    found = needed_events(
        events, lambda some: pieces(answer, left, some, columns), FIRST, np.zeros(1), np.eye(1) * 1e-6
    )
    return set(found.jumps)


def test_an_event_that_a_parameter_explains_is_not_needed():
    assert kept(theta_off=2.0, jump=2.0) == {60}


def test_an_event_that_no_parameter_explains_is_needed():
    assert kept(theta_off=0.0, jump=2.0) == {60}


def test_of_events_that_a_parameter_explains_each_but_not_all_one_is_given_up():
    """The first one wants a larger parameter, the second one a smaller one."""
    assert len(kept(theta_off=2.0, jump=-12.0, share=3.0)) == 1


def test_an_event_that_explains_less_than_it_costs_is_not_needed():
    assert kept(theta_off=0.0, jump=0.0) == set()


SPRING = Model(
    name="Spring",
    states=["place", "rate"],
    inputs=["force"],
    outputs={"place": lambda x, u, p: x.place},
    disturbances=["load"],
    dynamics=lambda x, u, d, p: [x.rate, (u.force - 200.0 * x.place - 4.0 * x.rate + d.load) / p.mass],
    parameters={"mass": 2.0},
    noise_std={"place": 1e-4},
    disturbance_bound=5.0,
    x0=[0.0, 0.0],
    xhat0=[0.0, 0.0],
    xhat0_std=[0.1, 0.1],
)
EQUATIONS = compile_model(SPRING)


def write_sine_log(path, seed, load=3.0, rows=1000, H=0.01, parts=4):
    """Write a log of a mass on a spring that swings once, and follows a sine of amplitude `load`."""
    random, time, h = np.random.default_rng(seed), H * np.arange(rows), H / parts
    force = np.where(time < 0.5, 4.0, 0.0)
    d = load * np.sin(2.0 * np.pi * random.uniform(0.4, 0.6) * time + random.uniform(0.0, 6.0))
    x, places = np.zeros(2), []
    for k in range(rows):
        places.append(x[0])
        for _ in range(parts):
            slopes = []
            for share in (0.0, 0.5, 0.5, 1.0):
                at = x + share * h * (slopes[-1] if slopes else 0.0)
                slopes.append(np.array(EQUATIONS.derivatives(at.tolist(), [force[k]], [d[k]], [2.0])))
            x = x + h / 6 * (slopes[0] + 2 * slopes[1] + 2 * slopes[2] + slopes[3])
    columns = np.column_stack([time, force, np.array(places) + 1e-4 * random.standard_normal(rows)])
    path.write_text("time,force,place\n" + "\n".join(",".join(map(repr, row)) for row in columns.tolist()) + "\n")


@pytest.fixture(scope="module")
def masses(tmp_path_factory):
    """The masses that are found in four logs of the spring, told 10 % off."""
    folder, found = tmp_path_factory.mktemp("spring"), []
    for seed in range(4):
        write_sine_log(folder / "log.csv", seed)
        told = {"mass": 2.2, "disturbance_rate": 40.0}
        fitted = fit_log(SPRING, folder / "log.csv", folder / "out", free=["mass"], hold=0.0, start_values=told)
        assert fitted.order == 2
        found.append(fitted.parameters["mass"])
    return found


def test_a_parameter_is_not_taken_for_a_part_of_the_load_that_the_plant_follows(masses):
    """A sine is more than white noise behind a second derivative. With order 2 a larger mass explains that, 5 % off."""
    errors, bars = (np.array(one) for one in zip(*((one.value - 2.0, one.std) for one in masses), strict=True))
    assert np.sqrt(np.mean(errors**2)) < 0.04
    assert np.sqrt(np.mean((errors / bars) ** 2)) < 1.5


@pytest.fixture(scope="module")
def problem(tmp_path_factory):
    """A log of the spring without a load, whose mass is told 10 % off, and the observer's trajectory."""
    path = tmp_path_factory.mktemp("calm") / "log.csv"
    write_sine_log(path, 5, load=0.0)
    values = told_values(EQUATIONS, {"mass": 2.2, "disturbance_rate": 40.0})
    setup = Setup(SPRING, EQUATIONS, values, ("mass",), 0.0, None)
    run = setup.online(path, None, None)
    found = setup.problem(run, 2)
    return found, setup.trajectory(run, found)


def test_events_that_a_wrong_mass_looks_like_are_given_up_with_the_step_to_the_right_one(problem):
    told, trajectory = problem
    calm = NoiseFit(np.zeros(1), np.full(1, -6.0), np.eye(2), Events(), 0.0)
    course = told.course(trajectory, told.told)
    record, search = told.about(course, course.plan).pieces(slice(None))
    events = search.within(calm.cut(record, told.layout), Events())
    assert len(events.jumps) + len(events.outliers) > 0
    step, _, needed = most_likely(told, trajectory, told.told, replace(calm, events=events))
    assert needed == Events()
    assert 2.2 + step[0] == pytest.approx(2.0, abs=0.02)


@pytest.mark.parametrize("told_off", [1.3, 1.1])
def test_a_parameter_that_is_told_far_off_is_found_in_a_few_rounds(problem, told_off):
    """What it leaves in the innovations is no information about the noise, with which it would be scored too slowly."""
    told, trajectory = problem
    model, rounds = replace(told.rows.model, parameters=(2.0 * told_off,)), []

    def counted(*arguments):
        rounds.append(arguments)
        return most_likely(*arguments)

    fit = fit_class(replace(told, rows=replace(told.rows, model=model)), trajectory, counted)
    assert len(rounds) <= 5
    assert abs(fit.parameters[0] - 2.0) < 2.0 * np.sqrt(fit.covariance[0, 0])
