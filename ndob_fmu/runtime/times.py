"""Comparison of times that are sums of steps and differ by rounding."""

from __future__ import annotations

_ROUNDING = 1e-6


def same_time(a: float, b: float) -> bool:
    """Return whether two times (s) may be the same sum of steps, added up in another order."""
    return abs(a - b) <= _ROUNDING * (1.0 + abs(b))
