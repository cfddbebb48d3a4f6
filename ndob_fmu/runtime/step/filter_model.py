"""What all steps of one observer have in common: its equations, its settings, and ẋ and y linearised at an estimate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from math import inf

import numpy as np
from numpy.typing import NDArray

from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.design.like_disturbance import along_disturbance
from ndob_fmu.runtime.equations import HIGHEST_ORDER, Equations, Vector
from ndob_fmu.runtime.generated_steps import ConvergedGain, Numbers
from ndob_fmu.runtime.numerics.sliding import Sliding, all_on, beside, released
from ndob_fmu.runtime.numerics.units import units_of_inputs
from ndob_fmu.runtime.step.adaptive_noise import in_use
from ndob_fmu.runtime.step.delayed_outputs import PLACES, delayed
from ndob_fmu.runtime.step.filter_state import SensorMemory
from ndob_fmu.runtime.step.jump_bank import INSTANTS, first_sizes, signatures_at_sample
from ndob_fmu.runtime.step.layout import Layout
from ndob_fmu.runtime.step.settings import ObserverSettings

_SAMPLES_PER_STATE = 3


@dataclass(frozen=True)
class FilterModel:
    """An observer's constants.

    layout: of ξ
    noise_variance (p,): of the samples, as told, times the square of the scale
    scale: factor on the standard deviations of all noises, as in `Intensities`
    start_std (N,): standard deviations of ξ before the first sample
    undriven (n,): intensity of the noise on states that nothing else drives, over the step
    doubtful (n,): whether nothing drives a state where its equation may be wrong
    like_disturbance: 1 for each uncertain parameter that is considered and acts as d does, else 0
    natural_units (n + r q2,): of x and the series of d, as in `Augmented`
    least_noise (p,): the least ratio of a variance of noise to the one that was told
    jump_spacing: between two hypotheses of a jump (s)
    """

    equations: Equations
    parameters: Vector
    settings: ObserverSettings
    layout: Layout
    noise_variance: Array = field(repr=False)
    scale: float
    start_std: Array = field(repr=False)
    undriven: Array = field(repr=False)
    doubtful: NDArray[np.bool_] = field(repr=False)
    like_disturbance: Array = field(repr=False)
    natural_units: Array = field(repr=False)
    least_noise: Array = field(repr=False)
    jump_spacing: float

    @cached_property
    def bound(self) -> Array:
        """D₀ (q2,)."""
        return np.array(self.settings.disturbance_bound, dtype=float)

    @cached_property
    def first_sizes(self) -> Array:
        """The sizes (2 q2,3,4) of jumps in one step before any evidence, as in `JumpBank`."""
        return first_sizes(self.bound)

    @cached_property
    def signatures_at_sample(self) -> Array:
        """The signatures (q2,4 q2) of jumps in the next step in d at a sample."""
        return signatures_at_sample(self.layout.q)

    @cached_property
    def jump_channel(self) -> Array:
        """The channel (N,q2) through which d drives ξ."""
        channel = np.zeros((self.layout.size, self.layout.q))
        channel[self.layout.disturbance] = np.eye(self.layout.q)
        return channel

    @property
    def adapts(self) -> bool:
        """Whether the variance of the noise follows the innovations, which for r = 0 carry the disturbance."""
        return self.settings.adapt_noise and self.layout.order > 0

    def noise_ratios(self, sensors: Sequence[SensorMemory]) -> list[float]:
        """Return the variances of the noise that are used over those told (p,)."""
        if not self.adapts:
            return [1.0] * len(sensors)
        return in_use([sensor.noise_ratio for sensor in sensors], self.least_noise.tolist())

    def noise_used(self, sensors: Sequence[SensorMemory]) -> list[float]:
        """Return the variances of the noise that are used (p,)."""
        return [a * b for a, b in zip(self.noise_variance.tolist(), self.noise_ratios(sensors), strict=True)]

    @cached_property
    def delayed(self) -> tuple[int, ...]:
        """Indices of the outputs that arrive late."""
        return delayed(self.settings.sensors.delay)

    @cached_property
    def longest_delay(self) -> float:
        """Of all outputs (s)."""
        return max(self.settings.sensors.delay, default=0.0)

    @cached_property
    def past_size(self) -> int:
        """How many entries behind ξ hold what delayed sensors measured."""
        return PLACES * len(self.delayed)

    @property
    def rows(self) -> int:
        """N + past."""
        return self.layout.size + self.past_size

    @property
    def start_samples(self) -> int:
        """How many samples the start lasts."""
        return _SAMPLES_PER_STATE * (self.layout.n + self.layout.order * self.layout.q)

    @cached_property
    def estimated(self) -> Array:
        """Return 1 for each entry of ξ and of the past that samples correct, 0 for parameters that are considered."""
        mask = np.ones(self.rows)
        mask[self.layout.parameters] = [self.settings.estimated[i] for i in self.layout.uncertain]
        return mask

    def growths(self, growth: float) -> Array:
        """Return the factors (N + past,) on the standard deviations of ξ̂ where it is worse known than P says.

        Of parameters that are considered, samples say nothing.
        """
        return np.where(self.estimated > 0.0, growth, 1.0)

    @cached_property
    def unknown_disturbance(self) -> Array:
        """The columns (N + past,r q2) of d and its derivatives in the factor before the first sample."""
        columns = np.zeros((self.rows, self.layout.order * self.layout.q))
        columns[self.layout.series] = np.diag(self.start_std[self.layout.series])
        return columns

    @cached_property
    def noise_directions(self) -> Array:
        """Directions (N,·) of white noise: on the r-th derivatives of d, and on states."""
        on_states = np.eye(self.layout.size)[:, self._noisy]
        return np.hstack([self.layout.last_derivative, on_states])

    def noise_sizes(self, intensity: Array, H: float) -> Array:
        """Return the square root of the intensities in these directions, for d's (q2,) and a step H (s)."""
        told, undriven = self._on_states
        return np.asarray(np.sqrt(np.concatenate([intensity, told + undriven * H])))

    @cached_property
    def _on_states(self) -> tuple[Array, Array]:
        told = np.array(self.settings.state_noise, dtype=float)
        return told[self._noisy] ** 2, self.undriven[self._noisy]

    @cached_property
    def _noisy(self) -> NDArray[np.intp]:
        return np.flatnonzero(np.array(self.settings.state_noise) + self.undriven > 0.0)

    def signatures_in_step(self, responses: Array) -> Array:
        """Return the signatures (N + past,4 q2) of jumps in a step, for their responses (4,N,q2) at its end."""
        newest = np.zeros((self.rows, self.layout.q * len(INSTANTS)))
        newest[: self.layout.size] = responses.transpose(1, 2, 0).reshape(self.layout.size, -1)
        return newest

    @property
    def is_linear(self) -> bool:
        """Whether ẋ is linear in ξ; not where a parameter is uncertain, because it is multiplied by states."""
        return not self.equations.f_states and not self.layout.uncertain

    @cached_property
    def considers(self) -> bool:
        """Whether there are entries of ξ that samples do not correct."""
        return not all(self.settings.estimated[i] for i in self.layout.uncertain)

    def with_parameters(self, xi: Array) -> Vector:
        """Return the model's parameters, the estimated ones from ξ̂."""
        if not self._estimates_parameters:
            return self.parameters
        values = list(self.parameters)
        for place, index in enumerate(self.layout.uncertain):
            values[index] = float(xi[self.layout.parameters.start + place])
        return tuple(values)

    def step_constants(self, parameters: Vector) -> Numbers:
        """Return what the generated step needs of the parameters. Raises ArithmeticError or ValueError."""
        return self._step_constants if parameters is self.parameters else self._constants_of(parameters)

    @cached_property
    def _step_constants(self) -> Numbers:
        return self._constants_of(self.parameters)

    def _constants_of(self, parameters: Vector) -> Numbers:
        return self.equations.steps.observer_constants(parameters)

    @cached_property
    def no_sample(self) -> tuple[float, ...]:
        """Zeros (p,), for the generated step without a correction."""
        return (0.0,) * len(self.equations.outputs)

    @cached_property
    def no_gain(self) -> ConvergedGain:
        """The gain of the generated step without a correction."""
        p, n, q = len(self.equations.outputs), self.layout.n, self.layout.q
        return ConvergedGain(
            gate=(inf,) * p,
            weight=(0.0,) * p,
            d_std=(0.0,) * q,
            at_sample_std=(0.0,) * q,
            residual_std=(0.0,) * p,
            K=(0.0,) * ((n + HIGHEST_ORDER * q) * p),
        )

    @cached_property
    def _estimates_parameters(self) -> bool:
        return any(self.settings.estimated[i] for i in self.layout.uncertain)

    def rates(self, xi: Array, u: Vector) -> Array:
        """Return F (N,N) of ξ' = F ξ + …, linearised at ξ̂ (N or more,) and u (m,)."""
        layout, (both, sensitivity) = self.layout, self._linearised(xi, u)
        n = layout.n
        F: Array = layout.chain.copy()
        F[:n, :n] = both[:n, :n]
        if layout.order:
            F[:n, layout.disturbance] = both[:n, n:]
        if sensitivity is not None:
            F[:n, layout.parameters] = sensitivity[:n] * (1.0 - self.like_disturbance)
        return F

    def taken_for_disturbance(self, xi: Array, u: Vector) -> Array:
        """Return the variance (q2,) that parameters which act as d does add to that of d̂, at ξ̂ and u (m,)."""
        n, q = self.layout.n, self.layout.q
        if not np.any(self.like_disturbance):
            return np.zeros(q)
        both, sensitivity = self._linearised(self.beside_surfaces(xi, u), u)
        if sensitivity is None:
            return np.zeros(q)
        std = self.like_disturbance * self.start_std[self.layout.parameters]
        W = along_disturbance(both[:n, n:], sensitivity[:n], self.start_std)
        return np.asarray(((W * std) ** 2).sum(axis=1))

    def units(self, F: Array, H: float) -> Array:
        """Return units (N,) of ξ, powers of two, in which norms of F of `rates` count, for a step H (s)."""
        layout, n = self.layout, self.layout.n
        of_parameters = units_of_inputs(F[:n, layout.parameters] * H, self.natural_units[:n])
        return np.concatenate([self.natural_units, np.ones(len(layout.biased)), of_parameters])

    def is_on_a_surface(self, xi: Array, u: Vector) -> bool:
        """Return whether x̂ is on a surface at which ẋ jumps, at ξ̂ and u (m,)."""
        return self.equations.surfaces is not None and bool(all_on(self.surfaces(xi, u), xi[: self.layout.n]))

    def surfaces(self, xi: Array, u: Vector) -> Array:
        """Return [g, ∂g/∂x] (k,1 + n) of the surfaces at which ẋ jumps, at ξ̂ and u (m,)."""
        return self.equations.surfaces_at(xi[: self.layout.n].tolist(), u, self.with_parameters(xi))

    def on_surfaces(self, xi: Array, u: Vector, *, held: bool) -> Sliding | None:
        """Return how x̂ lies to the surfaces that it is on, at ξ̂ and u (m,); None where it is on none.

        held: whether all of them count as if they held it
        """
        eq, parameters, x = self.equations, self.with_parameters(xi), xi[: self.layout.n]
        if eq.surfaces is None:
            return None
        table = self.surfaces(xi, u)
        on = all_on(table, x)
        if not on:
            return None
        d = xi[self.layout.disturbance].tolist() or [0.0] * self.layout.q

        def rate(x: Array) -> Array:
            return np.array(eq.derivatives(x.tolist(), u, d, parameters), dtype=float)

        here = beside(rate, table, x, on)
        return here if held else released(here)

    def beside_surfaces(self, xi: Array, u: Vector) -> Array:
        """Return ξ̂ (N + past,) just below all surfaces that x̂ is on."""
        here = self.on_surfaces(xi, u, held=True)
        if here is None:
            return xi
        moved: Array = xi.copy()
        moved[: self.layout.n] = here.x - here.apart.sum(axis=1)
        return moved

    def coasted(self, xi: Array, H: float) -> Array:
        """Return by how much d̂ and its derivatives change ξ̂ (N + past,) in H s by themselves."""
        N, term = self.layout.size, xi[: self.layout.size]
        change = np.zeros(len(xi))
        for k in range(1, self.layout.order):
            term = self.layout.chain @ term * (H / k)
            change[:N] += term
        return change

    def output_slopes(self, xi: Array, u: Vector) -> Array:
        """Return C (p,N) of y, linearised at ξ̂ (N or more,) and u (m,)."""
        layout, (both, sensitivity) = self.layout, self._linearised(xi, u)
        n = layout.n
        C: Array = self._offsets.copy()
        C[:, :n] = both[n:, :n]
        if sensitivity is not None:
            C[:, layout.parameters] = sensitivity[n:]
        return C

    def _linearised(self, xi: Array, u: Vector) -> tuple[Array, Array | None]:
        """Return the slopes of ẋ and y, (n + p,n + q2), and those by uncertain parameters, None without such."""
        layout, eq = self.layout, self.equations
        n, q, p = layout.n, layout.q, len(eq.outputs)
        x, d = xi[:n].tolist(), xi[layout.disturbance].tolist() or [0.0] * q
        parameters = self.with_parameters(xi)
        both = np.array(eq.linearisation(x, u, d, parameters)).reshape(n + p, n + q)
        if not layout.uncertain:
            return both, None
        sensitivity = np.array(eq.sensitivity(x, u, d, parameters)).reshape(n + p, -1)
        return both, sensitivity[:, list(layout.uncertain)]

    @cached_property
    def _offsets(self) -> Array:
        """The part (p,N) of C that is the same everywhere: offsets of sensors."""
        C = np.zeros((len(self.equations.outputs), self.layout.size))
        for place, output in enumerate(self.layout.biased):
            C[output, self.layout.biases.start + place] = 1.0
        return C

    def predicted_output(self, xi: Array, u: Vector) -> list[float]:
        """Return ŷ (p,) at ξ̂, offsets included."""
        layout = self.layout
        y = list(self.equations.output(xi[: layout.n].tolist(), u, self.with_parameters(xi)))
        for place, output in enumerate(layout.biased):
            y[output] += float(xi[layout.biases.start + place])
        return y
