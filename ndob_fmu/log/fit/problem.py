"""What a class of disturbances is fitted to: a log and equations, linear about a trajectory, in pieces."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ndob_fmu.log.fit.noise_columns import in_few_columns
from ndob_fmu.log.fit.noise_fit import EventSearch, NoiseFit
from ndob_fmu.log.smooth.along import Course, Samples, Start
from ndob_fmu.log.smooth.events import Jumps
from ndob_fmu.log.smooth.linear_record import LinearRecord
from ndob_fmu.log.smooth.pieces import CutRecord, parts_of, side_by_side
from ndob_fmu.log.smooth.row_model import RowModel
from ndob_fmu.log.smooth.row_steps import StepPlan
from ndob_fmu.log.smooth.whole_record import WholeRecord
from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.step.layout import Layout

# Rows of a piece, at least. Each begins with a part of the piece before it; within that, what it begins with is
# forgotten, as a rule.
PIECE, _BEGINS = 150, 0.2
# A jump at the first row is a part of the start.
_FIRST = 1


@dataclass(frozen=True)
class Problem:
    """A log, and the equations of an observer with an order of the disturbance.

    rows: the equations, at the parameters that are told
    samples: of all rows, with the variances that were told
    intensity (q2,): of the noise behind the r-th derivative of d, to begin with
    offset (p,): of the outputs, constant
    free: which of the parameters and, behind them, of the offsets are θ, which is fitted
    parameter_std (n_θ,): prior standard deviations of θ
    trained: how many rows are fitted; the others are held out
    spacing: between two events, in rows
    piece: rows of a piece, at least
    """

    rows: RowModel
    samples: Samples
    intensity: Array
    offset: Array
    free: tuple[int, ...]
    parameter_std: Array
    trained: int
    spacing: int
    piece: int

    @property
    def layout(self) -> Layout:
        """Of ξ."""
        return self.rows.model.layout

    @property
    def wide(self) -> Array:
        """Standard deviations (N,) at the start of a piece."""
        return self.rows.model.start_std

    @property
    def told(self) -> Array:
        """θ (n_θ,) as told."""
        return np.array([*self.rows.model.parameters, *self.offset])[list(self.free)]

    def course(self, trajectory: Array, theta: Array) -> Course:
        """Return the first rows of the log along a trajectory (K,N), with θ (n_θ,) and without the offsets in it."""
        told = self.rows.model.parameters
        numbers = np.array([*told, *self.offset])
        numbers[list(self.free)] = theta
        parameters, offset = np.split(numbers, [len(told)])
        samples = self.samples.first(len(trajectory))
        rows = RowModel(replace(self.rows.model, parameters=tuple(parameters.tolist())), self.rows.functions)
        return Course(rows, replace(samples, outputs=samples.outputs - offset), trajectory)

    def about(self, course: Course, plan: StepPlan) -> Linearised:
        """Return what `course` found, linearised; plan: of it, or of one with θ near its own.

        Raises IntegrationError where the equations cannot be followed.
        """
        start = Start(course.trajectory[0], np.diag(self.wide))
        record, columns = course.record(start, self.intensity, plan, apart=True)
        record = replace(record, noise=in_few_columns(record.noise, self.layout.q))
        return Linearised(self, course.trajectory, record, columns)


@dataclass(frozen=True)
class Linearised:
    """A log about a trajectory ξ (K,N), and the columns of jumps at each row."""

    problem: Problem
    trajectory: Array
    record: LinearRecord
    columns: Jumps

    def pieces(self, rows: slice) -> tuple[CutRecord, EventSearch]:
        """Return some rows as pieces side by side, and where events may be in them."""
        first, stop, _ = rows.indices(len(self.trajectory))
        least, wide = self.problem.piece, self.problem.wide
        pieces = side_by_side(stop - first, least, round(_BEGINS * least))
        kept = slice(first, first + int(pieces.own[-1]))
        some = self.record.some(kept, np.zeros(len(wide)), np.diag(wide))
        return CutRecord(some, pieces, parts_of(some, pieces, wide)), self.search(kept)

    def whole(self, noise: NoiseFit) -> WholeRecord:
        """Return all rows as one record, with a noise and a pace."""
        return WholeRecord(noise.applied(self.record, self.problem.layout))

    def search(self, rows: slice) -> EventSearch:
        """Return where events may be in some rows."""
        return EventSearch(self.columns.some(rows), self.problem.spacing, _FIRST)
