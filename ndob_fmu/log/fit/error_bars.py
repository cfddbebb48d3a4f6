"""Error bars of parameters that also hold where what is left over follows itself, or where few numbers tell them.

What is left over, s, disturbs an estimate as far as it is like the parameter's answer g by chance. If one is shifted
against the other along the record in all ways, they are as like as

    M = Σ_f |G(f)|² S(f),     S(f) = |s(f)|², the mean over frequencies near f

over the frequencies f of a discrete Fourier transform, and the covariance is J⁻¹ M J⁻¹ with J = Σ g gᵀ (White, 1982,
for the form). For a white s of variance 1 that is J⁻¹. A disturbance that is not as its class says leaves more over
where the drive is.

An answer of few rows, or of few frequencies as that of a drive along a sine, meets few numbers of s. The fit takes one
of them away. So few numbers tell their variance as a small sample does, and two standard deviations are as long as
Student's distribution says.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm, t

from ndob_fmu.runtime.arrays import Array

# Frequencies on each side over which S is a mean: a sine that is left over may lie beside that of the drive.
_BESIDE = 2
_TWO_STD = float(norm.cdf(2.0))


def widened(covariance: Array, inverse: Array, answer: Array, left: Array) -> Array:
    """Return a covariance (m,m) with error bars that are long enough.

    inverse (m,m): J⁻¹; answer (m,c,R): g, of c numbers along R rows; left (c,R): s
    """
    influence = np.einsum("ab,bcr->acr", inverse, answer)
    G, s, R = np.fft.fft(influence), np.fft.fft(left), left.shape[1]
    around = range(-_BESIDE, _BESIDE + 1)
    S = np.sum([np.roll(s[:, None] * s.conj(), shift, axis=-1) for shift in around], axis=0) / (R * len(around))
    like = np.einsum("acf,cdf,adf->a", G.conj(), S, G, optimize=True).real / R
    met = np.minimum(_effective(influence), _effective(G))
    like *= met / np.maximum(met - 1.0, 0.5)
    longer = np.sqrt(np.maximum(1.0, like / np.diag(covariance))) * t.ppf(_TWO_STD, met) / 2.0
    return np.asarray(covariance * longer * longer[:, None])


def _effective(parts: Array | NDArray[np.complex128]) -> Array:
    """Return of how many columns the numbers (m,c,R) effectively consist (m,)."""
    weights = np.sum(np.abs(parts) ** 2, axis=1)
    return np.asarray(weights.sum(axis=1) ** 2 / np.maximum(np.sum(weights**2, axis=1), 1e-300))
