"""Constant offsets of sensors that a log tells: by the names `<output>_bias`, as parameters of the model are.

An observer estimates an offset anew in each log, as a state b, where `<output>_bias_std` says how large it may be. The
offset found in one log says how large it is as a rule: the root mean square of a number known as ± its error bar.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import hypot
from typing import Any

import numpy as np

from ndob_fmu.errors import UsageError, some_of
from ndob_fmu.interface.told_observer import values_of
from ndob_fmu.log.log import Log
from ndob_fmu.log.told import Told
from ndob_fmu.runtime.design.lumping import lumped
from ndob_fmu.runtime.design.ranges import continued
from ndob_fmu.runtime.design.separability import inseparable_offsets
from ndob_fmu.runtime.equations import Equations

# Prior standard deviation of an offset that has none, over the largest sample.
_OPEN = 0.5


def offset_names(eq: Equations) -> list[str]:
    """Return the name of the offset of each output, which no parameter of the model can have."""
    return [f"{output}_bias" for output in eq.outputs]


def check_offsets(eq: Equations, values: Mapping[str, Any], free: Sequence[str]) -> None:
    """Raise UsageError for a free offset that the samples cannot tell from a disturbance."""
    names = offset_names(eq)
    wanted = [i for i, name in enumerate(names) if name in free]
    if not wanted:
        return
    value = values.__getitem__
    parameters, x_hat = values_of(value, eq.parameters), values_of(value, eq.states, "_hat_start")
    stds = values_of(value, eq.outputs, "_bias_std")
    biased = [i for i, std in enumerate(stds) if i in wanted or std > 0.0]
    for i in inseparable_offsets(continued(lumped(eq)), parameters, x_hat, biased):
        if i in wanted:
            alike = some_of(eq.disturbances, between=" or ")
            raise UsageError.report(
                f"--free {names[i]}",
                expected="an offset that the samples tell from all else",
                received=f"one of {eq.outputs[i]} that looks like a constant {alike}, another state or another offset",
                likely=f"no other sensor shows it; tell its size instead, --start-values {eq.outputs[i]}_bias_std",
            )


def open_offsets(eq: Equations, values: Mapping[str, Any], free: Sequence[str], log: Log) -> dict[str, float]:
    """Return a standard deviation for each free offset, with which an observer estimates it: as told, or a wide one."""
    names = offset_names(eq)
    largest = np.nanmax(np.abs(log.outputs), axis=0, initial=0.0)
    return {
        f"{name}_std": values[f"{name}_std"] or _OPEN * float(size) or 1.0
        for name, size in zip(names, largest, strict=True)
        if name in free
    }


def as_start_values(eq: Equations, told: Mapping[str, Told]) -> dict[str, float]:
    """Return start values of the observer for parameters and offsets that were found."""
    offsets = offset_names(eq)
    values: dict[str, float] = {}
    for name, one in told.items():
        if name in offsets:
            values[f"{name}_std"] = hypot(one.value, one.std)
        else:
            values |= {name: one.value, f"{name}_std": one.std}
    return values
