"""The generated steps do what NumPy does by their definition, to 1e-13 over random states."""

from __future__ import annotations

import functools
from dataclasses import replace
from math import factorial

import numpy as np
import pytest
import sympy
from hypothesis import assume, given
from hypothesis import strategies as st

from ndob_fmu.codegen.compile_model import compile_model
from ndob_fmu.codegen.emit import emit_python
from ndob_fmu.model.model import Model
from ndob_fmu.runtime.base_errors import IntegrationError
from ndob_fmu.runtime.blocks.disturbance import KINDS, Generator
from ndob_fmu.runtime.blocks.plant import Plant
from ndob_fmu.runtime.design.lumping import lumped
from ndob_fmu.runtime.generated_steps import MEMORY
from ndob_fmu.runtime.numerics.integrate import integrate
from ndob_fmu.runtime.step.converged_step import disturbance_std, frozen_memory, residual_std
from ndob_fmu.runtime.step.faulty_samples import SUSPICIOUS
from tests.helpers.observers import sampled_observer
from tests.helpers.problems import MODELS, RANDOM, to_model

WITHIN = 1e-13
K, MASS = sympy.symbols("k mass")
KINKS = Model(
    # n, m, p, q1, q2 = 5, 2, 3, 2, 1; parameters in the matrices, and functions that are no polynomials.
    name="Kinks",
    states=["a", "b", "c", "v", "w"],
    inputs=["push", "pull"],
    outputs=["a", "c", "both"],
    disturbances=["load"],
    parameters={"k": 3.0, "mass": 2.0, "slip": 0.3},
    A=[[0, 0, 0, 1, 0], [0, -K, 1, 0, 0], [0, 0, 0, 0, 1], [-K / MASS, 0, K / MASS, -1, 0], [K, 0, -K, 0, -2]],
    B=[[0, 0], [0, 1], [0, 0], [1 / MASS, 0], [0, 2.5]],
    C=[[1, 0, 0, 0, 0], [0, 0, 1, 0, 0], [0, 1, K, 0, 0]],
    G_d=[[0], [1 / MASS], [0], [0], [0]],
    G_f=[[0, 0], [0, 0], [0, 0], [1, 0], [0, 1]],
    f=lambda x, u, p: [
        sympy.Piecewise((-p.k * x.a, x.a > p.slip), (0, True)) + sympy.tanh(x.v / p.slip) * u.push,
        sympy.Max(-1, sympy.Min(1, x.w)) + sympy.sqrt(x.c**2 + p.slip) ** 3 / (1 + sympy.Abs(x.b)),
    ],
    lipschitz=20.0,
)
ALL = {**MODELS, "kinks": KINKS, **{problem.name: to_model(problem.linear) for problem in RANDOM[::2]}}
SEEDS = st.integers(0, 2**32 - 1)
NAMES = st.sampled_from(sorted(ALL))


def side(name, x):
    """Return on which side of the kinks x lies: where a step crosses one, rounding decides on the substeps."""
    a, b, _, _, w = x if name == "kinks" else (0.0,) * 5
    return a > KINKS.parameters["slip"], b > 0.0, w > 1.0, w > -1.0


@functools.cache
def observer_of(name, order, H):
    """Return the observer, and its converged state before a sample."""
    model = ALL[name]
    eq = lumped(compile_model(model))
    observer = sampled_observer(
        eq,
        model.parameter_values(),
        order=order,
        noise_std=[1e-4] * len(eq.outputs),
        disturbance_bound=eq.disturbance_bound,
        disturbance_rate=[bound * 6.0 ** max(order, 1) for bound in eq.disturbance_bound],
        x_hat=eq.xhat0,
        x_std=eq.xhat0_std,
        alpha=0.2,
        pi=1e8,
    )
    start, tuned = observer.init(eq.xhat0), observer.tuned(H)
    steps = {"age": tuned.model.start_samples, "steady": tuned.model.start_samples, "step": H, "tuned_at": H}
    memory = frozen_memory(
        tuned.model, replace(start.memory, **steps), observer.designs.at(H, H), start.memory.frozen_noise
    )
    return observer, replace(start, memory=memory, sample=(0.0,) * len(eq.outputs))


def at_random(observer, state, seed):
    """Return a random converged state, an input, and a sample with an innovation of up to nine tenths of the gate."""
    random = np.random.default_rng(seed)
    bound = observer.known.disturbance_bound
    x = np.array(observer.equations.xhat0) + random.normal(size=len(observer.designs.x_std)) * observer.designs.x_std
    derivatives = [bound * random.normal(size=len(bound)) * 6.0**i for i in range(observer.system.order)]
    xi = np.concatenate([x, *derivatives])
    padding = (0.0,) * (len(state.xi_hat) - len(xi))
    y = observer.system.C @ xi + 0.9 * largest(observer, state) * random.uniform(-1.0, 1.0, len(observer.system.C))
    u = random.normal(size=len(observer.equations.inputs))
    return replace(state, xi_hat=(*xi.tolist(), *padding)), u.tolist(), y.tolist()


def largest(observer, state):
    return SUSPICIOUS * residual_std(observer.designs.at(state.memory.tuned_at))


def predicted(observer, xi, u, H):
    """Return ξ̂⁻ a step H later: ẋ with d continued by its Taylor series, by the integrator in NumPy."""
    eq, order = observer.equations, observer.system.order
    n, q = len(eq.states), len(eq.disturbances)
    series = xi[n:].reshape(order, q)

    def taylor(i, t):
        return sum((series[j] * t ** (j - i) / factorial(j - i) for j in range(i, order)), np.zeros(q))

    x, _ = integrate(
        lambda t, x: np.array(eq.derivatives(x.tolist(), u, taylor(0, t).tolist(), observer.parameters)),
        *(xi[:n], 0.0, H, H),
    )
    return np.concatenate([x, *(taylor(i, H) for i in range(order))])


def assert_close(mine, theirs, scale):
    np.testing.assert_array_less(np.abs(np.subtract(mine, theirs)), WITHIN * (np.abs(theirs) + scale) + 1e-300)


@given(name=NAMES, order=st.integers(0, 3), H=st.sampled_from([1e-3, 2e-2]), seed=SEEDS)
def test_the_observers_step_corrects_by_the_frozen_gain_and_predicts_by_the_plants_equations(name, order, H, seed):
    observer, state = observer_of(name, order, H)
    state, u, y = at_random(observer, state, seed)
    designs = observer.designs.at(H)
    design, n, N = designs.stationary, len(observer.equations.states), len(observer.system.A)
    xi = np.array(state.xi_hat[:N])
    e = y - observer.system.C @ xi
    corrected = xi + design.K @ e
    try:
        ahead = predicted(observer, corrected, u, H)
    except IntegrationError:
        assume(False)
    assume(side(name, corrected[:n]) == side(name, ahead[:n]))
    assert observer.step_converged(state, [*u, *y], H) is not None
    after, estimate = observer.step(state, u, y, H)
    # A residual is the difference of numbers of the size of the samples, and K multiplies its rounding.
    of_samples = np.abs(y) + np.abs(observer.system.C) @ np.abs(xi)
    of_states = np.abs(design.K) @ of_samples + np.max(np.abs(ahead))
    q = len(state.d_hat)
    d_at_sample, d_ahead, of_d = corrected[n : n + q], ahead[n : n + q], of_states[n : n + q]
    if design.M_H is not None:
        d_at_sample = d_ahead = design.M_H @ e
        of_d = np.abs(design.M_H) @ of_samples
    assert_close(after.xi_hat[:N], ahead, of_states)
    assert not any(after.xi_hat[N:])
    assert_close(after.innovation, e, of_samples)
    assert_close(estimate.residual, e, of_samples)
    assert_close(after.d_hat, d_ahead, of_d)
    assert_close(estimate.x_hat, ahead[:n], of_states[:n])
    assert_close(estimate.x_at_sample, corrected[:n], of_states[:n])
    assert_close(estimate.d_hat, d_ahead, of_d)
    assert_close(estimate.d_at_sample, d_at_sample, of_d)
    assert_close(estimate.d_lagged, d_at_sample, of_d)
    std_ahead, std_at_sample = disturbance_std(designs)
    assert_close(estimate.d_std, std_ahead, 0.0)
    assert_close(estimate.d_lagged_std, std_at_sample, 0.0)
    expected = residual_std(designs)
    assert_close(estimate.residual_std, expected, 0.0)
    squares = np.array(state.squares) + ((e / expected) ** 2 - state.squares) / MEMORY
    assert_close(after.squares, squares, 1.0 + of_samples / expected)
    assert_close(estimate.consistency, np.mean(squares), 1.0 + np.max(of_samples / expected))
    assert (after.u, after.sample, after.memory) == (tuple(u), tuple(y), state.memory)
    assert estimate.valid


@given(name=NAMES, H=st.sampled_from([1e-3, 2e-2, 0.3]), seed=SEEDS)
def test_the_plants_step_is_the_definitions_over_random_states_and_generators(name, H, seed):
    """The generators may jump within the step, and a long one takes several substeps."""
    model, random = ALL[name], np.random.default_rng(seed)
    eq = compile_model(model)
    generators = [
        Generator(random.choice(list(KINDS.values())), *random.uniform([-3.0, 0.0, 0.0], [3.0, 5.0, 1.5 * H]))
        for _ in eq.disturbances
    ]
    plant = Plant(eq, model.parameter_values(), generators)
    state = plant.init(random.normal(size=len(eq.states)) * eq.xhat0_std, random.choice([0.0, 0.3 * H]))
    u, d = random.normal(size=len(eq.inputs)).tolist(), random.normal(size=len(eq.disturbances)).tolist()
    try:
        expected = plant.step_by_definition(state, u, d, state.t + H, H)
    except IntegrationError:
        assume(False)
    assume(side(name, state.x) == side(name, expected.x))
    after = plant.step(state, u, d, state.t + H, H)
    assert after.t == expected.t
    # Rounding grows along unstable directions, and a Lipschitz constant of 20 lets it grow e^6 times in 0.3 s.
    growth = np.exp(H * (20.0 + np.linalg.norm(eq.linear_part(model.parameter_values()).A, 2)))
    assert_close(after.x, expected.x, growth * max(np.max(np.abs(expected.x)), np.max(np.abs(state.x))))


@pytest.mark.parametrize("name", ["flexible_joint", "kinks"])
@pytest.mark.parametrize("order", range(4))
def test_a_sample_outside_the_gate_or_an_input_that_is_not_finite_is_left_to_the_definition(name, order):
    observer, state = observer_of(name, order, 5e-3)
    state, u, y = at_random(observer, state, 7)
    expected = observer.system.C @ state.xi_hat[: len(observer.system.A)]
    beyond = expected + 1.001 * largest(observer, state)
    for inputs, sample in [
        (u, [np.nan, *y[1:]]),
        (u, [*y[:-1], -np.inf]),
        (u, [beyond[0], *y[1:]]),
        (u, [*y[:-1], 2.0 * expected[-1] - beyond[-1]]),
        ([np.nan, *u[1:]], y),
        ([*u[:-1], np.inf], y),
    ]:
        assert observer.step_converged(state, [*inputs, *sample], 5e-3) is None
        after, estimate = observer.step(state, inputs, sample, 5e-3)
        by_definition, estimate_by_definition = observer.step_by_definition(state, inputs, sample, 5e-3)
        assert after.xi_hat == by_definition.xi_hat
        assert (after.u, after.innovation) == (by_definition.u, by_definition.innovation)
        assert after.memory.sensors == by_definition.memory.sensors
        assert estimate == estimate_by_definition


def test_equations_that_cannot_be_evaluated_end_as_the_definition_does():
    rooted = replace(KINKS, f=lambda x, u, p: [sympy.sqrt(x.a), x.w ** sympy.Rational(1, 3)], lipschitz=20.0)
    plant = Plant(compile_model(rooted), rooted.parameter_values(), [Generator()])
    for x in ([-1.0, 0.0, 0.0, 0.0, 1.0], [1.0, 0.0, 0.0, 0.0, -1.0]):
        with pytest.raises(IntegrationError, match="equations cannot be evaluated"):
            plant.step(plant.init(x, 0.0), (0.0, 0.0), (0.0,), 1e-3)


def chain(n):
    """Return n carts in a row between springs, with numbers that differ; every fourth state is measured."""
    A = sympy.zeros(2 * n)
    for i in range(n):
        A[i, n + i] = 1
        A[n + i, i] = -2 - sympy.Rational(i, 7)
        for neighbour in {i - 1, i + 1} & set(range(n)):
            A[n + i, neighbour] = 1 + sympy.Rational(i, 5)
    measured = range(0, n, 4)
    return Model(
        name="Carts",
        states=[f"x{i}" for i in range(2 * n)],
        inputs=[],
        outputs=[f"x{i}" for i in measured],
        disturbances=["load"],
        A=A,
        C=[[float(j == i) for j in range(2 * n)] for i in measured],
        G_d=[[float(j == n)] for j in range(2 * n)],
    )


def operations(n):
    """Return how many multiplications the plant's step has, and the observer's besides those by the dense gain."""
    plant, observer = (
        emit_python(chain(n)).split(f"def {name}")[1].split("\n\n")[0] for name in ("plant_trial", "observer_step")
    )
    return plant.count("*"), observer.count("*") - observer.count("*_e")


def test_the_work_of_a_step_grows_with_the_entries_of_the_model_that_are_not_zero():
    for small, large in zip(operations(4), operations(12), strict=True):
        assert large < 3.3 * small
