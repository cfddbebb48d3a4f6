"""The plant between communication points, against SciPy at its tightest tolerance: 1e-8 over 20 s at any step."""

import functools
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import scipy.linalg
import sympy
from scipy.integrate import solve_ivp

from ndob_fmu.codegen.compile_model import compile_model, linear_part
from ndob_fmu.model.model import Model
from ndob_fmu.runtime.base_errors import IntegrationError
from ndob_fmu.runtime.blocks.disturbance import KINDS, Generator
from ndob_fmu.runtime.blocks.plant import Plant
from ndob_fmu.runtime.numerics import integrate as integrator
from tests.helpers.problems import MODELS, RANDOM, to_model
from tests.runtime.test_disturbance import FORMULAS, T_S, A, generator

JOINT = MODELS["flexible_joint"]
TORQUE, OFFSET, END = 0.3, -0.2, 20.0  # the input and the disturbance that is added to the generator's


@functools.cache
def reference(kind):
    """The joint's states at 20 s, from eq. (20) with its matrices and its f written here."""
    linear = linear_part(JOINT)

    def derivatives(t, x):
        f, d = [-10.0 * np.sin(x[0])], [FORMULAS[kind](t) + OFFSET]
        return linear.A @ x + linear.B @ [TORQUE] + linear.G_f @ f + linear.G_d @ d

    x = np.ones(4)
    for begin, end in pairwise([0.0, *generator(kind).breaks, END]):
        # The formulas switch at the very end of the stretch before.
        piece = functools.partial(lambda t, x, last: derivatives(min(t, last), x), last=np.nextafter(end, begin))
        x = solve_ivp(piece, (begin, end), x, method="DOP853", rtol=1e-13, atol=1e-14).y[:, -1]
    return x


def run(plant, x, H, end, u=(), d=(0.0,)):
    state = plant.init(x, 0.0)
    for k in range(round(end / H)):
        state = plant.step(state, u, d, (k + 1) * H)
    return state


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("H", [0.1, 0.01])
def test_the_joint_is_within_1e_8_after_20_s_under_every_disturbance_though_it_begins_inside_a_step(kind, H):
    assert round(T_S / H) * H != T_S or H < 0.05
    plant = Plant(compile_model(JOINT), JOINT.parameter_values(), [generator(kind)])
    state = run(plant, np.ones(4), H, END, u=(TORQUE,), d=(OFFSET,))
    np.testing.assert_allclose(state.x, reference(kind), rtol=0, atol=1e-8)


def test_the_joint_is_within_1e_8_after_20_s_at_a_step_of_1_ms():
    plant = Plant(compile_model(JOINT), JOINT.parameter_values(), [generator("sine")])
    state = run(plant, np.ones(4), 1e-3, END, u=(TORQUE,), d=(OFFSET,))
    np.testing.assert_allclose(state.x, reference("sine"), rtol=0, atol=1e-8)


def test_one_step_over_20_s_is_within_1e_8_too():
    plant = Plant(compile_model(JOINT), JOINT.parameter_values(), [generator("step")])
    state = plant.step(plant.init(np.ones(4), 0.0), (TORQUE,), (OFFSET,), END)
    np.testing.assert_allclose(state.x, reference("step"), rtol=0, atol=1e-8)
    assert state.t == END


@pytest.mark.parametrize("problem", [RANDOM[1], RANDOM[7]], ids=lambda problem: problem.name)
def test_a_linear_plant_is_its_matrix_exponential(problem):
    """ẋ = A x + B u + G d with u and d held: x(t) from e^{[A b; 0 0] t}."""
    linear = replace(problem.linear, A=problem.linear.A - 2.0 * np.eye(len(problem.linear.A)))
    n, m = linear.B.shape
    model = to_model(linear, f=None, G_f=None, lipschitz=None)
    q = len(model.disturbances)
    u, d, x = np.linspace(1.0, 2.0, m), np.linspace(-1.0, 1.0, q) + 0.3, np.linspace(-1.0, 1.0, n)
    plant = Plant(compile_model(model), (), [Generator()] * q)
    whole = np.zeros((n + 1, n + 1))
    whole[:n, :n], whole[:n, n] = linear.A, linear.B @ u + linear.G_d @ d
    exact = (scipy.linalg.expm(whole * 5.0) @ [*x, 1.0])[:n]
    np.testing.assert_allclose(run(plant, x, 0.05, 5.0, u, d).x, exact, rtol=0, atol=1e-9)


def test_every_disturbance_has_its_own_generator():
    """A double set of integrators, one per disturbance: a ramp into the first, a step into the second."""
    model = Model(
        name="Two",
        states=["a", "b", "c"],
        outputs=["a", "b"],
        disturbances=["to_a", "to_b"],
        A=[[0, 0, 0], [0, 0, 0], [1, 0, 0]],
        C=[[1, 0, 0], [0, 1, 0]],
        G_d=[[1, 0], [0, 1], [0, 0]],
    )
    generators = [Generator(KINDS["ramp"], 2.0, start_time=0.25), Generator(KINDS["step"], 3.0, start_time=0.33)]
    plant = Plant(compile_model(model), (), generators)
    state = run(plant, [0.0, 0.0, 1.0], 0.1, 1.0, d=(0.0, -1.0))
    np.testing.assert_allclose(state.x, [0.75**2, 3.0 * 0.67 - 1.0, 1.0 + 0.75**3 / 3.0], rtol=0, atol=1e-12)
    assert plant.disturbance(1.0, (0.5, -1.0)) == [2.0 * 0.75 + 0.5, 2.0]


@pytest.mark.parametrize("start", [0.3, 0.25])
def test_a_jump_inside_a_step_or_at_its_edge_costs_no_accuracy(start):
    model = Model(name="One", states=["a"], outputs=["a"], disturbances=["d"], A=[[-1]], C=[[1]], G_d=[[1]])
    plant = Plant(compile_model(model), (), [Generator(KINDS["step"], A, start_time=start)])
    exact = A * (1.0 - np.exp(-(1.0 - start)))
    assert run(plant, [0.0], 0.25, 1.0).x[0] == pytest.approx(exact, abs=1e-10)


def test_a_step_of_the_plant_is_pure():
    plant = Plant(compile_model(JOINT), JOINT.parameter_values(), [generator("sine")])
    state = run(plant, np.ones(4), 0.01, 4.0, u=(TORQUE,), d=(OFFSET,))
    before = tuple(state.x)
    first = plant.step(state, (TORQUE,), (OFFSET,), 4.05)
    plant.step(plant.init(np.zeros(4), 7.0), (0.0,), (9.0,), 9.0)
    again = plant.step(state, (TORQUE,), (OFFSET,), 4.05)
    np.testing.assert_array_equal(first.x, again.x)
    np.testing.assert_array_equal(state.x, before)


# -- where there is no solution


def scalar(f, **fields):
    return Model(
        name="Scalar",
        states=["a"],
        outputs=["a"],
        disturbances=["d"],
        A=[[0]],
        C=[[1]],
        G_d=[[1]],
        f=lambda x, u, p: [f(x.a)],
        **fields,
    )


@pytest.mark.parametrize(
    ("f", "x0", "end"),
    [
        (lambda a: a**2, 1.0, 2.0),  # a = 1/(1 − t)
        (lambda a: 5.0 * a**3, 1.0, 1.0),
    ],
)
def test_a_solution_that_escapes_in_finite_time_ends_in_an_integration_error_with_the_time(monkeypatch, f, x0, end):
    monkeypatch.setattr(integrator, "MOST_SUBSTEPS", 10_000)
    plant = Plant(compile_model(scalar(f)), (), [Generator()])
    with pytest.raises(IntegrationError, match=r"at t = \d[\d.e-]* s: ") as failed:
        run(plant, [x0], 0.1, end)
    assert failed.value.exit_code == 1
    assert "\n" not in str(failed.value)


def test_equations_that_cannot_be_evaluated_end_in_an_integration_error():
    plant = Plant(compile_model(scalar(lambda a: -sympy.sqrt(a), x0=[1.0], xhat0=[1.0])), (), [Generator()])
    with pytest.raises(IntegrationError, match="cannot be evaluated"):
        run(plant, [0.01], 0.1, 1.0)


def test_too_many_substeps_in_one_step_end_in_an_integration_error_that_names_the_likely_cause(monkeypatch):
    monkeypatch.setattr(integrator, "MOST_SUBSTEPS", 300)
    swinging = compile_model(scalar(lambda a: 1e4 * sympy.cos(100.0 * a)))
    plant = Plant(swinging, (), [Generator(KINDS["constant"], 2e4)])
    with pytest.raises(
        IntegrationError, match=r"more than 300 substeps in one communication step; likely cause: .*stiff"
    ):
        plant.step(plant.init([1.0], 0.0), (), (0.0,), 1.0)


def test_a_plant_with_dry_friction_sticks_and_slips():
    """ȧ = d − 3 sign(a): held by d = 1, gone by d = 5, where a = 2 t."""
    plant = Plant(compile_model(scalar(lambda a: -3.0 * sympy.sign(a))), (), [Generator(KINDS["constant"], 1.0)])
    held = plant.step(plant.init([0.0], 0.0), (), (0.0,), 1.0)
    assert abs(held.x[0]) <= 6.0 / 64.0
    plant = Plant(compile_model(scalar(lambda a: -3.0 * sympy.sign(a))), (), [Generator(KINDS["constant"], 5.0)])
    assert plant.step(plant.init([0.0], 0.0), (), (0.0,), 1.0).x[0] == pytest.approx(2.0, abs=1e-9)
