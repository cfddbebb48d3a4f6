"""The rate of an observer of a disturbance that jumps, chosen by running it."""

import numpy as np
import pytest

from ndob_fmu.log.fit.tried_rates import Followed, best_followed

SMOOTHED = np.cumsum(np.random.default_rng(1).standard_normal((300, 1)), axis=0)
LOWEST, HIGHEST = np.array([1.0]), np.array([27.0])


def errs_away_from(best, sure_from=0.0):
    """Return an observer that errs with the distance from a rate, and is far too sure of itself below another."""

    def follow(rates):
        error = np.abs(np.log(rates / best)) + 0.01
        return Followed(SMOOTHED + error, np.full_like(SMOOTHED, error[0] if rates[0] >= sure_from else 1e-6))

    return follow


@pytest.mark.parametrize(("best", "chosen"), [(1.2, 1.0), (4.0, 3.0), (8.0, 9.0), (25.0, 27.0)])
def test_the_rate_with_which_the_observer_is_nearest_to_the_smoothed_estimate_is_taken(best, chosen):
    assert best_followed(LOWEST, HIGHEST, errs_away_from(best), SMOOTHED) == pytest.approx(chosen)


def test_a_rate_whose_error_bars_do_not_hold_is_not_taken():
    assert best_followed(LOWEST, HIGHEST, errs_away_from(5.0, sure_from=10.0), SMOOTHED) == pytest.approx(27.0)
