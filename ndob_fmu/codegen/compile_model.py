"""A model as functions that can be called: its equations, compiled from the text that goes into the FMUs."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cached_property
from typing import Any

import numpy as np

from ndob_fmu.codegen.emit import FunctionTexts, equations_text, function_texts, header_text
from ndob_fmu.codegen.once_per_model import once_per_model
from ndob_fmu.errors import DesignError, ModelError, some_of
from ndob_fmu.model.model import Model
from ndob_fmu.runtime.design.operating_point import middle_input, require_tangent
from ndob_fmu.runtime.equations import Equations
from ndob_fmu.runtime.linear_part import LinearPart
from ndob_fmu.support.progress import begin


@once_per_model
def compile_model(model: Model) -> Equations:
    """Return the model's equations as the runtime uses them.

    Each function is written and compiled when it is first called: a check or a design needs few of them.

    Raises ModelError where an expression has no Python form or cannot be evaluated at the model's start values.
    """
    begin(f"writing the equations of {model.name} as code")
    functions = function_texts(model)
    namespace: dict[str, Any] = {"__name__": f"equations of {model.name}"}
    _run(header_text(model), namespace)
    namespace |= {name: _CompiledOnFirstCall(name, functions, namespace) for name in functions.names}
    _run(equations_text(model), namespace)
    equations: Equations = namespace["EQUATIONS"]
    values, u = tuple(equations.parameters.values()), middle_input(equations.inputs, equations.ranges)
    try:
        if equations.matrices is not None:
            equations.matrices(values)
        for start in (equations.x0, equations.xhat0):
            equations.nonlinearity(start, u, values)
            if equations.matrices is None:
                equations.derivatives(start, u, equations.disturbance_nominal, values)
                equations.output(start, u, values)
            if equations.channel is not None:
                equations.channel.direction(start, u, values)
    except (ArithmeticError, ValueError, NameError, TypeError) as error:
        raise ModelError.report(
            f"{model.name} at its start values",
            expected=f"{_evaluated(equations)} that can be evaluated",
            received=f"{type(error).__name__}: {error}",
            likely="a division by zero or a root of a negative number (x0 is 0 where it is not told), "
            "or a SymPy function without a Python form",
        ) from error
    return equations


class _CompiledOnFirstCall:
    """A function of a model, compiled in the namespace of all its functions when it is first called."""

    def __init__(self, name: str, functions: FunctionTexts, namespace: dict[str, Any]) -> None:
        self._name, self._functions, self._namespace = name, functions, namespace

    def __call__(self, *arguments: Any) -> Any:
        return self._function(*arguments)

    @cached_property
    def _function(self) -> Callable[..., Any]:
        _run(self._functions[self._name], self._namespace)
        function: Callable[..., Any] = self._namespace[self._name]
        return function


def _run(text: str, namespace: dict[str, Any]) -> None:
    exec(compile(text, f"<{namespace['__name__']}>", "exec"), namespace)


def _evaluated(equations: Equations) -> str:
    if equations.matrices is None:
        return "derivatives and outputs"
    return f"matrices and f{' and channel' if equations.channel else ''}"


def working_part(model: Model, parameters: Mapping[str, float] | None = None) -> LinearPart:
    """Return the constant matrices; outside the paper's form the plant linearised where it starts.

    Raises ModelError as `linear_part`, and where the plant has no slopes there.
    """
    if model.vector_field.has_paper_form:
        return linear_part(model, parameters)
    equations = compile_model(model)
    try:
        return require_tangent(equations, model.parameter_values(parameters), equations.xhat0)
    except DesignError as error:
        raise ModelError(str(error)) from error


def linear_part(model: Model, parameters: Mapping[str, float] | None = None) -> LinearPart:
    """Return the constant matrices at the default parameters, or with those in `parameters` replaced.

    Raises ModelError for a name that is not a parameter, and for values at which the matrices are not finite;
    DesignError outside the paper's form.
    """
    values = model.parameter_values(parameters)
    try:
        linear = compile_model(model).linear_part(values)
        finite = all(np.isfinite(M).all() for M in (linear.A, linear.B, linear.C, linear.G_f, linear.G_d))
    except (ArithmeticError, ValueError, TypeError):  # TypeError: the root of a negative number is complex
        finite = False
    if not finite:
        raise ModelError.report(
            f"the matrices of {model.name}",
            expected="finite real entries",
            received=some_of(f"{name} = {value:g}" for name, value in zip(model.parameters, values, strict=True)),
            likely="a division by zero or the root of a negative number at these parameters",
        )
    return linear
