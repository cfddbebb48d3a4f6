"""The results of a benchmark for the page: ratios to named programs, then times."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from benchmarks.timing import Times, ratio


@dataclass(frozen=True)
class Ratio:
    """Ours over theirs: the median over the rounds and its quartiles; required: the largest value allowed."""

    what: str
    peer: str
    median: float
    low: float
    high: float
    required: float | None = None


@dataclass(frozen=True)
class Time:
    """How long something takes (s): the median."""

    what: str
    seconds: float


@dataclass(frozen=True)
class Section:
    """A part of the page. rank: its place among the sections; text: what is measured and how, in Markdown."""

    rank: int
    title: str
    text: str
    ratios: tuple[Ratio, ...] = ()
    times: tuple[Time, ...] = ()

    def as_dict(self) -> dict[str, Any]:
        """Return the section in JSON's types."""
        return asdict(self)

    @classmethod
    def from_dict(cls, found: Mapping[str, Any]) -> Section:
        """Return the section from the result of `as_dict`."""
        ratios, times = (Ratio(**row) for row in found["ratios"]), (Time(**row) for row in found["times"])
        return cls(**{**found, "ratios": tuple(ratios), "times": tuple(times)})


def compared(what: str, peer: str, ours: Times, theirs: Times, required: float | None = None) -> Ratio:
    """Return the ratio of times that were measured in turns."""
    return Ratio(what, peer, *ratio(ours, theirs), required)
