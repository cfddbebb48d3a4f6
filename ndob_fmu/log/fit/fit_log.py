"""A log to start values of the observer: noise of each output, class and pace of the disturbance, named parameters."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ndob_fmu.codegen.compile_model import compile_model
from ndob_fmu.log.fit.class_fit import ClassFit, fit_class
from ndob_fmu.log.fit.fit_parameters import as_told, with_parameters
from ndob_fmu.log.fit.followed import said_of_residuals
from ndob_fmu.log.fit.map_step import LearnedMap, MapStep, learn_maps
from ndob_fmu.log.fit.offsets import as_start_values
from ndob_fmu.log.fit.orders import best_order, in_pieces, of_each_order, with_own_orders
from ndob_fmu.log.fit.pace import rates_for
from ndob_fmu.log.fit.parameter_step import most_likely
from ndob_fmu.log.fit.setup import Run, Setup
from ndob_fmu.log.fit.tried_rates import MOST_ROWS, Followed, best_followed
from ndob_fmu.log.told import Told
from ndob_fmu.log.told_values import start_values_text, told_values
from ndob_fmu.model.model import Model
from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.step.tuned import Tuned
from ndob_fmu.support.files import atomic_folder
from ndob_fmu.support.progress import begin

FIT, SUMMARY = "fit.json", "fit_summary.json"
# What a log shows of a disturbance may not be its largest; a bound below this multiple of it is raised.
_BEYOND, _FAR_BEYOND = 1.2, 2.0
# A jump that is too small to be noticed at once must be followed, too. Of the mean rate of all jumps: where few are so
# small, and where an observer that follows most of them errs less than one that waits until it is sure of them.
_OF_JUMPS, _MOST_OF_JUMPS = 0.3, 10.0


@dataclass(frozen=True)
class Fitted:
    """What was found in a log.

    build: of the observer that ran along it, as in `Estimated`
    rows, held_out: how many rows there are, and how many of them were held out until the order was chosen
    order: the highest one of a disturbance
    orders: of each disturbance; with 1 it wanders, with 2 it is smooth
    is_jumping: whether a disturbance that jumps explains the log better than one that does not
    jumps, outliers: in all rows
    noise_std: of each output
    intensity: of the white noise behind the order-th derivative of each disturbance
    parameters: those that were fitted and that the log tells
    maps: what was learned of the maps of the disturbances
    held_out_values: log-likelihood of a held-out sample for each order of all disturbances; None where no row is held
        out
    held_out_value: the same for the orders that were chosen
    warnings: what in the log does not look like the model's signals, and what the log does not tell
    start_values: for fit.json
    """

    build: str
    rows: int
    held_out: int
    order: int
    orders: Mapping[str, int]
    is_jumping: bool
    jumps: int
    outliers: int
    noise_std: Mapping[str, Told]
    intensity: Mapping[str, Told]
    parameters: Mapping[str, Told]
    maps: Mapping[str, LearnedMap]
    held_out_values: Mapping[int, float | None]
    held_out_value: float | None
    warnings: tuple[str, ...]
    start_values: Mapping[str, Any]


def fit_log(
    model: Model,
    path: str | Path,
    folder: str | Path,
    *,
    free: Sequence[str] = (),
    hold: float = 0.3,
    names: Mapping[str, str] | None = None,
    units: Mapping[str, str] | None = None,
    start_values: Mapping[str, Any] | None = None,
    native: Path | None = None,
) -> Fitted:
    """Fit noise, class and pace of the disturbance and free parameters of a model to a log; write fit.json.

    free: parameters of the model to be fitted, and offsets of outputs, `<output>_bias`
    hold: share of the rows, the last ones, that is held out to judge by
    names, units, start_values, native: as of `estimate_log`

    Raises UsageError for a log or values that cannot be used, DesignError and AssumptionError where the observer cannot
    be designed, IntegrationError where its estimate leaves the finite numbers.
    """
    eq = compile_model(model)
    values = told_values(eq, start_values or {})
    given = {name: values[name] for name in start_values or {}}
    setup = Setup(model, eq, values, tuple(free), hold, native)
    setup.check()
    run = setup.online(path, names, units)
    setup = setup.with_values(setup.open_offsets(run.stretch.log))
    fitted = _fitted(setup, run, given)
    with atomic_folder(folder) as new:
        (new / FIT).write_text(start_values_text(fitted.start_values), "utf-8")
        (new / SUMMARY).write_text(json.dumps(asdict(fitted), indent=2) + "\n", "utf-8")
    return fitted


def _fitted(setup: Setup, run: Run, given: Mapping[str, Any]) -> Fitted:
    warnings = list(run.warnings)
    if not run.is_whole:
        warnings.append(f"the first {run.rows} rows of the log are fitted, the others are not read")
    setup, fits = in_pieces(setup.with_one_order, run)
    best = best_order(fits)
    at_first, raised = setup, _raised_bounds(setup, best)
    if any(value > _FAR_BEYOND * setup.values[name] for name, value in raised.items()):
        # Jumps were searched for with a wrong size.
        setup = setup.with_values(raised)
        fits = of_each_order(setup, run)
        best = best_order(fits)
        raised |= _raised_bounds(setup, best)
    setup, best = with_own_orders(setup, run, best)
    held_out_value = best.held_out.of_a_sample
    setup, held_out = setup.with_values(raised), run.rows - best.problem.trained
    if held_out:
        setup, best = _with_all_rows(setup, run, best)
    parameters, best = with_parameters(setup, run, best, warnings)
    if parameters:
        # What the wrong parameters added to the disturbance is gone.
        as_given = {name: at_first.values[name] for name in raised}
        raised = _raised_bounds(at_first, best)
        setup = setup.with_values({**as_given, **raised})
    warnings += [f"{name} is raised to {value:.3g}, because the log shows more" for name, value in raised.items()]
    setup, best, maps = _with_maps(setup.with_values(as_told(parameters)), run, best)
    warnings += [*maps.warnings, *said_of_residuals(setup.equations.outputs, best.residuals)]
    noise_std = _noise_std(setup, best)
    found = {
        **given,
        **raised,
        **{f"{name}_noise_std": told.value for name, told in noise_std.items()},
        "disturbance_order": best.order,
        **setup.own_orders,
        **as_start_values(setup.equations, parameters),
        **maps.values,
    }
    pace, pace_std = best.pace
    pace, pace_std = pace * best.raised, pace_std * best.raised
    rates = _rates(setup, best, found, pace, run)
    return Fitted(
        build=run.build,
        rows=run.rows,
        held_out=held_out,
        order=best.order,
        orders=dict(zip(setup.equations.disturbances, best.problem.layout.own, strict=True)),
        is_jumping=best.is_jumping,
        jumps=len(best.noise.events.jumps),
        outliers=len(best.noise.events.outliers),
        noise_std=noise_std,
        intensity={
            name: Told(float(value), float(std))
            for name, value, std in zip(setup.equations.disturbances, pace, pace_std, strict=True)
        },
        parameters=parameters,
        maps=maps.maps,
        held_out_values={order: fit.held_out.of_a_sample for order, fit in fits.items()},
        held_out_value=held_out_value,
        warnings=tuple(warnings),
        start_values={**found, **setup.named("disturbance_rate", rates)},
    )


def _with_all_rows(setup: Setup, run: Run, known: ClassFit) -> tuple[Setup, ClassFit]:
    """Return the fit of all rows in the class that was chosen, and the setup that holds out none."""
    setup = replace(setup, hold=0.0)
    problem = replace(setup, free=()).problem(run, known.order)
    return setup, fit_class(problem, known.trajectory, most_likely, start=known.with_held_out_events)


def _with_maps(setup: Setup, run: Run, known: ClassFit) -> tuple[Setup, ClassFit, MapStep]:
    """Return the maps that the log tells, and the fit of what remains of the disturbance."""
    maps = learn_maps(setup.model, known, setup.values)
    setup = replace(setup.with_values(maps.values), free=())
    if not maps.maps:
        return setup, known, maps
    problem, trajectory = setup.problem(run, known.order), known.trajectory.copy()
    trajectory[:, problem.layout.disturbance] -= maps.disturbance
    return setup, fit_class(problem, trajectory, most_likely), maps


def _rates(setup: Setup, best: ClassFit, found: Mapping[str, Any], pace: Array, run: Run) -> Array:
    """Return the disturbance_rate (q2,) for an intensity (q2,), or the one with which jumps are followed best."""
    usual = run.stretch.usual

    def tuned(rates: Array) -> Tuned:
        return setup.tuned({**found, **setup.named("disturbance_rate", rates)}, usual)

    begin("fitting, part 5 of 5: disturbance_rate")
    rates = rates_for(
        pace,
        lambda rates: tuned(rates).intensity(usual, [1.0] * len(setup.equations.outputs)),
        setup.of_disturbances("disturbance_rate"),
    )
    if not best.is_jumping:
        return rates
    # With a lower rate than that of a raised pace, error bars do not hold what wanders between jumps.
    of_jumps = best.jumping_rate
    least, highest = _OF_JUMPS * of_jumps, np.maximum(rates, _MOST_OF_JUMPS * of_jumps)
    lowest = np.where(best.raised > 1.0, np.maximum(rates, least), least)
    first = best.problem.rows.model.start_samples
    smoothed = best.disturbance[: MOST_ROWS - first]

    def follow(rates: Array) -> Followed:
        said = setup.along({**found, **setup.named("disturbance_rate", rates)}, run, first + len(smoothed))
        return Followed(said.d_at_sample[first:], said.d_std[first:])

    return best_followed(lowest, highest, follow, smoothed)


def _raised_bounds(setup: Setup, best: ClassFit) -> dict[str, float]:
    """Return larger values of disturbance_bound where the log shows a larger disturbance."""
    bound, nominal = setup.of_disturbances("disturbance_bound"), setup.of_disturbances("disturbance_nominal")
    seen = _BEYOND * best.largest(nominal)
    raised = setup.named("disturbance_bound", np.maximum(bound, seen))
    return {name: value for (name, value), higher in zip(raised.items(), seen > bound, strict=True) if higher}


def _noise_std(setup: Setup, best: ClassFit) -> dict[str, Told]:
    told = np.sqrt(best.problem.rows.model.noise_variance)
    p = len(told)
    log_std = 0.5 * np.sqrt(np.diag(best.noise_covariance)[:p])
    found = told * np.exp(0.5 * best.noise.log_variance)
    return {
        name: Told(float(value), float(value * own))
        for name, value, own in zip(setup.equations.outputs, found, log_std, strict=True)
    }
