"""The plant as its user writes it: matrices and a symbolic nonlinearity, the one source of everything else.

Matched (paper §2, eq. 1):    ẋ = A x + B u + G (f(x, u) + d),           y = C x
Unmatched (paper §3, eq. 20): ẋ = A x + B u + G_f f(x, u) + G_d d,       y = C x
With a channel (docs/state_dependent_channel.md): n(x, u) d in place of d, for one d and n with k entries
"""

from __future__ import annotations

import keyword
import math
import re
import traceback
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from types import MappingProxyType, SimpleNamespace
from typing import Any

import sympy

from ndob_fmu.errors import ModelError, nearest, one_of, some_of
from ndob_fmu.interface.model_variables import reserved_names
from ndob_fmu.model.vector_field import VectorField
from ndob_fmu.runtime.equations import Experiment, ObserverDefaults, SignalDefaults, lumped_names

# What XML 1.0 cannot carry, not even escaped.
_NO_TEXT = re.compile("[^\t\n\r -\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")

Nonlinearity = Callable[[Any, Any, Any], Sequence[Any]]


@dataclass(frozen=True, eq=False)
class Model:
    """A nonlinear plant with unknown disturbances.

    States (n), inputs (m), outputs (p) and disturbances (q2) are named; A (n,n), B (n,m), C (p,n), G_f (n,q1) and
    G_d (n,q2) hold numbers or SymPy expressions in the `parameters` (name: default value). `f(x, u, p)` returns q1
    SymPy expressions; x, u and p carry the symbols as attributes (`x.link_angle`). Without `G_f`, or with G_f equal to
    G_d, the system is matched (eq. 1). `units` and `descriptions` go by name. `lipschitz` is γ of eq. (3);
    `disturbance_bound` is D₀, one number or one for each disturbance; `x0` and `xhat0` are the start values of the
    plant and of its estimate, `xhat0_std` the standard deviation of the latter's error (by default what they differ by,
    or 1 where they do not). `observer`, `disturbance` and `experiment` are start values of the FMUs.

    `channel(x, u, p)` returns k SymPy expressions n, the direction in which the one disturbance acts through the k
    columns of G_d (n,k). `channel_bound` bounds their magnitudes, one number or k (default 1); `channel_rate` Ω (rad/s)
    is how fast n changes along a motion: its i-th derivative in time is at most Ω^i times the bound.

    Raises ModelError where names, shapes or symbols contradict each other.
    """

    name: str
    states: Sequence[str]
    outputs: Sequence[str]
    disturbances: Sequence[str]
    A: Any
    C: Any
    G_d: Any
    inputs: Sequence[str] = ()
    B: Any = None
    G_f: Any = None
    f: Nonlinearity | None = None
    parameters: Mapping[str, float] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    descriptions: Mapping[str, str] = field(default_factory=dict)
    description: str = ""
    lipschitz: float | None = None
    disturbance_bound: float | Sequence[float] = 1.0
    x0: Sequence[float] | None = None
    xhat0: Sequence[float] | None = None
    xhat0_std: Sequence[float] | None = None
    observer: ObserverDefaults = field(default_factory=ObserverDefaults)
    disturbance: SignalDefaults = field(default_factory=SignalDefaults)
    experiment: Experiment = field(default_factory=Experiment)
    channel: Nonlinearity | None = None
    channel_bound: float | Sequence[float] | None = None
    channel_rate: float = 0.0
    f_expressions: tuple[sympy.Expr, ...] = field(init=False, repr=False)
    channel_expressions: tuple[sympy.Expr, ...] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        self._normalise_names()
        n, m, p, q = len(self.states), len(self.inputs), len(self.outputs), len(self.disturbances)
        self._set("A", self._matrix("A", self.A, (n, n), f"{n} states are named"))
        self._set("B", self._matrix("B", self.B if m else None, (n, m), f"{n} states and {m} inputs are named"))
        self._set("C", self._matrix("C", self.C, (p, n), f"{p} outputs and {n} states are named"))
        directions = self._evaluate("channel", self.channel)
        self._set("channel_expressions", directions)
        self._check_channel(q)
        named = f"{n} states and {q} disturbances are named"
        returned = f"{n} states are named and channel returns {len(directions)} expressions"
        shape = (n, len(directions) or q)
        self._set("G_d", self._matrix("G_d", self.G_d, shape, returned if directions else named))
        expressions = self._evaluate("f", self.f)
        columns = len(expressions)
        if self.G_f is None and columns:
            self._set("G_f", self.G_d)
        self._set("G_f", self._matrix("G_f", self.G_f, (n, columns), f"f returns {columns} expressions"))
        self._set("f_expressions", expressions)
        for vector in ("x0", "xhat0"):
            self._set(vector, self._vector(vector, getattr(self, vector), (0.0,) * n))
        differences = tuple(abs(a - b) or 1.0 for a, b in zip(self.x0 or (), self.xhat0 or (), strict=True))
        self._set("xhat0_std", self._vector("xhat0_std", self.xhat0_std, differences, positive=True))
        bound = _for_each(q, self.disturbance_bound)
        self._set("disturbance_bound", self._vector("disturbance_bound", bound, (1.0,) * q, positive=True))
        if directions:
            bound = _for_each(len(directions), self.channel_bound)
            self._set("channel_bound", self._vector("channel_bound", bound, (1.0,) * len(directions), positive=True))
        self._check_lipschitz()
        self._check_output_names()

    # -- what follows from the fields

    @property
    def matched(self) -> bool:
        """Whether f and d enter through the same channel (eq. 1), or there is no f."""
        return not self.f_expressions or _same(self.G_f, self.G_d)

    @property
    def unknown_inputs(self) -> tuple[str, ...]:
        """What enters through the columns of G_d: the disturbances, or n₁ d … n_k d of the one with a channel."""
        names = tuple(self.disturbances)
        return lumped_names(names[0], len(self.channel_expressions)) if self.channel_expressions else names

    @cached_property
    def symbols(self) -> Mapping[str, sympy.Symbol]:
        """The real symbol of every state, input, disturbance and parameter."""
        names = [*self.states, *self.inputs, *self.disturbances, *self.parameters]
        return MappingProxyType({name: sympy.Symbol(name, real=True) for name in names})

    @cached_property
    def vector_field(self) -> VectorField:
        """ẋ, y and ∂f/∂x in symbols."""
        x, u, d, p = (
            tuple(self.symbols[name] for name in group)
            for group in (self.states, self.inputs, self.disturbances, self.parameters)
        )
        matrices = {name: getattr(self, name) for name in ("A", "B", "C", "G_f", "G_d")}
        return VectorField(x, u, d, p, **matrices, f=self.f_expressions, direction=self.channel_expressions)

    @property
    def disturbance_rate(self) -> tuple[float, ...]:
        """Bound (q2,) of |d^{(r)}|, of |ḋ| for r = 0: the observer's default, or that of 1 Hz sines at the bound."""
        rate, order = self.observer.disturbance_rate, max(self.observer.disturbance_order, 1)
        sines = tuple(bound * (2.0 * math.pi) ** order for bound in tuple(self.disturbance_bound))  # type: ignore[arg-type]
        return self._vector("observer.disturbance_rate", _for_each(len(sines), rate), sines)

    def parameter_values(self, overrides: Mapping[str, float] | None = None) -> tuple[float, ...]:
        """Return all parameter values in their order.

        Raises ModelError for a name that is not a parameter and for a value that is not a finite number.
        """
        overrides = overrides or {}
        for name, value in overrides.items():
            if name not in self.parameters:
                raise ModelError.report(
                    f"parameter {name!r} of {self.name}",
                    expected=one_of("parameter", sorted(self.parameters), name),
                    received=repr(name),
                    likely=nearest(name, self.parameters),
                )
            self._require_finite(name, value)
        return tuple(float(overrides.get(name, value)) for name, value in self.parameters.items())

    # -- checks, once, here

    def _set(self, name: str, value: Any) -> None:
        object.__setattr__(self, name, value)

    def _normalise_names(self) -> None:
        _require_identifier("the model's name", self.name)
        for group in ("states", "inputs", "outputs", "disturbances"):
            names = getattr(self, group)
            if isinstance(names, str) or not isinstance(names, Iterable):
                raise ModelError.report(f"{self.name}.{group}", expected="a list of names", received=repr(names))
            self._set(group, tuple(names))
            if not names and group != "inputs":
                raise ModelError.report(f"{self.name}.{group}", expected="at least one name", received="none")
        for mapping in ("parameters", "units", "descriptions"):
            self._set(mapping, MappingProxyType(dict(getattr(self, mapping))))
        seen: dict[str, str] = {}
        for group in ("states", "inputs", "disturbances", "parameters"):
            for name in getattr(self, group):
                _require_identifier(f"{self.name}.{group}", name)
                if name in seen:
                    raise ModelError.report(
                        f"{self.name}.{group}",
                        expected="every name once among states, inputs, disturbances and parameters",
                        received=f"{name!r}, which is also in {seen[name]}",
                    )
                seen[name] = group
        for name in self.outputs:
            _require_identifier(f"{self.name}.outputs", name)
            if self.outputs.count(name) > 1 or seen.get(name, "states") != "states":
                raise ModelError.report(
                    f"{self.name}.outputs",
                    expected="names used once, or the name of the state that is measured",
                    received=f"{name!r}, which is also in {seen.get(name, 'outputs')}",
                )
        reserved = reserved_names(self.states, self.outputs, self.disturbances)
        for name in [*seen, *self.outputs]:
            if name in reserved:
                raise ModelError.report(
                    self.name, expected="names that the FMUs do not use themselves", received=repr(name)
                )
        for mapping in ("units", "descriptions"):
            for name in getattr(self, mapping):
                if name not in seen and name not in self.outputs:
                    known = sorted({*seen, *self.outputs})
                    raise ModelError.report(
                        f"{self.name}.{mapping}",
                        expected=one_of("name", known, name),
                        received=repr(name),
                        likely=nearest(name, known),
                    )
        for name, text in {"description": self.description, **self.descriptions}.items():
            if not isinstance(text, str) or _NO_TEXT.search(text):
                raise ModelError.report(
                    f"{self.name}, text of {name}", expected="characters that XML can carry", received=repr(text)
                )
        for name, value in self.parameters.items():
            self._require_finite(name, value)

    def _require_finite(self, name: str, value: Any) -> None:
        if not _is_finite_number(value):
            raise ModelError.report(
                f"parameter {name!r} of {self.name}", expected="a finite number", received=repr(value)
            )

    def _matrix(self, label: str, value: Any, shape: tuple[int, int], why: str) -> sympy.ImmutableMatrix:
        if value is None and 0 in shape:
            return sympy.ImmutableMatrix.zeros(*shape)
        try:
            matrix = sympy.ImmutableMatrix(self._parsed(value) if value is not None else [])
        except (TypeError, ValueError, sympy.SympifyError) as error:
            raise ModelError.report(
                f"{self.name}.{label}", expected=f"a {shape} matrix", received=f"{value!r} ({_one_line(error)})"
            ) from error
        if matrix.shape != shape:
            raise ModelError.report(
                f"{self.name}.{label}",
                expected=f"shape {shape} because {why}",
                received=f"shape {matrix.shape}",
                likely="a missing row or column, or a missing pair of brackets",
            )
        return matrix.applyfunc(lambda entry: self._own_symbols(label, entry, self.parameters))

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

    def _own_symbols(self, label: str, expression: Any, allowed: Iterable[str]) -> sympy.Expr:
        """Replace the user's symbols by the model's real ones of the same name; refuse any other symbol."""
        known = set(allowed)
        expression = sympy.sympify(self._parsed(expression))
        if not isinstance(expression, sympy.Expr) or expression.has(sympy.I):
            raise ModelError.report(
                f"{self.name}.{label}", expected="real numbers or SymPy expressions", received=str(expression)
            )
        for symbol in expression.free_symbols:
            if symbol.name not in known:
                raise ModelError.report(
                    f"{self.name}.{label}",
                    expected=f"expressions in {some_of(sorted(known))}" if known else "numbers",
                    received=f"the symbol {symbol.name!r}",
                    likely="a parameter that is not declared, or a state in a constant matrix",
                )
        if expression.has(sympy.nan, sympy.zoo, sympy.oo, -sympy.oo):
            raise ModelError.report(f"{self.name}.{label}", expected="finite entries", received=str(expression))
        return expression.xreplace({symbol: self.symbols[symbol.name] for symbol in expression.free_symbols})

    def _evaluate(self, label: str, function: Nonlinearity | None) -> tuple[sympy.Expr, ...]:
        if function is None:
            return ()
        spaces = [
            SimpleNamespace(**{name: self.symbols[name] for name in group})
            for group in (self.states, self.inputs, self.parameters)
        ]
        try:
            values = list(function(*spaces))
            return tuple(
                self._own_symbols(label, value, [*self.states, *self.inputs, *self.parameters]) for value in values
            )
        except (AttributeError, TypeError, sympy.SympifyError) as error:
            if isinstance(error, AttributeError) and _raised_in_sympy(error):
                raise
            raise ModelError.report(
                f"{self.name}.{label}",
                expected=f"{label}(x, u, p) returning a list of SymPy expressions in their attributes",
                received=_one_line(error),
                likely="a name that is not declared, math.sin in place of sympy.sin, or a missing list",
            ) from error

    def _vector(
        self, label: str, value: Any, default: tuple[float, ...], *, positive: bool = False
    ) -> tuple[float, ...]:
        if value is None:
            return default
        numbers = tuple(value) if isinstance(value, Iterable) else ()
        usable = all(_is_finite_number(v) and (v > 0 or not positive) for v in numbers)
        if len(numbers) != len(default) or not usable:
            expected = f"{len(default)} finite numbers" + (" > 0" if positive else "")
            raise ModelError.report(f"{self.name}.{label}", expected=expected, received=repr(value))
        return tuple(float(v) for v in numbers)

    def _check_channel(self, disturbances: int) -> None:
        if self.channel is None:
            for label, given in (
                ("channel_bound", self.channel_bound is not None),
                ("channel_rate", self.channel_rate),
            ):
                if given:
                    raise ModelError.report(
                        f"{self.name}.{label}", expected="a channel that it belongs to", received="no channel"
                    )
            return
        if not self.channel_expressions:
            raise ModelError.report(f"{self.name}.channel", expected="at least one expression", received="none")
        if disturbances != 1:
            raise ModelError.report(
                f"{self.name}.disturbances",
                expected="one disturbance where there is a channel",
                received=f"{disturbances}: {some_of(self.disturbances)}",
                likely="the channel belongs to one of them; give the others constant columns in a model of their own",
            )
        if not (_is_finite_number(self.channel_rate) and self.channel_rate >= 0):
            raise ModelError.report(
                f"{self.name}.channel_rate", expected="a finite number ≥ 0 (rad/s)", received=repr(self.channel_rate)
            )

    def _check_lipschitz(self) -> None:
        gamma = self.lipschitz
        if gamma is not None and not (_is_finite_number(gamma) and gamma >= 0):
            raise ModelError.report(f"{self.name}.lipschitz", expected="a finite number ≥ 0", received=repr(gamma))

    def _check_output_names(self) -> None:
        for row, name in enumerate(self.outputs):
            unit_row = sympy.Matrix([[1 if state == name else 0 for state in self.states]])
            if name in self.states and not _same(self.C.row(row), unit_row):
                raise ModelError.report(
                    f"{self.name}.outputs",
                    expected=f"output {name!r} to be the state of that name",
                    received=f"the row {list(self.C.row(row))} of C",
                    likely="another name is needed for this output, or the rows of C are in another order",
                )


def _for_each(count: int, value: Any) -> Any:
    return [value] * count if _is_finite_number(value) else value


def _is_finite_number(value: Any) -> bool:
    try:
        return math.isfinite(value)
    except TypeError:
        return False


def _require_identifier(where: str, name: Any) -> None:
    plain = isinstance(name, str) and name.isidentifier() and name.isascii() and not name.startswith("_")
    if not plain or keyword.iskeyword(name):
        raise ModelError.report(
            where,
            expected="a name of ASCII letters, digits and underscores that starts with a letter and is no keyword of "
            "Python",
            received=repr(name),
            likely=f"x.{name} cannot be written in Python; {name}_ can" if plain else "",
        )


def _raised_in_sympy(error: Exception) -> bool:
    """Return whether the error comes from SymPy's own code: a fault of the library, not of what it was given."""
    innermost = [frame for frame, _ in traceback.walk_tb(error.__traceback__)][-1]
    return str(innermost.f_globals.get("__name__")).partition(".")[0] == "sympy"


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())


def _same(one: sympy.MatrixBase, other: sympy.MatrixBase) -> bool:
    """Return whether two matrices are equal as numbers; SymPy's own == holds 1.0 and 1 to be different."""
    return one.shape == other.shape and all((a - b).is_zero for a, b in zip(one, other, strict=True))
