"""Models in which a name of Python or of SymPy stands in every role, through check, design, the written code and steps.

`python -m tests.attacks.names --trials N --seed S`; tests/model/test_names.py does a few of them.
"""

from __future__ import annotations

import argparse
import builtins
import keyword
import random
import sys

import numpy as np
import sympy

from ndob_fmu import Model, NdobError, check, design
from ndob_fmu.codegen.compile_model import compile_model
from tests.helpers.observers import sampled_observer

ROLES = ("states", "inputs", "outputs", "disturbances", "parameters")
FMU_NAMES = {"time", "valid", "method", "alpha", "disturbance"}


def with_name(role, name):
    """ẋ₁ = x₂, ẋ₂ = −x₁ − k x₂ + k u + d + k sin(x₁) / (2 + |x₁|) + max(0, x₂) sin u, with one name replaced."""
    names = {"states": ["s1", "s2"], "inputs": ["u1"], "outputs": ["y1"], "disturbances": ["d1"], "parameters": ["k"]}
    names[role] = [name, *names[role][1:]]
    (s, _), (u,), (k,) = names["states"], names["inputs"], names["parameters"]

    def f(x, inputs, p):
        x1, u1 = getattr(x, s), getattr(inputs, u)
        return [getattr(p, k) * sympy.sin(x1) / (2 + sympy.Abs(x1)) + sympy.Max(0, x.s2) * sympy.sin(u1)]

    matrices = {"A": [["0", "1"], ["-1", f"-{k}"]], "B": [[0], [k]], "C": [[1, 0]], "G_d": [[0], [1]]}
    return Model(name="Named", **matrices, f=f, lipschitz=20.0, **(names | {"parameters": {k: 2.0}}))


def judge(role, name):
    """Raise AssertionError where a model with this name in this role computes something else than others do."""
    x, u, d, p = (0.3, 0.4), (0.5,), (0.6,), (2.0,)
    expected = (0.4, -0.3 - 2 * 0.4 + 2 * 0.5 + 0.6 + 2 * np.sin(0.3) / 2.3 + 0.4 * np.sin(0.5))
    equations = compile_model(with_name(role, name))
    np.testing.assert_allclose(equations.derivatives(x, u, d, p), expected, rtol=1e-15, err_msg=name)
    steps = equations.steps
    after, _ = steps.plant_trial(x, u, d * 6, steps.plant_constants(p), 1e-3)
    np.testing.assert_allclose(after, np.add(x, np.multiply(1e-3, expected)), atol=1e-5, err_msg=name)


def walk(role, name):
    """Take a model with this name in this role through check, design and steps of the observer with a frozen gain."""
    judge(role, name)
    model = with_name(role, name)
    assert check(model).passed, name
    design(model, step_size=1e-2)
    knowledge = {"noise_std": (1e-3,), "disturbance_bound": (1.0,), "disturbance_rate": (40.0,)}
    start = {"x_hat": (0.0, 0.0), "x_std": (1.0, 1.0), "alpha": 0.5, "pi": 1e6}
    observer = sampled_observer(compile_model(model), (2.0,), order=2, **knowledge, **start)
    state = observer.init((0.0, 0.0))
    for k in range(200):
        state, estimate = observer.step(state, (0.0,), (1e-3 * (-1) ** k,), 1e-2)
    assert estimate.valid, name
    assert state.memory.converged, name
    np.testing.assert_allclose(estimate.d_hat, 0.0, atol=1.0)


def main(arguments=None):
    """Judge names drawn from builtins, SymPy, tuple and dict; return the number of those that went wrong."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--trials", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(arguments)
    pool = sorted({*dir(builtins), *dir(sympy), *dir(tuple), *dir(dict), *keyword.kwlist, *keyword.softkwlist, "math"})
    draw = random.Random(options.seed)
    worked, refused, wrong = 0, 0, []
    for _ in range(options.trials):
        role, name = draw.choice(ROLES), draw.choice(pool)
        try:
            walk(role, name)
            worked += 1
        except NdobError as error:
            unusable = name.startswith("_") or keyword.iskeyword(name) or name in FMU_NAMES
            if unusable and len(str(error)) < 300 and "\n" not in str(error):
                refused += 1
            else:
                wrong.append(f"{role} {name}: {error}")
        except Exception as error:
            wrong.append(f"{role} {name}: {type(error).__name__}: {error}")
    print(f"{options.trials} models: {worked} worked, {refused} refused in one line, {len(wrong)} wrong")
    for line in wrong:
        print(line)
    return len(wrong)


if __name__ == "__main__":
    sys.exit(main() != 0)
