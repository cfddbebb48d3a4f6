"""Outputs that the fitted model does not follow: what is left of them follows itself, and their noise holds it, too.

The most likely noise of such an output is as large as the model's error, which no noise is. On made logs with a
parameter that is 20 % off the noise was 1.3 to 12 000 times too large where the correlation of what is left, one
sample apart, was 0.6 to 1; elsewhere the noise was right and the correlation below 0.1.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from ndob_fmu.log.diagnostics import CORRELATED
from ndob_fmu.runtime.arrays import Array


def said_of_residuals(outputs: Sequence[str], residuals: Array) -> Iterator[str]:
    """Yield a line for each output whose residuals (K,p), over their standard deviations, follow one another.

    residuals: NaN where nothing was measured
    """
    for name, column in zip(outputs, residuals.T, strict=True):
        e = column[np.isfinite(column)]
        correlation = float(e[1:] @ e[:-1] / max(e @ e, 1e-300))
        if correlation > max(CORRELATED, 2.0 / max(len(e), 1) ** 0.5):
            yield (
                f"{name}: residuals follow one another (correlation {correlation:.2f}), and {name}_noise_std holds an "
                "error of the model, too; a parameter is wrong (--free), or the model lacks something"
            )
