"""The same plant in other units of its states, outputs and disturbances has the same design at the same cost."""

from __future__ import annotations

import numpy as np
import pytest

from ndob_fmu.runtime.design.augmented import augment, discretise
from ndob_fmu.runtime.design.stationary_design import stationary_design
from ndob_fmu.runtime.design.tuning import Knowledge, predicted_error, tuned_intensities
from ndob_fmu.runtime.linear_part import LinearPart
from ndob_fmu.runtime.numerics import transition as transition_module
from ndob_fmu.runtime.numerics.transition import NO_PARTS, transition
from ndob_fmu.runtime.numerics.units import natural_units

SIGMA = 1e-4


def plant(seed):
    """Return masses in a row with springs and dampers, one disturbance each on the first and the last: n = 6."""
    random = np.random.default_rng(seed)
    m, k, c = random.uniform(0.5, 2.0, 3), random.uniform(20.0, 200.0, 4), random.uniform(0.1, 1.0, 4)
    A = np.zeros((6, 6))
    for i in range(3):
        A[2 * i, 2 * i + 1] = 1.0
        for spring, other in ((i, i - 1), (i + 1, i + 1)):
            A[2 * i + 1, 2 * i] -= k[spring] / m[i]
            A[2 * i + 1, 2 * i + 1] -= c[spring] / m[i]
            if 0 <= other < 3:
                A[2 * i + 1, 2 * other] += k[spring] / m[i]
                A[2 * i + 1, 2 * other + 1] += c[spring] / m[i]
    G_d = np.zeros((6, 2))
    G_d[1, 0], G_d[5, 1] = 1.0 / m[0], 1.0 / m[2]
    G_f = np.zeros((6, 1))
    G_f[3] = 1.0 / m[1]
    C = np.eye(6)[[0, 2, 4]]
    return LinearPart(A=A, B=np.zeros((6, 0)), C=C, G_f=G_f, G_d=G_d, matched=False)


def knowledge(order, sigma=SIGMA, rate=6.0):
    """Return what is told of the plant's sensors and disturbances."""
    bound = np.array([2.0, 0.5])
    return Knowledge(sigma * np.array([1.0, 2.0, 0.5]) * np.eye(3), bound, bound * rate ** max(order, 1))


class Units:
    """What multiplies the numbers of states x, outputs y, disturbances d and f."""

    def __init__(self, seed, base, n=6, p=3, q=2):
        random = np.random.default_rng(seed)
        low, high = (-6, 9) if base == 10.0 else (-20, 30)
        sizes = [base ** random.integers(low, high, size=k).astype(float) for k in (n, p, q, 1)]
        self.x, self.y, self.d, self.f = sizes

    def xi(self, order):
        """Return the same for ξ."""
        return np.concatenate([self.x, *[self.d] * order])

    def changed(self, linear):
        """Return the plant in these units."""
        return LinearPart(
            A=linear.A * self.x[:, None] / self.x,
            B=linear.B,
            C=linear.C * self.y[:, None] / self.x,
            G_f=linear.G_f * self.x[:, None] / self.f,
            G_d=linear.G_d * self.x[:, None] / self.d,
            matched=linear.matched,
        )

    def known(self, known):
        """Return what is told of sensors and disturbances in these units."""
        return Knowledge(
            known.R_factor * self.y[:, None], known.disturbance_bound * self.d, known.disturbance_rate * self.d
        )


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("base", [2.0, 10.0])
def test_the_natural_units_of_a_plant_are_the_same_physical_sizes_in_whatever_units_it_is_written(seed, base):
    linear, units = plant(seed), Units(seed, base)
    one = augment(linear, 2, np.full(3, SIGMA))
    two = augment(units.changed(linear), 2, SIGMA * units.y)
    np.testing.assert_allclose(np.log2(two.units / units.xi(2) / one.units), 0.0, atol=0.0 if base == 2.0 else 1.0)


@pytest.mark.parametrize("seed", range(3))
def test_one_step_of_the_plant_has_the_same_bits_in_units_of_other_powers_of_two(seed):
    linear, units, H = plant(seed), Units(seed, 2.0), 5e-3
    T = units.xi(2)
    one = discretise(augment(linear, 2, np.full(3, SIGMA)), H, 1.0)
    two = discretise(augment(units.changed(linear), 2, SIGMA * units.y), H, 1.0)
    np.testing.assert_array_equal(two.Phi, one.Phi * T[:, None] / T)
    np.testing.assert_array_equal(two.noise_factor, one.noise_factor * T[:, None] / np.tile(units.d, 8))
    np.testing.assert_array_equal(two.drive, one.drive * T[:, None] / units.d)


@pytest.mark.parametrize("base", [2.0, 10.0])
def test_the_covariances_step_costs_no_more_doublings_in_other_units(base, monkeypatch):
    joined = []
    original = transition_module.triangular
    monkeypatch.setattr(transition_module, "triangular", lambda rows: joined.append(1) or original(rows))
    counts = []
    for seed in range(5):
        linear, units = plant(seed), Units(seed, base)
        for same, sigma in ((linear, np.full(3, SIGMA)), (units.changed(linear), SIGMA * units.y)):
            system = augment(same, 2, sigma)
            joined.clear()
            transition(system.A, system.noise, 5e-3, np.zeros((10, 0)), NO_PARTS, system.units)
            counts.append(len(joined))
    assert max(counts) <= 2


def test_a_column_that_nothing_links_to_the_others_gets_a_unit_too():
    units = natural_units(np.diag([0.0, -1e9]), np.array([[1e-6, 0.0]]))
    assert np.all(np.isfinite(units))
    assert np.all(units > 0.0)


def designed(linear, known, order, H):
    """Return the stationary design with the intensities that are tuned for it."""
    system = augment(linear, order, np.diag(known.R_factor))
    return stationary_design(system, H, known.R_factor, tuned_intensities(system, H, 0.1, known), 0.1)


@pytest.mark.parametrize("order", [0, 1, 2, 3])
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("base", [2.0, 10.0])
@pytest.mark.parametrize("sigma", [1e-4, 1e-9])
def test_gain_and_predicted_error_are_the_same_physical_numbers_in_whatever_units_the_plant_is_written(
    order, seed, base, sigma
):
    linear, units, H = plant(seed), Units(10 * seed + order, base), 5e-3
    known = knowledge(order, sigma)
    one, two = designed(linear, known, order, H), designed(units.changed(linear), units.known(known), order, H)
    gain = two.K * units.y / units.xi(order)[:, None]
    errors = [predicted_error(one, known.disturbance_rate)]
    errors.append([part / units.d for part in predicted_error(two, known.disturbance_rate * units.d)])
    if base == 2.0:
        np.testing.assert_array_equal(gain, one.K)
        np.testing.assert_array_equal(errors[1], errors[0])
    else:
        size = np.max(np.abs(one.K), axis=1, keepdims=True)
        np.testing.assert_allclose(gain / size, one.K / size, rtol=0, atol=1e-9)
        np.testing.assert_allclose(errors[1], errors[0], rtol=1e-9)
