"""A sensor that dies or freezes is not followed; one that stands still because the plant does is believed."""

from __future__ import annotations

import numpy as np
import pytest
import sympy

from ndob_fmu.codegen.compile_model import compile_model
from ndob_fmu.model.model import Model
from tests.helpers.observers import MASS, sampled_observer

# The load is in kN, the pressure in bar. What the valve lets through is known to a fifth.
WINCH = Model(
    name="Winch",
    states=["angle", "speed", "pressure"],
    inputs=["spool"],
    outputs=["angle", "pressure"],
    disturbances=["load"],
    dynamics=lambda x, u, d, p: [
        x.speed,
        (200.0 * x.pressure - 200.0 * x.speed - 500.0 * d.load) / 400.0,
        2e4 * (p.valve * u.spool * sympy.sqrt(250.0 - x.pressure * u.spool) - 2e-3 * x.speed - 2e-6 * x.pressure),
    ],
    parameters={"valve": 1e-3},
    ranges={"angle": (-100.0, 100.0), "speed": (-10.0, 10.0), "pressure": (-200.0, 200.0), "spool": (-1.0, 1.0)},
    x0=[0.0, 0.0, 45.0],
)
TANKS = Model(
    name="Tanks",
    states=["upper", "lower"],
    inputs=["pump"],
    outputs=["upper", "lower"],
    disturbances=["inflow"],
    dynamics=lambda x, u, d, p: [
        (u.pump + d.inflow - p.out * sympy.sqrt(x.upper)) / 0.5,
        (p.out * sympy.sqrt(x.upper) - 8e-3 * sympy.sqrt(x.lower)) / 0.4,
    ],
    parameters={"out": 8e-3},
    ranges={"upper": (0.01, 4.0), "lower": (0.01, 4.0)},
    x0=[1.0, 1.0],
)
SPOOL = (lambda t: 0.5 * np.sin(1.2 * t) + 0.2, lambda t: 18.0 + np.sin(0.8 * t))
PUMP = (lambda t: 6e-3 + 2e-3 * np.sin(t / 60.0), lambda t: 2e-3 + 1e-3 * np.sin(t / 100.0))
# Model, u(t) and d(t), step, noise of the samples, order, bound and rate of d, uncertainty of the parameter.
PLANTS = {
    "winch": (WINCH, SPOOL, 2e-3, (1e-3, 0.3), 2, 30.0, 1.0, 2e-4),
    "tanks": (TANKS, PUMP, 1.0, (2e-3, 2e-3), 1, 5e-3, 3e-5, 8e-4),
}
AT, LATER = 600, 200  # the sample from which on it is stuck, and the samples after that


class Run:
    """Errors of d̂, their bars, over D₀, and `valid` along a record in which an output is stuck for a while."""

    def __init__(self, name, *, output, value, length, seed, noise=0.0):
        model, (u, d), H, told, order, bound, rate, uncertain = PLANTS[name]
        rows = AT + length + LATER
        eq, p = compile_model(model), model.parameter_values()
        random, x, Y = np.random.default_rng(seed), np.array(eq.x0), []
        for k in range(rows):
            Y.append(np.array(eq.output(x.tolist(), [u(k * H)], p)) + told * random.standard_normal(len(eq.outputs)))
            for i in range(8):
                x = x + H / 8 * np.array(eq.derivatives(x.tolist(), [u(k * H)], [d((k + i / 8) * H)], p))
        samples = np.array(Y)
        samples[AT : AT + length, output] = samples[AT - 1, output] if value is None else value
        samples[AT : AT + length, output] += noise * told[output] * random.standard_normal(length)
        observer = sampled_observer(
            eq,
            p,
            x_hat=eq.x0,
            order=order,
            noise_std=told,
            disturbance_bound=(bound,),
            disturbance_rate=(rate,),
            x_std=(0.1, 0.1, 10.0)[-len(eq.x0) :],
            parameter_std=(uncertain,),
        )
        state, found = observer.init(eq.x0), []
        for k, y in enumerate(samples):
            state, now = observer.step(state, (u(k * H),), tuple(y), H)
            found.append([now.d_at_sample[0] - d(k * H), now.d_std[0], now.valid])
        error, std, valid = np.array(found).T
        self.error, self.std, self.valid = np.abs(error) / bound, std / bound, valid > 0.0
        self.stuck, self.later = slice(AT, AT + length), slice(AT + length, None)


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("value", [0.0, None], ids=["zero", "frozen"])
@pytest.mark.parametrize(("name", "output", "length"), [("winch", 1, 700), ("tanks", 0, 300), ("tanks", 1, 300)])
def test_the_estimate_does_not_follow_a_stuck_sensor(name, output, length, value, seed):
    """A frozen pressure was followed to an error of 200 error bars with `valid` true."""
    run = Run(name, output=output, value=value, length=length, seed=seed)
    for part in (run.stuck, run.later):
        assert np.sum(run.valid[part] & (run.error[part] > 5.0 * run.std[part]) & (run.error[part] > 0.02)) <= 1
    assert np.max(run.error[run.later][60:]) <= 0.1


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize(("name", "output", "length"), [("winch", 1, 700), ("tanks", 0, 300), ("tanks", 1, 300)])
def test_the_estimate_does_not_follow_a_dead_sensor_that_shows_its_noise(name, output, length, seed):
    """The covariance was raised until the samples were believed, though the other sensor agreed with the estimate."""
    run = Run(name, output=output, value=0.0, length=length, seed=seed, noise=1.0)
    for part in (run.stuck, run.later):
        assert np.sum(run.valid[part] & (run.error[part] > 5.0 * run.std[part]) & (run.error[part] > 0.02)) <= 1
    assert np.max(run.error[run.later][60:]) <= 0.1


def valid_at_rest(spoil, rows=600):
    """`valid` of the last third of samples of a mass that moves for a third of them; `spoil`(random, position) them."""
    H, random = 1e-2, np.random.default_rng(1)
    observer = sampled_observer(
        compile_model(MASS),
        (),
        x_hat=(0.0, 0.0),
        order=1,
        noise_std=(1e-3,),
        disturbance_bound=(2.0,),
        disturbance_rate=(5.0,),
        x_std=(1e-2, 1e-2),
    )
    state, found = observer.init((0.0, 0.0)), []
    for k in range(rows):
        t = min(k * H, rows * H / 3.0)
        position = 0.2 * (1.0 - np.cos(np.pi * t / (rows * H / 3.0)))
        state, now = observer.step(state, (0.0,), (spoil(random, position),), H)
        found.append(now.valid)
    return np.array(found)[2 * rows // 3 :]


@pytest.mark.parametrize(
    "spoil",
    [
        lambda random, position: position,
        lambda random, position: np.round(position / 3e-3) * 3e-3,
        lambda random, position: np.round(np.round(position * 300.0) / 300.0, 5),
        lambda random, position: np.round((position + 1e-3 * random.standard_normal()) / 2e-3) * 2e-3,
    ],
    ids=["without noise", "rounded", "rounded twice", "rounded and noisy"],
)
def test_samples_that_repeat_because_the_plant_stands_are_used(spoil):
    assert np.all(valid_at_rest(spoil))
