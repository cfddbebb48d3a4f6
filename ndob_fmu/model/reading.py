"""A model's equations, in either form that a user may write, as the parts of ẋ and y."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import sympy

from ndob_fmu.errors import ModelError, some_of
from ndob_fmu.model.affine_split import AffineSplit, NotAffineError, split
from ndob_fmu.model.expressions import Expressions, Function, Nonlinearity

# What belongs to the form of matrices, and what to that of ẋ.
MATRIX_FORM = ("A", "B", "C", "G_f", "G_d", "f", "channel")


def require_one_form(model: str, dynamics: object, outputs: object, given: Mapping[str, object]) -> None:
    """Require `dynamics`, or else A, C and G_d with a list of outputs; `given`: the fields of MATRIX_FORM."""
    told = [field for field, value in given.items() if value is not None]
    where = f"the equations of {model}"
    if dynamics is not None and told:
        raise ModelError.report(
            where,
            expected="dynamics, or A, B, C, G_f, G_d, f and channel",
            received=f"dynamics and {some_of(told)}",
            likely="the same plant written twice; leave out one of the two",
        )
    missing = [field for field in ("A", "C", "G_d") if field not in told]
    if dynamics is None and missing:
        raise ModelError.report(
            where,
            expected="dynamics=lambda x, u, d, p: […], or A, C and G_d",
            received=f"no {some_of(missing, between=' and no ')}",
        )
    if dynamics is None and isinstance(outputs, Mapping):
        raise ModelError.report(
            f"{model}.outputs",
            expected="a list of names where C says what they measure",
            received="a mapping",
            likely="outputs={name: expression} belongs to dynamics",
        )


def read_matrices(
    read: Expressions,
    names: Mapping[str, Sequence[str]],
    given: Mapping[str, Any],
) -> AffineSplit:
    """Return the parts of the form A, B, C, G_f, G_d, f, channel. Raises ModelError.

    names: of states, inputs, outputs, disturbances and parameters
    """
    n, m, p, q = (len(names[group]) for group in ("states", "inputs", "outputs", "disturbances"))
    groups = {"x": names["states"], "u": names["inputs"], "p": names["parameters"]}

    def matrix(label: str, value: Any, shape: tuple[int, int], why: str) -> sympy.ImmutableMatrix:
        return read.matrix(label, value, shape, why, names["parameters"])

    A = matrix("A", given["A"], (n, n), f"{n} states are named")
    B = matrix("B", given["B"] if m else None, (n, m), f"{n} states and {m} inputs are named")
    C = matrix("C", given["C"], (p, n), f"{p} outputs and {n} states are named")
    direction = read.returned_by("channel", given["channel"], groups)
    if given["channel"] is not None and not direction:
        raise ModelError.report(f"{read.model}.channel", expected="at least one expression", received="none")
    k, why = q, f"{n} states and {q} disturbances are named"
    if direction:
        k = len(direction)
        why = f"{n} states are named and channel returns {k} expressions"
    G_d = matrix("G_d", given["G_d"], (n, k), why)
    f = read.returned_by("f", given["f"], groups)
    G_f = G_d if given["G_f"] is None and f else given["G_f"]
    G_f = matrix("G_f", G_f, (n, len(f)), f"f returns {len(f)} expressions")
    return AffineSplit(A, B, C, G_f, G_d, f, direction, output_rest=(sympy.S.Zero,) * p)


def read_dynamics(
    read: Expressions,
    names: Mapping[str, Sequence[str]],
    dynamics: Function,
    outputs: Mapping[str, Nonlinearity | str],
    *,
    channel: bool,
) -> AffineSplit:
    """Return the parts of ẋ = dynamics(x, u, d, p), y = outputs. Raises ModelError.

    outputs: for each, h(x, u, p) or the name of a state
    channel: whether a single direction that depends on x or u becomes a channel n(x, u)
    """
    states, inputs, disturbances, parameters = (
        names[group] for group in ("states", "inputs", "disturbances", "parameters")
    )
    groups = {"x": states, "u": inputs, "d": disturbances, "p": parameters}
    derivatives = read.returned_by("dynamics", dynamics, groups)
    if len(derivatives) != len(states):
        raise ModelError.report(
            f"{read.model}.dynamics",
            expected=f"{len(states)} expressions, the derivatives of {some_of(states)}",
            received=str(len(derivatives)),
            likely="a derivative is missing, as that of an angle, which is its rate",
        )
    measured = tuple(_output(read, name, value, names) for name, value in outputs.items())
    x, u, d = (tuple(read.symbols[name] for name in group) for group in (states, inputs, disturbances))
    try:
        return split(derivatives, measured, x, u, d, channel=channel and len(d) == 1)
    except NotAffineError as error:
        raise ModelError.report(
            f"{read.model}.dynamics",
            expected=f"derivatives that are affine in the disturbances: … + g(x, u) {error.disturbance.name}",
            received=f"{states[error.state]}' = {derivatives[error.state]}",
            likely="a product or a function of disturbances; name what enters linearly, as a force, as the disturbance",
        ) from error


def _output(read: Expressions, name: str, value: Nonlinearity | str, names: Mapping[str, Sequence[str]]) -> sympy.Expr:
    """Return h of one output."""
    states, where = names["states"], f"{read.model}.outputs, {name}"
    if isinstance(value, str) and value in states:
        return read.symbols[value]
    if not callable(value):
        raise ModelError.report(
            where,
            expected="lambda x, u, p: …, or the name of a state",
            received=repr(value),
            likely="an output of another name needs an expression: outputs={name: lambda x, u, p: …}",
        )
    if _arguments(value) == 4:
        raise ModelError.report(
            where,
            expected="lambda x, u, p: …, which does not depend on disturbances",
            received="a function of four arguments",
            likely="a sensor that a disturbance acts on, as an accelerometer; make the disturbance a state, or leave "
            "the output out",
        )

    def alone(*arguments: Any) -> list[Any]:
        return [value(*arguments)]

    groups = {"x": states, "u": names["inputs"], "p": names["parameters"]}
    return read.returned_by(f"outputs, {name}", alone, groups, hidden=names["disturbances"])[0]


def _arguments(function: Callable[..., Any]) -> int:
    """Return how many arguments a function requires; 0 where that is unknown."""
    try:
        parameters = inspect.signature(function).parameters.values()
    except (TypeError, ValueError):
        return 0
    return sum(parameter.default is parameter.empty for parameter in parameters)
