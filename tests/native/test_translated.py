"""Each translated function gives what its twin in Python gives, on arguments from runs of the twins."""

from __future__ import annotations

import numpy as np
import pytest

from ndob_fmu.native.translate.kinds import NOTHING, Maybe, is_number
from tests.helpers.translated import difference
from tests.native.scope import BY_HAND, NOT_YET

# Of the largest number in a result.
TOLERANCE = 1e-12
# Results that are not the same by nature, and what of them is.
SAME = {
    # Singular vectors have any sign.
    "numerics.riccati.controllability_staircase": lambda result: [np.abs(part) for part in result],
    # Orthogonal coordinates inside spaces of null vectors are any; singular values do not depend on them.
    "numerics.zeros._remove_infinite_part": lambda result: np.linalg.svd(
        np.vstack([np.hstack(result[:2]), np.hstack(result[2:])])
    )[1],
    "numerics.riccati.solve_riccati": lambda result: _solved(result),
    "numerics.riccati.solve_riccati_over": lambda results: [_solved(result) for result in results],
    # The substep to try next follows from an error that is near rounding.
    "numerics.integrate.integrate": lambda result: result[0],
    "numerics.stiff.integrate_any": lambda result: result[0],
    # The error is a sum of slopes that cancel, which NumPy's products add in another order on each processor. What
    # rounding leaves of it, 1e-16 of x, is 1e-4 of the tolerance of 1e-12. So the norm of a substep that may be
    # accepted is the same to 1e-4, that is to `TOLERANCE` of 1e8, and a larger one to `TOLERANCE` of itself.
    "numerics.integrate.cash_karp": lambda result: [result[0], 1e8 + result[1]],
    "numerics.stiff._trial": lambda result: result[0],
    # Second differences of ẋ, beside ẋ H.
    "step.time_update.left_out": lambda result: 1e-4 + result,
    "design.tuning.PredictedErrors.best_bandwidth": lambda result: result[0],
    "step.tuned._judged": lambda result: result and [field(result, "intensities"), field(result, "error")],
    "design.tuning.search": lambda result: field(result, "bandwidth"),
    "design.step_designs.StepDesigns.searched": lambda result: result and field(result, "bandwidth"),
    "design.schedule.gain_table": lambda result: [field(result, "L"), field(result, "dL")],
    "design.schedule._gain_table": lambda result: [field(result, "L"), field(result, "dL")],
    "design.gains.paper_gains": lambda result: [field(result, name) for name in ("L", "W", "M")],
    "step.paper_observer.paper_observer": lambda result: field(field(field(result, "gains"), "table"), "L"),
    # Eigenvalues have no order.
    "design.operating_point.driven_modes": np.sort_complex,
    "design.stationary_design.StationaryDesign.poles": np.sort_complex,
    # A column of rounding errors in a factor has any sign.
    "numerics.kalman.converged_factor": lambda result: result @ result.T,
    # What rounding leaves, beside 1.
    "numerics.riccati._relative_residual": lambda result: 1.0 + result,
    "numerics.riccati._relative_size": lambda result: 1.0 + result,
}


def _solved(result):
    """Return what of a Riccati solution does not depend on the signs of its coordinates."""
    Q, T, balanced = (field(result, name) for name in ("Q", "coordinates", "balanced"))
    return [Q, T @ balanced @ T.T]


def field(result, name):
    return result[name] if isinstance(result, dict) else getattr(result, name)


# Results of many operations that each enlarge a rounding error.
LOOSE = dict.fromkeys(
    (
        # The filter forgets slowly, and rounding errors are summed until it has.
        "numerics.kalman._doubled",
        "numerics.kalman.converged_factor",
        "design.stationary_design.StationaryDesign.bias_gain",
        "design.stationary_design.StationaryDesign.noise_std",
        "design.stationary_design.Whitened.settled",
        "design.stationary_design._whitened",
        "design.stationary_design.design_for",
        "design.stationary_design.stationary_design",
        "design.step_designs.StepDesigns.at",
        "step.preparation.PreparedObserver.design",
        "design.tuning.PredictedErrors._predicted",
        "design.tuning.PredictedErrors.at",
        "design.tuning.search",
        "design.tuning.predicted_error",
        "design.tuning.squared_errors",
        "numerics.kalman.stationary",
        "numerics.kalman._limit",
        # A fit that is weighed again twenty times; its result is rounded to powers of two.
        "numerics.units.nearest_to_one",
    ),
    1e-7,
) | dict.fromkeys(
    (
        # Second differences of ẋ are a part of the covariance during the start.
        "step.time_update.left_out",
        "step.sampled_step._stepped",
        "step.sampled_step.step_by_definition",
        "step.time_update._moved",
        "step.time_update.predict",
        "step.tracking_step.step_with_covariance",
    ),
    1e-6,
)


def short(where):
    return where.removeprefix("ndob_fmu.runtime.")


def outcome(run):
    """Return a result, or the type of what was raised instead."""
    try:
        return run()
    except Exception as error:
        return type(error)


def raised(call, definition):
    return call.result is None and definition.result != NOTHING and not isinstance(definition.result, Maybe)


def compared(definition, call, library):
    """Return the difference of a call in C from the same call in Python; ∞ where one of them alone raised."""
    own = outcome(lambda: library.call(definition, call.arguments))
    if isinstance(own, type) or raised(call, definition):
        return 0.0 if isinstance(own, type) and raised(call, definition) else np.inf
    same = SAME.get(short(definition.where), lambda result: result)
    return difference(same(call.result), same(own))


def test_each_function_gives_what_its_twin_in_python_gives(translation, library, recorded):
    found = {}
    for definition in translation.definitions:
        calls = recorded.get(definition.where, [])
        allowed = LOOSE.get(short(definition.where), TOLERANCE)
        if all(is_number(one.kind) for one in definition.parameters) and is_number(definition.result):
            allowed = 0.0  # operations on numbers are the same to the last bit
        differences = [compared(definition, call, library) for call in calls]
        if any(not one <= allowed for one in differences):
            found[short(definition.where)] = differences
    assert found == {}


def test_the_runs_call_every_function(translation, recorded):
    at_import = {"numerics.transition._series_weights", "numerics.transition.parts_of"}  # make constants
    in_generated_code = {"numerics.integrate.largest"}
    never = {short(one.where) for one in translation.definitions if not recorded.get(one.where)}
    assert never - at_import - in_generated_code == set()


def test_every_function_of_these_modules_translates_but_for_those_that_are_listed(translation):
    assert {
        short(where): why
        for where, why in translation.refused.items()
        if short(where) not in NOT_YET | dict.fromkeys(BY_HAND, "")
    } == {}


def test_the_list_of_those_that_do_not_translate_yet_holds_no_others(translation):
    assert {*NOT_YET, *BY_HAND} - {short(where) for where in translation.refused} == set()


def test_a_function_gives_back_the_memory_that_it_took_but_for_its_result(translation, library, recorded):
    for definition in translation.definitions:
        if is_number(definition.result) and recorded.get(definition.where):
            outcome(lambda definition=definition: library.call(definition, recorded[definition.where][0].arguments))
            assert library.arena.error or library.arena.used == 0, definition.where


@pytest.mark.parametrize("error", [np.linalg.LinAlgError])
def test_an_error_in_python_is_an_error_in_c(translation, library, error):
    (definition,) = [one for one in translation.definitions if one.where.endswith("kalman.update")]
    with pytest.raises(error):
        library.call(definition, (np.zeros((2, 2)), np.ones((1, 2)), np.zeros((1, 1))))
