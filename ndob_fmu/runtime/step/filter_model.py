"""What all steps of one observer have in common: its equations, its settings, and ẋ and y linearised at an estimate."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.equations import Equations, Vector
from ndob_fmu.runtime.numerics.transition import responses
from ndob_fmu.runtime.step.adaptive_noise import in_use
from ndob_fmu.runtime.step.delayed_outputs import PLACES, delayed
from ndob_fmu.runtime.step.jump_bank import INSTANTS, inverse_variances
from ndob_fmu.runtime.step.layout import Layout
from ndob_fmu.runtime.step.settings import ObserverSettings

_SAMPLES_PER_STATE = 3


@dataclass(frozen=True)
class Slopes:
    """ẋ and y linearised.

    F (N,N): of ξ' = F ξ + ….
    C (p,N): of y.
    """

    F: Array
    C: Array


@dataclass(frozen=True)
class FilterModel:
    """An observer's constants.

    layout: of ξ
    noise_variance (p,): of the samples, as told, times the square of the scale
    scale: factor on the standard deviations of all noises, as in `Intensities`
    start_std (N,): standard deviations of ξ before the first sample
    undriven (n,): intensity of the noise on states that nothing else drives, over the step
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
    least_noise: Array = field(repr=False)
    jump_spacing: float

    @cached_property
    def bound(self) -> Array:
        """D₀ (q2,)."""
        return np.array(self.settings.disturbance_bound, dtype=float)

    @cached_property
    def jump_precision(self) -> Array:
        """W of the jump hypotheses (2 L q2,3)."""
        return inverse_variances(self.bound)

    @property
    def adapts(self) -> bool:
        """Whether the variance of the noise follows the innovations, which for r = 0 carry the disturbance."""
        return self.settings.adapt_noise and self.layout.order > 0

    def noise_ratios(self, found: Array) -> list[float]:
        """Return the variances of the noise that are used over those told (p,), for those that were found (p,)."""
        return in_use(found, self.least_noise) if self.adapts else [1.0] * len(found)

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

    @cached_property
    def start_columns(self) -> Array:
        """The columns (N + past,r q2) of d and its derivatives in the factor before the first sample."""
        columns = np.zeros((self.rows, self.layout.order * self.layout.q))
        columns[self.layout.series] = np.diag(self.start_std[self.layout.series])
        return columns

    def jumps_in_step(self, F: Array, H: float) -> Array:
        """Return the responses (N + past,4 q2) at the end of a step H (s) to jumps in it, for slopes F (N,N) of ẋ."""
        layout = self.layout
        channel = np.zeros((layout.size, layout.q))
        channel[layout.disturbance] = np.eye(layout.q)
        at_end = responses(F, channel, [(1.0 - instant) * H for instant in INSTANTS])
        newest = np.zeros((self.rows, layout.q * len(INSTANTS)))
        newest[: layout.size] = np.stack(at_end, axis=2).reshape(layout.size, -1)
        return newest

    def with_parameters(self, xi: Array) -> Vector:
        """Return the model's parameters, the estimated ones from ξ̂."""
        uncertain = self.layout.uncertain
        if not any(self.settings.estimated[i] for i in uncertain):
            return self.parameters
        values = list(self.parameters)
        for place, index in enumerate(uncertain):
            values[index] = float(xi[self.layout.parameters.start + place])
        return tuple(values)

    def slopes(self, xi: Array, u: Vector) -> Slopes:
        """Linearise at ξ̂ (N or more,) and u (m,)."""
        layout, eq = self.layout, self.equations
        n, q, p = layout.n, layout.q, len(eq.outputs)
        x = xi[:n].tolist()
        d = xi[layout.disturbance].tolist() or [0.0] * q
        parameters = self.with_parameters(xi)
        both = np.array(eq.linearisation(x, u, d, parameters)).reshape(n + p, n + q)
        F, C = layout.chain.copy(), np.zeros((p, layout.size))
        F[:n, :n], C[:, :n] = both[:n, :n], both[n:, :n]
        if layout.order:
            F[:n, layout.disturbance] = both[:n, n:]
        for place, output in enumerate(layout.biased):
            C[output, layout.biases.start + place] = 1.0
        if layout.uncertain:
            sensitivity = np.array(eq.sensitivity(x, u, d, parameters)).reshape(n + p, -1)[:, list(layout.uncertain)]
            F[:n, layout.parameters], C[:, layout.parameters] = sensitivity[:n], sensitivity[n:]
        return Slopes(F, C)

    def predicted_output(self, xi: Array, u: Vector) -> Array:
        """Return ŷ (p,) at ξ̂, offsets included."""
        layout = self.layout
        y = np.array(self.equations.output(xi[: layout.n].tolist(), u, self.with_parameters(xi)), dtype=float)
        for place, output in enumerate(layout.biased):
            y[output] += xi[layout.biases.start + place]
        return y
