"""The map of a disturbance, learned where the smoothed disturbance of a log depends on the states.

    d_k = Σ c_j φ_j(x_k) + line_k + r_k

The line passes through a free level in the middle of each block of the log: what changes slowly by itself, as a real
disturbance does, is not taken for a map. The coefficients leave the least Σ w_k r_k² + λ Σ (c_j · RMS of φ_j)², where
w = 0 holds what comes rarely and is large, as a pulse does, to be no map either.

Each block is left out in turn, and predicted from the others, its level by a line between its neighbours. Only parts of
a map that lower what remains there are kept; so is λ chosen. A map that stands for the time, because each state comes
once, predicts no better than that line.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ndob_fmu.log.fit.rare import weights_of_usual
from ndob_fmu.runtime.arrays import Array

_BLOCKS = 10
_PENALTIES = (1e-6, 1e-4, 1e-2, 0.1, 1.0)
# A part is kept where the mean square in blocks that were left out falls by so many of its standard errors, and by this
# share of it.
_SURE, _WORTH = 2.5, 0.05


@dataclass(frozen=True)
class Learned:
    """What the log says of a map.

    parts: indices of those that are kept
    coefficients (n_φ,): of all functions; 0 of those that are left out
    before, after: root mean squares of what remains in blocks that were left out, without and with the map, but for
        pulses
    as_well: pairs of a part that is kept and of one that is not and lowers what remains as much
    """

    parts: tuple[int, ...]
    coefficients: Array
    before: float
    after: float
    as_well: tuple[tuple[int, int], ...]


def learn(parts: Sequence[Array], d: Array) -> Learned:
    """Return what the disturbance d (K,) at K rows says of a map whose parts have functions (K,·)."""
    columns = np.concatenate(parts, axis=1)
    groups = np.split(np.arange(columns.shape[1]), np.cumsum([part.shape[1] for part in parts])[:-1])
    knots = (np.arange(_BLOCKS) + 0.5) * len(d) / _BLOCKS
    whole = np.concatenate([columns, _lines(len(d), knots)], axis=1)
    every = range(whole.shape[1])
    of_rows = weights_of_usual(
        lambda some: d - whole @ _Squares.of(whole, d, some).solved(every, _PENALTIES[1]), len(d)
    )
    folds = [_fold(columns, d, of_rows, knots, b) for b in range(_BLOCKS)]
    kept, found, as_well = _selected(folds, groups)
    coefficients = np.zeros(columns.shape[1])
    used = _columns(groups, kept)
    own = [*used, *range(columns.shape[1], whole.shape[1])]
    solved = _Squares.of(whole, d, of_rows).solved(own, found.penalty)
    coefficients[used] = solved[: len(used)]
    nothing = _tried(folds, [], _PENALTIES[0])
    return Learned(
        parts=tuple(kept),
        coefficients=coefficients,
        before=float(np.sqrt(nothing.left.mean())),
        after=float(np.sqrt(found.left.mean())),
        as_well=tuple(as_well),
    )


@dataclass(frozen=True)
class _Squares:
    """Weighted sums over rows: of products of columns (n,n), of columns and d (n,), of d², and of the weights."""

    products: Array
    with_d: Array
    of_d: float
    weight: float

    @staticmethod
    def of(columns: Array, d: Array, weights: Array) -> _Squares:
        weighted = columns * weights[:, None]
        return _Squares(weighted.T @ columns, weighted.T @ d, float(weights @ d**2), float(weights.sum()))

    def solved(self, own: Sequence[int], penalty: float) -> Array:
        """Return the coefficients of some columns."""
        size = np.sqrt(np.maximum(self.products.diagonal()[list(own)], 1e-300))
        normal = self.products[np.ix_(own, own)] / np.outer(size, size) + penalty * np.eye(len(size))
        return np.asarray(np.linalg.solve(normal, self.with_d[list(own)] / size) / size)

    def left(self, own: Sequence[int], coefficients: Array) -> float:
        """Return the mean square that coefficients of some columns leave."""
        explained = 2.0 * self.with_d[list(own)] - self.products[np.ix_(own, own)] @ coefficients
        return max(self.of_d - float(coefficients @ explained), 0.0) / max(self.weight, 1e-300)


@dataclass(frozen=True)
class _Fold:
    """A block that is left out, and the others; the last columns are those of the line."""

    others: _Squares
    block: _Squares


@dataclass(frozen=True)
class _Tried:
    """A penalty, and the mean square that remains in each block (B,)."""

    penalty: float
    left: Array

    def gain_on(self, other: _Tried) -> tuple[float, float]:
        """Return by how much less remains than with another choice, and the standard error of that."""
        less = other.left - self.left
        return float(less.mean()), float(less.std(ddof=1) / np.sqrt(len(less)))


def _selected(
    folds: Sequence[_Fold], groups: Sequence[NDArray[np.int_]]
) -> tuple[list[int], _Tried, list[tuple[int, int]]]:
    """Return the parts that are kept, in the order of what they explain, and those that explain as much."""
    kept: list[int] = []
    best, ties = _tried(folds, [], _PENALTIES[0]), []
    while len(kept) < len(groups):
        trials = {
            part: min(
                (_tried(folds, _columns(groups, [*kept, part]), penalty) for penalty in _PENALTIES),
                key=lambda one: float(one.left.mean()),
            )
            for part in range(len(groups))
            if part not in kept
        }
        first = min(trials, key=lambda part: float(trials[part].left.mean()))
        gain, error = trials[first].gain_on(best)
        if gain < _SURE * error or gain < _WORTH * float(best.left.mean()):
            break
        for part, one in trials.items():
            less, unsure = trials[first].gain_on(one)
            if part != first and less < _SURE * unsure:
                ties.append((first, part))
        kept.append(first)
        best = trials[first]
    return kept, best, [(one, other) for one, other in ties if other not in kept]


def _tried(folds: Sequence[_Fold], used: Sequence[int], penalty: float) -> _Tried:
    left = []
    for fold in folds:
        line = range(len(fold.others.with_d) - (_BLOCKS - 1), len(fold.others.with_d))
        own = [*used, *line]
        left.append(fold.block.left(own, fold.others.solved(own, penalty)))
    return _Tried(penalty, np.array(left))


def _columns(groups: Sequence[NDArray[np.int_]], parts: Sequence[int]) -> list[int]:
    return [int(column) for part in parts for column in groups[part]]


def _fold(columns: Array, d: Array, weights: Array, knots: Array, b: int) -> _Fold:
    """Return the squares of all blocks but one, and of that one, whose level is left to the line."""
    both = np.concatenate([columns, _lines(len(d), np.delete(knots, b))], axis=1)
    out = np.arange(len(d)) * _BLOCKS // len(d) == b
    return _Fold(_Squares.of(both[~out], d[~out], weights[~out]), _Squares.of(both[out], d[out], weights[out]))


def _lines(rows: int, knots: Array) -> Array:
    """Return the line (rows,·) that is 1 at one knot and 0 at the others, for each."""
    at = np.arange(rows) + 0.5
    return np.column_stack([np.interp(at, knots, one) for one in np.eye(len(knots))])
