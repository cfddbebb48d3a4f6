"""What a user writes as numbers, texts or SymPy expressions, as expressions in the model's own symbols."""

from __future__ import annotations

import traceback
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import sympy

from ndob_fmu.errors import ModelError, NdobError, nearest, one_of, some_of

# f(x, u, p), n(x, u, p) or h(x, u, p), with the names as attributes of x, u and p; ẋ(x, u, d, p) has d besides.
Nonlinearity = Callable[[Any, Any, Any], Sequence[Any]]
Function = Callable[[Any, Any, Any, Any], Sequence[Any]]

_KINDS = {"x": "state", "u": "input", "d": "disturbance", "p": "parameter"}


@dataclass(frozen=True)
class Expressions:
    """The reader of a model's expressions.

    model: its name, for messages
    symbols: the real symbol of every state, input, disturbance and parameter
    """

    model: str
    symbols: Mapping[str, sympy.Symbol]

    def matrix(
        self, label: str, value: Any, shape: tuple[int, int], why: str, allowed: Iterable[str]
    ) -> sympy.ImmutableMatrix:
        """Return a matrix of this shape in the allowed symbols; `why` says where the shape comes from.

        Raises ModelError for another shape, and for entries other than finite real expressions in these symbols.
        """
        if value is None and 0 in shape:
            return sympy.ImmutableMatrix.zeros(*shape)
        try:
            matrix = sympy.ImmutableMatrix(self._parsed(value) if value is not None else [])
        except (TypeError, ValueError, sympy.SympifyError) as error:
            raise ModelError.report(
                f"{self.model}.{label}", expected=f"a {shape} matrix", received=f"{value!r} ({_one_line(error)})"
            ) from error
        if matrix.shape != shape:
            raise ModelError.report(
                f"{self.model}.{label}",
                expected=f"shape {shape} because {why}",
                received=f"shape {matrix.shape}",
                likely="a missing row or column, or a missing pair of brackets",
            )
        known = frozenset(allowed)
        return matrix.applyfunc(lambda entry: self._own_symbols(label, entry, known))

    def returned_by(
        self,
        label: str,
        function: Callable[..., Any] | None,
        groups: Mapping[str, Sequence[str]],
        hidden: Sequence[str] = (),
    ) -> tuple[sympy.Expr, ...]:
        """Return what a function of these groups of names returns, as of x, u and p; nothing without a function.

        hidden: names of disturbances, on which it must not depend

        Raises ModelError where it cannot be called so, or returns anything but a list of real expressions in these.
        """
        if function is None:
            return ()
        spaces = [SimpleNamespace(**{name: self.symbols[name] for name in group}) for group in groups.values()]
        known = frozenset(name for group in groups.values() for name in group)
        try:
            values = list(function(*spaces))
            return tuple(self._own_symbols(label, value, known, hidden) for value in values)
        except (AttributeError, TypeError, NameError, sympy.SympifyError) as error:
            if isinstance(error, AttributeError | NameError) and _raised_in_sympy(error):
                raise
            where = f"{self.model}.{label}{_place(error)}"
            for letter, space in zip(groups, spaces, strict=True):
                if isinstance(error, AttributeError) and error.obj is space:
                    raise _no_such_name(where, letter, str(error.name), groups) from error
            raise ModelError.report(
                where,
                expected=f"{_returned(label, groups)} in their attributes",
                received=_one_line(error),
                likely="a name that is not declared, math.sin in place of sympy.sin, or a missing list",
            ) from error

    def _parsed(self, value: Any) -> Any:
        """Return lists with each text in them as an expression, in which the model's names mean the model's symbols.

        By itself SymPy takes the text "E" for 2.718… and "beta" for a function.
        """
        if isinstance(value, str):
            try:
                found = sympy.sympify(value, locals=dict(self.symbols))
            except Exception as error:  # SymPy evaluates the text, which may raise anything
                raise sympy.SympifyError(value, error) from error
            if not isinstance(found, sympy.Expr):
                raise sympy.SympifyError(value)
            return found
        return [self._parsed(entry) for entry in value] if isinstance(value, list | tuple) else value

    def _own_symbols(
        self, label: str, expression: Any, known: frozenset[str], hidden: Sequence[str] = ()
    ) -> sympy.Expr:
        """Replace the user's symbols by the model's real ones of the same name; refuse any other symbol."""
        expression = sympy.sympify(self._parsed(expression))
        if not isinstance(expression, sympy.Expr) or expression.has(sympy.I):
            raise ModelError.report(
                f"{self.model}.{label}", expected="real numbers or SymPy expressions", received=str(expression)
            )
        for symbol in expression.free_symbols:
            if symbol.name in hidden:
                raise ModelError.report(
                    f"{self.model}.{label}",
                    expected="an output that does not depend on disturbances",
                    received=str(expression),
                    likely=f"a sensor that {symbol.name} acts on; make it a state, or leave the output out",
                )
            if symbol.name not in known:
                raise ModelError.report(
                    f"{self.model}.{label}",
                    expected=f"expressions in {some_of(sorted(known))}" if known else "numbers",
                    received=f"the symbol {symbol.name!r}",
                    likely="a parameter that is not declared, or a state in a constant matrix",
                )
        if expression.has(sympy.nan, sympy.zoo, sympy.oo, -sympy.oo):
            raise ModelError.report(f"{self.model}.{label}", expected="finite entries", received=str(expression))
        return expression.xreplace({symbol: self.symbols[symbol.name] for symbol in expression.free_symbols})


def same_matrix(one: sympy.MatrixBase, other: sympy.MatrixBase) -> bool:
    """Return whether two matrices are equal as numbers; SymPy's own == holds 1.0 and 1 to be different."""
    return one.shape == other.shape and all((a - b).is_zero for a, b in zip(one, other, strict=True))


def _no_such_name(where: str, letter: str, name: str, groups: Mapping[str, Sequence[str]]) -> NdobError:
    """Return the error of a name that a group does not have, by the group's letter."""
    other = next((f"{other}.{name}" for other, names in groups.items() if name in names), "")
    return ModelError.report(
        where,
        expected=one_of(_KINDS[letter], groups[letter], name),
        received=f"{letter}.{name}",
        likely=f"did you mean '{other}'?" if other else nearest(name, groups[letter]) or "a name that is not declared",
    )


def _place(error: Exception) -> str:
    """Return the line of a user's function where an error comes from; empty where it does not come from one."""
    own = [
        (Path(frame.f_code.co_filename).name, line)
        for frame, line in traceback.walk_tb(error.__traceback__)
        if str(frame.f_globals.get("__name__")).partition(".")[0] not in ("ndob_fmu", "sympy")
    ]
    return f", line {own[-1][1]} of {own[-1][0]}" if own else ""


def _raised_in_sympy(error: Exception) -> bool:
    """Return whether the error comes from SymPy's own code: a fault of the library, not of what it was given."""
    innermost = [frame for frame, _ in traceback.walk_tb(error.__traceback__)][-1]
    return str(innermost.f_globals.get("__name__")).partition(".")[0] == "sympy"


def _returned(label: str, groups: Iterable[str]) -> str:
    is_output = label.startswith("outputs")
    call = f"{'h' if is_output else label}({', '.join(groups)})"
    return f"{call} returning {'a SymPy expression' if is_output else 'a list of SymPy expressions'}"


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())
