"""The explicit integrator of plant and prediction: Cash and Karp's method of order 5, at rounding-level tolerance."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import inf, isfinite
from typing import NamedTuple, TypeAlias, TypeVar

import numpy as np

from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.base_errors import IntegrationError

RELATIVE_TOLERANCE = 2e-12
ABSOLUTE_TOLERANCE = 1e-12
# In one communication step. After so many trials, 0.1 s of a plant's generated code, the rest is judged by its substep.
MOST_SUBSTEPS = 100_000
_JUDGED_AFTER = 10_000
# Where the pace of the first trials and the present substep tell that more than so many are left, `numerics.stiff` is
# tried. A start far from where a fast state settles takes 200 even where it is not stiff, 2 ms of generated code.
_FIRST_TRIALS = 30
_FEW_SUBSTEPS = 500
# Where the right-hand side jumps back and forth, as friction does that holds a mass, no substep is short enough: the
# error rises with the substep, not with its fifth power. If so many trials running, more than the instant of one jump
# takes, are too slow to finish, two longer substeps show the power. The rest is then taken in parts.
_TRIALS_AT_JUMPS = 60
_LONGER, _POWER_AT_JUMPS = 5.0, 1.5
_PARTS_AT_JUMPS = 64
# A substep that comes this near to the end of the interval goes to the end.
_ALMOST = 1.0 - 1e-12

# Cash and Karp, RK5(4): nodes, weights of the stages, of the result and of its error, for six evaluations. Methods that
# have a seventh one for the next substep waste it, since a sample corrects x before that.
NODES = (0.0, 1 / 5, 3 / 10, 3 / 5, 1.0, 7 / 8)
STAGE_WEIGHTS = (
    (),
    (1 / 5,),
    (3 / 40, 9 / 40),
    (3 / 10, -9 / 10, 6 / 5),
    (-11 / 54, 5 / 2, -70 / 27, 35 / 27),
    (1631 / 55296, 175 / 512, 575 / 13824, 44275 / 110592, 253 / 4096),
)
WEIGHTS = (37 / 378, 0.0, 250 / 621, 125 / 594, 0.0, 512 / 1771)
ERROR_WEIGHTS = (-277 / 64512, 0.0, 6925 / 370944, -6925 / 202752, -277 / 14336, 277 / 7084)

_STAGE_WEIGHTS = tuple(np.array(weights) for weights in STAGE_WEIGHTS)
_WEIGHTS, _ERROR_WEIGHTS = np.array(WEIGHTS), np.array(ERROR_WEIGHTS)

X = TypeVar("X")
Trial: TypeAlias = Callable[[float, X, float], tuple[X, float]]


@np.errstate(over="ignore", invalid="ignore")  # what leaves the finite numbers ends in an error below, not in a warning
def integrate(
    derivatives: Callable[[float, Array], Array], x: Array, t: float, t_end: float, h: float
) -> tuple[Array, float]:
    """Return x (n,) at t_end of x' = derivatives(t, x) from x at t, and the substep to try next; h is the one to try.

    Raises IntegrationError where the solution leaves the finite numbers or needs too small substeps.
    """
    last_inside = float(np.nextafter(t_end, t))

    def trial(t: float, x: Array, step: float) -> tuple[Array, float]:
        return cash_karp(derivatives, last_inside, t, x, step)

    return adapt(trial, x, t, t_end, h)


def cash_karp(
    derivatives: Callable[[float, Array], Array], last_inside: float, t: float, x: Array, step: float
) -> tuple[Array, float]:
    """Try a substep as `adapt` wants it.

    last_inside: the last time in the interval. At a jump of the right-hand side in time the end of the interval already
        has the new value; the last stage needs the old one.
    """
    K = np.empty((len(NODES), len(x)))
    K[0] = derivatives(t, x)
    for i in range(1, len(NODES)):
        stage = x + step * (K[:i].T @ _STAGE_WEIGHTS[i])
        K[i] = derivatives(min(t + NODES[i] * step, last_inside), stage)
    after = x + step * (_WEIGHTS @ K)
    errors = np.abs(step * (_ERROR_WEIGHTS @ K)) / (ABSOLUTE_TOLERANCE + RELATIVE_TOLERANCE * np.abs(after))
    return after, float(np.max(errors, initial=0.0))


class Substep(NamedTuple):
    """The substep to try, within an interval.

    t: where it begins (s)
    length: of the substep (s)
    left: from t to the end of the interval (s); equal to `length` in the last substep
    trials: how many substeps have been tried, this one included; 0 where the interval cannot be finished
    planned: the length that the error allows, of which the end of the interval may cut a part (s)
    """

    t: float
    length: float
    left: float
    trials: int
    planned: float


def adapt(trial: Trial[X], x: X, t: float, t_end: float, h: float) -> tuple[X, float]:
    """Return x at t_end from x at t, and the substep to try next, by trials of which h is the first one's.

    trial(t, x, step) returns x at t + step and the norm of its error, at most 1 where it may be accepted.

    Where the right-hand side jumps back and forth, x follows it within what that does in one of `_PARTS_AT_JUMPS`.

    Raises IntegrationError where the solution leaves the finite numbers or needs too small substeps.
    """
    x, _, planned = _adapt(trial, x, t, t_end, h, few=False, stops=False)
    return x, planned


def adapt_in_few(
    trial: Trial[X], x: X, t: float, t_end: float, h: float, *, stops: bool
) -> tuple[X, float, float] | None:
    """Return x, its time and the substep to try next; None where `adapt` fails, or is seen to need many trials.

    stops: whether it stops before t_end where the right-hand side jumps and many trials would be needed
    """
    try:
        return _adapt(trial, x, t, t_end, h, few=True, stops=stops)
    except IntegrationError:
        return None


def _adapt(
    trial: Trial[X], x: X, t: float, t_end: float, h: float, *, few: bool, stops: bool
) -> tuple[X, float, float]:
    left, trials, planned = t_end - t, 1, h
    length, t_before, began = cut(planned, left), t, t
    while True:
        after, error_norm = _tried(trial, t, x, length)
        if error_norm <= 1.0:
            x = after
            if length == left:
                # A substep cut short by the end of the interval says little against the longer one that was planned.
                return x, t_end, max(planned, _length_after(length, error_norm))
        tried = trials
        t, length, left, trials, planned = _next_of_any(t, length, tried, error_norm, t_end)
        # While errors are too large, the substep is not yet known. The instant of one jump takes so many trials too.
        if few and error_norm <= 1.0 and _are_many(Substep(t - began, length, left, tried, planned)):
            jumps = _jumps(trial, x, t, planned)
            if jumps and stops:
                return x, t, planned
            few, trials = False, trials if jumps else 0
        if trials % _TRIALS_AT_JUMPS == 0:
            too_slow = MOST_SUBSTEPS * (t - t_before) < _TRIALS_AT_JUMPS * left
            if too_slow and _jumps(trial, x, t, planned):
                return (x, t, planned) if stops else (_in_parts(trial, x, t, t_end), t_end, left)
            t_before = t
        if not trials:
            raise IntegrationError(
                f"model at t = {t:g} s: more than {MOST_SUBSTEPS} substeps in one communication step; "
                "likely cause: a step that is too long, or parameters that make the plant stiff or unstable"
            )


def _jumps(trial: Trial[X], x: X, t: float, planned: float) -> bool:
    """Return whether the right-hand side jumps near x, where the error allows so short a substep (s)."""
    try:
        _, shorter = trial(t, x, _LONGER * planned)
        _, longer = trial(t, x, _LONGER**2 * planned)
    except (ArithmeticError, ValueError):
        return False
    return shorter > 1.0 and longer < shorter * _LONGER**_POWER_AT_JUMPS


def _in_parts(trial: Trial[X], x: X, t: float, t_end: float) -> X:
    """Return x at t_end from x at t, in equal parts with any error. Raises IntegrationError as `adapt`."""
    part = (t_end - t) / _PARTS_AT_JUMPS
    for k in range(_PARTS_AT_JUMPS):
        x, _ = _tried(trial, t + k * part, x, part)
    return x


def _tried(trial: Trial[X], t: float, x: X, step: float) -> tuple[X, float]:
    """Return what the trial does. Raises IntegrationError where that has no value."""
    try:
        after, error_norm = trial(t, x, step)
    except (ArithmeticError, ValueError) as error:
        raise IntegrationError(f"model at t = {t:g} s: its equations cannot be evaluated ({error})") from error
    if not isfinite(error_norm):
        raise IntegrationError(f"model at t = {t:g} s: the solution leaves the finite numbers")
    return after, error_norm


def next_substep(t: float, length: float, trials: int, error_norm: float, t_end: float) -> Substep:
    """Return the substep to try after the one from t of this length and error, in an interval that began at 0.

    trials: until now. Those of the result are 0 too where many more would be needed.
    """
    substep = _next_of_any(t, length, trials, error_norm, t_end)
    return substep._replace(trials=0) if _are_many(substep._replace(trials=trials)) else substep


def _are_many(substep: Substep) -> bool:
    """Return whether the trials until now, which `trials` counts, tell that many more are needed."""
    by_pace = substep.left * substep.trials > _FEW_SUBSTEPS * substep.t
    return substep.trials >= _FIRST_TRIALS and by_pace and substep.left > _FEW_SUBSTEPS * substep.planned


def _next_of_any(t: float, length: float, trials: int, error_norm: float, t_end: float) -> Substep:
    if error_norm <= 1.0:
        t += length
    left, planned = t_end - t, _length_after(length, error_norm)
    too_many = trials >= MOST_SUBSTEPS or (trials == _JUDGED_AFTER and left > MOST_SUBSTEPS * planned)
    hopeless = too_many or not isfinite(error_norm)
    return Substep(t, cut(planned, left), left, 0 if hopeless else trials + 1, planned)


def cut(planned: float, left: float) -> float:
    """Return the planned substep, or what is left of the interval where that ends with it."""
    return left if planned >= left * _ALMOST else planned


def _length_after(length: float, error_norm: float) -> float:
    grow = min(5.0, max(0.2, 0.9 * error_norm**-0.2)) if error_norm > 0.0 else 5.0
    return length * (min(grow, 0.9) if error_norm > 1.0 else grow)


def largest(ratios: Sequence[float]) -> float:
    """Return the largest of some numbers ≥ 0, infinity where one of them is NaN."""
    return max(ratios) if isfinite(sum(ratios)) else inf
