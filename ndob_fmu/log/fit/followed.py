"""Outputs that the fitted model does not follow: what is left of them follows itself, and their noise holds it, too.

The most likely noise of such an output is as large as the model's error, which no noise is. On made logs with a
parameter that is 20 % off the noise was 1.3 to 12 000 times too large where the correlation of what is left, one
sample apart, was 0.6 to 1; elsewhere the noise was right and the correlation below 0.1.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from ndob_fmu.log.diagnostics import follow_one_another, products_apart
from ndob_fmu.runtime.arrays import Array


def said_of_residuals(outputs: Sequence[str], residuals: Array) -> Iterator[str]:
    """Yield a line for each output whose residuals (K,p), over their standard deviations, follow one another.

    residuals: NaN where nothing was measured
    """
    counts, products = products_apart(residuals, 0, 1)
    for name, pairs, sums in zip(outputs, counts.T.tolist(), products.T.tolist(), strict=True):
        correlation = (sums[1] / max(pairs[1], 1.0)) / max(sums[0] / max(pairs[0], 1.0), 1e-300)
        if follow_one_another(correlation, pairs[0]):
            yield (
                f"{name}: residuals follow one another (correlation {correlation:.2f}), and {name}_noise_std holds an "
                "error of the model, too; a parameter is wrong (--free), or the model lacks something"
            )
