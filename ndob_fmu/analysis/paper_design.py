"""The design of the paper's observer at one π, for people: gains, poles, bandwidth, noise gain."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ndob_fmu.runtime.arrays import Array


@dataclass(frozen=True)
class PaperDesign:
    """The paper's observer at one π.

    model, disturbances: their names.
    pi, alpha: π and α (1/s).
    L (n,p): of eq. (7).
    W (q,p): of eq. (9).
    M (q,p): exact at DC.
    Q (n,n): of eqs. (8) and (24).
    poles (n,): of A − L C, in 1/s.
    riccati_residual: relative, ≤ 1e-8.
    bandwidth: largest magnitude of a pole, rad/s.
    dc_gain (q2,): d̂/d for a constant d with W.
    noise_gain (q2,): standard deviation of d̂ per standard deviation of a white error in each sample.
    """

    model: str
    disturbances: tuple[str, ...]
    pi: float
    alpha: float
    L: Array
    W: Array
    M: Array
    Q: Array = field(repr=False)
    poles: NDArray[np.complex128]
    riccati_residual: float
    bandwidth: float
    dc_gain: Array
    noise_gain: Array

    def to_dict(self) -> dict[str, Any]:
        """Return the design in JSON's types; a pole is a pair [real, imaginary]."""
        arrays = {name: getattr(self, name).tolist() for name in ("L", "W", "M", "Q", "dc_gain", "noise_gain")}
        return {
            "model": self.model,
            "pi": self.pi,
            "alpha": self.alpha,
            **arrays,
            "poles": [[pole.real, pole.imag] for pole in self.poles.tolist()],
            "riccati_residual": self.riccati_residual,
            "bandwidth": self.bandwidth,
        }

    def __str__(self) -> str:
        poles = ", ".join(f"{pole:.4g}" for pole in self.poles)
        lines = [
            f"{self.model}: the paper's observer at pi = {self.pi:g}, alpha = {self.alpha:g}",
            "",
            table("L", self.L),
            table("W", self.W),
            table("M", self.M),
            "",
            f"poles of A - LC   {poles} 1/s",
            f"bandwidth         {self.bandwidth:.4g} rad/s: steps longer than {1.0 / self.bandwidth:.2g} s blur it",
            f"Riccati residual  {self.riccati_residual:.1e}, relative",
        ]
        for name, dc, noise in zip(self.disturbances, self.dc_gain, self.noise_gain, strict=True):
            lines.append(
                f"{name}: estimate of a constant {dc:.5f} times its value; noise in the samples times {noise:.3g}"
            )
        return "\n".join(lines)


def sorted_poles(poles: NDArray[Any]) -> NDArray[np.complex128]:
    """Return poles (n,) in the order of their real, then their imaginary parts."""
    return np.asarray(poles[np.lexsort((poles.imag, poles.real))].astype(complex))


def table(label: str, matrix: Array) -> str:
    """Return a matrix as lines of text, the first one labelled."""
    rows = ["  ".join(f"{value:12.4e}" for value in row) for row in matrix]
    return "\n".join(f"{label if i == 0 else '':4}{row}" for i, row in enumerate(rows))
