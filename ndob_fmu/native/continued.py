"""The plant continued outside its ranges in C: its limits, and `component/continued.c` over them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import inf
from pathlib import Path

from ndob_fmu.native.variable_table import number
from ndob_fmu.runtime.equations import Equations

CONTINUED = ("derivatives", "output", "linearisation", "input_slopes", "sensitivity")
_SOURCE = Path(__file__).parent / "component" / "continued.c"


def continued_text(eq: Equations, calls: Mapping[str, str]) -> str:
    """Return C text that defines `continued_…` for each function of CONTINUED; none for a plant without ranges.

    calls: the names in C of the functions that are continued
    """
    if not eq.ranges:
        return ""
    sizes = {"STATES": eq.states, "INPUTS": eq.inputs, "OUTPUTS": eq.outputs, "DISTURBANCES": eq.disturbances}
    listed = ", ".join(f"CONTINUED_{name} = {len(names)}" for name, names in sizes.items())
    limits = [_limits("states", eq, eq.states), _limits("inputs", eq, eq.inputs)]
    text = _SOURCE.read_text("utf-8")
    for name in calls:
        text = text.replace(f"call_{name}(", f"{calls[name]}(")
    return "\n".join([f"enum {{ {listed} }};", *limits, text])


def _limits(name: str, eq: Equations, names: Sequence[str]) -> str:
    pairs = [eq.ranges.get(one, (-inf, inf)) for one in names] or [(-inf, inf)]
    listed = ", ".join(f"{{{number(low)}, {number(high)}}}" for low, high in pairs)
    return f"static const double limits_of_{name}[][2] = {{{listed}}};"
