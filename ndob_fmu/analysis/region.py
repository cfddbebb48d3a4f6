"""Where the checks look: in the ranges that are told, elsewhere around the start values and the default experiment."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np

from ndob_fmu.codegen.compile_model import compile_model
from ndob_fmu.codegen.once_per_model import once_per_model
from ndob_fmu.errors import NdobError, some_of
from ndob_fmu.model.model import Model
from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.blocks.disturbance import KINDS, Generator
from ndob_fmu.runtime.blocks.plant import Plant
from ndob_fmu.runtime.design.operating_point import middle_input

_POINTS = 200  # of the default experiment
_WIDER = 0.5  # of the span of what was visited, on each side
_INPUT = 1.0  # half-width of an input without a range, which the default experiment holds at 0
# The experiment is left where a state exceeds the larger of this and this many times its start value.
_FARTHEST = 10.0
_SMALLEST_MAGNITUDE = 1e-8
_SAMPLES = 4096


@dataclass(frozen=True)
class Region:
    """An interval for each state and input.

    limits: {name: (lowest, highest)}
    guessed: names whose range the model does not tell
    """

    limits: Mapping[str, tuple[float, float]] = field(repr=False)
    guessed: tuple[str, ...]

    def bounds(self, names: list[str]) -> tuple[Array, Array]:
        """Return the lowest and the highest values (k,) of the names."""
        both = np.array([self.limits[name] for name in names], dtype=float).reshape(-1, 2)
        return both[:, 0], both[:, 1]

    def searched(self, names: list[str]) -> str:
        """Return where a search over these names looked, for a report."""
        guessed = [name for name in names if name in self.guessed]
        if not guessed:
            return "in the ranges told" if names else "everywhere"
        return f"around start values and default experiment, without ranges of {some_of(guessed)}"


@once_per_model
def working_region(model: Model) -> Region:
    """Return where the model's states and inputs are taken to be."""
    visited = np.array(list(_visited(model)))
    low, high = np.min(visited, axis=0), np.max(visited, axis=0)
    wider = _WIDER * (high - low)
    farthest = _farthest(model)
    limits: dict[str, tuple[float, float]] = {
        name: (max(float(low[i] - wider[i]), -farthest[i]), min(float(high[i] + wider[i]), farthest[i]))
        for i, name in enumerate(model.states)
    }
    limits |= dict.fromkeys(model.inputs, (-_INPUT, _INPUT))
    guessed = tuple(name for name in limits if name not in model.ranges)
    return Region({**limits, **{name: (low, high) for name, (low, high) in model.ranges.items()}}, guessed)


def _farthest(model: Model) -> list[float]:
    starts = zip(model.x0, model.xhat0, strict=True)
    return [max(_FARTHEST, _FARTHEST * abs(x0), _FARTHEST * abs(xhat0)) for x0, xhat0 in starts]


def _visited(model: Model) -> Iterator[list[float]]:
    """Yield states (n,): the start values, and those of the default experiment as far as it can be run."""
    yield list(model.x0)
    for sign in (0.0, 1.0, -1.0):
        yield [x + sign * std for x, std in zip(model.xhat0, model.xhat0_std, strict=True)]
    looked_at = {symbol.name for symbol in model.vector_field.not_linear} & {*model.states}
    if looked_at <= {*model.ranges}:
        return
    equations, signal = compile_model(model), model.disturbance
    source = Generator(KINDS[signal.kind], signal.amplitude, signal.frequency, signal.start_time)
    plant = Plant(equations, model.parameter_values(), [source] * len(model.disturbances))
    u, farthest = middle_input(equations.inputs, equations.ranges), np.array(_farthest(model))
    state, H = plant.init(equations.x0, 0.0), model.experiment.stop_time / _POINTS
    for k in range(1, _POINTS + 1):
        try:
            # The steps as generated code would take longer to write than this takes.
            state = plant.step_by_definition(state, u, equations.disturbance_nominal, k * H, H)
        except (NdobError, ArithmeticError, ValueError):
            return
        if not np.all(np.abs(state.x) <= farthest):
            return
        yield list(state.x)


def samples(low: Array, high: Array) -> Array:
    """Return points (4096,k) of the box from low to high (k,), with a fixed seed; half of their entries are small.

    Friction and saturation are steepest at small values.
    """
    random = np.random.default_rng(0)
    shape = (_SAMPLES, len(low))
    points = random.uniform(-1.0, 1.0, shape)
    small = random.random(shape) < 0.5
    magnitudes = _SMALLEST_MAGNITUDE ** random.random(int(np.sum(small)))
    anywhere = 0.5 * (low + high) + 0.5 * (high - low) * points
    near_zero = points.copy()
    near_zero[small] *= magnitudes
    near_zero *= np.maximum(np.abs(low), np.abs(high))
    return np.where(small & (near_zero >= low) & (near_zero <= high), near_zero, anywhere)
