"""The events of a record that other parameters do not explain as well.

What wrong parameters leave in the innovations looks like jumps and outliers. Once such an event is in the record, the
samples around it say no more about the parameters, which stay wrong. So an event has to explain more than the
parameters could without it. With the log-likelihood L, its slopes s by the parameters and the information I about them,
of the record with the event (1) and without it (0),

    L₁ + ½ s₁ᵀ I₁⁻¹ s₁ − (L₀ + ½ s₀ᵀ I₀⁻¹ s₀)

is what it explains with the best parameters of each, which has to be more than it costs. Where the parameters explain
each of some events, but not all of them, only those are given up that they explain best: half of them, or a quarter ….
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import zip_longest

import numpy as np
from numpy.typing import NDArray

from ndob_fmu.log.fit.likelihood import Likelihood
from ndob_fmu.log.smooth.events import Events
from ndob_fmu.runtime.arrays import Array


@dataclass(frozen=True)
class _Sums:
    """L (S,), s (S,n) and I (S,n,n) of each piece, or (), (n,) and (n,n) of all."""

    value: Array
    slopes: Array
    information: Array

    @staticmethod
    def of(found: Likelihood) -> _Sums:
        """Return those of each piece."""
        (n, _, rows), S = found.answer.shape, len(found.values)
        answer = found.answer.reshape(n, -1, S, rows // S)
        surprise = found.surprise.reshape(*answer.shape[1:])
        return _Sums(
            found.values,
            -np.einsum("mcsr,csr->sm", answer, surprise),
            np.einsum("acsr,bcsr->sab", answer, answer, optimize=True),
        )

    @property
    def total(self) -> _Sums:
        """Those of all pieces."""
        return _Sums(self.value.sum(), self.slopes.sum(axis=0), self.information.sum(axis=0))

    def and_also(self, other: _Sums) -> _Sums:
        """Return the sums of both."""
        return _Sums(self.value + other.value, self.slopes + other.slopes, self.information + other.information)

    def but_for(self, s: int, other: _Sums) -> _Sums:
        """Return these with piece s of others."""
        is_other = np.arange(len(self.value)) == s
        mixed = [
            np.where(is_other.reshape(-1, *[1] * (own.ndim - 1)), theirs, own)
            for own, theirs in zip(vars(self).values(), vars(other).values(), strict=True)
        ]
        return _Sums(*mixed)

    def with_best(self) -> float:
        """Return L + ½ sᵀ I⁻¹ s of all."""
        return float(self.value + 0.5 * self.slopes @ np.linalg.solve(self.information, self.slopes))


def needed_events(
    events: Events, told: Callable[[Events], Likelihood], first: NDArray[np.intp], slopes: Array, precision: Array
) -> Events:
    """Return the events that explain more than the parameters θ (n,) could.

    told: told(events) is the likelihood of pieces with events, and what they say of θ
    first (S,): the rows that the pieces begin with
    slopes (n,), precision (n,n): of the prior of θ, at θ
    """
    prior = _Sums(np.zeros(()), slopes, precision)

    def explained(sums: _Sums, some: Events) -> float:
        """Return what events explain with the best parameters, less what they cost."""
        return sums.total.and_also(prior).with_best() - some.costs

    known = _Sums.of(told(events))
    all_explain, fewer = explained(known, events), dict[float, Events]()
    for some in _one_of_each_piece(events, first):
        others = _Sums.of(told(_without(events, *some.values())))
        for s, one in some.items():
            left = _without(events, one)
            more = explained(known.but_for(s, others), left) - all_explain
            if more > 0.0:
                fewer[more] = one
    given_up = [fewer[more] for more in sorted(fewer, reverse=True)]
    while given_up:
        needed = _without(events, *given_up)
        if len(given_up) == 1 or explained(_Sums.of(told(needed)), needed) > all_explain:
            return needed
        given_up = given_up[: len(given_up) // 2]
    return events


def _one_of_each_piece(events: Events, first: NDArray[np.intp]) -> Iterator[dict[int, Events]]:
    """Yield events, each as `Events` by the number of its piece, so that no two of those at once share a piece."""
    each: list[list[Events]] = [[] for _ in first]
    one_by_one = [(k, Events({k: kind})) for k, kind in sorted(events.jumps.items())]
    one_by_one += [(one[0], Events(outliers=frozenset([one]))) for one in sorted(events.outliers)]
    for k, event in one_by_one:
        each[int(np.searchsorted(first, k, side="right")) - 1].append(event)
    for some in zip_longest(*each):
        yield {s: one for s, one in enumerate(some) if one is not None}


def _without(events: Events, *others: Events) -> Events:
    for one in others:
        events = events.without(one)
    return events
