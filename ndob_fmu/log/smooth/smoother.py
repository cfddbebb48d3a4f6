"""The smoother over a whole record: a Kalman filter forward, Bryson's and Frazier's adjoint backward.

About a trajectory, the errors ξ (N,) and the samples of a record are linear,

    ξ_{k+1} = Φ_k ξ_k + a_k + N_k w_k,     e_k = C_k ξ_k + v_k,     v_k ~ N(0, R_k)

    forward    ξ̂⁻, P⁻ = S Sᵀ, and of each sample its gain K, innovation e and variance α
    backward   λ ← Φᵀλ,  Λ ← ΦᵀΛΦ;   u = e/α − Kᵀλ,  D = 1/α + KᵀΛK,  λ ← λ + cᵀu,  Λ ← (I − K c)ᵀ Λ (I − K c) + cᵀc/α
    smoothed   ξ̂ = ξ̂⁻ + P⁻λ,   P = P⁻ − P⁻ΛP⁻

(Bierman, 1973). λ and Λ are the score of the likelihood with regard to anything that is added to ξ_k, and its variance.
u and D are those of what is added to a sample (de Jong and Penzer, 1998). So they also tell which jumps and outliers
are likely (`events`).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import lru_cache
from math import prod

import numpy as np
from numpy.typing import NDArray

from ndob_fmu.log.smooth.c_library import c_library
from ndob_fmu.log.smooth.closed_loop import ClosedLoop, closed_loop
from ndob_fmu.log.smooth.linear_record import Adjoint, Forward, LinearRecord
from ndob_fmu.runtime.arrays import Array

# Rows that the processor keeps near itself.
NEAR = 1000


def forward(record: LinearRecord, jumps: Mapping[int, Array] | None = None) -> Forward:
    """Filter a record.

    jumps: columns (…,N,·) that are added to the factor of P⁻ at an instant
    """
    in_c = c_library(prod(record.rows.shape[:-2]))
    if in_c is not None:
        return in_c.forward(record, jumps or {})
    K, added = len(record.rows), jumps or {}
    several, (p, N) = record.rows.shape[1:-2], record.rows.shape[-2:]
    found = Forward(
        xi=np.empty((K, *several, N)),
        factor=np.empty((K, *several, N, N)),
        gain=np.zeros((K, *several, p, N)),
        innovation=np.zeros((K, *several, p)),
        alpha=np.full((K, *several, p), np.inf),
    )
    measured: NDArray[np.bool_] = np.asarray(np.isfinite(record.misfit))
    there, misfit = measured.reshape(K, -1, p).max(axis=1), np.where(measured, record.misfit, 0.0)
    xi, S = record.start, record.start_factor
    for k in range(K):
        if k in added:
            S = lower_factor(np.concatenate([S, added[k]], axis=-1))
        found.xi[k], found.factor[k] = xi, S
        both = np.concatenate([S, xi[..., None]], axis=-1)
        for i in range(p):
            if not there[k, i]:
                continue
            R, known = record.variance[k, ..., i], measured[k, ..., i]
            seen = np.matmul(record.rows[k, ..., i, None, :], both)[..., 0, :]
            f = seen[..., :N]
            alpha = np.einsum("...i,...i->...", f, f) + R
            gain = np.matmul(both[..., :N], f[..., None])[..., 0] * (known / alpha)[..., None]
            e = known * (misfit[k, ..., i] - seen[..., N])
            found.gain[k, ..., i, :], found.innovation[k, ..., i] = gain, e
            found.alpha[k, ..., i] = np.where(known, alpha, np.inf)
            f /= (1.0 + np.sqrt(R / alpha))[..., None]
            seen[..., N] = -e
            both -= gain[..., None] * seen[..., None, :]
        if k < K - 1:
            both = np.matmul(record.Phi[k], both)
            xi = both[..., N] + record.shift[k]
            S = lower_factor(np.concatenate([both[..., :N], record.noise[k]], axis=-1))
    return found


def backward(record: LinearRecord, found: Forward, after: tuple[Array, Array] | None = None) -> Adjoint:
    """Return the adjoint of a filtered record.

    after: λ (…,N) and Λ (…,N,N) behind its last samples, where the record goes on
    """
    in_c = c_library(prod(record.rows.shape[:-2]))
    if in_c is not None and after is None:
        return in_c.backward(record, found)
    adjoint = Adjoint(*(np.empty((*found.xi.shape[:-1], *one)) for one in _adjoint_shapes(record)))
    score, variance = after or (np.zeros(1), np.zeros((1, 1)))
    for rows, loop in closed_loops(record, found):
        scores, variances = np.empty_like(loop.of_state), np.empty_like(loop.of_state_variance)
        for k in range(len(scores) - 1, -1, -1):
            scores[k], variances[k] = score, variance
            score, variance = loop.before(k, scores[k], variances[k])
            adjoint.of_state[rows][k], adjoint.of_state_variance[rows][k] = score, variance
        own = np.diagonal(loop.of_samples_variance, axis1=-2, axis2=-1)
        adjoint.of_sample[rows] = loop.of_sample + np.matmul(scores[..., None, :], loop.later)[..., 0, :]
        adjoint.of_sample_variance[rows] = own + (loop.later * np.matmul(variances, loop.later)).sum(axis=-2)
    return adjoint


def through(record: LinearRecord, found: Forward) -> tuple[Array, Array, Array]:
    """Return of a filtered record its closed loop (…,N,N) from the first row behind the last, and λ and Λ before it."""
    last = record.rows.shape[-1]
    closed, score, variance = np.eye(last), np.zeros(last), np.zeros((last, last))
    for _, loop in closed_loops(record, found):
        for k in range(len(loop.Psi) - 1, -1, -1):
            closed = np.matmul(closed, loop.Psi[k])
            score, variance = loop.before(k, score, variance)
    return closed, score, variance


def closed_loops(record: LinearRecord, found: Forward) -> Iterator[tuple[slice, ClosedLoop]]:
    """Yield the closed loop of a filtered record, some rows at once, from the last ones on.

    There is no step from the last one.
    """
    K, several, N = len(record.rows), record.rows.shape[1:-2], record.rows.shape[-1]
    near = max(1, NEAR // max(1, prod(several)))
    for stop in range(K, 0, -near):
        rows = slice(max(stop - near, 0), stop)
        Phi = record.Phi[rows]
        if stop == K:
            Phi = np.concatenate([Phi, np.broadcast_to(np.eye(N), (1, *several, N, N))])
        yield rows, closed_loop(Phi, record.rows[rows], found.gain[rows], found.innovation[rows], found.alpha[rows])


def _adjoint_shapes(record: LinearRecord) -> tuple[tuple[int, ...], ...]:
    p, N = record.rows.shape[-2:]
    return (N,), (N, N), (p,), (p,)


def lower_factor(rows: Array) -> Array:
    """Return lower triangles T (…,m,m) with T Tᵀ = rows rowsᵀ, for rows (…,m,·)."""
    in_c = c_library(prod(rows.shape[:-2]))
    if in_c is not None:
        return in_c.lower_factor(rows)
    m, columns = rows.shape[-2:]
    if columns < m:
        rows = np.concatenate([rows, np.zeros((*rows.shape[:-1], m - columns))], axis=-1)
    reflected = np.linalg.qr(np.swapaxes(rows, -1, -2), mode="raw")[0]
    return np.where(_lower(m), reflected[..., :m], 0.0)


@lru_cache(maxsize=16)
def _lower(m: int) -> NDArray[np.bool_]:
    return np.tri(m, dtype=bool)
