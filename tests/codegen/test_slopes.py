"""The generated derivatives of ẋ and y, against central differences of the generated ẋ and y."""

import math
from dataclasses import replace

import numpy as np
import pytest
import sympy

from ndob_fmu.codegen.compile_model import compile_model
from ndob_fmu.codegen.slopes import slopes
from ndob_fmu.model.model import Model
from ndob_fmu.runtime.design.lumping import lumped
from tests.codegen.test_emit import FUNCTIONS, scalar
from tests.helpers.general_plants import GENERAL
from tests.helpers.problems import MODELS, RANDOM, to_model

# Of central differences with steps of 1e-6: rounding leaves 1e-10 of the function's values, the cut series less.
STEP, WITHIN = 1e-6, 1e-8


def random_model():
    """n, m, p, q1, q2 and the number of parameters are 5, 2, 3, 1, 4, 6."""
    random = np.random.default_rng(11)
    a, b, c, d, e, g = sympy.symbols("a b c d e g")
    A, B = random.normal(size=(5, 5)).tolist(), random.normal(size=(5, 2)).tolist()
    C, G_f, G_d = random.normal(size=(3, 5)).tolist(), [[0], [a], [0], [2.0], [-b]], random.normal(size=(5, 4)).tolist()
    A[0][1], A[3][2], B[1][1], C[2][4], G_d[0][3] = a * b, -c / d, 1 / a, e**2, sympy.cos(g)
    return Model(
        name="Random",
        states=["x1", "x2", "x3", "x4", "x5"],
        inputs=["u1", "u2"],
        outputs=["y1", "y2", "y3"],
        disturbances=["d1", "d2", "d3", "d4"],
        parameters=dict(zip("abcdeg", random.uniform(0.5, 1.5, 6).tolist(), strict=True)),
        A=A,
        B=B,
        C=C,
        G_f=G_f,
        G_d=G_d,
        f=lambda x, u, p: [sympy.sin(p.c * x.x1 * u.u2) * x.x4 + sympy.exp(-p.g * x.x2**2) / (1 + x.x5**2)],
        lipschitz=1.0,
    )


# In units in which no parameter is so small that differences show only rounding.
BALL = {"Ball": replace(GENERAL["Ball"], parameters={"gravity": 1.0, "pull": 2.0})}
ALL = (
    MODELS
    | GENERAL
    | BALL
    | {problem.name: to_model(problem.linear) for problem in RANDOM}
    | {"random": random_model()}
)


def differences(function, at):
    """Return the derivative of function(at), an array, with respect to each number of `at`, as columns."""
    steps = STEP * np.diag(np.where(at == 0.0, 1.0, np.abs(at)))
    columns = [(function(at + h) - function(at - h)) / (2.0 * np.max(h)) for h in steps]
    return np.array(columns).T if columns else np.zeros((len(function(at)), 0))


def assert_derivatives_agree_with_differences(eq, x, u, d, p):
    n, q, outputs = len(x), len(d), len(eq.outputs)

    def rates_and_outputs(x, d, p, u=u):
        return np.array([*eq.derivatives(x, u, d, p), *eq.output(x, u, p)], dtype=float)

    size = np.max(np.abs(rates_and_outputs(x, d, p)))
    found = np.array(eq.linearisation(x, u, d, p), dtype=float).reshape(n + outputs, n + q)
    assert_close(found, differences(lambda z: rates_and_outputs(z[:n], z[n:], p), np.array([*x, *d])), size)
    found = np.array(eq.input_slopes(x, u, d, p), dtype=float).reshape(n + outputs, len(u))
    assert_close(found, differences(lambda u: rates_and_outputs(x, d, p, u), np.array(u)), size)
    found = np.array(eq.sensitivity(x, u, d, p), dtype=float).reshape(n + outputs, len(p))
    assert_close(found, differences(lambda p: rates_and_outputs(x, d, p), np.array(p)), size)


def assert_close(found, by_differences, size):
    largest = np.max(np.abs(by_differences), initial=size)
    np.testing.assert_allclose(found, by_differences, rtol=WITHIN, atol=WITHIN * largest)


@pytest.mark.parametrize("name", ALL)
def test_linearisation_and_sensitivity_of_a_model_agree_with_differences(name):
    eq, random = compile_model(ALL[name]), np.random.default_rng(3)
    for _ in range(3):
        p = [value * random.uniform(0.8, 1.2) for value in eq.parameters.values()]
        x, u, d = (random.uniform(0.3, 1.5, len(names)) for names in (eq.states, eq.inputs, eq.disturbances))
        assert_derivatives_agree_with_differences(eq, x, u, d, p)


def test_with_a_channel_the_lumped_plant_is_linearised_in_the_lumped_inputs():
    eq, random = lumped(compile_model(MODELS["tool_on_arm"])), np.random.default_rng(4)
    x, u, w = (random.uniform(0.3, 1.5, len(names)) for names in (eq.states, eq.inputs, eq.disturbances))
    assert len(w) == 2
    assert_derivatives_agree_with_differences(eq, x, u, w, tuple(eq.parameters.values()))


@pytest.mark.parametrize("name", RANDOM, ids=lambda problem: problem.name)
def test_the_output_is_c_times_x(name):
    eq, x = compile_model(to_model(name.linear)), np.random.default_rng(1).normal(size=len(name.linear.A))
    assert eq.output(x, (0.0,) * len(eq.inputs), ()) == pytest.approx(name.linear.C @ x, rel=1e-14, abs=1e-14)


# Besides those that SymPy differentiates: what its derivative writes as Re and Im, as a delta function or not at all.
KINKS = {name: function for name, (function, _) in FUNCTIONS.items()} | {
    "magnitude of a root": lambda a, b, k: sympy.Abs(sympy.sqrt(a**2 + b) - k) ** 3,
    "magnitude of a magnitude": lambda a, b, k: sympy.exp(-sympy.Abs(a - k * sympy.Abs(b))),
    "flow through an orifice": lambda a, b, k: k * sympy.sign(a - b) * sympy.sqrt(sympy.Abs(a - b)),
    "sign of a floor": lambda a, b, k: a * sympy.sign(b + sympy.floor(a)) + sympy.ceiling(k * sympy.sign(a)) * b,
    "remainder": lambda a, b, k: sympy.Mod(a * b, k) + sympy.frac(b),
    "power": lambda a, b, k: sympy.Abs(a) ** k * b,
    "no derivative with a python form": lambda a, b, k: sympy.gamma(2 + a**2) * b,
    "nested limits": lambda a, b, k: sympy.Max(-k, sympy.Min(k, sympy.Max(a, 2 * b))) * b,
}


@pytest.mark.parametrize("name", KINKS)
def test_kinks_and_jumps_have_the_slope_of_their_branch(name):
    eq, random = compile_model(scalar(KINKS[name])), np.random.default_rng(7)
    for a, b in random.uniform(0.2, 2.9, (30, 2)) * random.choice([-1.0, 1.0], (30, 2)):
        b = abs(b) if name == "magnitude of a root" else b
        assert_derivatives_agree_with_differences(eq, (a, b), (), (0.3,), (1.5,))


def slope_of(function, a, b, k=1.5):
    """Return ∂f/∂a, ∂f/∂b of `scalar`, whose f drives its second state (and, as G_f = G_d, nothing else)."""
    return compile_model(scalar(function)).linearisation((a, b), (), (0.0,), (k,))[3:5]


def test_a_jump_has_the_slope_0_where_it_jumps():
    assert slope_of(lambda a, b, k: 3 * a + sympy.sign(a) + sympy.Heaviside(b), 0.0, 0.0) == (3, 0)


def test_a_power_with_a_parameter_as_exponent_has_a_slope_at_0():
    assert slope_of(lambda a, b, k: a**k, 0.0, 1.0) == (0.0, 0)


@pytest.mark.parametrize("limit", [sympy.Max, sympy.Min])
def test_a_branch_that_is_not_taken_is_not_differentiated(limit):
    """The slope of the root is infinite at 0, where the limit is not the root."""
    sign = -1 if limit is sympy.Min else 1
    assert slope_of(lambda a, b, k: limit(sign * sympy.sqrt(sympy.Abs(a)), sign * k * (1 + b)), 0.0, 1.0) == (
        0,
        sign * 1.5,
    )


def test_what_two_branches_share_is_not_evaluated_where_neither_is_taken():
    """1/a and 1/a² stand more than once in the slope of sin(a)/a; at a = 0 they have no value."""

    def f(a, b, k):
        return sympy.Piecewise((sympy.sin(a) / a + (sympy.cos(a) - 1) / a, sympy.Ne(a, 0)), (1, True))

    assert compile_model(scalar(f)).nonlinearity((0.0, 0.0), (), (1.5,)) == (1,)
    assert slope_of(f, 0.0, 0.0) == (0, 0)
    expected = math.cos(2.0) / 2.0 - math.sin(2.0) / 4.0 - math.sin(2.0) / 2.0 - (math.cos(2.0) - 1.0) / 4.0
    assert slope_of(f, 2.0, 0.0)[0] == pytest.approx(expected, rel=1e-14)


def test_an_infinite_slope_is_an_arithmetic_error():
    with pytest.raises(ArithmeticError):
        slope_of(lambda a, b, k: sympy.sqrt(sympy.Abs(a)), 0.0, 1.0)


def test_slopes_are_zero_for_a_symbol_that_does_not_occur():
    a, b = sympy.symbols("a b", real=True)
    assert slopes([a * a, sympy.sin(b)], [a, b]) == sympy.Matrix([[2 * a, 0], [0, sympy.cos(b)]])
