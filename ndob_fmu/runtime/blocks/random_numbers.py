"""Random numbers as a function of a seed and an index: no generator whose state would have to be kept.

Philox 4x64 with 10 rounds (Salmon, Moraes, Dror and Shaw, *Parallel random numbers: as easy as 1, 2, 3*, 2011): any
index is drawn as fast as any other, and what one instance draws changes nothing for another.
"""

from __future__ import annotations

from math import cos, log, pi, sqrt

_WORD = 2**64 - 1
_MULTIPLIERS = (0xD2E7470EE14C6C93, 0xCA5A826395121157)
_WEYL = (0x9E3779B97F4A7C15, 0xBB67AE8584CAA73B)
_ROUNDS = 10


def philox(key: tuple[int, int], counter: tuple[int, int, int, int]) -> tuple[int, int, int, int]:
    """Return four independent words of 64 bits for this key and counter, words of 64 bits themselves."""
    k0, k1 = key
    c0, c1, c2, c3 = counter
    for _ in range(_ROUNDS):
        first, second = _MULTIPLIERS[0] * c0, _MULTIPLIERS[1] * c2
        c0, c1, c2, c3 = (second >> 64) ^ c1 ^ k0, second & _WORD, (first >> 64) ^ c3 ^ k1, first & _WORD
        k0, k1 = (k0 + _WEYL[0]) & _WORD, (k1 + _WEYL[1]) & _WORD
    return c0, c1, c2, c3


def uniforms(seed: int, index: float) -> tuple[float, ...]:
    """Return four independent numbers in [0, 1) for this seed and index, an integer, each a multiple of 2⁻⁵³."""
    return tuple((word >> 11) * 2.0**-53 for word in philox((seed & _WORD, 0), (int(index) & _WORD, 0, 0, 0)))


def normal(first: float, second: float) -> float:
    """Return one standard normal number from two uniform ones (Box and Muller)."""
    return sqrt(-2.0 * log(1.0 - first)) * cos(2.0 * pi * second)
