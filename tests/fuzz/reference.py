"""What FMI's rules and docs/fmi_behaviour.md promise: the statuses that a call may have, from the calls before it.

A prediction is one status where values are of an engineer's size, and a set of them where numbers are so wild that the
numerics may fail: there the model goes on with the status that came.

It is written from FMI's text and on purpose imports no rule of the package: a wrong entry in
`ndob_fmu/interface/fmi_rules.py` shows here. `tests/fmu/test_fmi_rules.py` checks the FMUs against that table.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from math import inf, isfinite, ulp

from .library import DISCARD, ERROR, OK, WARNING, Library, Variable

INSTANTIATED, INITIALIZATION, STEPPING, TERMINATED = "instantiated", "initialization", "stepping", "terminated"
NO_DESIGN = ("motor_damping", 1e12)  # in range, and no observer can be made for it
# Their declared minimum 0 is itself not allowed, which FMI has no word for.
POSITIVE = ("alpha", "pi_start", "pi_end", "disturbance_bound")
LARGEST_INPUT = 10.0
LONGEST_STEP = 0.01
SHORTEST_STEP = 1e-4
TOLERANCE = 1e-3
ROUNDING = 1e-9  # a step (s) that is shorter is no sample, and the one before counts as the last one


def acceptable(variable: Variable, value: float) -> bool:
    """Return whether it is in the declared range."""
    if variable.items:
        return value in variable.items
    if value == 0.0 and (variable.name in POSITIVE or variable.name.endswith("_hat_start_std")):
        return False
    least = -inf if variable.least is None else variable.least
    most = inf if variable.most is None else variable.most
    return isfinite(value) and least <= value <= most


def everyday(variable: Variable, value: float) -> bool:
    """Return whether the design and the numerics must cope with this value of a parameter or an input."""
    if variable.causality == "input":
        return not isfinite(value) or abs(value) <= LARGEST_INPUT
    return variable.type == "Integer" or value in usual(variable)


def usual(variable: Variable) -> tuple[float, float]:
    """Return two ordinary values of a parameter of type Real."""
    return variable.start, variable.start * 1.05 if variable.start else 0.1


@dataclass
class Memory:
    """What an instance remembers, all of which a saved state brings back; times in s.

    values: set by the host, by value reference; last: the last step; shaken: a step with wild numbers has been
    taken; outputs: the last ones read, while nothing may have changed them.
    """

    values: dict[int, float]
    mode: str = INSTANTIATED
    experiment: bool = False
    start: float = 0.0
    stop: float | None = None
    time: float = 0.0
    last: float = 0.0
    refused: set[int] = field(default_factory=set)
    stale: bool = False
    shaken: bool = False
    outputs: tuple[float, ...] | None = None


def fresh(library: Library) -> Memory:
    return Memory({v.reference: v.start for v in library.variables if v.causality in ("input", "parameter")})


def copy(memory: Memory) -> Memory:
    return Memory(**{**vars(memory), "values": dict(memory.values), "refused": set(memory.refused)})


def wild(library: Library, memory: Memory) -> bool:
    return (
        memory.shaken
        or abs(memory.start) > 1e3
        or not all(everyday(library.variables[vr], value) for vr, value in memory.values.items())
    )


def holds_inputs(library: Library, memory: Memory) -> bool:
    """A plant and a controller warn of inputs that are not finite; an observer says it by an output."""
    inputs = library.references("Real", "input")
    return library.name.endswith(("Plant", "Controller")) and not all(isfinite(memory.values[vr]) for vr in inputs)


def refreshed(library: Library, memory: Memory) -> set[int]:
    """The statuses of bringing the outputs up to date in initialization mode."""
    if memory.refused:
        return {ERROR}
    set_to = {library.variables[vr].name: value for vr, value in memory.values.items()}
    if library.name.endswith("Observer") and NO_DESIGN in set_to.items():
        return {ERROR}
    statuses = made(library, memory) - {OK} | {WARNING if holds_inputs(library, memory) else OK}
    # An observer refuses a nominal disturbance in a channel.
    nominal = any(name.endswith("_nominal") and value != 0.0 for name, value in set_to.items())
    return statuses | {ERROR} if wild(library, memory) or nominal else statuses


def made(library: Library, memory: Memory) -> set[int]:
    """The statuses of making what computes: an observer warns of what a disturbance explains as well."""
    set_to = {library.variables[vr].name: value for vr, value in memory.values.items()}
    offsets = any(name.endswith("_bias_std") and value > 0.0 for name, value in set_to.items())
    explained = offsets or set_to.get("estimate_parameters")
    return {OK, WARNING} if explained and library.name.endswith("Observer") else {OK}


def got(library: Library, memory: Memory) -> set[int]:
    return refreshed(library, memory) if memory.stale else {OK}


def set_(library: Library, memory: Memory, references: list[int], values: list) -> set[int]:
    """The status of a call with right references and types; as far as it is allowed the values are taken over."""
    variables = [library.variables[vr] for vr in references]
    if memory.mode == TERMINATED or any(v.causality == "output" for v in variables):
        return {ERROR}
    if memory.mode == STEPPING and any(v.causality == "parameter" for v in variables):
        return {ERROR}
    status = OK
    for variable, value in zip(variables, values, strict=True):
        memory.values[variable.reference] = int(value != 0) if variable.type == "Boolean" else value
        memory.refused.discard(variable.reference)
        if variable.causality == "parameter" and not acceptable(variable, value):
            memory.refused.add(variable.reference)
            status = ERROR
    memory.stale = memory.mode == INITIALIZATION
    if memory.stale:
        memory.outputs = None
    return {status}


def stepped(library: Library, memory: Memory, time: float, size: float) -> set[int]:
    if memory.mode != STEPPING:
        return {ERROR}
    late = abs(time - memory.time)
    if not (0.0 < size < inf and late <= max(TOLERANCE * max(size, memory.last), 4.0 * ulp(memory.time))):
        return {DISCARD}
    if not time + size > time:
        return {DISCARD}
    if memory.stop is not None and time + size > memory.stop + max(TOLERANCE * size, 4.0 * ulp(memory.stop)):
        return {ERROR}
    status = WARNING if holds_inputs(library, memory) else OK
    ordinary = SHORTEST_STEP <= size <= LONGEST_STEP and not wild(library, memory)
    # An observer warns of a step that is absurd for its plant.
    return {status} if ordinary else {status, DISCARD, WARNING}


def after_step(library: Library, memory: Memory, time: float, size: float) -> None:
    memory.shaken = memory.shaken or wild(library, memory) or not SHORTEST_STEP <= size <= LONGEST_STEP
    memory.time = time + size
    memory.last = size if size > ROUNDING else memory.last
    memory.outputs = None


def set_up(memory: Memory, start: float, stop: float | None) -> set[int]:
    if memory.mode != INSTANTIATED or not isfinite(start) or not (stop is None or stop >= start):
        return {ERROR}
    memory.experiment, memory.start, memory.time, memory.last = True, start, start, 0.0
    memory.stop = None if stop == inf else stop
    return {OK}
