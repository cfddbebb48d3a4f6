"""The points of a study: the values of each run."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy import stats
from scipy.stats import qmc

from ndob_fmu.cosim import Value

_LEAST_SHARE = 2.0**-53  # a drawn share may be 0, where a normal distribution has no finite value


@dataclass(frozen=True)
class ParameterTable:
    """Parameters that vary together: ``rows[k]`` has a value for each of ``names``; drawn: spread over ranges."""

    names: tuple[str, ...]
    rows: tuple[tuple[Value, ...], ...]
    drawn: bool = False


@dataclass(frozen=True)
class Range:
    """The distribution of a parameter: uniform between two bounds, or normal.

    a, b: lower and upper bound, or mean and standard deviation if ``normal``.
    log: uniform in the logarithm.
    """

    a: float
    b: float
    log: bool = False
    normal: bool = False

    def at(self, share: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the values below which a ``share`` in (0, 1) of the distribution lies, of the same shape."""
        if self.normal:
            share = np.clip(share, _LEAST_SHARE, 1.0 - _LEAST_SHARE)
            return np.asarray(stats.norm.ppf(share, loc=self.a, scale=self.b))
        if self.log:
            between = np.exp(math.log(self.a) + share * (math.log(self.b) - math.log(self.a)))
        else:
            between = self.a + share * (self.b - self.a)
        return np.clip(between, self.a, self.b)  # exp and log round


def grid(columns: Mapping[str, Sequence[Value]]) -> ParameterTable:
    """Return every combination, the last parameter varying fastest."""
    return ParameterTable(tuple(columns), tuple(product(*columns.values())))


def listed(columns: Mapping[str, Sequence[Value]]) -> ParameterTable:
    """Return the k-th values of all parameters as the k-th row."""
    return ParameterTable(tuple(columns), tuple(zip(*columns.values(), strict=True)))


def latin_hypercube(ranges: Mapping[str, Range], count: int, seed: int) -> ParameterTable:
    """Return points of which each of ``count`` equally likely slices of every range holds one."""
    # Streams of their own, so that a study with both kinds of tables has no points that go together.
    shares = qmc.LatinHypercube(len(ranges), rng=np.random.default_rng((seed, 0))).random(count)
    return _spread(ranges, shares)


def random(ranges: Mapping[str, Range], count: int, seed: int) -> ParameterTable:
    """Return points drawn independently."""
    return _spread(ranges, np.random.default_rng((seed, 1)).random((count, len(ranges))))


def _spread(ranges: Mapping[str, Range], shares: NDArray[np.float64]) -> ParameterTable:
    columns = [spread.at(shares[:, k]).tolist() for k, spread in enumerate(ranges.values())]
    return ParameterTable(tuple(ranges), tuple(zip(*columns, strict=True)), drawn=True)


@dataclass(frozen=True)
class Points:
    """Every row of each table combined with every row of the others; the last table varies fastest."""

    tables: tuple[ParameterTable, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """The parameters that vary."""
        return tuple(name for table in self.tables for name in table.names)

    def __len__(self) -> int:
        return math.prod(len(table.rows) for table in self.tables)

    def __getitem__(self, run: int) -> dict[str, Value]:
        """Return the values of run 0 … len − 1."""
        values: list[tuple[str, Value]] = []
        for table in reversed(self.tables):
            run, row = divmod(run, len(table.rows))
            values = [*zip(table.names, table.rows[row], strict=True), *values]
        return dict(values)

    def levels(self) -> dict[str, list[Value]]:
        """Return the different values of each parameter, in the order in which they first appear."""
        return {
            name: list(dict.fromkeys(row[k] for row in table.rows))
            for table in self.tables
            for k, name in enumerate(table.names)
        }
