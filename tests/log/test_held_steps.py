"""What all samples say of a disturbance while dry friction holds the plant for a part of a log."""

import math
from dataclasses import replace

import numpy as np
import pytest
import sympy

from ndob_fmu import Model
from ndob_fmu.codegen.compile_model import compile_model
from ndob_fmu.codegen.row_functions import row_functions
from ndob_fmu.interface.told_observer import told_observer
from ndob_fmu.log.fit.while_moving import while_moving
from ndob_fmu.log.log import Found, Log
from ndob_fmu.log.online import along
from ndob_fmu.log.smooth.along import Samples
from ndob_fmu.log.smooth.held_steps import HeldSteps, held_at_first
from ndob_fmu.log.smooth.row_model import RowModel
from ndob_fmu.log.smooth.smooth_log import smooth
from ndob_fmu.log.told_values import told_values

FRICTION, H, NOISE, D0 = 10.0, 2e-3, 1e-5, 8.0
TABLE = Model(
    name="RoughTable",
    states=["x", "v"],
    inputs=["u"],
    disturbances=["d"],
    outputs=["x"],
    parameters={"friction": FRICTION},
    dynamics=lambda x, u, d, p: [x.v, u.u + d.d - x.v - p.friction * sympy.sign(x.v)],
    noise_std=NOISE,
    disturbance_bound=D0,
)


def made(load, seed, rows, *, friction=FRICTION, parts=20):
    """Return a log of the table, pushed back and forth, the true d, in which rows friction holds it, and x and v."""
    random, h = np.random.default_rng(seed), H / parts
    x, v, phase, found = 0.0, 0.0, random.uniform(0.0, 6.0), []
    for k in range(rows):
        u = 13.5 * math.sin(3.5 * k * H + phase)
        found.append((k * H, u, x + NOISE * random.standard_normal(), load(k * H), v == 0.0, x, v))
        for part in range(parts):
            force = u + load(k * H + part * h) - v
            if v == 0.0:
                after = h * (force - math.copysign(friction, force)) if abs(force) > friction else 0.0
            else:
                after = v + h * (force - math.copysign(friction, v))
                after = 0.0 if after * v < 0.0 else after
            x, v = x + 0.5 * h * (v + after), after
    time, u, y, d, held, *state = np.array(found).T
    return Log(time, u[:, None], y[:, None], Found()), d, held > 0.5, np.array(state).T


def a_sine(seed):
    pace, phase = 2.0 * math.pi * np.random.default_rng(seed).uniform(0.4, 0.8), 2.0 * seed
    return lambda t: 4.0 * math.sin(pace * t + phase)


@pytest.mark.parametrize(("seed", "wrong"), [(1, 0.0), (3, -0.15)])
def test_the_smoothed_error_bar_holds_the_error_while_friction_holds_the_mass(seed, wrong):
    log, d, held, _ = made(a_sine(seed), seed, 600, friction=FRICTION * (1.0 + wrong))
    eq, told = compile_model(TABLE), {"disturbance_rate": 4.0 * 25.0, "friction_std": abs(wrong) * FRICTION}
    observer = told_observer(eq, told_values(eq, told).__getitem__, print)
    run = along(observer, (0.0, 0.0), iter([log]))
    [(_, found)] = smooth(observer, row_functions(TABLE), (0.0, 0.0), run)
    error, settled = found.d[:, 0] - d, np.arange(len(d)) > 50
    for which in (settled & held, settled & ~held):
        assert np.mean(np.abs(error[which]) <= 2.0 * found.d_std[which, 0]) >= 0.9
    assert 0.1 < np.mean(held) < 0.8
    assert found.jumps <= 1  # a friction that is wrong looks like a jump where the direction changes
    if not wrong:
        assert np.sqrt(np.mean(error[settled & ~held] ** 2)) < 0.02 * FRICTION


def rows_and_steps(**told):
    eq = compile_model(TABLE)
    model = told_observer(eq, told_values(eq, told).__getitem__, print).tuned(H).model
    rows = RowModel(model, row_functions(TABLE))
    xi, u = np.array([[0.2, 0.0, 3.0, 50.0], [0.2, 0.01, 3.0, 50.0]]), np.zeros((2, 1))
    return rows, xi, u, model.noise_directions, np.zeros((2, model.noise_directions.shape[1]))


def test_in_a_step_in_which_friction_may_hold_nothing_depends_on_the_disturbance():
    rows, xi, u, channel, sizes = rows_and_steps()
    held = HeldSteps(np.array([[True], [False]]), np.array([0.01, 0.01]), shows_jumps=True)

    def taken(found):
        motion, noise = found.motion(rows, xi, u, np.full(2, H))
        steps = motion.steps(motion.plan(xi), channel, sizes, apart=False)
        return replace(steps, noise=np.concatenate([steps.noise, noise], axis=2))

    steps, free = taken(held), taken(replace(held, by=~held.by))
    np.testing.assert_array_equal(steps.Phi[0, :2, 2:], 0.0)
    np.testing.assert_allclose(steps.end[0], [0.2, 0.0, 3.0 + 50.0 * H, 50.0], rtol=1e-12)
    assert free.Phi[0, 1, 2] == pytest.approx(H, rel=1e-2)
    # The speed may change as under any force up to the friction: v̇ is a number anywhere between ±10.
    covariance = steps.noise[0] @ steps.noise[0].T
    assert covariance[1, 1] == pytest.approx((2.0 * FRICTION * H) ** 2 / 12.0)
    assert covariance[2, 2] == pytest.approx(0.01 * D0**2 / 3.0)
    rate = rows.model.settings.disturbance_rate[0]
    assert covariance[3, 3] == pytest.approx(rate**2 * H**2 * 3.0 / 8.0)
    np.testing.assert_array_equal(steps.noise[1], 0.0)


def test_a_fit_takes_no_samples_while_friction_holds():
    log, d, held, state = made(a_sine(3), 3, 1500)
    rows, *_ = rows_and_steps()
    trajectory = np.column_stack([state, d, np.zeros(len(d))])
    samples = Samples(np.full(len(d) - 1, H), log.inputs, log.outputs, np.full(log.outputs.shape, NOISE**2))
    found = while_moving(rows, samples, trajectory)
    left = np.isfinite(found.outputs[:, 0])
    assert not left[held].any()
    assert np.mean(left[~held]) > 0.8
    assert found.held is not None
    assert not found.held.shows_jumps
    assert found.held.any[held[:-1]].all()


def test_a_plant_that_only_passes_its_friction_may_be_held_in_the_steps_around():
    rows, *_ = rows_and_steps()
    v = np.linspace(0.05, -0.05, 20)
    xi = np.column_stack([np.zeros(20), v, np.zeros((20, 2))])
    found = held_at_first(rows, xi, np.zeros((20, 1)), passing=True)
    np.testing.assert_array_equal(np.flatnonzero(found.any), [7, 8, 9, 10])
    assert not held_at_first(rows, xi, np.zeros((20, 1)), passing=False).any.any()
