"""Design the observer of a model: assumptions first, then the gain, then what the gain means for its user."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ndob_fmu.assumptions import check
from ndob_fmu.errors import UsageError
from ndob_fmu.model import Model
from ndob_fmu.runtime.gains import paper_gains

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Design:
    """The paper's observer at one π.

    L (n,p) of eq. (7), W (q,p) of eq. (9), M (q,p) exact at DC, Q (n,n) of eq. (8)/(24), poles (n,) of A − L C in 1/s.
    bandwidth: largest pole magnitude, rad/s. dc_gain (q2,): d̂/d for a constant d with W. noise_gain (q2,): standard
    deviation of d̂ per standard deviation of a white error in each sample. riccati_residual: relative, ≤ 1e-8.
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
        """Return all of it in JSON's types; a pole is a pair [real, imaginary]."""
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
            _table("L", self.L),
            _table("W", self.W),
            _table("M", self.M),
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


def design(
    model: Model,
    *,
    pi: float | None = None,
    alpha: float | None = None,
    parameters: Mapping[str, float] | None = None,
) -> Design:
    """Design the paper's observer for π > 0 and α > 0 (1/s), by default the model's `observer.pi_end` and `.alpha`.

    Raises UsageError for a π or α that is none, AssumptionError where an assumption of the paper fails, and DesignError
    where the Riccati equation cannot be solved to a relative residual of 1e-8.
    """
    pi = model.observer.pi_end if pi is None else pi
    alpha = model.observer.alpha if alpha is None else alpha
    if not (np.isfinite(pi) and pi > 0):
        raise UsageError.report("pi", expected="a finite number > 0", received=repr(pi))
    check(model, alpha=alpha, parameters=parameters).require()
    linear = model.linear_part(parameters)
    gains = paper_gains(linear, pi=pi, alpha=alpha)
    poles = np.linalg.eigvals(linear.A - gains.L @ linear.C)
    estimate = np.sqrt(pi) * linear.selector @ gains.W
    constant = estimate @ linear.C @ np.linalg.solve(gains.L @ linear.C - linear.A, linear.G_d)
    return Design(
        model=model.name,
        disturbances=tuple(model.disturbances),
        pi=float(pi),
        alpha=float(alpha),
        L=gains.L,
        W=gains.W,
        M=gains.M,
        Q=gains.riccati.Q,
        poles=poles[np.lexsort((poles.imag, poles.real))].astype(complex),
        riccati_residual=gains.riccati.residual,
        bandwidth=float(np.max(np.abs(poles))),
        dc_gain=np.diag(constant),
        noise_gain=np.linalg.norm(estimate, axis=1),
    )


def _table(label: str, matrix: Array) -> str:
    rows = ["  ".join(f"{value:12.4e}" for value in row) for row in matrix]
    return "\n".join(f"{label if i == 0 else '':2}{row}" for i, row in enumerate(rows))
