"""What the rows of both parts of the checks share: hidden modes, relative degrees, and how numbers are shown."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ndob_fmu.analysis.check_report import CheckRow
from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.numerics.zeros import AXIS_TOLERANCE, RANK_TOLERANCE, Balanced, ComplexArray, pencil_zeros

MODE_TOLERANCE = 1e-8


def outcome(
    name: str, passed: bool, requirement: str, measured: str, *, failure: str, likely: str, values: Mapping[str, Any]
) -> CheckRow:
    """Return a row; `failure` and `likely` count only where it fails."""
    if passed:
        failure = likely = ""
    return CheckRow(name, passed, requirement, measured, failure, likely, values)


def modes_reached(name: str, requirement: str, system: Balanced, A: Array, C: Array, states: Sequence[str]) -> CheckRow:
    """Return whether (A, C) has no hidden mode; names say whether it is observability or controllability."""
    smallest, limit, found = hidden_modes(A, C)
    hidden = places_of_modes(found, system.rate, states)
    return outcome(
        name,
        smallest > limit,
        f"{requirement} (PBH test)",
        f"smallest singular value {smallest:.2g} (> {limit:.2g})",
        failure=", ".join(f"hidden mode {mode} 1/s ({where})" for mode, where in hidden.items()),
        likely="an output is missing, or a state acts on nothing that is measured"
        if name == "observable"
        else "no unknown input drives that state; leave it out of the model or give it an unknown input",
        values={"smallest_singular_value": smallest, "hidden_modes": hidden},
    )


def hidden_modes(A: Array, C: Array) -> tuple[float, float, list[tuple[complex, ComplexArray]]]:
    """Apply the PBH test to a balanced (A, C): [A − λI; C] has full column rank at every eigenvalue λ.

    Returns the smallest singular value, the limit below which a mode is hidden, and the hidden modes with Im λ ≥ 0,
    each with the direction (n,) of its states.

    The test also covers the modes that the structure of (A, C) shows to be unobservable. A multiple eigenvalue of A is
    known only to a root of the rounding error, and the test at it could miss the mode.
    """
    candidates = np.concatenate([np.linalg.eigvals(A), pencil_zeros(A, np.zeros((len(A), 0)), C)[0]])
    limit = MODE_TOLERANCE * max(1.0, float(np.linalg.norm(A, 2)))
    smallest, hidden = math.inf, []
    for mode in candidates:
        _, sigma, Vh = np.linalg.svd(np.vstack([A - mode * np.eye(len(A)), C]))
        smallest = min(smallest, float(sigma[-1]))
        if sigma[-1] <= limit and mode.imag >= -limit:
            hidden.append((complex(mode), Vh[-1]))
    return smallest, limit, hidden


def places_of_modes(
    hidden: Sequence[tuple[complex, ComplexArray]], rate: float, states: Sequence[str]
) -> dict[str, str]:
    """Return {mode (1/s): its dominant states} of hidden modes in a plant's own rate (1/s), each state named once.

    A mode of 0 that is found twice has two rounding errors for its values.
    """
    found: dict[str, dict[str, None]] = {}
    for mode, vector in hidden:
        text = "0" if abs(mode) <= AXIS_TOLERANCE else number(rate * mode)
        found.setdefault(text, {}).update(dict.fromkeys(largest(vector, states)))
    return {mode: ", ".join(names) for mode, names in found.items()}


def relative_degrees(system: Balanced, channels: Sequence[str]) -> CheckRow:
    """Yield the smallest k with C A^{k−1} G_j ≠ 0 for each unknown input j; None if no output depends on it."""
    degrees: dict[str, int | None] = dict.fromkeys(channels)
    reached = system.G
    norm_A = max(1.0, float(np.linalg.norm(system.A, 2)))
    for k in range(1, len(system.A) + 1):
        for j, channel in enumerate(channels):
            size = np.linalg.norm(system.G[:, j]) * np.linalg.norm(system.C) * norm_A ** (k - 1)
            if degrees[channel] is None and np.linalg.norm(system.C @ reached[:, j]) > RANK_TOLERANCE * size:
                degrees[channel] = k
        reached = system.A @ reached
    measured = ", ".join(f"{channel}: {k or 'never seen'}" for channel, k in degrees.items())
    return CheckRow("relative_degree", True, "for information", measured, values=degrees)


def dominant(vector: Any, labels: Sequence[str]) -> str:
    """Return the labels of `largest` as text."""
    return ", ".join(largest(vector, labels))


def largest(vector: Any, labels: Sequence[str]) -> list[str]:
    """Return the labels of the entries that are at least half as large as the largest."""
    sizes = np.abs(vector)
    return [label for label, size in zip(labels, sizes, strict=True) if size >= 0.5 * np.max(sizes)]


def numbers(values: ComplexArray | Array, digits: int = 6) -> str:
    """Return numbers as text, separated by commas."""
    return ", ".join(number(value, digits) for value in values)


def number(value: complex, digits: int = 6) -> str:
    """Return a number as text, without an imaginary part that is rounding."""
    if abs(value.imag) <= 1e-9 * abs(value):
        return f"{value.real:.{digits}g}"
    return f"{value.real:.{digits}g}{value.imag:+.{digits}g}j"
