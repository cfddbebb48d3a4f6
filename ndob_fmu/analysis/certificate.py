"""Bounds of the estimate's error, for every disturbance and nonlinearity of the declared class.

They hold for the frozen gain of the sampled-data observer at its own step H, channel by channel; not while the
covariance runs. Between samples ξ̃' = A ξ̃ + B w + G_f φ.
|w| ≤ D bounds d's r-th derivative, and φ = f(x) − f(x̂) has ‖φ‖ ≤ γ ‖x̃_f‖ for the states x̃_f that f depends on. At a
sample ξ̃⁺ = (I − K C) ξ̃⁻ − K v, with |v| ≤ v̄. The largest output that bounded inputs can cause is the L1 norm of the
impulse response. If the loop gain γ ‖φ → x̃_f‖₁ is below one, the small-gain theorem bounds φ, and with it every error.

docs/theory.md compares them with Theorem 3 of the paper, which bounds the state error of the continuous observer.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ndob_fmu.analysis.summed_responses import summed
from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.design.stationary_design import StationaryDesign
from ndob_fmu.runtime.numerics.exponential import exponential
from ndob_fmu.runtime.numerics.units import units_of_inputs

_INSTANTS = 5
_QUADRATURE = 16


@dataclass(frozen=True)
class Certificate:
    """Bounds of the error once the start has decayed; infinite where `loop_gain` is not below one.

    loop_gain: γ times the L1 norm from f's error back to the states that f depends on.
    at_sample (q2,): of |d̂ − d| for the sample.
    ahead (q2,): of |d̂ − d| for the end of the step.
    states (n,): of |x̂_i − x_i| at any time.
    lacking: what a bound would need that is missing; empty where the loop gain decides.
    """

    loop_gain: float
    at_sample: Array
    ahead: Array
    states: Array
    lacking: str = ""

    @property
    def exists(self) -> bool:
        """Whether the small-gain condition holds."""
        return self.loop_gain < 1.0

    def to_dict(self) -> dict[str, Any]:
        """Return the bounds in JSON's types, None where they are infinite."""

        def finite(values: Array) -> list[float] | None:
            return [float(v) for v in values] if self.exists else None

        return {
            "loop_gain": None if self.lacking else self.loop_gain,
            "disturbance_at_sample": finite(self.at_sample),
            "disturbance_ahead": finite(self.ahead),
            "states": finite(self.states),
            "lacking": self.lacking,
        }


def certify(
    design: StationaryDesign,
    *,
    disturbance_rate: Array,
    disturbance_bound: Array,
    lipschitz: float,
    f_states: tuple[int, ...],
    sample_error: float = 0.0,
) -> Certificate:
    """Bound the errors of a stationary design.

    disturbance_rate (q2,): bound of |d^{(r)}|, of |ḋ| for r = 0.
    disturbance_bound (q2,): bound of |d|; for r = 0 it decides about the errors of the states.
    lipschitz: γ.
    f_states: indices of the states that f depends on.
    sample_error: bound v̄ of the error in each sample, in the outputs' units.
    """
    system = _error_system(design)
    rows = _outputs(system, design)
    if design.M_H is None:
        from_w = _l1(system, rows, system.from_w, per_channel=True) @ disturbance_rate
    else:
        # Without d in the model x̂ lags behind a constant d, so that only the error of d̂ depends on d's rate.
        of_d, of_x = rows.part(slice(2 * len(disturbance_rate))), rows.part(slice(2 * len(disturbance_rate), None))
        from_rate = _l1(system, of_d, system.from_w, per_channel=True) @ disturbance_rate
        from_d = _l1(system, of_x, system.from_d, per_channel=True) @ disturbance_bound
        from_w = np.concatenate([from_rate, from_d])
    alone = from_w
    if sample_error > 0.0:
        alone = from_w + _l1_of_samples(system, rows, design.K.shape[1]) * sample_error
    if system.from_f.shape[1] == 0 or not f_states or lipschitz == 0.0:
        return _certificate(0.0, alone, system, len(disturbance_rate))
    from_f = _l1(system, rows, system.from_f, per_channel=False)[:, 0]
    n, first_state = system.n, 2 * len(disturbance_rate)
    at_instants = [first_state + np.array(f_states) + i * n for i in range(_INSTANTS)]
    gain = lipschitz * max(float(np.linalg.norm(from_f[rows_at])) for rows_at in at_instants)
    if gain >= 1.0:
        return _certificate(gain, np.full(len(alone), np.inf), system, len(disturbance_rate))
    largest = max(float(np.linalg.norm(alone[rows_at])) for rows_at in at_instants) / (1.0 - gain)
    return _certificate(gain, alone + from_f * lipschitz * largest, system, len(disturbance_rate))


def no_certificate(design: StationaryDesign, lacking: str) -> Certificate:
    """Return infinite bounds; lacking: what a bound would need."""
    n, q = design.system.linear.G_d.shape
    of_d, of_x = np.full(q, np.inf), np.full(n, np.inf)
    return Certificate(np.inf, of_d, of_d, of_x, lacking)


@dataclass(frozen=True)
class _ErrorSystem:
    """ξ̃ with the disturbance itself added for r = 0: A (N,N), update J (N,N) and K (N,p), inputs (N,·).

    units (N,): as in `Augmented`.
    """

    n: int
    H: float
    A: Array
    J: Array
    K: Array
    from_w: Array
    from_d: Array
    from_f: Array
    units: Array

    def after(self, t: float) -> Array:
        """Return e^{A t}."""
        return exponential(self.A * t, self.units)


@dataclass(frozen=True)
class _Rows:
    """Outputs as rows on ξ̃⁻ (R,N) and on the sample's error (R,p), and how long after the sample each is taken (R,)."""

    on_state: Array
    on_sample: Array
    instant: Array
    selector: Array

    def part(self, which: slice) -> _Rows:
        """Return some of the rows."""
        return _Rows(self.on_state[which], self.on_sample[which], self.instant[which], self.selector[which])


def _error_system(design: StationaryDesign) -> _ErrorSystem:
    linear, H = design.system.linear, design.discrete.H
    n, q = linear.G_d.shape
    units = design.system.units
    if design.system.order:
        A, K, J = design.system.A, design.K, np.eye(len(design.K)) - design.K @ design.system.C
        from_w = design.system.noise
    else:
        A = np.zeros((n + q, n + q))
        A[:n] = np.hstack([linear.A, linear.G_d])
        K = np.vstack([design.K, np.zeros((q, design.K.shape[1]))])
        J = np.eye(n + q)
        J[:n, :n] -= design.K @ linear.C
        from_w = np.eye(n + q)[:, n:]
        units = np.concatenate([units, units_of_inputs(linear.G_d * H, units)])
    from_d, from_f = (np.vstack([G, np.zeros((len(A) - n, G.shape[1]))]) for G in (linear.G_d, linear.G_f))
    return _ErrorSystem(n=n, H=H, A=A, J=J, K=K, from_w=from_w, from_d=from_d, from_f=from_f, units=units)


def _outputs(system: _ErrorSystem, design: StationaryDesign) -> _Rows:
    """Return the rows of d̃ at the sample, d̃ ahead, and x̃ at instants spread over the step, in this order."""
    n, H, N = system.n, system.H, len(system.A)
    q, p = design.system.linear.G_d.shape[1], system.K.shape[1]
    pick = np.eye(N)[n : n + q]
    if design.M_H is None:
        at_sample, sampled = pick @ system.J, -pick @ system.K
        ahead = pick @ system.after(H)
        blocks = [
            (at_sample, sampled, 0.0, np.zeros((q, N))),
            (ahead @ system.J, -ahead @ system.K, H, pick),
        ]
    else:
        at_sample = pick - design.M_H @ np.hstack([design.system.C, np.zeros((p, q))])
        blocks = [(at_sample, -design.M_H, 0.0, np.zeros((q, N))), (at_sample, -design.M_H, H, pick)]
    for s in np.linspace(0.0, H, _INSTANTS):
        later = system.after(float(s))[:n]
        blocks.append((later @ system.J, -later @ system.K, s, np.eye(N)[:n]))
    return _Rows(
        on_state=np.vstack([block[0] for block in blocks]),
        on_sample=np.vstack([block[1] for block in blocks]),
        instant=np.concatenate([np.full(len(block[0]), block[2]) for block in blocks]),
        selector=np.vstack([block[3] for block in blocks]),
    )


def _l1(system: _ErrorSystem, rows: _Rows, channels: Array, *, per_channel: bool) -> Array:
    """Return ∫ |impulse response| (R, channels), or ∫ of its norm over the channels (R, 1)."""
    per_channel = per_channel or channels.shape[1] == 1

    def size(response: Array) -> Array:
        return np.abs(response) if per_channel else np.linalg.norm(response, axis=-1, keepdims=True)

    nodes, weights = np.polynomial.legendre.leggauss(_QUADRATURE)

    def over(length: float) -> tuple[Array, Array]:
        """Return e^{A t} channels at the nodes of [0, length], and their weights."""
        times = 0.5 * length * (1.0 + nodes)
        return np.array([system.after(float(t)) @ channels for t in times]), 0.5 * length * weights

    total = np.zeros((len(rows.instant), channels.shape[1] if per_channel else 1))
    for instant in np.unique(rows.instant):
        if instant > 0.0:
            since, weight = over(float(instant))
            own = rows.instant == instant
            total[own] += np.einsum("k,kri->ri", weight, size(np.einsum("rn,knc->krc", rows.selector[own], since)))
    step, weight = over(system.H)
    k, _, c = step.shape

    def added(responses: Array) -> Array:
        sizes = size(responses.reshape(len(responses), -1, k, c))
        return np.asarray(np.moveaxis(sizes, 2, 3) @ weight)

    before = system.after(system.H) @ system.J
    return total + summed(added, rows.on_state, before, _side_by_side(step), by_element=per_channel)


def _l1_of_samples(system: _ErrorSystem, rows: _Rows, p: int) -> Array:
    """Return Σ |response to the samples' errors| (R,), summed over the outputs."""
    Phi = system.after(system.H)

    def added(responses: Array) -> Array:
        return np.asarray(np.sum(np.abs(responses.reshape(len(responses), -1, p)), axis=-1))

    before = summed(added, rows.on_state, Phi @ system.J, Phi @ system.K, by_element=True)
    return np.asarray(np.sum(np.abs(rows.on_sample), axis=1) + before)


def _side_by_side(inputs: Array) -> Array:
    """Return (N, k c) of (k, N, c)."""
    return np.asarray(inputs.transpose(1, 0, 2).reshape(inputs.shape[1], -1))


def _certificate(gain: float, bounds: Array, system: _ErrorSystem, q: int) -> Certificate:
    states = bounds[2 * q :].reshape(_INSTANTS, system.n)
    return Certificate(loop_gain=gain, at_sample=bounds[:q], ahead=bounds[q : 2 * q], states=np.max(states, axis=0))
