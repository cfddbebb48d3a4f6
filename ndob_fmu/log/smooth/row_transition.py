"""`numerics.transition` for many steps at once."""

from __future__ import annotations

from math import ceil, factorial, log2
from typing import NamedTuple

import numpy as np

from ndob_fmu.log.smooth.c_library import c_library
from ndob_fmu.log.smooth.smoother import lower_factor
from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.numerics.transition import SERIES_WEIGHTS

# With ‖F h‖ ≤ 1/4 the terms left out are below rounding in Φ, and below 1e-12 in N.
_TERMS = len(SERIES_WEIGHTS)
_RADIUS = 0.25
# Of X^k/k! g in the columns of N.
_NOISE_WEIGHTS = SERIES_WEIGHTS * [float(factorial(k)) for k in range(_TERMS)]


class RowTransition(NamedTuple):
    """K steps of ξ' = F ξ + g w.

    Phi (K,N,N): Φ
    noise (K,N,c,N): for each column of g, a factor of the noise's covariance
    responses (K,N,parts,h): e^{F s H} of the held columns, for each part s of the step
    """

    Phi: Array
    noise: Array
    responses: Array


def row_transition(F: Array, channel: Array, H: Array, held: Array, parts: Array, units: Array) -> RowTransition:
    """Return steps H (K,) s for F (K,N,N), the noise's channel g (N,c) and `held` columns (N,h).

    units (N,): of ξ, in which ‖F‖ is measured
    """
    in_c = c_library(len(F))
    if in_c is not None:
        return RowTransition(*in_c.transition(F, channel, H, held, parts, units, _NOISE_WEIGHTS))
    rows = units[:, None]
    Phi, noise, responses = _in_units(F * (units / rows), channel / rows, H, held / rows, parts)
    back = rows[:, None]
    return RowTransition(Phi * (rows / units), np.swapaxes(noise, 1, 2) * back, np.swapaxes(responses, 1, 2) * back)


def _in_units(F: Array, channel: Array, H: Array, held: Array, parts: Array) -> tuple[Array, Array, Array]:
    """Return Φ (K,N,N), the noise (K,c,N,N) and the responses (K,parts,N,h)."""
    size = float(np.max(np.abs(F).sum(axis=1).max(axis=1) * H, initial=0.0))
    doublings = max(0, ceil(log2(size / _RADIUS))) if size > _RADIUS else 0
    h = (H / 2.0**doublings)[:, None, None]
    powers = _powers(F * h)
    Phi, noise = np.asarray(powers.sum(axis=0)), _short_noise(powers, channel, h)
    if not doublings:
        return Phi, noise, _at_parts(powers, held, parts)
    for _ in range(doublings):
        noise = lower_factor(np.concatenate([noise, Phi[:, None] @ noise], axis=-1))
        Phi = Phi @ Phi
    ends = [_in_units(F, channel[:, :0], part * H, held, parts[:0])[0] @ held for part in parts.tolist()]
    return Phi, noise, np.stack(ends, axis=1) if ends else np.zeros((len(F), 0, *held.shape))


def _powers(X: Array) -> Array:
    """Return X^k/k! (terms,K,N,N), k = 0, 1, …"""
    terms = np.empty((_TERMS, *X.shape))
    terms[0] = np.eye(X.shape[1])
    for k in range(1, _TERMS):
        np.matmul(terms[k - 1], X, out=terms[k])
        terms[k] /= k
    return terms


def _short_noise(powers: Array, channel: Array, h: Array) -> Array:
    return lower_factor(_combined(_NOISE_WEIGHTS, _columns(powers, channel) * np.sqrt(h)).transpose(1, 3, 2, 0))


def _at_parts(powers: Array, held: Array, parts: Array) -> Array:
    return np.swapaxes(_combined(parts[:, None] ** np.arange(_TERMS), _columns(powers, held)), 0, 1)


def _columns(powers: Array, columns: Array) -> Array:
    """Return powers (terms,K,N,N) times columns (N,h), by one product of large matrices."""
    return np.asarray((powers.reshape(-1, len(columns)) @ columns).reshape(*powers.shape[:3], columns.shape[1]))


def _combined(weights: Array, terms: Array) -> Array:
    """Return sums (s,K,N,h) of terms (terms,K,N,h) with weights (s,terms)."""
    return np.asarray((weights @ terms.reshape(len(terms), -1)).reshape(len(weights), *terms.shape[1:]))
