"""The generator's signals are their formulas, in continuous time, and it names the times where they are not smooth."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ndob_fmu.runtime.blocks.disturbance import KINDS, Generator

A, F, T_S = 2.5, 1.3, 3.25
TIMES = np.concatenate([np.linspace(-2.0, 20.0, 1001), [T_S, T_S + 10.0]])


def chirp(t):
    """A·sin φ with φ' = 2π F τ/10 up to τ = 10 and 2π F after."""
    tau = t - T_S
    cycles = np.where(tau < 10.0, F * tau**2 / 20.0, F * 5.0 + F * (tau - 10.0))
    return A * np.sin(2.0 * np.pi * cycles)


FORMULAS = {
    "none": lambda t: 0.0 * t,
    "constant": lambda t: A + 0.0 * t,
    "ramp": lambda t: np.where(t < T_S, 0.0, A * (t - T_S)),
    "sine": lambda t: np.where(t < T_S, 0.0, A * np.sin(2.0 * np.pi * F * (t - T_S))),
    "step": lambda t: np.where(t < T_S, 0.0, A),
    "chirp": lambda t: np.where(t < T_S, 0.0, chirp(t)),
}


def generator(kind):
    return Generator(kind=KINDS[kind], amplitude=A, frequency=F, start_time=T_S)


def test_the_kinds_have_the_numbers_that_users_of_the_fmu_know():
    assert KINDS == {"none": 0, "constant": 1, "ramp": 2, "sine": 3, "step": 4, "chirp": 5}
    assert set(FORMULAS) == set(KINDS)


@pytest.mark.parametrize("kind", KINDS)
def test_each_kind_is_its_formula(kind):
    values = [generator(kind)(t) for t in TIMES]
    np.testing.assert_allclose(values, FORMULAS[kind](TIMES), rtol=0, atol=2e-13)


@pytest.mark.parametrize("kind", ["ramp", "sine", "chirp"])
def test_what_starts_from_zero_is_continuous(kind):
    d = generator(kind)
    assert [d(T_S - 1e-9), d(T_S)] == [0.0, 0.0]
    values = np.array([d(t) for t in np.linspace(0.0, 20.0, 200_001)])
    assert np.max(np.abs(np.diff(values))) < 1.01e-4 * A * 2.0 * np.pi * F


def test_the_step_is_at_its_new_value_from_its_start_time_on():
    d = generator("step")
    assert [d(np.nextafter(T_S, 0.0)), d(T_S)] == [0.0, A]


def test_a_constant_is_there_at_all_times_and_nothing_at_none():
    assert generator("constant")(-1e6) == generator("constant")(1e6) == A
    assert generator("none")(5.0) == 0.0
    assert Generator()(5.0) == 0.0


@settings(max_examples=200, deadline=None, derandomize=True)
@given(t=st.floats(-100.0, 100.0), kind=st.sampled_from(["constant", "sine", "step", "chirp"]))
def test_the_amplitude_bounds_every_kind_but_the_ramp(t, kind):
    assert abs(generator(kind)(t)) <= A


def test_the_frequency_of_the_chirp_rises_to_f_in_ten_seconds_and_stays():
    """Counted in zero crossings: F·5 cycles in the first ten seconds, F·10 in the next."""
    d = generator("chirp")
    for begin, cycles in ((0.0, 5.0 * F), (10.0, 10.0 * F)):
        signs = np.sign([d(T_S + begin + s) for s in np.linspace(1e-9, 10.0, 20_001)])
        assert np.count_nonzero(np.diff(signs)) == pytest.approx(2.0 * cycles, abs=1.0)


@pytest.mark.parametrize(
    ("kind", "breaks"),
    [
        ("none", ()),
        ("constant", ()),
        ("ramp", (T_S,)),
        ("sine", (T_S,)),
        ("step", (T_S,)),
        ("chirp", (T_S, T_S + 10.0)),
    ],
)
def test_an_integrator_is_told_where_a_signal_or_its_slope_jumps(kind, breaks):
    assert generator(kind).breaks == breaks


@pytest.mark.parametrize("kind", KINDS)
def test_away_from_its_breaks_a_signal_is_smooth(kind):
    """Fourth differences over 1 ms are (2πF)⁴·1e-12 of the amplitude where no break lies between."""
    d, h = generator(kind), 1e-3
    for t in np.linspace(-1.0, 19.0, 401):
        if all(abs(t - b) > 3.0 * h for b in d.breaks):
            fourth = sum(w * d(t + s * h) for s, w in ((-2, 1), (-1, -4), (0, 6), (1, -4), (2, 1)))
            assert abs(fourth) < 1.2 * A * (2.0 * np.pi * F * h) ** 4 + 1e-12
