"""π raised over time, π(t) = π₀ (π_end/π₀)^{t/T}, and the table of gains along the way (eqs. 8 and 24)."""

import functools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ndob_fmu.codegen.compile_model import linear_part
from ndob_fmu.errors import DesignError
from ndob_fmu.runtime.design.schedule import PiSchedule, gain_table
from ndob_fmu.runtime.numerics.riccati import solve_riccati
from tests.helpers.problems import MODELS, RANDOM

LINEAR_PARTS = {problem.name: problem.linear for problem in RANDOM}
LINEAR_PARTS |= {name: linear_part(model) for name, model in MODELS.items()}
ALPHA = 0.4
every_plant = pytest.mark.parametrize("name", LINEAR_PARTS)


@functools.cache
def long_table(name):
    return gain_table(LINEAR_PARTS[name], PiSchedule(1e-2, 1e16, 10.0), alpha=ALPHA)


def exact_gain(linear, log_pi):
    return solve_riccati(linear.A, linear.C, linear.G, pi=np.exp(log_pi), alpha=ALPHA).Q @ linear.C.T


def by_column(difference, L):
    """The largest entry of each column's difference, relative to the largest of that column of L."""
    return np.max(np.abs(difference) / np.max(np.abs(L), axis=0))


# -- π(t)


def test_pi_rises_geometrically_from_its_start_to_its_end_and_stays_there():
    """The example: 1 → 1e12 in 10 s, so 1e6 at half the time and a decade every 10/12 s."""
    schedule = PiSchedule(1.0, 1e12, 10.0)
    for t, pi in ((0.0, 1.0), (10.0 / 12.0, 10.0), (5.0, 1e6), (10.0, 1e12), (10.001, 1e12), (1e9, 1e12)):
        assert np.exp(schedule.log_pi(t)) == pytest.approx(pi, rel=1e-12)


@settings(max_examples=200, deadline=None, derandomize=True)
@given(start=st.floats(1e-3, 1e16), end=st.floats(1e-3, 1e16), ramp_time=st.floats(1e-3, 1e3), part=st.floats(0.0, 2.0))
def test_pi_follows_the_papers_formula_up_and_down(start, end, ramp_time, part):
    t = part * ramp_time
    formula = start * (end / start) ** (t / ramp_time) if t < ramp_time else end
    assert np.exp(PiSchedule(start, end, ramp_time).log_pi(t)) == pytest.approx(formula, rel=1e-11)


def test_without_a_ramp_pi_is_at_its_end_from_the_start():
    assert PiSchedule(1.0, 1e12, 0.0).log_pi(0.0) == np.log(1e12)


@pytest.mark.parametrize("field", ["pi_start", "pi_end"])
@pytest.mark.parametrize("value", [0.0, -1.0, np.nan, np.inf])
def test_a_pi_that_is_not_a_finite_number_above_zero_is_refused_by_name(field, value):
    values = {"pi_start": 1.0, "pi_end": 1e12, "ramp_time": 10.0} | {field: value}
    with pytest.raises(DesignError, match=f"{field}: expected a finite number > 0, received {value!r}"):
        PiSchedule(**values)


@pytest.mark.parametrize("value", [-1e-3, np.nan, np.inf])
def test_a_ramp_time_that_is_not_a_finite_time_is_refused(value):
    with pytest.raises(DesignError, match="pi_ramp_time: expected a finite time ≥ 0 s"):
        PiSchedule(1.0, 1e12, value)


# -- L(π)


@every_plant
def test_at_its_knots_the_table_is_the_riccati_solution(name):
    linear, table = LINEAR_PARTS[name], long_table(name)
    assert np.exp(table.log_pi[[0, -1]]) == pytest.approx([1e-2, 1e16], rel=1e-12)
    for k in range(0, len(table.log_pi), 16):
        np.testing.assert_array_equal(table.gain(table.log_pi[k]), table.L[k])
        assert by_column(table.L[k] - exact_gain(linear, table.log_pi[k]), table.L[k]) < 1e-9


@every_plant
def test_between_its_knots_the_table_is_within_1e_5_of_the_riccati_solution(name):
    linear, table = LINEAR_PARTS[name], long_table(name)
    for log_pi in np.random.default_rng(0).uniform(table.log_pi[0], table.log_pi[-1], 12):
        exact = exact_gain(linear, log_pi)
        assert by_column(table.gain(log_pi) - exact, exact) < 1e-5


@every_plant
def test_the_slope_of_the_table_is_that_of_the_riccati_solution(name):
    """dL/d ln π from A_c Q' + Q' A_cᵀ + π G Gᵀ = 0, against differences of order 4."""
    linear, table = LINEAR_PARTS[name], long_table(name)
    h = 1e-2
    for k in (1, 32, 63, 94):
        far_below, below, above, far_above = (exact_gain(linear, table.log_pi[k] + s * h) for s in (-2, -1, 1, 2))
        differences = (far_below - 8.0 * below + 8.0 * above - far_above) / (12.0 * h)
        assert by_column(table.dL[k] - differences, table.L[k]) < 1e-7


def test_the_table_is_smooth_across_its_knots():
    table = gain_table(RANDOM[6].linear, PiSchedule(1.0, 1e8, 1.0), alpha=ALPHA)
    for k in (1, 20, 40):
        step = 1e-6
        left, middle, right = (table.gain(table.log_pi[k] + s * step) for s in (-1.0, 0.0, 1.0))
        assert by_column((right - middle) / step - (middle - left) / step, middle) < 1e-4


def test_beyond_its_ends_the_table_gives_the_ends_gain():
    table = gain_table(RANDOM[6].linear, PiSchedule(1e8, 1e2, 1.0), alpha=ALPHA)
    np.testing.assert_array_equal(table.gain(np.log(1e2) - 3.0), table.L[0])
    np.testing.assert_array_equal(table.gain(np.log(1e8) + 3.0), table.L[-1])
    assert np.all(np.diff(table.log_pi) > 0)


@pytest.mark.parametrize("schedule", [PiSchedule(1.0, 1e6, 0.0), PiSchedule(1e6, 1e6, 3.0)])
def test_where_pi_does_not_move_the_table_is_one_gain(schedule):
    linear = RANDOM[6].linear
    table = gain_table(linear, schedule, alpha=ALPHA)
    assert len(table.log_pi) == 1
    for log_pi in (0.0, np.log(1e6), 99.0):
        np.testing.assert_array_equal(table.gain(log_pi), table.L[0])
    assert by_column(table.L[0] - exact_gain(linear, np.log(1e6)), table.L[0]) < 1e-10


def test_a_schedule_that_leads_beyond_trust_is_refused():
    with pytest.raises(DesignError, match="too large a pi"):
        gain_table(RANDOM[3].linear, PiSchedule(1.0, 1e36, 10.0), alpha=ALPHA)
