"""A model's equations for many rows at once: functions of arrays instead of numbers, as a whole log needs them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from math import prod
from typing import NamedTuple

import numpy as np
import sympy
from sympy.printing.numpy import NumPyPrinter

from ndob_fmu.codegen.build_definitions import input_slopes, linearisation, sensitivity, surfaces
from ndob_fmu.codegen.once_per_model import once_per_model
from ndob_fmu.model.model import Model
from ndob_fmu.runtime.arrays import Array

# Rows that the processor keeps near itself.
_NEAR = 1000

# SymPy's names of the functions that NumPy has.
_OF_NUMPY = {name for name, own in NumPyPrinter().known_functions.items() if own.startswith("numpy.")}

# x (K,n), u (K,m), d (K,q2), p (K,n_p) → (K,…)
RowFunction = Callable[[Array, Array, Array, Array], Array]


@dataclass(frozen=True)
class RowFunctions:
    """The functions of `runtime.equations.Equations` for K rows: x (K,n), u (K,m), d (K,q2) and p (K,n_p).

    A row without a value has NaN.

    derivatives: ẋ (K,n)
    output: y (K,p)
    slopes: [[∂ẋ/∂x, ∂ẋ/∂d], [∂y/∂x, 0]], (K,n + p,n + q2)
    input_slopes: [[∂ẋ/∂u], [∂y/∂u]], (K,n + p,m)
    sensitivity: [[∂ẋ/∂p], [∂y/∂p]], (K,n + p,n_p)
    surfaces: [g, ∂g/∂x] (K,k,1 + n) of the surfaces at which ẋ jumps
    """

    derivatives: RowFunction = field(repr=False)
    output: RowFunction = field(repr=False)
    slopes: RowFunction = field(repr=False)
    input_slopes: RowFunction = field(repr=False)
    sensitivity: RowFunction = field(repr=False)
    surfaces: RowFunction = field(repr=False)


@once_per_model
def row_functions(model: Model) -> RowFunctions:
    """Return the equations of a model without a channel for many rows. Each is compiled when it is first called."""
    f = model.vector_field
    symbols, rows = (f.x, f.u, f.d, f.p), len(f.x) + len(f.outputs)
    return RowFunctions(
        derivatives=_function(symbols, lambda: f.derivatives(f.d), (len(f.x),)),
        output=_function(symbols, lambda: f.outputs, (len(f.outputs),)),
        slopes=_function(symbols, lambda: linearisation(f, f.d, f.d), (rows, len(f.x) + len(f.d))),
        input_slopes=_function(symbols, lambda: input_slopes(f, f.d), (rows, len(f.u))),
        sensitivity=_function(symbols, lambda: sensitivity(f, f.d), (rows, len(f.p))),
        surfaces=_function(symbols, lambda: surfaces(f), (len(f.jumps_at), 1 + len(f.x))),
    )


@once_per_model
def map_functions(model: Model) -> RowFunction:
    """Return the functions of the states in all maps of a model (K,n_φ), in the order of their coefficients."""
    f = model.vector_field
    functions = [function for one in model.maps for function in one.functions]
    return _function((f.x, f.u, f.d, f.p), lambda: functions, (len(functions),))


def _function(
    symbols: Sequence[Sequence[sympy.Symbol]], expressions: Callable[[], Sequence[sympy.Expr]], shape: tuple[int, ...]
) -> RowFunction:
    @cache
    def compiled() -> _Compiled:
        wanted = list(expressions())
        varying = [i for i, one in enumerate(wanted) if not one.is_Number]
        functions = {type(one).__name__ for expression in wanted for one in expression.atoms(sympy.Function)}
        # SciPy, which takes a tenth of a second to import, has those that NumPy has not.
        knows_all = functions <= _OF_NUMPY
        found: Callable[..., Sequence[Array | float]] = sympy.lambdify(
            [symbol for group in symbols for symbol in group],
            [wanted[i] for i in varying],
            modules=["numpy"] if knows_all else ["numpy", "scipy"],
            cse=True,
            dummify=True,
        )
        constant = {i: float(one) for i, one in enumerate(wanted) if one.is_Number and one != 0}
        return _Compiled(found, varying, constant)

    def of_rows(*groups: Array) -> Array:
        K, (function, varying, constant) = len(groups[0]), compiled()
        found = np.zeros((K, prod(shape)))
        for column, number in constant.items():
            found[:, column] = number
        with np.errstate(all="ignore"):
            for some in (slice(first, first + _NEAR) for first in range(0, K, _NEAR)):
                arguments = (_some(values, some) for group in groups for values in group.T)
                for column, value in zip(varying, function(*arguments), strict=True):
                    found[some, column] = value
        return found.reshape(K, *shape)

    return of_rows


class _Compiled(NamedTuple):
    """A function of all columns, the places of its results, and the numbers at other places; elsewhere is 0."""

    function: Callable[..., Sequence[Array | float]]
    varying: Sequence[int]
    constant: Mapping[int, float]


def _some(values: Array, rows: slice) -> Array | float:
    """Return some rows of a column (K,), or the number that it has in all rows."""
    found: Array | float = values[0] if values.strides == (0,) else values[rows]
    return found
