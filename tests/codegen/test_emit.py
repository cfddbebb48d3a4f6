"""The text that a symbolic model is written as: the same numbers, the same text every time, or one clear error."""

import ast
import math
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import sympy
from hypothesis import given, settings
from hypothesis import strategies as st

from ndob_fmu.analysis.assumptions import check
from ndob_fmu.codegen.compile_model import compile_model, linear_part
from ndob_fmu.codegen.emit import emit_python
from ndob_fmu.codegen.print_python import print_function
from ndob_fmu.errors import ModelError
from ndob_fmu.model.model import Model
from tests.helpers.problems import MODELS, RANDOM, to_model

# n, m, p, q1, q2 = 3, 2, 4, 1, 5, with names that are legal and awkward: of mathematics, of Python's soft keywords,
# of the generated module's own functions and of its imports.
AWKWARD = {
    "states": ["E", "matrices", "match"],
    "inputs": ["S", "derivatives"],
    "outputs": ["E", "Equations", "gamma", "case"],
    "disturbances": ["I", "pi", "Experiment", "beta", "N"],
    "parameters": {"nonlinearity": 3.0, "EQUATIONS": -2.0, "x": 0.5},
    "A": [[0, 1, 0], [sympy.Symbol("EQUATIONS"), 0, 2], [0, 0, -sympy.Symbol("x")]],
    "B": [[1, 0], [0, 1], [0, 0]],
    "C": [[1, 0, 0], [0, 1, 0], [0, 1, 1], [0, 0, 2]],
    "G_d": np.arange(15.0).reshape(3, 5),
    "G_f": [[0], [1], [sympy.Symbol("nonlinearity")]],
}


def awkward(**changes):
    def f(x, u, p):
        return [p.nonlinearity * sympy.sin(x.E * x.matrices) + x.match * u.derivatives - u.S * p.x]

    return Model(name="Awkward", f=f, lipschitz=1.0, **(AWKWARD | changes))


def scalar(f, **changes):
    """ẋ = f(a, b, k) + d with start values at which all functions of the tests are defined."""
    fields = {
        "name": "Scalar",
        "states": ["a", "b"],
        "outputs": ["a"],
        "disturbances": ["d"],
        "A": np.zeros((2, 2)),
        "C": [[1, 0]],
        "G_d": [[0], [1]],
        "parameters": {"k": 1.5},
    }
    return Model(f=lambda x, u, p: [f(x.a, x.b, p.k)], **(fields | changes))


def value(f, a, b, k=1.5):
    return compile_model(scalar(f)).nonlinearity((a, b), (), (k,))[0]


# -- the same numbers


def test_every_function_of_the_module_is_the_symbolic_model():
    """ẋ = A x + B u + G_f f + G_d d in SymPy's own arithmetic, under names that could be mistaken."""
    model = awkward()
    eq, p = compile_model(model), (3.0, -2.0, 0.5)
    x, u, d = (0.7, -1.2, 0.4), (0.3, 2.0), (1.0, -1.0, 0.5, 2.0, 3.0)
    f = 3.0 * math.sin(0.7 * -1.2) + 0.4 * 2.0 - 0.3 * 0.5
    A = np.array([[0, 1, 0], [-2, 0, 2], [0, 0, -0.5]])
    G_f, G_d = np.array([[0.0], [1.0], [3.0]]), np.arange(15.0).reshape(3, 5)
    for text, expected in zip(eq.matrices(p), (A, AWKWARD["B"], AWKWARD["C"], G_f, G_d), strict=True):
        np.testing.assert_array_equal(text, expected)
    assert eq.nonlinearity(x, u, p) == pytest.approx([f], rel=1e-14)
    expected = A @ x + np.array(AWKWARD["B"]) @ u + G_f[:, 0] * f + G_d @ d
    assert eq.derivatives(x, u, d, p) == pytest.approx(expected, rel=1e-14)
    assert (eq.states, eq.inputs, eq.outputs, eq.disturbances) == tuple(
        tuple(AWKWARD[group]) for group in ("states", "inputs", "outputs", "disturbances")
    )


@pytest.mark.parametrize("problem", RANDOM, ids=lambda problem: problem.name)
def test_the_numbers_of_a_matrix_keep_every_bit(problem):
    linear, written = problem.linear, linear_part(to_model(problem.linear))
    for name in ("A", "B", "C", "G_f", "G_d"):
        np.testing.assert_array_equal(getattr(written, name), getattr(linear, name))


@settings(max_examples=100, deadline=None, derandomize=True)
@given(number=st.floats(allow_nan=False, allow_infinity=False), factor=st.floats(1e-300, 1e300))
def test_any_float_in_a_matrix_in_f_or_in_a_start_value_keeps_every_bit(number, factor):
    model = scalar(lambda a, b, k: factor * a, A=[[0, number], [0, 0]], x0=[number, 0.0])
    assert linear_part(model).A[0, 1] == number
    assert compile_model(model).nonlinearity((1.0, 0.0), (), (1.5,)) == (factor,)
    assert compile_model(model).x0[0] == number


def test_exact_numbers_are_evaluated_as_such():
    third = sympy.Rational(1, 3)
    model = scalar(lambda a, b, k: sympy.pi * a + third, A=[[third, sympy.sqrt(2)], [10**20, 0]])
    np.testing.assert_array_equal(linear_part(model).A, [[1 / 3, math.sqrt(2)], [1e20, 0.0]])
    assert compile_model(model).nonlinearity((2.0, 0.0), (), (1.5,))[0] == pytest.approx(2 * math.pi + 1 / 3, rel=1e-15)


FUNCTIONS = {
    "sign": (lambda a, b, k: sympy.sign(a), lambda a, b, k: np.sign(a)),
    "abs": (lambda a, b, k: sympy.Abs(a - b) * a, lambda a, b, k: abs(a - b) * a),
    "max": (lambda a, b, k: sympy.Max(a, b, k), max),
    "min": (lambda a, b, k: sympy.Min(a, b, k), min),
    "saturation": (lambda a, b, k: sympy.Max(-k, sympy.Min(k, a)), lambda a, b, k: np.clip(a, -k, k)),
    "dead zone": (
        lambda a, b, k: sympy.Piecewise((a - k, a > k), (a + k, a < -k), (0, True)),
        lambda a, b, k: a - np.clip(a, -k, k),
    ),
    "conditions": (
        lambda a, b, k: sympy.Piecewise((a, (a > 0) & (b > 0)), (b, sympy.Or(a < -1, sympy.Ne(b, 0))), (k, True)),
        lambda a, b, k: a if a > 0 and b > 0 else b if a < -1 or b != 0 else k,
    ),
    "heaviside": (lambda a, b, k: sympy.Heaviside(a), lambda a, b, k: np.heaviside(a, 0.5)),
    "powers": (
        lambda a, b, k: sympy.sqrt(a**2 + k) ** 3 / (1 + b**2),
        lambda a, b, k: (a * a + k) ** 1.5 / (1 + b * b),
    ),
    "hyperbolic": (lambda a, b, k: sympy.tanh(k * a) + sympy.cosh(b), lambda a, b, k: np.tanh(k * a) + np.cosh(b)),
    "inverse": (
        lambda a, b, k: sympy.atan2(a, b) + sympy.asinh(a) + sympy.acos(sympy.tanh(b)),
        lambda a, b, k: np.arctan2(a, b) + np.arcsinh(a) + np.arccos(np.tanh(b)),
    ),
    "exponential": (
        lambda a, b, k: sympy.exp(-a * k) * sympy.log(4 + b),
        lambda a, b, k: np.exp(-a * k) * np.log(4 + b),
    ),
    "rounding": (lambda a, b, k: sympy.floor(a) + sympy.ceiling(b), lambda a, b, k: np.floor(a) + np.ceil(b)),
    "shared": (
        lambda a, b, k: sympy.sin(a * b) ** 2 + sympy.cos(sympy.sin(a * b)) / (2 + sympy.sin(a * b)),
        lambda a, b, k: np.sin(a * b) ** 2 + np.cos(np.sin(a * b)) / (2 + np.sin(a * b)),
    ),
}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_functions_are_evaluated_as_they_are_written(name):
    symbolic, numeric = FUNCTIONS[name]
    equations = compile_model(scalar(symbolic))
    points = np.random.default_rng(4).uniform(-3.0, 3.0, (50, 2)).tolist()
    for a, b in [*points, [0.0, 0.0], [0.0, 1.0], [1.5, 0.0], [-1.5, -1.5]]:
        received = equations.nonlinearity((a, b), (), (1.5,))[0]
        assert received == pytest.approx(float(numeric(a, b, 1.5)), rel=1e-13, abs=1e-14)


def test_where_no_branch_of_a_piecewise_holds_f_is_no_number_rather_than_none():
    def gap(a, b, k):
        return sympy.Piecewise((a, a > 1), (b, a < -1))

    assert (value(gap, 2.0, 5.0), value(gap, -2.0, 5.0)) == (2.0, 5.0)
    assert math.isnan(value(gap, 0.0, 5.0))


@pytest.mark.parametrize("model", MODELS.values(), ids=lambda model: model.name)
def test_the_states_that_f_depends_on_are_those_that_change_it(model):
    eq, p = compile_model(model), model.parameter_values()
    random = np.random.default_rng(0)
    x, u = random.uniform(0.1, 0.9, len(eq.states)), tuple(random.uniform(0.1, 0.9, len(eq.inputs)))
    changing = [
        j for j, unit in enumerate(np.eye(len(x))) if eq.nonlinearity(x + 1e-3 * unit, u, p) != eq.nonlinearity(x, u, p)
    ]
    assert list(eq.f_states) == changing


def test_a_model_without_f_has_none():
    model = to_model(RANDOM[5].linear, f=None, G_f=None, lipschitz=None)
    n, m, _, _ = RANDOM[5].shape
    eq = compile_model(model)
    assert eq.nonlinearity((1.0,) * n, (1.0,) * m, ()) == ()
    assert np.array(eq.matrices(())[3]).size == 0
    assert eq.linear_part(()).G_f.shape == (n, 0)
    assert (eq.lipschitz, eq.f_states, eq.matched) == (0.0, (), True)
    x, u, d = np.arange(1.0, n + 1), np.arange(1.0, m + 1), [2.0]
    linear = RANDOM[5].linear
    assert eq.derivatives(x, u, d, ()) == pytest.approx(linear.A @ x + linear.B @ u + linear.G_d @ d, rel=1e-13)


def test_a_model_without_inputs_and_parameters_has_no_columns_for_them():
    model = scalar(lambda a, b, k: a, parameters={"k": 1.0})
    assert compile_model(model).linear_part((1.0,)).B.shape == (2, 0)


# -- the same text


MANY = [*MODELS.values(), *(to_model(problem.linear) for problem in RANDOM[::3]), awkward()]


@pytest.mark.parametrize("model", MANY, ids=lambda model: model.name)
def test_the_text_is_the_same_each_time_and_evaluates_to_the_same_model(model):
    text = emit_python(model)
    assert text == emit_python(replace(model))
    namespace = {}
    exec(compile(text, "equations", "exec"), namespace)
    first, second = namespace["EQUATIONS"], compile_model(model)
    p = model.parameter_values()
    assert first.matrices(p) == second.matrices(p)
    assert {k: v for k, v in vars(first).items() if not callable(v) and k not in ("channel", "steps")} == {
        k: v for k, v in vars(second).items() if not callable(v) and k not in ("channel", "steps")
    }


def test_a_models_text_is_written_once_and_a_changed_copy_gets_its_own():
    model = replace(MODELS["dc_motor"])
    text = emit_python(model)
    assert emit_python(model) is text
    assert emit_python(replace(model, description="another")) != text


def test_a_check_of_a_model_writes_none_of_the_steps(monkeypatch):
    """The steps are most of the text: two thirds of the time for a plant of 60 states."""
    written = []

    def remembered(function):
        written.append(function.name)
        return print_function(function)

    monkeypatch.setattr("ndob_fmu.codegen.emit.print_function", remembered)
    model = replace(MODELS["dc_motor"])
    check(model)
    assert "matrices" in written
    assert not {"plant_trial", "observer_step"} & set(written)
    plant = compile_model(model)
    assert plant.steps.plant_constants(model.parameter_values())
    assert "plant_constants" in written


def test_the_text_does_not_depend_on_the_process_that_writes_it():
    """Python's hashes differ from process to process, and with them the order of its sets."""
    script = (
        "import sys\nfrom tests.helpers.problems import MODELS, RANDOM, to_model\n"
        "from ndob_fmu.codegen.emit import emit_python\n"
        "sys.stdout.reconfigure(encoding='utf-8', newline='\\n')\n"
        "for model in [*MODELS.values(), to_model(RANDOM[6].linear)]: sys.stdout.write(emit_python(model))"
    )
    root = Path(__file__).parents[2]
    environment = os.environ | {"PYTHONHASHSEED": "1", "PYTHONPATH": str(root)}
    other = subprocess.run([sys.executable, "-c", script], env=environment, capture_output=True, check=True).stdout
    own = "".join(emit_python(m) for m in [*MODELS.values(), to_model(RANDOM[6].linear)])
    assert other.decode("utf-8") == own


@pytest.mark.parametrize("model", MANY, ids=lambda model: model.name)
def test_the_text_imports_what_an_fmu_carries_and_nothing_else(model):
    imported = set()
    for node in ast.walk(ast.parse(emit_python(model))):
        if isinstance(node, ast.Import):
            imported |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            imported.add(node.module)
    assert imported == {
        "math",
        "ndob_fmu.runtime.equations",
        "ndob_fmu.runtime.generated_steps",
        "ndob_fmu.runtime.numerics.integrate",
    }


def test_what_occurs_twice_is_computed_once():
    text = emit_python(scalar(FUNCTIONS["shared"][0]))
    for function in ("def nonlinearity", "def derivatives"):
        body = text.split(function)[1].split("\n\n")[0]
        assert body.count("math.sin(") == 1


# -- one clear error


@pytest.mark.parametrize(
    ("f", "received"),
    [
        (lambda a, b, k: sympy.Function("friction")(a), "friction(a)"),
        (lambda a, b, k: sympy.besselj(0, a), "besselj(0, a)"),
        (lambda a, b, k: sympy.DiracDelta(a), "DiracDelta(a)"),
        (lambda a, b, k: sympy.Derivative(sympy.Function("g")(a), a), "Derivative(g(a), a)"),
        (lambda a, b, k: 2 * sympy.Si(a) + b, "Si(a)"),
    ],
)
def test_a_function_without_a_python_form_is_refused_by_name(f, received):
    with pytest.raises(ModelError, match="expected functions with a Python form") as refused:
        compile_model(scalar(f))
    message = str(refused.value)
    assert received in message
    assert "\n" not in message
    assert refused.value.exit_code == 2


@pytest.mark.parametrize(
    ("f", "error"),
    [
        (lambda a, b, k: 1 / a, "ZeroDivisionError"),
        (lambda a, b, k: sympy.log(a), "ValueError"),
        (lambda a, b, k: sympy.exp(1000 * sympy.exp(a)), "OverflowError"),
    ],
)
def test_an_f_that_cannot_be_evaluated_where_the_plant_starts_is_refused_with_the_reason(f, error):
    with pytest.raises(ModelError, match=f"Scalar at its start values: expected .*, received {error}") as refused:
        compile_model(scalar(f))
    assert "\n" not in str(refused.value)
