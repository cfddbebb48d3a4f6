"""What the observer says of a disturbance while dry friction holds the plant, so that no sample tells of it."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
import sympy

from ndob_fmu.codegen.compile_model import compile_model
from ndob_fmu.model.model import Model
from ndob_fmu.runtime.blocks.disturbance import Generator
from ndob_fmu.runtime.blocks.plant import Plant
from ndob_fmu.runtime.step.jump_bank import unseen_variance
from tests.helpers.observers import sampled_observer

FRICTION, H, NOISE = 10.0, 2e-3, 1e-5


def rough_table(friction=lambda v: sympy.sign(v), **changes):
    """ẋ = v, v̇ = u + d − v − 10 sign(v)."""
    fields = {
        "name": "RoughTable",
        "states": ["x", "v"],
        "inputs": ["u"],
        "disturbances": ["d"],
        "outputs": ["x"],
        "parameters": {"friction": FRICTION},
        "dynamics": lambda x, u, d, p: [x.v, u.u + d.d - x.v - p.friction * friction(x.v)],
        "noise_std": NOISE,
        "disturbance_bound": 8.0,
    }
    return compile_model(Model(**(fields | changes)))


def along(eq, push, load, count, *, true_friction=FRICTION, seed=1, **settings):
    """Return errors of d̂, its error bars, whether friction held, the observer, and its state at the end."""
    random, plant = np.random.default_rng(seed), Plant(eq, (true_friction,), (Generator(),))
    observer = sampled_observer(eq, (FRICTION,), x_hat=(0.0, 0.0), noise_std=(NOISE,), **settings)
    state, mass = observer.init((0.0, 0.0)), plant.init((0.0, 0.0), 0.0)
    rows = []
    for k in range(count):
        u, d = push(k * H), load(k * H)
        held = mass.x[1] == pytest.approx(0.0, abs=1e-12) and abs(u + d) < true_friction
        sample = mass.x[0] + NOISE * random.standard_normal()
        state, said = observer.step(state, (u,), (sample,), H)
        rows.append((said.d_at_sample[0] - d, said.d_std[0], held))
        mass = plant.step(mass, (u,), (load((k + 0.5) * H),), (k + 1) * H)
    errors, bars, helds = np.array(rows).T
    return errors, bars, helds > 0.5, observer, state


@pytest.mark.parametrize(("seed", "wrong"), [(1, 0.0), (1, -0.15), (2, 0.15)])
def test_the_error_bar_holds_the_error_while_friction_holds_the_mass(seed, wrong):
    """A mass is pushed back and forth and stands still for a part of the time; friction as told, and 15 % off."""
    random = np.random.default_rng(seed)
    pace, phase = 2.0 * math.pi * random.uniform(0.5, 1.0), random.uniform(0.0, 6.0)
    errors, bars, held, *_ = along(
        rough_table(),
        lambda t: 14.5 * math.sin(3.0 * t),
        lambda t: 4.0 * math.sin(pace * t + phase),
        1000,
        true_friction=FRICTION * (1.0 + wrong),
        seed=seed,
        order=2,
        disturbance_rate=(4.0 * pace**2,),
        parameter_std=(abs(wrong) * FRICTION,),
    )
    settled = np.arange(len(held)) > 100
    for which in (settled & held, settled & ~held):
        assert np.mean(np.abs(errors[which]) <= 2.0 * bars[which]) >= 0.9
    assert 0.1 < np.mean(held) < 0.85
    assert np.median(bars[settled & held]) <= 3.0 * np.sqrt(np.mean(errors[settled & held] ** 2))


def test_friction_that_holds_for_long_leaves_a_disturbance_anywhere_within_it():
    """|d| < 10 and no more: the standard deviation of such a number is 10/√3."""
    errors, bars, held, *_ = along(
        rough_table(disturbance_bound=50.0), lambda t: 0.0, lambda t: 6.0, 500, order=1, disturbance_rate=(100.0,)
    )
    assert held.all()
    assert bars[-1] == pytest.approx(FRICTION / math.sqrt(3.0), rel=0.05)
    assert np.all(np.abs(errors[100:]) <= 2.0 * bars[100:])


def test_while_friction_holds_the_variance_grows_as_the_disturbance_does_by_itself():
    """r = 1: in each step by s H, and by what jumps that do not show add."""
    eq = rough_table()
    settings = {"order": 1, "disturbance_rate": (2.0,)}
    *_, observer, state = along(eq, lambda t: 16.0 * math.sin(3.0 * t), lambda t: 1.0, 400, **settings)
    resting, said = state, []
    for k in range(150):
        resting, _ = observer.step(resting, (0.0,), (resting.xi_hat[0],), H)
        if k >= 140:  # the mass has come to rest
            said.append(resting)
    tuned, d = observer.tuned(H), observer.layout.disturbance
    for before, after in pairwise(said):
        old, new = (float((one.memory.columns.factor[d] ** 2).sum()) for one in (before, after))
        unseen = unseen_variance(before.memory.jumps, tuned.model.bound * tuned.model.scale)
        own = tuned.intensity(H, tuned.model.noise_ratios(before.memory.sensors)) * H
        assert new - old == pytest.approx(float((own + unseen)[0]), rel=2e-2)


def test_a_mass_that_leaves_its_place_tells_the_disturbance_again():
    errors, bars, held, *_ = along(
        rough_table(), lambda t: 12.0 if t > 0.6 else 0.0, lambda t: 3.0, 400, order=1, disturbance_rate=(10.0,)
    )
    assert held[:300].all()
    assert bars[290] > 1.0
    assert np.all(np.abs(errors[340:]) < 0.5)
    assert np.all(bars[340:] < 0.5)


@pytest.mark.parametrize(
    "friction",
    [
        sympy.sign,
        lambda v: 2 * sympy.Heaviside(v) - 1,
        lambda v: sympy.Piecewise((1, v > 0), (-1, v < 0), (0, True)),
    ],
)
def test_dry_friction_holds_in_whatever_form_it_is_written(friction):
    eq = rough_table(friction)
    plant = Plant(eq, (FRICTION,), (Generator(),))
    state = plant.init((0.0, 0.1), 0.0)
    for k in range(50):
        state = plant.step(state, (5.0,), (1.0,), (k + 1) * H)
    assert state.x[1] == pytest.approx(0.0, abs=1e-100)


def test_a_plant_without_jumps_has_no_surfaces():
    assert rough_table(sympy.tanh).surfaces is None
    np.testing.assert_array_equal(rough_table().surfaces((2.0, 3.0), (0.0,), (FRICTION,)), [3.0, 0.0, 1.0])
