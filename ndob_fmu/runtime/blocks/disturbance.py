"""The plant FMU's built-in disturbance generator: a function of continuous time."""

from __future__ import annotations

from dataclasses import dataclass
from math import pi, sin

KINDS = {"none": 0, "constant": 1, "ramp": 2, "sine": 3, "step": 4, "chirp": 5}
CHIRP_TIME = 10.0


@dataclass(frozen=True)
class Generator:
    """One disturbance d(t), by its kind. All but the constant are 0 before τ = t − start_time = 0 (s).

    none: 0
    constant: amplitude, at all times
    ramp: amplitude·τ
    sine: amplitude·sin(2π frequency τ), with the frequency in Hz
    step: amplitude
    chirp: a sine whose frequency rises linearly from 0 to `frequency` in 10 s and stays there
    """

    kind: int = KINDS["none"]
    amplitude: float = 0.0
    frequency: float = 1.0
    start_time: float = 0.0

    def __call__(self, t: float) -> float:
        """Return d(t)."""
        if self.kind == KINDS["none"]:
            return 0.0
        if self.kind == KINDS["constant"]:
            return self.amplitude
        tau = t - self.start_time
        if tau < 0.0:
            return 0.0
        if self.kind == KINDS["step"]:
            return self.amplitude
        if self.kind == KINDS["ramp"]:
            return self.amplitude * tau
        if self.kind == KINDS["sine"]:
            return self.amplitude * sin(2.0 * pi * self.frequency * tau)
        rising = min(tau, CHIRP_TIME)
        cycles = self.frequency * (0.5 * rising * rising / CHIRP_TIME + (tau - rising))
        return self.amplitude * sin(2.0 * pi * cycles)

    @property
    def breaks(self) -> tuple[float, ...]:
        """Times at which d or one of its low derivatives jumps; an integrator must not step across them."""
        if self.kind in (KINDS["none"], KINDS["constant"]):
            return ()
        if self.kind == KINDS["chirp"]:
            return (self.start_time, self.start_time + CHIRP_TIME)
        return (self.start_time,)
