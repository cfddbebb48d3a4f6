"""The trees of the generated functions hold no Python: printed in C and compiled, they give the same bits."""

from __future__ import annotations

import ctypes
import functools
import os
import shlex
import subprocess
import tempfile
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
import sympy

from ndob_fmu.codegen.build_definitions import build_definitions
from ndob_fmu.codegen.build_step import build_steps
from ndob_fmu.codegen.c_expressions import RUNTIME
from ndob_fmu.codegen.compile_model import compile_model
from ndob_fmu.codegen.print_c import print_function, statements
from ndob_fmu.codegen.program import Return
from ndob_fmu.model.model import Model
from ndob_fmu.runtime.equations import HIGHEST_ORDER
from ndob_fmu.runtime.generated_steps import ConvergedGain
from ndob_fmu.runtime.numerics.integrate import NODES
from tests.codegen.test_generated_step import ALL
from tests.helpers.needs import C_COMPILER

pytestmark = C_COMPILER
NAMES = ["flexible_joint", "three_tank", "tool_on_arm", "kinks", "tall, three channels, unmatched"]
# What the generated steps call, as `runtime.numerics.integrate` has it.
OF_THE_RUNTIME = """
#include <math.h>
#include <float.h>

static int finite_number(double number) { return fabs(number) <= DBL_MAX; }
static int not_a_number(double number) { return !(fabs(number) <= HUGE_VAL); }

static double largest(const double *ratios, int count) {
    double sum = 0.0, most = 0.0;
    for (int i = 0; i < count; i++) { sum += ratios[i]; most = fmax(most, ratios[i]); }
    return finite_number(sum) ? most : INFINITY;
}

static double length_after(double length, double norm) {
    double grow = norm > 0.0 ? fmin(5.0, fmax(0.2, 0.9 * pow(norm, -0.2))) : 5.0;
    return length * (norm > 1.0 ? fmin(grow, 0.9) : grow);
}

static void next_substep(double begin, double tried, double count, double norm, double t_end,
                         double *t, double *length, double *left, double *trials, double *planned) {
    *t = norm <= 1.0 ? begin + tried : begin;
    *left = t_end - *t;
    *planned = length_after(tried, norm);
    *length = *planned >= *left * (1.0 - 1e-12) ? *left : *planned;
    int too_many = count >= 100000 || (count == 10000 && *left > 100000 * *planned)
        || (count >= 30 && *left * count > 500 * *t && *left > 500 * *planned);
    *trials = too_many || !finite_number(norm) ? 0 : count + 1;
}
"""
EXCEPTIONS = {2: ZeroDivisionError, 3: ValueError, 4: OverflowError, 5: OverflowError}


def _hard(x, u, d, p):
    a, b, c, e = x.a, x.b, x.c, x.e
    return [
        sympy.sqrt(a)
        + b**3 / (c * e)
        - sympy.log(b)
        + d.d
        + sympy.Rational(1, 3) * sympy.Abs(a) ** sympy.Rational(1, 3),
        sympy.exp(-a / c) + sympy.Max(a, b, 0.25) * sympy.Min(c, e) + sympy.sign(b) * a**2,
        sympy.Piecewise((a / b, (a > 0) & (b > 1)), (sympy.exp(c), sympy.Or(c < 0, e >= 2)), (1 / e, True)) + u.u,
        sympy.tanh(a) * sympy.atan2(b, c) + sympy.Mod(a, 3) + sympy.sin(b) / sympy.pi - 2 * c / 3 + p.k * e**-2,
    ]


# Where a function has no value.
HARD = Model(
    name="Hard",
    states=("a", "b", "c", "e"),
    inputs=("u",),
    disturbances=("d",),
    parameters={"k": 2.0},
    dynamics=_hard,
    outputs={"y": lambda x, u, p: x.a},
    x0=(1.0, 1.5, 1.0, 1.0),
    xhat0=(1.0, 1.5, 1.0, 1.0),
    disturbance_bound=1.0,
)


@functools.cache
def library(name):
    """Return the model's generated functions as a C library."""
    field = (ALL | {"hard": HARD})[name].vector_field
    text = "\n".join(
        [
            OF_THE_RUNTIME,
            RUNTIME,
            *map(print_function, [build() for build in {**build_definitions(field), **build_steps(field)}.values()]),
        ]
    )
    with tempfile.TemporaryDirectory() as folder:
        source, built = Path(folder, "model.c"), Path(folder, "model.so")
        source.write_text(text.replace("static int ", "int "))
        # Neither fuses multiplications with additions: what is rounded once in Python is rounded once in C.
        options = [
            "-std=c99",
            "-Wall",
            "-Wextra",
            "-Wpedantic",
            "-Wconversion",
            "-Werror",
            "-O2",
            "-ffp-contract=off",
            "-shared",
            "-fPIC",
            str(source),
            "-lm",
            "-o",
            str(built),
        ]
        subprocess.run([*shlex.split(os.environ.get("CC", "cc")), *options], check=True)
        return ctypes.CDLL(str(built))


def in_c(name, function, *arguments, count):
    """Return the first `count` numbers of the function's result, or its fault; arrays are passed as such."""
    passed = [ctypes.c_double(a) if isinstance(a, float) else (ctypes.c_double * (len(a) or 1))(*a) for a in arguments]
    result = (ctypes.c_double * (count or 1))()
    fault = getattr(library(name), function)(*passed, result)
    return fault or list(result)[:count]


def flat(value):
    """Return all numbers of nested tuples in their order."""
    return [number for part in value for number in flat(part)] if isinstance(value, tuple) else [float(value)]


def assert_same(name, function, expected, *arguments):
    expected = flat(expected)
    np.testing.assert_array_equal(in_c(name, function, *arguments, count=len(expected)), expected)


@pytest.fixture(params=NAMES)
def case(request):
    """A model's name and equations, and the random numbers of the test."""
    return request.param, compile_model(ALL[request.param]), np.random.default_rng(5)


def at(eq, random):
    x = tuple((random.normal(size=len(eq.states)) * eq.xhat0_std).tolist())
    u, d = (tuple(random.normal(size=len(names)).tolist()) for names in (eq.inputs, eq.disturbances))
    return x, u, d, tuple(eq.parameters.values())


def test_the_definitions_in_c_give_the_numbers_of_python(case):
    name, eq, random = case
    for _ in range(5):
        x, u, d, p = at(eq, random)
        assert_same(name, "matrices", eq.matrices(p), p)
        assert_same(name, "nonlinearity", eq.nonlinearity(x, u, p), x, u, p)
        if eq.channel is None:
            assert_same(name, "derivatives", eq.derivatives(x, u, d, p), x, u, d, p)
        else:
            w = tuple(random.normal(size=len(eq.channel.bound)).tolist())
            assert_same(name, "direction", eq.channel.direction(x, u, p), x, u, p)
            assert_same(name, "lumped_derivatives", eq.channel.derivatives(x, u, w, p), x, u, w, p)


def test_the_trial_of_the_plant_in_c_gives_the_numbers_of_python(case):
    name, eq, random = case
    for h in (1e-3, 0.05):
        x, u, _, p = at(eq, random)
        d = tuple(random.normal(size=len(NODES) * len(eq.disturbances)).tolist())
        k = eq.steps.plant_constants(p)
        assert_same(name, "plant_constants", k, p)
        tried = eq.steps.plant_trial(x, u, d, k, h)
        assert_same(name, "plant_trial", (*tried.x, tried.error_norm), x, u, d, k, h)


@pytest.mark.parametrize(("H", "second"), [(1e-3, 0.0), (1e-3, 2.0), (0.1, 0.0), (0.1, 2.0)])
def test_the_step_of_the_observer_in_c_gives_the_numbers_of_python(case, H, second):
    """Over one substep and over several, with d̂'' = 0 and with another."""
    name, eq, random = case
    x, u, _, p = at(eq, random)
    q = len(eq.disturbances) if eq.channel is None else len(eq.channel.bound)
    inputs, gain = (*u, *(0.1,) * len(eq.outputs)), converged_gain(eq, q, random)
    xi_hat = (*x, *random.normal(size=2 * q).tolist(), *(second,) * q)
    k = eq.steps.observer_constants(p)
    squares = tuple(random.uniform(0.5, 1.5, len(eq.outputs)).tolist())
    step = eq.steps.observer_step(xi_hat, inputs, squares, k, gain, H)
    assert_same(name, "observer_step", tuple(step), xi_hat, inputs, squares, k, *numbers_of(gain), H)


def converged_gain(eq, q, random, gate=100.0):
    p, rows = len(eq.outputs), len(eq.states) + HIGHEST_ORDER * q
    return ConvergedGain(
        gate=(gate,) * p,
        weight=tuple(random.uniform(0.5, 2.0, p).tolist()),
        d_std=(0.1,) * q,
        at_sample_std=(0.3,) * q,
        residual_std=(0.2,) * p,
        K=tuple((1e-2 * random.normal(size=rows * p)).tolist()),
    )


def numbers_of(gain):
    """Return the fields of the structure as arrays, one after another, as C takes them."""
    return tuple(getattr(gain, field.name) for field in fields(gain))


@pytest.mark.parametrize("which", ["outside the gate", "not finite", "too long"])
def test_a_step_that_the_generated_code_leaves_to_the_definition_is_left_in_c_too(case, which):
    name, eq, random = case
    x, u, _, p = at(eq, random)
    q = len(eq.disturbances) if eq.channel is None else len(eq.channel.bound)
    gain = converged_gain(eq, q, random, gate=0.0 if which == "outside the gate" else 100.0)
    sample = (np.nan if which == "not finite" else 0.1,) * len(eq.outputs)
    xi_hat, H = (*x, *(0.0,) * (HIGHEST_ORDER * q)), 1e9 if which == "too long" else 1e-3
    k = eq.steps.observer_constants(p)
    squares, arguments = (1.0,) * len(eq.outputs), numbers_of(gain)
    found = in_c(name, "observer_step", xi_hat, (*u, *sample), squares, k, *arguments, H, count=1000)
    try:
        expected = eq.steps.observer_step(xi_hat, (*u, *sample), squares, k, gain, H)
    except (ArithmeticError, ValueError) as error:
        expected, found = type(error), EXCEPTIONS[found]
    assert found == (1 if expected is None else expected)


def test_a_function_without_a_value_has_the_fault_in_c_that_python_raises():
    random, eq, counted = np.random.default_rng(2), compile_model(HARD), set()
    for _ in range(300):
        x = random.choice([0.0, -0.0, 1.0, -1.0, 0.5, -2.5, 1e-300, 1e3, -1e200, 1e308, np.inf, np.nan], size=4)
        u, p = tuple(random.normal(size=1).tolist()), tuple(eq.parameters.values())
        arguments = (tuple(x.tolist()), u, (0.5,), p)
        found = in_c("hard", "derivatives", *arguments, count=4)
        try:
            expected = list(eq.derivatives(*arguments))
        except (ArithmeticError, ValueError) as error:
            expected = type(error)
            counted.add(found)
            found = EXCEPTIONS[found]
        np.testing.assert_array_equal(found, expected)
    assert counted == {*EXCEPTIONS}


def test_the_named_results_have_the_fields_of_the_runtimes_structures():
    """The trees name the fields in the order of the structures, which the Python text relies on."""
    from ndob_fmu.runtime import generated_steps

    for build in build_steps(ALL["kinks"].vector_field).values():
        function = build()
        for statement in statements(function.body):
            if isinstance(statement, Return) and hasattr(statement.value, "fields"):
                names = tuple(name for name, _ in statement.value.fields)
                assert names == getattr(generated_steps, statement.value.type)._fields
