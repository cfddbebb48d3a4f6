"""SymPy's expressions as Python text that evaluates to the very numbers of the model."""

from __future__ import annotations

from collections.abc import Iterable

import sympy
from sympy.printing.pycode import PythonCodePrinter

from ndob_fmu.errors import ModelError


class _Printer(PythonCodePrinter):  # type: ignore[misc]
    """Python text that evaluates to the very numbers of the model: SymPy's own keeps 15 digits of a float.

    The model's names get an underscore behind them; those of the generated text begin with one.
    """

    def _print_Symbol(self, symbol: sympy.Symbol) -> str:
        # Names of Python do not end like this, so that a state `id` or `abs` hides nothing that the text uses.
        return str(symbol.name if symbol.name.startswith("_") else f"{symbol.name}_")

    def _print_Float(self, number: sympy.Float) -> str:
        return repr(float(number))

    def _print_Pow(self, power: sympy.Pow, rational: bool = False) -> str:
        # A root of a negative number is an error, not the complex number that ** makes of it.
        if not power.exp.is_Integer and abs(power.exp) != sympy.Rational(1, 2):
            return f"math.pow({self._print(power.base)}, {self._print(power.exp)})"
        text: str = super()._print_Pow(power, rational=rational)
        return text

    def _print_Piecewise(self, pieces: sympy.Piecewise) -> str:
        if pieces.args[-1].cond != sympy.true:  # where no condition holds there is no number; SymPy would write None
            pieces = sympy.Piecewise(*pieces.args, (sympy.nan, True))
        text: str = super()._print_Piecewise(pieces)
        return text


_PRINTER = _Printer({"fully_qualified_modules": True})


def python_text(expression: sympy.Expr) -> str:
    """Return the expression in Python. Raises ModelError for a function that has no Python form."""
    try:
        text: str = _PRINTER.doprint(expression)
    except NotImplementedError as error:
        raise ModelError.report(
            "f", expected="functions with a Python form", received=str(expression), likely="an undefined function"
        ) from error
    return text


def tuple_text(items: Iterable[str]) -> str:
    """Return a tuple of these items in Python."""
    items = list(items)
    return f"({', '.join(items)}{',' if len(items) == 1 else ''})"
