"""Settings of a component that make it do something: no number keeps its start value."""

from __future__ import annotations

AWAY_FROM_ZERO = 0.002


def moved(variables):
    """Return a value by name for each number among the parameters: 5 % larger, or 0.002 (Reals) or 1 where it is 0.

    Variables are those of a record or of a model description: they have causality, type, start and items.
    """
    values = {}
    for variable in variables:
        if variable.causality == "parameter" and not variable.items:
            if variable.type == "Real":
                values[variable.name] = 1.05 * variable.start or AWAY_FROM_ZERO
            elif variable.type == "Integer":
                values[variable.name] = variable.start + 1
    return values
