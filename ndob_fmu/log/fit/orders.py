"""The order of each disturbance that explains a log best: 1, it wanders, or 2, it is smooth.

With one order for all, a disturbance that wanders beside a smooth one counts as smooth, too, because the smooth one
tells more of the order. Then the error bars of the one that wanders are too narrow.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from ndob_fmu.interface.model_variables import OWN_ORDER
from ndob_fmu.log.fit.class_fit import ClassFit, fit_class
from ndob_fmu.log.fit.parameter_step import most_likely
from ndob_fmu.log.fit.setup import Run, Setup
from ndob_fmu.support.progress import begin

# Orders of a disturbance that an observer is proposed for.
ORDERS = (1, 2)
# A gain of the log-likelihood that is worth another order.
SURE = 2.0
# By what factor pieces become longer, and how many are left at least.
_LONGER, _FEWEST = 4, 4


def in_pieces(setup: Setup, run: Run) -> tuple[Setup, dict[int, ClassFit]]:
    """Return the fits with one order for all disturbances, and the setup with pieces long enough to tell the pace.

    What wanders slowly beside the noise of its sensor, or of a sensor that is read seldom, is a line in a short piece.
    Values of fits are compared, so that all have the same pieces.
    """
    fits = of_each_order(setup, run)
    while not all(fit.tells_pace for fit in fits.values()):
        longer = min(_LONGER * setup.piece, fits[ORDERS[0]].problem.trained // _FEWEST)
        if longer <= setup.piece:
            break
        setup = replace(setup, piece=longer)
        fits = of_each_order(setup, run)
    return setup, fits


def of_each_order(setup: Setup, run: Run) -> dict[int, ClassFit]:
    """Return the fits with one order for all disturbances, with the parameters as told."""
    setup, fits = replace(setup, free=()), {}
    for order in ORDERS:
        begin(f"fitting, part {1 + order} of 5: noise, pace and jumps with disturbance_order {order}")
        problem = setup.problem(run, order)
        fits[order] = fit_class(problem, setup.trajectory(run, problem), most_likely)
    return fits


def best_order(fits: Mapping[int, ClassFit]) -> ClassFit:
    """Return the class that explains held-out and fitted rows best; the lower order where chance decides."""
    best = fits[ORDERS[0]]
    for order in ORDERS[1:]:
        best = _better(best, fits[order])
    return best


def with_own_orders(setup: Setup, run: Run, best: ClassFit) -> tuple[Setup, ClassFit]:
    """Return the best fit with an order of its own for each disturbance, and the setup that tells them."""
    names = setup.equations.disturbances
    for j, name in enumerate(names if len(names) > 1 else ()):
        own = list(best.problem.layout.own)
        own[j] = sum(ORDERS) - own[j]
        begin(f"fitting: noise, pace and jumps with order {own[j]} of {name}")
        told = setup.with_values(setup.named(OWN_ORDER, own))
        problem = replace(told, free=()).problem(run, max(own))
        other = fit_class(problem, best.in_layout_of(problem), most_likely)
        lower, higher = sorted((best, other), key=lambda fit: sum(fit.problem.layout.own))
        taken = higher if _all_rows_tell(higher) > _all_rows_tell(lower) + SURE else lower
        if taken is other:
            setup, best = told, other
    return setup, best


def _all_rows_tell(fit: ClassFit) -> float:
    """Return the log-likelihood of fitted and held-out rows.

    One disturbance of several moves less of a log than all of them do, so that each row counts.
    """
    return fit.noise.value + fit.held_out.value


def _better(lower: ClassFit, higher: ClassFit) -> ClassFit:
    """Return which fit explains held-out and fitted rows better; the one of lower orders where chance decides."""
    is_higher = higher.judged > lower.judged + SURE and higher.noise.value > lower.noise.value
    return higher if is_higher else lower
