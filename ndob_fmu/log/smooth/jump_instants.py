"""The smoothed disturbance at rows of which it is not sure whether they are before or behind a jump.

A jump at a sample and one in the step behind it move the plant alike. With the gains g of both (`event_search`), each
as if the record had no jump there, that of the other kind has the weight w = 1/(1 + e^{g − g'}). The row is behind the
jump in one case, and before it in the other, with the disturbance of the row beside it. So what is shown is the mixture

    d ← d + w (d' − d),     σ² ← (1 − w) σ² + w σ'² + w (1 − w) (d' − d)²
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ndob_fmu.log.smooth.closed_loop import closed_loop
from ndob_fmu.log.smooth.events import AT_SAMPLE_COSTS, IN_STEP_COSTS, Explained, Jumps
from ndob_fmu.runtime.arrays import Array

# Beyond, the other kind is out of the question. Less of I − M may be a rounding error.
_UNLIKELY, _LEAST_LEFT = 40.0, 1e-9


def mixed(found: Explained, columns: Jumps, d: Array, variance: Array) -> tuple[Array, Array]:
    """Return the smoothed disturbances (K,q2) and their variances (K,q2) with what is not sure of the jumps' instants.

    columns: J of jumps
    """
    shown, spread = d.copy(), variance.copy()
    for row, beside, w in _unsure(found, columns):
        other = d[beside] - d[row]
        shown[row] = d[row] + w * other
        spread[row] = (1.0 - w) * variance[row] + w * variance[beside] + w * (1.0 - w) * other**2
    return shown, spread


def _unsure(found: Explained, columns: Jumps) -> Iterator[tuple[int, int, float]]:
    """Yield rows, those beside them on the other side of the jump, and the weight of the jump's other kind."""
    record, run, adjoint = found.record, found.forward, found.adjoint
    for k, in_step in found.events.jumps.items():
        first = k - 1 if in_step else k
        if not 0 < first < len(record.rows) - 1:
            continue
        loop = closed_loop(
            record.Phi[first], record.rows[first], run.gain[first], run.innovation[first], run.alpha[first]
        )
        score, variance = adjoint.of_state, adjoint.of_state_variance
        J, other = columns.of(k, in_step), first if in_step else k + 1
        V = columns.of(other, not in_step)
        s, left = J.T @ score[k], np.eye(J.shape[1]) - J.T @ variance[k] @ J
        if np.linalg.eigvalsh(left)[0] < _LEAST_LEFT:
            continue
        G = loop.Psi.T @ variance[k] @ J if in_step else variance[other] @ loop.Psi @ J
        without = np.linalg.solve(left, np.column_stack([G.T, s]))
        l_other = V.T @ (score[other] + G @ without[:, -1])
        M_other = V.T @ (variance[other] + G @ without[:, :-1]) @ V
        whole = np.eye(len(l_other)) + M_other
        own = 0.5 * (s @ without[:, -1] + np.linalg.slogdet(left)[1])
        others = 0.5 * (l_other @ np.linalg.solve(whole, l_other) - np.linalg.slogdet(whole)[1])
        less = (IN_STEP_COSTS - AT_SAMPLE_COSTS) * (1.0 if in_step else -1.0)
        w = 1.0 / (1.0 + np.exp(np.clip(own - others - less, -_UNLIKELY, _UNLIKELY)))
        yield (first, k, float(w)) if in_step else (k, k - 1, float(w))
