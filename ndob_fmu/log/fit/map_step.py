"""From the fit of a log to what it says of the model's maps: the values of their parameters, and how sure it is."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ndob_fmu.codegen.row_functions import map_functions
from ndob_fmu.errors import some_of
from ndob_fmu.log.fit.class_fit import ClassFit
from ndob_fmu.log.fit.learn_map import learn
from ndob_fmu.model.disturbance_map import DisturbanceMap
from ndob_fmu.model.model import Model
from ndob_fmu.runtime.arrays import Array


@dataclass(frozen=True)
class LearnedMap:
    """What a log says of the map of a disturbance.

    depends_on: the parts that are kept
    rms_without, rms_with: of what remains of the disturbance in parts of the log that were left out, without and with
        the map, about a line, but for pulses
    """

    depends_on: tuple[str, ...]
    rms_without: float
    rms_with: float

    @property
    def explained(self) -> float:
        """The share of the mean square that the map explains."""
        return 1.0 - (self.rms_with / self.rms_without) ** 2


@dataclass(frozen=True)
class MapStep:
    """The maps that were learned.

    maps: for each disturbance
    values: of parameters of the model
    disturbance (K,q2): what the maps say along the log
    warnings: what the log cannot tell apart
    """

    maps: Mapping[str, LearnedMap]
    values: Mapping[str, float]
    disturbance: Array
    warnings: tuple[str, ...]


def learn_maps(model: Model, fit: ClassFit, told: Mapping[str, float]) -> MapStep:
    """Return what a fit says of the maps of a model; one with coefficients that are told stays as it is."""
    rows = fit.problem.rows.model
    first, layout = rows.start_samples, rows.layout
    states, d = fit.trajectory[:, : layout.n], fit.trajectory[:, layout.disturbance]
    found: dict[str, LearnedMap] = {}
    values: dict[str, float] = {}
    warnings: list[str] = []
    along = np.zeros((len(d), layout.q))
    for one in model.maps:
        if any(told[name] for name in one.coefficients):
            continue
        index = model.disturbances.index(one.disturbance)
        region = _region(model, one, states[first:])
        functions = _functions(model, one, states, region)
        ends = np.cumsum([len(part.terms) for part in one.parts])[:-1]
        learned = learn(np.split(functions[first:, 1:], ends, axis=1), d[first:, index])
        names = [part.name for part in one.parts]
        if not learned.parts:
            warnings.append(
                f"the map of {one.disturbance} stays as told: a part of the log that is left out is not predicted "
                f"better by {some_of(names, between=' or ')}"
            )
            continue
        warnings += [
            f"the map of {one.disturbance}: {names[other]} explains as much as {names[kept]}; the log cannot tell them "
            "apart"
            for kept, other in learned.as_well
        ]
        says = functions[:, 1:] @ learned.coefficients
        # A constant cannot be told from a real disturbance, so the map is 0 in the mean.
        offset = -float(says[first:].mean())
        values |= {**region, **dict(zip(one.coefficients, [offset, *learned.coefficients.tolist()], strict=True))}
        along[:, index] = offset + says
        found[one.disturbance] = LearnedMap(tuple(names[i] for i in learned.parts), learned.before, learned.after)
    return MapStep(found, values, along, tuple(warnings))


def _region(model: Model, one: DisturbanceMap, states: Array) -> dict[str, float]:
    """Return the parameters that say where the states (K,n) of a map are."""

    def along(name: str) -> Array:
        return np.asarray(states[:, model.states.index(name)])

    region = {parameter: float(np.max(np.abs(along(rate)))) for rate, parameter in one.rates.items()}
    for place, (low, high) in one.places.items():
        region |= {low: float(np.min(along(place))), high: float(np.max(along(place)))}
    return region


def _functions(model: Model, one: DisturbanceMap, states: Array, region: Mapping[str, float]) -> Array:
    """Return the functions (K,n_φ) of a map along states (K,n)."""
    K, before = len(states), model.maps[: model.maps.index(one)]
    first = sum(len(other.coefficients) for other in before)
    parameters = np.tile(np.array(model.parameter_values(region)), (K, 1))
    u, d = (np.zeros((K, len(group))) for group in (model.inputs, model.disturbances))
    return map_functions(model)(states, u, d, parameters)[:, first : first + len(one.coefficients)]
