"""Units in which a plant's numbers are near one, found from the plant alone.

Norms and tolerances mean something only there: beside 1e7 Pa a norm sees nothing of 1e-1 m. All units are powers of
two, so that to change them is exact, and the same plant in other units ends with the same numbers.
"""

from __future__ import annotations

import numpy as np

from ndob_fmu.runtime.arrays import Array

_REWEIGHTINGS = 20
# Outputs and time keep their units where the entries leave a choice, with next to no weight where not.
_ANCHOR = 1e-3
# No ratio of round numbers lies on this edge between two powers of two.
_EDGE = 0.4817


def nearest_to_one(rows: Array, logarithms: Array, anchors: Array | None = None) -> Array:
    """Return exponents e (k,) for which logarithms + rows e (m,) are nearest to zero, and anchors e (·,) where free.

    The fit is Huber's, so that an entry that is a rounding error, far below all others, has no more weight than any
    other.
    """
    exponents = np.zeros(rows.shape[1])
    fixed = np.zeros((0, rows.shape[1])) if anchors is None else _ANCHOR * anchors
    weights = np.ones(len(rows))
    for _ in range(_REWEIGHTINGS if len(rows) else 0):
        system = np.vstack([weights[:, None] * rows, fixed])
        wanted = np.concatenate([-weights * logarithms, np.zeros(len(fixed))])
        exponents = np.linalg.lstsq(system, wanted, rcond=None)[0]
        weights = 1.0 / np.sqrt(np.maximum(1.0, abs(logarithms + rows @ exponents)))
    return exponents


def natural_units(A: Array, C: Array) -> Array:
    """Return units (N,) of x, powers of two: A (N,N) in them has entries near to one rate, C (p,N) rows near to one.

    C belongs to outputs in units of their noise.
    """
    N, p = len(A), len(C)
    rows, logarithms = [], []
    for i, j in np.argwhere(A != 0.0):
        row = np.zeros(N + p + 1)
        row[i] -= 1.0
        row[j] += 1.0
        row[-1] = -1.0
        rows.append(row)
        logarithms.append(np.log2(abs(A[i, j])))
    for i, j in np.argwhere(C != 0.0):
        row = np.zeros(N + p + 1)
        row[j], row[N + i] = 1.0, 1.0
        rows.append(row)
        logarithms.append(np.log2(abs(C[i, j])))
    if not rows:
        return np.ones(N)
    anchors = np.eye(N + p + 1)[N:]
    exponents = nearest_to_one(np.array(rows), np.array(logarithms), anchors)
    return np.asarray(np.exp2(np.floor(exponents[:N] + _EDGE)))


def units_of_inputs(channel: Array, units: Array) -> Array:
    """Return units (q,), powers of two, of inputs that nothing drives: those in which each column adds less than one.

    channel (n,q): of the inputs; units (n,): of what they drive.
    """
    sizes = np.sum(np.abs(channel) / units[:, None], axis=0)
    return np.asarray(np.exp2(-np.frexp(sizes)[1].astype(float)))
