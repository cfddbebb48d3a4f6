"""Which columns of a file are which of a model's signals, and in which units."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ndob_fmu.errors import UsageError, nearest, one_of, some_of
from ndob_fmu.runtime.arrays import Array
from ndob_fmu.support.units import Unit, likely_unit

TIME = "time"


@dataclass(frozen=True)
class Columns:
    """The columns of a file that are read, S signals.

    places: of each signal in a row
    names: of the columns, as the header has them
    factor, offset (S,): turn a value into the model's unit
    """

    places: tuple[int, ...]
    names: tuple[str, ...]
    factor: Array
    offset: Array

    def converted(self, rows: Array) -> Array:
        """Return rows (K,S) in the units of the model."""
        return np.asarray(rows * self.factor + self.offset)


@dataclass(frozen=True)
class Signals:
    """The signals of a model that a log must have: the time, the inputs, the outputs.

    inputs, outputs: their names
    model_units: by name, of those that have one; the time is in s
    names: the model's name for each column that has another one in the file
    units: of columns that are not in the model's unit, in Modelica's notation
    """

    inputs: Sequence[str]
    outputs: Sequence[str]
    model_units: Mapping[str, str]
    names: Mapping[str, str]
    units: Mapping[str, str]

    @property
    def all(self) -> tuple[str, ...]:
        """The time, the inputs, the outputs."""
        return (TIME, *self.inputs, *self.outputs)


def columns_of(where: str, header: Sequence[str], signals: Signals) -> Columns:
    """Return the columns of a file with a header.

    Raises UsageError where the file lacks one, or where names and units do not fit the file or the model.
    """
    for column, name in signals.names.items():
        if name not in signals.all:
            raise UsageError.report(
                f"--map {column}={name}",
                expected=one_of("signal", signals.all, name),
                received=repr(name),
                likely=_turned_round("--map", column, name, header)
                if column in signals.all
                else nearest(name, signals.all),
            )
    for option, columns in (("--map", signals.names), ("--unit", signals.units)):
        for column, right in columns.items():
            if column not in header:
                raise UsageError.report(
                    f"{option} {column}",
                    expected=f"a column of {where}",
                    received=repr(column),
                    likely=_turned_round(option, column, right, header)
                    or _own_name(option, column, right, signals)
                    or nearest(column, header)
                    or f"it has {some_of(header)}",
                )
    known = {column: column for column in header if column not in signals.names}
    known |= {name: column for column, name in signals.names.items()}
    if missing := [name for name in signals.all if name not in known]:
        raise UsageError.report(
            where,
            expected=f"{'columns' if missing[1:] else 'a column'} {some_of(missing)}",
            received=f"columns {some_of(header)}" if any(header) else "an empty file",
            likely=f"--map COLUMN={missing[0]}{' …' if missing[1:] else ''} says which it is" if any(header) else "",
        )
    chosen = tuple(known[name] for name in signals.all)
    scales = [_scale(signals, column, name) for column, name in zip(chosen, signals.all, strict=True)]
    factor, offset = np.array(scales).T
    return Columns(tuple(list(header).index(column) for column in chosen), chosen, factor, offset)


def _turned_round(option: str, left: str, right: str, header: Sequence[str]) -> str:
    """Return the likely cause of an assignment whose right side is a column; empty where it is none."""
    return f'it is the other way round: {option} "{right}={left}"' if right in header else ""


def _own_name(option: str, name: str, right: str, signals: Signals) -> str:
    """Return the likely cause where a signal has the model's name in place of its column's; empty for other names."""
    column = next((column for column, own in signals.names.items() if own == name), None)
    return "" if column is None else f'a column has its name in the log: {option} "{column}={right}"'


def _scale(signals: Signals, column: str, name: str) -> tuple[float, float]:
    unit, own = signals.units.get(column), "s" if name == TIME else signals.model_units.get(name)
    if unit is None:
        return 1.0, 0.0
    if own is None:
        of_model = "1" if Unit(unit).to(Unit("1")) else "…"
        raise UsageError.report(
            f"--unit {column}={unit}",
            expected=f"a unit of {name} in the model, to convert to",
            received="none",
            likely=f'units={{"{name}": "{of_model}"}} is missing in the model',
        )
    found = Unit(unit).to(Unit(own))
    if found is None:
        raise UsageError.report(
            f"--unit {column}={unit}",
            expected=f"a unit that can become {own}, that of {name}",
            received=repr(unit),
            likely=likely_unit(unit),
        )
    return found
