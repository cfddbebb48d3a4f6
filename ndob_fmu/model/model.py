"""The plant as its user writes it, in symbols, the one source of everything else.

As in a textbook:             ẋ = F(x, u) + G_d(x, u) d,                 y = h(x, u)
Matched (paper §2, eq. 1):    ẋ = A x + B u + G (f(x, u) + d),           y = C x
Unmatched (paper §3, eq. 20): ẋ = A x + B u + G_f f(x, u) + G_d d,       y = C x
With a channel (docs/state_dependent_channel.md): n(x, u) d in place of d, for one d and n with k entries
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from types import MappingProxyType
from typing import Any

import numpy as np
import sympy

from ndob_fmu.errors import ModelError, UsageError, nearest, one_of
from ndob_fmu.interface.model_variables import reserved_names
from ndob_fmu.model.affine_split import AffineSplit, with_known_part
from ndob_fmu.model.checks import (
    by_name,
    for_each,
    listed,
    require_bounds,
    require_distinct_names,
    require_finite,
    require_identifier,
    require_known,
    require_names,
    require_no_channel,
    require_not_negative,
    require_numbers,
    require_one_disturbance,
    require_ranges,
    require_text,
)
from ndob_fmu.model.defaults import require_defaults
from ndob_fmu.model.disturbance_map import DisturbanceMap, read_maps
from ndob_fmu.model.expressions import Expressions, Function, Nonlinearity, same_matrix
from ndob_fmu.model.reading import MATRIX_FORM, read_dynamics, read_matrices, require_one_form
from ndob_fmu.model.vector_field import VectorField
from ndob_fmu.runtime.equations import Experiment, ObserverDefaults, SignalDefaults, lumped_names

NO_EXPERIMENT = Experiment()  # of a model that tells none
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
    """A nonlinear plant with unknown disturbances, as `dynamics` or as matrices and f.

    Matrices hold numbers, or SymPy expressions in the `parameters`.

    name: of the model; the FMUs are called <name>Plant and <name>Observer
    states, inputs, outputs, disturbances: names, of n, m, p and q2 variables
    dynamics: dynamics(x, u, d, p) returns ẋ, n SymPy expressions that are affine in d; x, u, d and p have the symbols
        as attributes (`x.link_angle`). `outputs` are then names of states, or {name: h(x, u, p)}
    A, B, C: (n,n), (n,m), (p,n)
    G_d: how the disturbances enter, (n,q2); with a channel (n,k)
    G_f: how f enters, (n,q1); where it is left out or equal to G_d, the system is matched (eq. 1)
    f: f(x, u, p) returns q1 SymPy expressions; x, u and p have the symbols as attributes (`x.link_angle`)
    parameters: name and default value
    units, descriptions: name of a variable or parameter, and its unit or a text
    description: of the model
    lipschitz: γ of eq. (3)
    ranges: where the plant works, {state or input: (lowest, highest)}. γ and the checks look only there, and the
        observer evaluates the equations only there
    disturbance_bound: D₀, one number, one for each disturbance or {disturbance: D₀}: the bound of |d − nominal|; 1 by
        default
    disturbance_nominal: value about which d is small, likewise; 0 by default
    noise_std: standard deviation of the noise in a sample of an output, in its unit: {output: σ} or one number for all;
        1e-4 where it is not given, 0 for no noise
    delay: age (s) of a sample of an output when it arrives, likewise; 0 where it is not given
    bias_std: standard deviation of a constant offset of an output, likewise, in its unit; 0 for none
    parameter_std: one-sigma uncertainty of a parameter, {parameter: σ}, in its unit; 0 where it is known
    state_noise: intensity of white noise on the derivative of a state, {state: σ}, a standard deviation per √s; 0 for
        none
    x0, xhat0: start values of the plant and of its estimate, (n,) or {state: value}; by default 0, and x0
    xhat0_std: standard deviation of the error of xhat0, likewise; by default |x0 − xhat0|, and where that is 0, that of
        a number anywhere in the state's range. Without a range |xhat0|, and where that is 0, too, 1
    observer, disturbance, experiment: start values of the FMUs
    channel: n(x, u, p) returns k SymPy expressions, the direction in which the one disturbance acts
    channel_bound: bound of each |n_j|, one number or k; 1 by default
    channel_rate: Ω (rad/s), how fast n changes along a motion: its i-th time derivative is at most Ω^i times the bound
    disturbance_map: which part of a disturbance is a function of states, {disturbance: {state: "friction" or "place"}};
        its coefficients are parameters, with the start value 0 until `fit` tells them
    maps: the terms and parameters of these functions
    parts: ẋ and y taken apart into matrices, f, n and what is left, in the model's symbols
    output_equations: the mapping that `outputs` was, where it was one

    Raises ModelError where names, shapes or symbols contradict each other.
    """

    name: str
    states: Sequence[str]
    outputs: Any
    disturbances: Sequence[str]
    A: Any = None
    C: Any = None
    G_d: Any = None
    inputs: Sequence[str] = ()
    B: Any = None
    G_f: Any = None
    f: Nonlinearity | None = None
    parameters: Mapping[str, float] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    descriptions: Mapping[str, str] = field(default_factory=dict)
    description: str = ""
    lipschitz: float | None = None
    disturbance_bound: Any = 1.0
    noise_std: float | Mapping[str, float] = SAID_BY_NAME["noise_std"][1]
    delay: float | Mapping[str, float] = 0.0
    bias_std: float | Mapping[str, float] = 0.0
    parameter_std: float | Mapping[str, float] = 0.0
    state_noise: float | Mapping[str, float] = 0.0
    x0: Any = None
    xhat0: Any = None
    xhat0_std: Any = None
    observer: ObserverDefaults = field(default_factory=ObserverDefaults)
    disturbance: SignalDefaults = field(default_factory=SignalDefaults)
    experiment: Experiment = NO_EXPERIMENT
    channel: Nonlinearity | None = None
    channel_bound: float | Sequence[float] | None = None
    channel_rate: float = 0.0
    dynamics: Function | None = None
    output_equations: Mapping[str, Any] | None = field(default=None, repr=False)
    ranges: Mapping[str, Sequence[float]] = field(default_factory=dict)
    disturbance_nominal: Any = 0.0
    disturbance_map: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    maps: tuple[DisturbanceMap, ...] = field(init=False, repr=False)
    parts: AffineSplit = field(init=False, repr=False)

    def __post_init__(self) -> None:
        self._check_names()
        self._read_equations()
        self._check_numbers()
        starts = {name: both for name, *both in zip(self.states, self.x0, self.xhat0, strict=True)}
        self._set("ranges", require_ranges(f"{self.name}.ranges", self.ranges, starts, self.inputs))
        unsaid = tuple(abs(x0 - xhat0) or self._spread(name, xhat0) for name, (x0, xhat0) in starts.items())
        self._set("xhat0_std", self._numbers("xhat0_std", self.states, unsaid, positive=True))
        for row, name in enumerate(self.outputs):
            state = self.symbols[name] if name in self.states else None
            if state is not None and (self.vector_field.outputs[row] - state).is_zero is not True:
                raise ModelError.report(
                    f"{self.name}.outputs",
                    expected=f"output {name!r} to be the state of that name",
                    received=f"{name} = {self.vector_field.outputs[row]}",
                    likely="another name is needed for this output, or the rows of C are in another order",
                )

    # -- what follows from the fields

    @property
    def f_expressions(self) -> tuple[sympy.Expr, ...]:
        """f (q1,) in the model's symbols."""
        return self.parts.f

    @property
    def channel_expressions(self) -> tuple[sympy.Expr, ...]:
        """n (k,) of the channel in the model's symbols; empty without one."""
        return self.parts.direction

    @property
    def matched(self) -> bool:
        """Whether f and d enter through the same channel (eq. 1), or there is no f."""
        return not self.parts.f or same_matrix(self.parts.G_f, self.parts.G_d)

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
        return VectorField(x, u, d, p, self.parts)

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
        if isinstance(self.outputs, Mapping):
            self._set("output_equations", MappingProxyType(dict(self.outputs)))
        for group in ("states", "inputs", "outputs", "disturbances"):
            names = require_names(f"{self.name}.{group}", getattr(self, group), may_be_empty=group == "inputs")
            self._set(group, names)
        self._set("maps", read_maps(self.name, self.disturbance_map, self.states, self.disturbances))
        for mapping in ("parameters", "units", "descriptions"):
            self._set(mapping, MappingProxyType(self._of_maps(mapping) | dict(getattr(self, mapping))))
        known = require_distinct_names(
            self.name,
            {group: getattr(self, group) for group in ("states", "inputs", "disturbances", "parameters")},
            self.outputs,
            reserved_names(self.states, self.outputs, self.disturbances, self.parameters),
        )
        for mapping in ("units", "descriptions"):
            require_known(f"{self.name}.{mapping}", getattr(self, mapping), known)
        for name, text in {"description": self.description, **self.descriptions, **self.units}.items():
            require_text(f"{self.name}, text of {name}", text)
        for name, value in self.parameters.items():
            self._require_finite_parameter(name, value)

    def _of_maps(self, mapping: str) -> dict[str, Any]:
        """Return the start values, units or descriptions of the parameters of all maps."""
        if mapping == "units":
            like = {name: other for one in self.maps for name, other in one.like.items()}
            return {name: self.units[other] for name, other in like.items() if other in self.units}
        return {name: value for one in self.maps for name, value in getattr(one, mapping).items()}

    def _require_finite_parameter(self, name: str, value: object) -> None:
        require_finite(f"parameter {name!r} of {self.name}", value)

    def _read_equations(self) -> None:
        """Take ẋ and y apart, from either form."""
        given = {label: getattr(self, label) for label in MATRIX_FORM}
        require_one_form(self.name, self.dynamics, self.output_equations, given)
        if self.dynamics is None and self.channel is None:
            self._refuse_channel_fields()
        read = Expressions(self.name, self.symbols)
        names = {group: tuple(getattr(self, group)) for group in ("states", "inputs", "outputs", "disturbances")}
        names["parameters"] = tuple(self.parameters)
        if self.dynamics is None:
            self._set("parts", read_matrices(read, names, given))
            for label in ("A", "B", "C", "G_f", "G_d"):
                self._set(label, getattr(self.parts, label))
        else:
            outputs = self.output_equations or {name: name for name in self.outputs}
            bounded = self.channel_bound is not None
            self._set("parts", read_dynamics(read, names, self.dynamics, outputs, channel=bounded))
        self._check_channel()
        if self.maps:
            known = {one.disturbance: one.expression for one in self.maps}
            through = [known.get(name, sympy.S.Zero) for name in self.disturbances]
            variables = {self.symbols[name] for name in (*self.states, *self.inputs)}
            self._set("parts", with_known_part(self.parts, through, variables))

    def _check_channel(self) -> None:
        if not self.channel_expressions:
            self._refuse_channel_fields()
            return
        require_one_disturbance(self.name, self.disturbances)
        if self.maps:
            raise ModelError.report(
                f"{self.name}.disturbance_map", expected="a plant without a channel", received="a channel"
            )
        require_not_negative(f"{self.name}.channel_rate", self.channel_rate, " (rad/s)")
        if np.any(self.disturbance_nominal):
            raise ModelError.report(
                f"{self.name}.disturbance_nominal",
                expected="0 with a channel",
                received=repr(self.disturbance_nominal),
                likely="write the plant as dynamics without channel_bound: the direction may depend on the state there",
            )

    def _refuse_channel_fields(self) -> None:
        given = {"channel_bound": self.channel_bound is not None, "channel_rate": bool(self.channel_rate)}
        require_no_channel(self.name, given)

    def _check_numbers(self) -> None:
        n, q, k = len(self.states), len(self.disturbances), len(self.channel_expressions)
        # The estimate starts where the plant does: at 0 K or 0 Pa few plants have a slope.
        self._set("x0", self._numbers("x0", self.states, (0.0,) * n))
        self._set("xhat0", self._numbers("xhat0", self.states, self.x0))
        where = f"{self.name}.disturbance_bound"
        bound = listed(where, self.disturbance_bound, self.disturbances, (1.0,) * q)
        self._set("disturbance_bound", require_bounds(where, bound, q, positive=True))
        self._set("disturbance_nominal", for_each(q, self.disturbance_nominal))
        self._set("disturbance_nominal", self._numbers("disturbance_nominal", self.disturbances, (0.0,) * q))
        for label in SAID_BY_NAME:
            value = getattr(self, label)
            self._set(label, MappingProxyType(dict(value)) if isinstance(value, Mapping) else value)
            self.told(label)
        if k:
            bound = 1.0 if self.channel_bound is None else self.channel_bound
            self._set(
                "channel_bound", require_bounds(f"{self.name}.channel_bound", bound, k, of="entry of n", positive=True)
            )
        if self.lipschitz is not None:
            require_not_negative(f"{self.name}.lipschitz", self.lipschitz)
        require_defaults(self.name, self.disturbances, self.observer, self.disturbance, self.experiment)

    def _spread(self, state: str, start: float) -> float:
        """Return the standard deviation of a number anywhere in the range of a state, or else of the start's size."""
        if state not in self.ranges:
            return abs(start) or 1.0
        low, high = self.ranges[state]
        return float((high - low) / np.sqrt(12.0))

    def _numbers(
        self, label: str, names: Sequence[str], default: tuple[float, ...], *, positive: bool = False
    ) -> tuple[float, ...]:
        """Return a field as one number for each name."""
        where, value = f"{self.name}.{label}", getattr(self, label)
        if value is None:
            return default
        return require_numbers(where, listed(where, value, names, default), len(names), positive=positive)


def require_model(value: object) -> None:
    """Raise UsageError if the value is no Model, for example the path of a model file."""
    if not isinstance(value, Model):
        raise UsageError.report(
            "model", expected="a Model", received=repr(value), likely="`load_model(path)` reads the Model of a file"
        )
