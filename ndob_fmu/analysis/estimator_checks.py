"""What method 2 needs: that samples show the disturbance and all that does not decay by itself, where the plant works.

The plant is the one that the observer is tuned for, linearised at the start values of the estimate. f of known inputs,
measured outputs or estimated states is known there. So it is no unknown input, as it is in the paper's assumptions.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from ndob_fmu.analysis.check_report import CheckRow
from ndob_fmu.analysis.direction import shortest_direction
from ndob_fmu.analysis.error_bars import stationary_at
from ndob_fmu.analysis.row_parts import MODE_TOLERANCE, dominant, hidden_modes, numbers, outcome, places_of_modes
from ndob_fmu.analysis.row_parts import relative_degrees as degrees_row
from ndob_fmu.analysis.separable import separability_rows
from ndob_fmu.codegen.compile_model import compile_model
from ndob_fmu.errors import DesignError, some_of
from ndob_fmu.model.model import NO_EXPERIMENT, Model
from ndob_fmu.runtime.design.lumping import lumped
from ndob_fmu.runtime.design.minimum_phase import margins_of
from ndob_fmu.runtime.design.operating_point import tangent_at
from ndob_fmu.runtime.design.pace import pace_of, pace_warnings
from ndob_fmu.runtime.design.ranges import continued
from ndob_fmu.runtime.design.tuning import predicted_error
from ndob_fmu.runtime.equations import Equations
from ndob_fmu.runtime.numerics.zeros import AXIS_TOLERANCE, Balanced, balance, pencil_zeros
from ndob_fmu.runtime.step.channel_observer import VANISHING
from ndob_fmu.runtime.step.preparation import linearised
from ndob_fmu.runtime.step.sampled_observer import sampled_observer
from ndob_fmu.runtime.step.settings import observer_settings

_POINTS = 8  # of the ranges told, besides the start values
_HARDLY_SEEN = 0.5  # of what is known without samples: of a disturbance's bound, of a state's error at the start


def estimator_rows(
    model: Model, alpha: float, parameters: Mapping[str, float] | None, *, tuned: bool = True
) -> tuple[CheckRow, ...]:
    """Return a row for each need of method 2; α (1/s) has a part only where disturbance_order is 0.

    tuned: whether the observer is also tuned at its default settings, to predict its error bars

    Raises DesignError where the plant cannot be linearised at its start.
    """
    equations, order = continued(lumped(compile_model(model))), model.observer.disturbance_order
    if order == 0 and equations.matrices is None:
        return (_no_order_zero(),)
    values = tuple(model.parameter_values(parameters))
    linear = linearised(equations, values, equations.xhat0, order)
    names = list(model.unknown_inputs)
    if order == 0:  # the paper's gain, which takes f for an unknown input
        linear = equations.linear_part(values)
        names = [*([] if linear.matched else [f"f[{i}]" for i in range(linear.G_f.shape[1])]), *names]
    system = balance(linear.A, linear.G, linear.C)
    degrees = degrees_row(system, names)
    elsewhere = [] if order == 0 else list(_elsewhere(equations, values))
    detectable = _detectable(system, elsewhere, model.states, names, constant=order > 0)
    zeros = _zeros(system, degrees.values, margin=alpha if order == 0 else 0.0)
    return (
        detectable,
        zeros,
        *([] if model.vector_field.has_paper_form else [degrees]),
        *([_error_bars(model, equations, values)] if tuned and detectable.passed and zeros.passed else []),
        *_direction(model, parameters),
        *separability_rows(model, parameters),
        _pace(model, parameters),
    )


def _no_order_zero() -> CheckRow:
    return outcome(
        "disturbance_order",
        False,
        "disturbance_order 1, 2 or 3",
        "0",
        failure="0",
        likely="disturbance_order 0 is the paper's design, whose form the plant does not have",
        values={},
    )


class _Point(NamedTuple):
    """The plant linearised at a point of the ranges told, and the values there that have one."""

    at: Mapping[str, float]
    system: Balanced


def _elsewhere(equations: Equations, values: Sequence[float]) -> Iterator[_Point]:
    """Yield points of the ranges that are told, the same ones each time; none without ranges."""
    random, ranges = np.random.default_rng(0), equations.ranges
    for _ in range(_POINTS if ranges else 0):
        at = {name: float(random.uniform(low, high)) for name, (low, high) in ranges.items()}
        x = [at.get(name, start) for name, start in zip(equations.states, equations.xhat0, strict=True)]
        u = [at.get(name, 0.0) for name in equations.inputs]
        linear = tangent_at(equations, values, x, u)
        if linear is not None:
            yield _Point(at, balance(linear.A, linear.G, linear.C))


def _detectable(
    start: Balanced, elsewhere: Sequence[_Point], states: Sequence[str], names: Sequence[str], *, constant: bool
) -> CheckRow:
    """Return whether all that no output shows decays, at the start values and at most points of the ranges told.

    A plant may pass a point where an output shows nothing, as an arm that is stretched. There it is only warned of.
    """
    here = _hidden(start, states, names, constant=constant)
    others = [(point, _hidden(point.system, states, names, constant=constant)) for point in elsewhere]
    lost = [(point, found) for point, found in others if found.failure]
    failure, likely, note = here.failure, here.likely, ""
    if lost and not failure:
        point, found = lost[0]
        where = ", ".join(f"{name} = {value:.3g}" for name, value in point.at.items())
        note = f"; warning: {found.failure} at {len(lost)} of {len(others)} points of the ranges, as at {where}"
        if 2 * len(lost) > len(others):
            failure, likely = f"{found.failure} where the plant works, as at {where}", found.likely
    shown = "".join(f"; {where} in no output, decays ({mode} 1/s)" for mode, where in here.decaying.items())
    return outcome(
        "detectable",
        not failure,
        "what no output shows decays",
        f"smallest singular value {here.smallest:.2g} (> {here.limit:.2g}){shown}{note}",
        failure=failure,
        likely=likely,
        values={
            "smallest_singular_value": here.smallest,
            "decaying": here.decaying,
            "lasting": here.lasting,
            "points": len(others),
            "not_detectable_at": [dict(point.at) for point, _ in lost],
        },
    )


class _Hidden(NamedTuple):
    """What no output shows of a plant at one point.

    failure, likely: what does not decay, and what to do; empty where all does
    smallest, limit: singular value, and below which a mode is hidden
    decaying, lasting: {mode: states}
    """

    failure: str
    likely: str
    smallest: float
    limit: float
    decaying: Mapping[str, str]
    lasting: Mapping[str, str]


def _hidden(system: Balanced, states: Sequence[str], names: Sequence[str], *, constant: bool) -> _Hidden:
    """Return whether all that no output shows decays, of the states and of the disturbances' models 1/s, 1/s² ….

    The disturbance's model has the eigenvalue 0 alone. So it is detectable where [A G; C 0] has full column rank: where
    no constant disturbance leaves the outputs as they are. Where d is never told apart, `_zeros` says so.

    constant: whether constant disturbances belong to what must be seen
    """
    smallest, limit, hidden = hidden_modes(system.A, system.C)
    decays = [bool(margins_of(np.array([mode]), 1.0)[0] > 0.0) for mode, _ in hidden]
    decaying, lasting = (
        places_of_modes([one for one, kept in zip(hidden, decays, strict=True) if kept is wanted], system.rate, states)
        for wanted in (True, False)
    )
    failure = "; ".join(f"{where} in no output, mode {mode} 1/s" for mode, where in lasting.items())
    likely = f"no output shows {some_of(dict.fromkeys(lasting.values()))}; measure it, or leave it out of the model"
    n, q = system.G.shape
    if constant and not lasting and pencil_zeros(system.A, system.G, system.C)[1] == q:
        both = np.block([[system.A, system.G], [system.C, np.zeros((len(system.C), q))]])
        _, sigma, Vh = np.linalg.svd(both)
        smallest = min(smallest, float(sigma[-1]))
        if sigma[-1] <= MODE_TOLERANCE * max(1.0, float(sigma[0])):
            which = dominant(Vh[-1, n:], names)
            failure = f"a constant {which} that leaves every output as it is"
            likely = f"only rates are measured; measure a state that a constant {which} shifts, or leave {which} out"
    return _Hidden(failure, likely if failure else "", smallest, limit, decaying, lasting)


def _zeros(system: Balanced, degrees: Mapping[str, int | None], *, margin: float) -> CheckRow:
    """Return whether every zero from the disturbances to the outputs lies left of −margin (1/s), none on the axis."""
    name, requirement = "disturbance_zeros", f"Re z < {-margin if margin else 0.0:g} for every zero z from d to y"
    scaled, rank = pencil_zeros(system.A, system.G, system.C)
    p, q = len(system.C), system.G.shape[1]
    if rank < q:
        unseen = [channel for channel, degree in degrees.items() if degree is None]
        if unseen:
            failure, them = f"{some_of(unseen)} without effect on any output", some_of(unseen)
            likely = f"measure a state that {them} moves, or leave {them} out of the model"
        elif p < q:
            failure = f"{p} outputs for {q} unknown inputs"
            likely = "measure more states, or leave disturbances out of the model"
        else:
            failure = f"{some_of(degrees)}, which move the outputs in ways that cannot be told apart"
            likely = "measure another state that they move differently, or make one disturbance of them"
        return outcome(
            name,
            False,
            requirement,
            f"every z is a zero: normal rank {rank} < {q}",
            failure=failure,
            likely=likely,
            values={"normal_rank": rank},
        )
    zeros = system.rate * scaled
    margins = margins_of(zeros, system.rate)
    return outcome(
        name,
        bool(np.all(margins > margin)),
        requirement,
        f"zeros {numbers(zeros)} 1/s (margin {AXIS_TOLERANCE:g})" if len(zeros) else "no finite zeros",
        failure=f"zeros {numbers(zeros[margins <= margin])} 1/s",
        likely="a disturbance may persist or grow and no output moves; measure a state nearer to where it acts"
        if margin == 0.0
        else "alpha is too large for these zeros, or the outputs are far from where the disturbance acts",
        values={"zeros": zeros, "normal_rank": rank},
    )


def _error_bars(model: Model, equations: Equations, values: Sequence[float]) -> CheckRow:
    """Return how well disturbances and states will be seen at the default step, with the noise and pace that are told.

    A disturbance's predicted error, bias and noise, counts relative to its bound, a state's relative to its error at
    the start. They are those of `design`, and the row fails where it refuses: where no gain can be found.
    """
    H, settings = model.experiment.step_size, observer_settings(equations)
    observer = sampled_observer(equations, values, settings, equations.xhat0)
    refused = "" if observer.longest >= H else f"the default step is too long; at most {observer.longest:.3g} s"
    try:
        if not refused:
            observer.tuned(H)
            found, _ = stationary_at(observer, H)
    except DesignError as why:
        refused = str(why)
    if refused:
        return outcome(
            "error_bars",
            False,
            "an observer that can be tuned",
            f"no gain at steps of {H:g} s",
            failure=f"no gain at steps of {H:g} s",
            likely=refused,
            values={},
        )
    error = np.sum(predicted_error(found, observer.known.disturbance_rate), axis=0)
    std = np.linalg.norm(found.update.factor, axis=1)[: len(model.states)] / found.intensities.scale
    of_x = dict(zip(model.states, (std / np.array(settings.x_std)).tolist(), strict=True))
    of_d = dict(zip(model.unknown_inputs, (error / np.array(settings.disturbance_bound)).tolist(), strict=True))
    shown = [*((name, part, "bound") for name, part in of_d.items())]
    warned = [*shown, *((name, part, "error at the start") for name, part in of_x.items())]
    warnings = [
        f"{name} is hardly seen: error bar {part:.2g} of its {whole}"
        for name, part, whole in warned
        if part > _HARDLY_SEEN
    ]
    measured = ", ".join(f"{name} {part:.2g} of its {whole}" for name, part, whole in shown)
    return CheckRow(
        "error_bars",
        True,
        "for information",
        "; warning: ".join([f"{measured}, steps of {H:g} s", *warnings]),
        values={"disturbances": of_d, "states": of_x, "warnings": warnings},
    )


def _direction(model: Model, parameters: Mapping[str, float] | None) -> Iterator[CheckRow]:
    """Yield how short n(x, u) becomes, relative to the bounds of its entries; nothing without a channel."""
    if not model.channel_expressions:
        return
    shortest = shortest_direction(model, parameters)
    where = ", ".join(f"{name} = {value:.4g}" for name, value in shortest.at.items())
    yield CheckRow(
        "direction",
        True,
        "for information",
        f"shortest n, in its bounds, {shortest.length:.3g}"
        + (f" at {where}" if where else "")
        + f"; the estimate is held below {VANISHING:g}; largest entry {shortest.largest_entry:.3g} times its bound",
        values={"shortest": shortest.length, "at": shortest.at, "largest_entry": shortest.largest_entry},
    )


def _pace(model: Model, parameters: Mapping[str, float] | None) -> CheckRow:
    """Return how fast plant and disturbance are, and whether rate or step are absurd; for information."""
    eq, order = compile_model(model), model.observer.disturbance_order
    pace = pace_of(
        eq,
        model.parameter_values(parameters),
        eq.xhat0,
        bound=eq.disturbance_bound,
        rate=eq.disturbance_rate,
        order=order,
    )
    warnings = pace_warnings(pace, model.disturbances, model.experiment.step_size)
    modes = dict.fromkeys(f"{mode:.3g}" for mode in (pace.slowest, pace.fastest))
    plant = f"plant {' to '.join(modes)} 1/s" if pace.fastest else "plant of integrators"
    disturbance = ", ".join(f"{omega:.3g}" for omega in pace.disturbance)
    values = {"slowest": pace.slowest, "fastest": pace.fastest, "disturbance": pace.disturbance, "warnings": warnings}
    untold = ", as the model has no experiment=Experiment(stop_time=..., step_size=...)"
    measured = f"{plant}, disturbance {disturbance} rad/s, step {model.experiment.step_size:g} s"
    measured += untold if model.experiment is NO_EXPERIMENT else ""
    return CheckRow("pace", True, "for information", "; warning: ".join([measured, *warnings]), values=values)
