"""Inputs from a file: columns over time, held from each row to the next."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ndob_fmu.cosim.system.ports import Link, Port
from ndob_fmu.cosim.system.system import System
from ndob_fmu.cosim.time_grid import TimeGrid
from ndob_fmu.errors import CouplingError, UsageError
from ndob_fmu.results.csv_files import read_csv
from ndob_fmu.runtime.arrays import Array


@dataclass(frozen=True, eq=False)
class InputTable:
    """Signals for inputs over time.

    ports: the inputs.
    time: (rows,), s.
    values: (rows, len(ports)); row k holds from ``time[k]`` on.
    """

    ports: tuple[Port, ...]
    time: Array
    values: Array

    def player(self, grid: TimeGrid) -> Callable[[int, Array], None]:
        """Return a function of (k, bus) that writes into ``bus``, (len(ports),), the row that holds at t_k.

        That is the latest row with time ≤ t_k, the last one where several have the same time; k must not decrease
        from call to call. Raises UsageError if the first row comes after the start.
        """
        # A row is meant for a communication point even if the file's decimal and t_k round to neighbouring doubles.
        first_steps = np.ceil((self.time - grid.start_time) / grid.step_size - 1e-9).tolist()
        if first_steps[0] > 0:
            expected = f"a row at or before the start, {grid.start_time:g} s"
            raise UsageError.report("input file", expected=expected, received=f"its first row at {self.time[0]:g} s")
        row = -1

        def play(k: int, bus: Array) -> None:
            nonlocal row
            previous = row
            while row + 1 < len(first_steps) and first_steps[row + 1] <= k:
                row += 1
            if row != previous:
                bus[:] = self.values[row]

        return play


NO_INPUTS = InputTable((), np.array([-np.inf]), np.zeros((1, 0)))


def read_inputs(path: str | Path, system: System) -> InputTable:
    """Read a CSV file in fmpy's form whose columns are named ``component.variable``, or as an input at the boundary.

    Raises UsageError if the file cannot be used, CouplingError if a column is not an input of the system or holds
    what the input's type cannot take. NaN is passed on: a lost sample is a legitimate input.
    """
    table = read_csv(path)
    if not np.isfinite(table.time).all() or (np.diff(table.time) < 0).any():
        raise UsageError.report(str(path), expected="finite times that do not decrease", received="a time that does")
    columns = [
        (name, link, values * link.factor + link.offset)
        for name, values in zip(table.names, table.columns.T, strict=True)
        for link in (system.inputs[name] if name in system.inputs else (Link(system.port(name)),))
    ]
    for name, (port, *_), values in columns:
        variable = system.variable(port)
        where = f"{path}, column {name}"
        if variable.causality != "input" or variable.type == "String":
            received = f"{variable.causality} of type {variable.type}"
            raise CouplingError.report(where, expected="a numeric or Boolean input", received=received)
        allowed = np.isin(values, (0, 1)) if variable.type == "Boolean" else values == np.round(values)
        if variable.type != "Real" and not allowed.all():
            wanted = "true, false, 1 or 0" if variable.type == "Boolean" else "whole numbers"
            received = repr(float(values[~allowed][0]))
            raise CouplingError.report(where, expected=f"{wanted} ({variable.type})", received=received)
    for name, link, _ in columns:
        others = [other for other, same, _ in columns if same.port == link.port and other != name]
        if others:
            received = f"the columns {name} and {others[0]}"
            raise CouplingError.report(f"{path}, input {link.port}", expected="exactly one driver", received=received)
    signals = np.column_stack([values for *_, values in columns]) if columns else table.columns
    return InputTable(tuple(link.port for _, link, _ in columns), table.time, signals)
