"""A made log of a plant: as a recorded one looks, with a second file that holds the true disturbance and states."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import ceil, inf, isnan, nan, pi
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ndob_fmu.codegen.compile_model import compile_model
from ndob_fmu.errors import UsageError, nearest, one_of
from ndob_fmu.model.model import Model
from ndob_fmu.results.csv_files import write_csv
from ndob_fmu.results.recording import Recording
from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.base_errors import IntegrationError
from ndob_fmu.runtime.blocks.disturbance import KINDS, Generator
from ndob_fmu.runtime.blocks.plant import Plant, PlantState
from ndob_fmu.runtime.equations import Equations, Vector
from ndob_fmu.support.files import atomic_path

Signal = Callable[[float], float]
# drive(t, y): the inputs (m,) from the time t (s) on, where y (p,) are the latest samples of the outputs
Drive = Callable[[float, Sequence[float]], Sequence[float]]

# The disturbance is held over so many parts of a usual step.
_PARTS = 4
# Of a step: rows keep their order.
_MOST_JITTER = 0.45
# Streams of random numbers, so that one irregularity more changes nothing else. Outputs have those above.
_OF_TIME, _OF_OUTPUTS = 0, 1


@dataclass(frozen=True)
class Sensor:
    """What a sensor makes of an output.

    noise_std: of white noise, in the output's unit
    resolution: of an encoder, in that unit; samples are rounded to its multiples; 0: not rounded
    every: rows from one sample to the next; the entries between are empty
    missing: share of the samples that are lost, from 0 to 1
    outliers: share of the samples that are wrong, from 0 to 1
    outlier_size: the largest error of these, in the output's unit; at least half of it
    bias: a constant offset, in that unit
    """

    noise_std: float = 0.0
    resolution: float = 0.0
    every: int = 1
    missing: float = 0.0
    outliers: float = 0.0
    outlier_size: float = 0.0
    bias: float = 0.0


def sines(size: float, pace: float, seed: int) -> Signal:
    """Return a sum of three sines that stays within ±size; the fastest has the frequency `pace` (Hz)."""
    random = np.random.default_rng(seed)
    frequencies, phases = pace * np.array([1.0, *random.uniform(0.2, 0.8, 2)]), random.uniform(0.0, 2.0 * pi, 3)
    return lambda t: float(size / 3.0 * np.sum(np.sin(2.0 * pi * frequencies * t + phases)))


def steps(size: float, pace: float, seed: int, stop_time: float) -> Signal:
    """Return a disturbance that jumps `pace` times a second on average, to any value within ±size."""
    random = np.random.default_rng(seed)
    count = ceil(2.0 * pace * stop_time) + 10
    jumps, levels = np.cumsum(random.exponential(1.0 / pace, count)), random.uniform(-size, size, count + 1)
    return lambda t: float(levels[np.searchsorted(jumps, t, side="right")])


def walk(size: float, pace: float, seed: int, stop_time: float) -> Signal:
    """Return a random walk from 0 on: over a time of 1/pace (s) it changes by `size`, one sigma."""
    random, interval = np.random.default_rng(seed), 1e-3 / pace
    count = ceil(stop_time / interval) + 1
    places = np.concatenate([[0.0], np.cumsum(random.standard_normal(count))]) * size * (pace * interval) ** 0.5
    return lambda t: float(np.interp(t, interval * np.arange(count + 1), places))


def make_log(
    model: Model,
    path: str | Path,
    drive: Drive,
    *,
    step: float,
    stop_time: float,
    disturbances: Mapping[str, Signal] | None = None,
    sensors: Mapping[str, Sensor] | None = None,
    parameters: Mapping[str, float] | None = None,
    jitter: float = 0.0,
    gaps: Sequence[tuple[float, float]] = (),
    seed: int = 0,
) -> Path:
    """Write a log of a plant, and beside it `<name>_truth.csv`; return the path of the truth.

    drive: the inputs of each row, held until the next one; a trajectory, or a controller that has what its sensors
        measured: of each output the latest sample, that of the row included. It is called once a row, in their order.
        Where no sample has come yet, it has the output at the start
    step: usual time between two rows (s); the first one is at 0
    disturbances: each as a function of the time; those that are left out are at their nominal value
    sensors: of the outputs; one that is left out gives the true value
    parameters: true values, in place of the model's
    jitter: standard deviation of a row's time over the step; a row is taken when its time stamp says
    gaps: (begin, end) of times (s) in which the logger wrote nothing; the controller has these samples
    seed: of noise, lost samples, outliers and jitter; the same arguments write the same bytes

    The log has the columns `time`, inputs and outputs; the truth has for each row of it the disturbances and states at
    its time. A sample with feed-through shows the inputs of the row before, in the first row its own. Raises UsageError
    for names that the model does not have and numbers that cannot be used, and IntegrationError where the equations
    cannot be followed.
    """
    eq = compile_model(model)
    told, wanted, values = dict(disturbances or {}), dict(sensors or {}), dict(parameters or {})
    for what, names, known in (
        ("disturbance", told, eq.disturbances),
        ("sensor", wanted, eq.outputs),
        ("parameter", values, tuple(eq.parameters)),
    ):
        _require_known(what, names, known)
    _require_usable(step, stop_time, jitter, wanted)
    p = [float(values.get(name, value)) for name, value in eq.parameters.items()]
    times = _times(step, stop_time, jitter, seed)
    signals = [
        told.get(name, lambda t, nominal=nominal: nominal)
        for name, nominal in zip(eq.disturbances, eq.disturbance_nominal, strict=True)
    ]
    measured = [
        _Measured.by(wanted.get(name, Sensor()), len(times), [seed, _OF_OUTPUTS + i])
        for i, name in enumerate(eq.outputs)
    ]
    inputs, states, outputs = _along(eq, p, times, step, drive, signals, measured)
    d = np.array([[signal(t) for signal in signals] for t in times.tolist()]).reshape(len(times), len(signals))
    kept = np.full(len(times), True)
    for begin, end in gaps:
        kept &= (times < begin) | (times > end)
    truth = Path(path).with_name(f"{Path(path).stem}_truth.csv")
    _write(Path(path), ("time", *eq.inputs, *eq.outputs), np.column_stack([times, inputs, outputs])[kept])
    write_csv(truth, Recording(times[kept], (*eq.disturbances, *eq.states), np.column_stack([d, states])[kept]))
    return truth


def _require_known(what: str, names: Mapping[str, object], known: Sequence[str]) -> None:
    for name in names:
        if name not in known:
            raise UsageError.report(
                f"{what} {name}", expected=one_of(what, known, name), received=repr(name), likely=nearest(name, known)
            )


def _require_usable(step: float, stop_time: float, jitter: float, sensors: Mapping[str, Sensor]) -> None:
    if not 0.0 < step < stop_time:
        raise UsageError.report("step", expected=f"a time above 0 and below {stop_time:g} s", received=f"{step:g} s")
    if not 0.0 <= jitter <= 0.2:
        raise UsageError.report("jitter", expected="a share of the step from 0 to 0.2", received=f"{jitter:g}")
    for name, one in sensors.items():
        if one.every < 1 or min(one.noise_std, one.resolution, one.outlier_size) < 0.0:
            raise UsageError.report(f"sensor {name}", expected="numbers of 0 or more, every ≥ 1", received=str(one))
        if not (0.0 <= one.missing <= 1.0 and 0.0 <= one.outliers <= 1.0):
            raise UsageError.report(f"sensor {name}", expected="missing, outliers from 0 to 1", received=str(one))


def _times(step: float, stop_time: float, jitter: float, seed: int) -> Array:
    """Return the times of the rows (K,)."""
    count = round(stop_time / step) + 1
    off = jitter * np.random.default_rng([seed, _OF_TIME]).standard_normal(count)
    off[0] = 0.0
    return np.array(step * (np.arange(count) + np.clip(off, -_MOST_JITTER, _MOST_JITTER)), dtype=float)


@dataclass(frozen=True)
class _Measured:
    """What a sensor makes of an output in K rows.

    error (K,): that it adds; absent (K,): whether there is no sample
    resolution: as in `Sensor`
    """

    error: Array
    absent: NDArray[np.bool_]
    resolution: float

    @classmethod
    def by(cls, sensor: Sensor, count: int, stream: Sequence[int]) -> _Measured:
        random = np.random.default_rng(stream)
        noise, lost, wrong = random.standard_normal(count), random.random(count), random.random(count)
        size = random.uniform(0.5, 1.0, count) * random.choice([-1.0, 1.0], count)
        wrong_by = np.where(wrong < sensor.outliers, sensor.outlier_size * size, 0.0)
        absent = (np.arange(count) % sensor.every != 0) | (lost < sensor.missing)
        return cls(sensor.bias + sensor.noise_std * noise + wrong_by, absent, sensor.resolution)

    def sample(self, k: int, true: float) -> float:
        """Return the sample in a row; NaN where there is none."""
        if self.absent[k]:
            return nan
        found = true + float(self.error[k])
        return self.resolution * round(found / self.resolution) if self.resolution else found


def _along(
    eq: Equations,
    p: Vector,
    times: Array,
    step: float,
    drive: Drive,
    signals: Sequence[Signal],
    measured: Sequence[_Measured],
) -> tuple[Array, Array, Array]:
    """Return the inputs (K,m), the states (K,n) and the samples (K,p) at the times (K,)."""
    plant = Plant(eq, tuple(p), [Generator(KINDS["none"], 0.0, 0.0, 0.0)] * len(signals))
    state = plant.init(eq.x0, 0.0)

    def samples(k: int, u: Vector) -> list[float]:
        return [one.sample(k, true) for one, true in zip(measured, eq.output(state.x, u, p), strict=True)]

    u = [0.0] * len(eq.inputs)
    latest = list(eq.output(state.x, u, p))
    rows = []
    for k, (t, after) in enumerate(zip(times.tolist(), [*times[1:].tolist(), None], strict=True)):
        y = samples(k, u)
        latest = [before if isnan(new) else new for new, before in zip(y, latest, strict=True)]
        u = [float(value) for value in drive(t, tuple(latest))]
        if len(u) != len(eq.inputs):
            raise UsageError.report("drive", expected=f"{len(eq.inputs)} inputs", received=f"{len(u)}")
        # The controller finds the plant with inputs of 0. A reader takes the first ones for older than the log.
        rows.append((u, state.x, y if k else samples(0, u)))
        if after is None:
            break
        parts = ceil(_PARTS * (after - t) / step)
        ends = [t + (after - t) * part / parts for part in range(1, parts)] + [after]
        for end in ends:
            middle = (state.t + end) / 2.0
            try:
                state = plant.step(state, u, [signal(middle) for signal in signals], end)
            except IntegrationError as error:
                raise _cannot_be_followed(eq, state) from error
    inputs, states, outputs = (np.array(column, dtype=float) for column in zip(*rows, strict=True))
    return inputs, states, outputs


def _cannot_be_followed(eq: Equations, state: PlantState) -> IntegrationError:
    """Return the error that says where a plant came to, and which states are not in their ranges there."""
    likely = "a state leaves where the equations hold, or the plant is too stiff"
    for name, value in zip(eq.states, state.x, strict=True):
        low, high = eq.ranges.get(name, (-inf, inf))
        if not low <= value <= high:
            likely = f"{name} is {value:.4g}, outside its range {low:g} to {high:g}"
            break
    at = ", ".join(f"{name} = {value:.4g}" for name, value in zip(eq.states, state.x, strict=True))
    return IntegrationError(
        f"plant at {state.t:.4g} s: its equations cannot be followed from {at}; likely cause: {likely}"
    )


def _write(path: Path, names: Sequence[str], rows: Array) -> None:
    with atomic_path(path) as temporary, temporary.open("w", encoding="utf-8", newline="\n") as file:
        file.write(",".join(names) + "\n")
        for row in rows.tolist():
            file.write(",".join("" if value != value else repr(value) for value in row) + "\n")
