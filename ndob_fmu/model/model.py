"""The plant as its user writes it: matrices and a symbolic nonlinearity, the one source of everything else.

Matched (paper §2, eq. 1):    ẋ = A x + B u + G (f(x, u) + d),           y = C x
Unmatched (paper §3, eq. 20): ẋ = A x + B u + G_f f(x, u) + G_d d,       y = C x
With a channel (docs/state_dependent_channel.md): n(x, u) d in place of d, for one d and n with k entries
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from types import MappingProxyType
from typing import Any

import sympy

from ndob_fmu.errors import ModelError, UsageError, nearest, one_of
from ndob_fmu.interface.model_variables import reserved_names
from ndob_fmu.model.checks import (
    by_name,
    for_each,
    require_distinct_names,
    require_finite,
    require_identifier,
    require_known,
    require_names,
    require_no_channel,
    require_not_negative,
    require_numbers,
    require_one_disturbance,
    require_text,
)
from ndob_fmu.model.expressions import Expressions, Nonlinearity, same_matrix
from ndob_fmu.model.vector_field import VectorField
from ndob_fmu.runtime.equations import Experiment, ObserverDefaults, SignalDefaults, lumped_names

# What a user may say by name, or with one number for all: of which group of names, and what holds for the others.
SAID_BY_NAME = {
    "noise_std": ("outputs", 1e-4),
    "delay": ("outputs", 0.0),
    "bias_std": ("outputs", 0.0),
    "parameter_std": ("parameters", 0.0),
    "state_noise": ("states", 0.0),
}


@dataclass(frozen=True, eq=False)
class Model:
    """A nonlinear plant with unknown disturbances. Matrices hold numbers, or SymPy expressions in the `parameters`.

    name: of the model; the FMUs are called <name>Plant and <name>Observer
    states, inputs, outputs, disturbances: names, of n, m, p and q2 variables
    A, B, C: (n,n), (n,m), (p,n)
    G_d: how the disturbances enter, (n,q2); with a channel (n,k)
    G_f: how f enters, (n,q1); where it is left out or equal to G_d, the system is matched (eq. 1)
    f: f(x, u, p) returns q1 SymPy expressions; x, u and p have the symbols as attributes (`x.link_angle`)
    parameters: name and default value
    units, descriptions: name of a variable or parameter, and its unit or a text
    description: of the model
    lipschitz: γ of eq. (3)
    disturbance_bound: D₀, one number or one for each disturbance
    noise_std: standard deviation of the noise in a sample of an output, in its unit: {output: σ} or one number for all;
        1e-4 where it is not given, 0 for no noise
    delay: age (s) of a sample of an output when it arrives, likewise; 0 where it is not given
    bias_std: standard deviation of a constant offset of an output, likewise, in its unit; 0 for none
    parameter_std: one-sigma uncertainty of a parameter, {parameter: σ}, in its unit; 0 where it is known
    state_noise: intensity of white noise on the derivative of a state, {state: σ}, a standard deviation per √s; 0 for
        none
    x0, xhat0: start values of the plant and of its estimate, (n,)
    xhat0_std: standard deviation of the error of xhat0, (n,); by default |x0 − xhat0|, or 1 where that is 0
    observer, disturbance, experiment: start values of the FMUs
    channel: n(x, u, p) returns k SymPy expressions, the direction in which the one disturbance acts
    channel_bound: bound of each |n_j|, one number or k; 1 by default
    channel_rate: Ω (rad/s), how fast n changes along a motion: its i-th time derivative is at most Ω^i times the bound
    f_expressions, channel_expressions: what f and channel return, in the model's symbols

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
    noise_std: float | Mapping[str, float] = SAID_BY_NAME["noise_std"][1]
    delay: float | Mapping[str, float] = 0.0
    bias_std: float | Mapping[str, float] = 0.0
    parameter_std: float | Mapping[str, float] = 0.0
    state_noise: float | Mapping[str, float] = 0.0
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
        self._check_names()
        self._read_expressions()
        self._check_numbers()
        for row, name in enumerate(self.outputs):
            unit_row = sympy.Matrix([[1 if state == name else 0 for state in self.states]])
            if name in self.states and not same_matrix(self.C.row(row), unit_row):
                raise ModelError.report(
                    f"{self.name}.outputs",
                    expected=f"output {name!r} to be the state of that name",
                    received=f"the row {list(self.C.row(row))} of C",
                    likely="another name is needed for this output, or the rows of C are in another order",
                )

    # -- what follows from the fields

    @property
    def matched(self) -> bool:
        """Whether f and d enter through the same channel (eq. 1), or there is no f."""
        return not self.f_expressions or same_matrix(self.G_f, self.G_d)

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
        return self._numbers("observer.disturbance_rate", for_each(len(sines), rate), sines)

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
            self._require_finite_parameter(name, value)
        return tuple(float(overrides.get(name, value)) for name, value in self.parameters.items())

    def told(self, label: str) -> tuple[float, ...]:
        """Return the numbers of a field of `SAID_BY_NAME` in the order of the names.

        Raises ModelError for a name that is not one of them, and for a number that is not finite or below 0.
        """
        where, (group, default) = f"{self.name}.{label}", SAID_BY_NAME[label]
        names = tuple(getattr(self, group))
        numbers = by_name(where, getattr(self, label), names, (default,) * len(names))
        for name, number in zip(names, numbers, strict=True):
            require_not_negative(f"{where}, {name}", number)
        return tuple(map(float, numbers))

    # -- checks and conversions, once, when a model is made

    def _set(self, name: str, value: Any) -> None:
        object.__setattr__(self, name, value)

    def _check_names(self) -> None:
        require_identifier("the model's name", self.name)
        for group in ("states", "inputs", "outputs", "disturbances"):
            names = require_names(f"{self.name}.{group}", getattr(self, group), may_be_empty=group == "inputs")
            self._set(group, names)
        for mapping in ("parameters", "units", "descriptions"):
            self._set(mapping, MappingProxyType(dict(getattr(self, mapping))))
        known = require_distinct_names(
            self.name,
            {group: getattr(self, group) for group in ("states", "inputs", "disturbances", "parameters")},
            self.outputs,
            reserved_names(self.states, self.outputs, self.disturbances, self.parameters),
        )
        for mapping in ("units", "descriptions"):
            require_known(f"{self.name}.{mapping}", getattr(self, mapping), known)
        for name, text in {"description": self.description, **self.descriptions}.items():
            require_text(f"{self.name}, text of {name}", text)
        for name, value in self.parameters.items():
            self._require_finite_parameter(name, value)

    def _require_finite_parameter(self, name: str, value: object) -> None:
        require_finite(f"parameter {name!r} of {self.name}", value)

    def _read_expressions(self) -> None:
        """Take matrices, f and channel as expressions in the model's own symbols."""
        n, m, p, q = len(self.states), len(self.inputs), len(self.outputs), len(self.disturbances)
        read, groups = Expressions(self.name, self.symbols), (self.states, self.inputs, tuple(self.parameters))

        def set_matrix(label: str, value: Any, shape: tuple[int, int], why: str) -> None:
            self._set(label, read.matrix(label, value, shape, why, self.parameters))

        set_matrix("A", self.A, (n, n), f"{n} states are named")
        set_matrix("B", self.B if m else None, (n, m), f"{n} states and {m} inputs are named")
        set_matrix("C", self.C, (p, n), f"{p} outputs and {n} states are named")
        directions = read.returned_by("channel", self.channel, groups)
        self._set("channel_expressions", directions)
        self._check_channel()
        k, why = q, f"{n} states and {q} disturbances are named"
        if directions:
            k = len(directions)
            why = f"{n} states are named and channel returns {k} expressions"
        set_matrix("G_d", self.G_d, (n, k), why)
        expressions = read.returned_by("f", self.f, groups)
        columns = len(expressions)
        if self.G_f is None and columns:
            self._set("G_f", self.G_d)
        set_matrix("G_f", self.G_f, (n, columns), f"f returns {columns} expressions")
        self._set("f_expressions", expressions)

    def _check_channel(self) -> None:
        if self.channel is None:
            given = {"channel_bound": self.channel_bound is not None, "channel_rate": bool(self.channel_rate)}
            require_no_channel(self.name, given)
            return
        if not self.channel_expressions:
            raise ModelError.report(f"{self.name}.channel", expected="at least one expression", received="none")
        require_one_disturbance(self.name, self.disturbances)
        require_not_negative(f"{self.name}.channel_rate", self.channel_rate, " (rad/s)")

    def _check_numbers(self) -> None:
        n, q, k = len(self.states), len(self.disturbances), len(self.channel_expressions)
        for vector in ("x0", "xhat0"):
            self._set(vector, self._numbers(vector, getattr(self, vector), (0.0,) * n))
        differences = tuple(abs(a - b) or 1.0 for a, b in zip(self.x0 or (), self.xhat0 or (), strict=True))
        self._set("xhat0_std", self._numbers("xhat0_std", self.xhat0_std, differences, positive=True))
        bound = for_each(q, self.disturbance_bound)
        self._set("disturbance_bound", self._numbers("disturbance_bound", bound, (1.0,) * q, positive=True))
        for label in SAID_BY_NAME:
            value = getattr(self, label)
            self._set(label, MappingProxyType(dict(value)) if isinstance(value, Mapping) else value)
            self.told(label)
        if k:
            bound = for_each(k, self.channel_bound)
            self._set("channel_bound", self._numbers("channel_bound", bound, (1.0,) * k, positive=True))
        if self.lipschitz is not None:
            require_not_negative(f"{self.name}.lipschitz", self.lipschitz)

    def _numbers(
        self, label: str, value: Any, default: tuple[float, ...], *, positive: bool = False
    ) -> tuple[float, ...]:
        if value is None:
            return default
        return require_numbers(f"{self.name}.{label}", value, len(default), positive=positive)


def require_model(value: object) -> None:
    """Raise UsageError if the value is no Model, for example the path of a model file."""
    if not isinstance(value, Model):
        raise UsageError.report(
            "model", expected="a Model", received=repr(value), likely="`load_model(path)` reads the Model of a file"
        )
