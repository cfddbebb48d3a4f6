"""Exact integration of the linear part: e^X, the φ-functions, and the exponential Runge–Kutta method of order 4."""

from math import factorial

import numpy as np
import pytest
import scipy.linalg
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from ndob_fmu.runtime.design.gains import paper_gains
from ndob_fmu.runtime.numerics.exponential import exponential, exponential_step
from tests.helpers.problems import RANDOM


def random_matrix(seed, n, size):
    X = np.random.default_rng(seed).normal(size=(n, n))
    return X * size / np.linalg.norm(X, 1)


def take(step, x, N):
    """One step of Cox and Matthews (2002) for x' = A x + N(s, x), s = 0, ½, 1 in units of the step."""
    N_0 = N(0.0, x)
    a = step.half @ x + step.half_weight @ N_0
    N_a = N(0.5, a)
    b = step.half @ x + step.half_weight @ N_a
    N_b = N(0.5, b)
    c = step.half @ a + step.half_weight @ (2.0 * N_b - N_0)
    return step.full @ x + step.start_weight @ N_0 + step.middle_weight @ (N_a + N_b) + step.end_weight @ N(1.0, c)


# -- the matrix exponential


@settings(max_examples=200, deadline=None, derandomize=True)
@given(seed=st.integers(0, 2**32 - 1), n=st.integers(1, 9), size=st.floats(1e-12, 30.0))
def test_the_exponential_is_scipys(seed, n, size):
    X = random_matrix(seed, n, size)
    expected = scipy.linalg.expm(X)
    assert np.linalg.norm(exponential(X) - expected) <= 1e-12 * np.linalg.norm(expected)


def test_the_exponential_of_zero_is_the_identity_to_the_last_bit():
    np.testing.assert_array_equal(exponential(np.zeros((5, 5))), np.eye(5))


@pytest.mark.parametrize("fast", [1e2, 1e4, 1e8, 1e12])
def test_a_stiff_matrix_has_an_exponential_as_exact_as_its_slow_mode_allows(fast):
    """Modes −fast, −1 and ±2i behind a rotation: the fast one is gone, the others are not touched by it."""
    modes = scipy.linalg.block_diag([[-fast]], [[-1.0]], [[0.0, 2.0], [-2.0, 0.0]])
    T = np.linalg.qr(np.random.default_rng(3).normal(size=(4, 4)))[0]
    exact = T @ scipy.linalg.block_diag(0.0 if fast > 800 else np.exp(-fast), np.exp(-1.0), rotation(2.0)) @ T.T
    assert np.linalg.norm(exponential(T @ modes @ T.T) - exact) < 10.0 * fast * np.finfo(float).eps


def rotation(angle):
    return np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])


def test_the_exponential_of_a_nilpotent_matrix_is_its_finite_series():
    N = np.diag([1e3, 2.0, -5.0], 1)
    series = sum(np.linalg.matrix_power(N, k) / factorial(k) for k in range(4))
    np.testing.assert_allclose(exponential(N), series, rtol=1e-13, atol=1e-13 * np.linalg.norm(series))


# -- the step


@settings(max_examples=60, deadline=None, derandomize=True)
@given(seed=st.integers(0, 2**32 - 1), n=st.integers(2, 6), size=st.floats(1e-3, 30.0), h=st.floats(1e-3, 2.0))
def test_a_step_is_exact_where_n_is_a_quadratic_polynomial_in_time(seed, n, size, h):
    """x' = A x + N₀ + N₁ t + N₂ t²/2 as the linear system of [x; N₂; N₁ + N₂ t; N] (any A, singular too)."""
    A = random_matrix(seed, n, size / h)
    N_0, N_1, N_2, x = np.random.default_rng(seed + 1).normal(size=(4, n))
    identity, zero = np.eye(n), np.zeros((n, n))
    whole = np.block(
        [
            [A, identity, zero, zero],
            [zero, zero, identity, zero],
            [zero, zero, zero, identity],
            [zero, zero, zero, zero],
        ]
    )
    exact = (scipy.linalg.expm(whole * h) @ np.concatenate([x, N_0, N_1, N_2]))[:n]
    result = take(exponential_step(A, h, np.eye(n)), x, lambda s, _: N_0 + N_1 * s * h + N_2 * (s * h) ** 2 / 2.0)
    largest = np.linalg.norm(scipy.linalg.expm(A * h), 2) * (np.linalg.norm(x) + h * np.linalg.norm([N_0, N_1, N_2]))
    assert np.linalg.norm(result - exact) <= 1e-11 * max(1.0, largest)


def test_with_a_of_zero_a_step_is_the_classical_runge_kutta_methods():
    h, x = 0.3, np.array([0.4, -1.2])

    def slope(t, x):
        return np.array([np.sin(x[1]) + t, x[0] * x[1]])

    k_1 = slope(0.0, x)
    k_2 = slope(h / 2, x + h / 2 * k_1)
    k_3 = slope(h / 2, x + h / 2 * k_2)
    k_4 = slope(h, x + h * k_3)
    result = take(exponential_step(np.zeros((2, 2)), h, np.eye(2)), x, lambda s, z: slope(s * h, z))
    np.testing.assert_allclose(result, x + h / 6 * (k_1 + 2 * k_2 + 2 * k_3 + k_4), rtol=1e-14)


def test_on_a_nonlinear_problem_the_error_falls_like_the_fourth_power_of_the_step():
    A = np.array([[-2.0, 1.0, 0.0], [0.0, -1.0, 3.0], [0.5, -3.0, -1.0]])
    x_0, t_end = np.array([1.0, -0.5, 0.2]), 2.0

    def N(t, x):
        return np.array([np.sin(3.0 * t), -x[0] * x[1], np.cos(x[0])])

    exact = solve_ivp(lambda t, x: A @ x + N(t, x), (0.0, t_end), x_0, method="DOP853", rtol=1e-13, atol=1e-14).y[:, -1]
    counts = np.array([20, 40, 80, 160, 320])
    errors = []
    for count in counts:
        h, x = t_end / count, x_0
        step = exponential_step(A, h, np.eye(3))
        for k in range(count):
            x = take(step, x, lambda s, z, t=k * h, h=h: N(t + s * h, z))
        errors.append(np.linalg.norm(x - exact))
    assert np.polyfit(np.log(1.0 / counts), np.log(errors), 1)[0] == pytest.approx(4.0, abs=0.1)


def test_stiffness_costs_no_accuracy():
    """A − L C at π = 1e12 has poles of 1e3 and more; the step is a hundred times longer than their time constants."""
    linear = RANDOM[1].linear
    gains = paper_gains(linear, pi=1e12, alpha=0.4)
    A, T, h = linear.A - gains.L @ linear.C, gains.riccati.coordinates, 0.1
    assert h * np.max(np.abs(np.linalg.eigvals(A))) > 80
    forcing = gains.L[:, 0]
    step = exponential_step(A, h, T)
    x = take(step, np.zeros(len(A)), lambda s, _: forcing)
    # In x itself A is as ill-conditioned as π is large: the reference is computed in the balanced states z of x = T z.
    T_inverse = np.linalg.inv(T)
    A_z, forcing_z = T_inverse @ A @ T, T_inverse @ forcing
    at_rest = -np.linalg.solve(A_z, forcing_z)
    exact = at_rest - scipy.linalg.expm(A_z * h) @ at_rest
    # The step is taken in x, where each of its terms is rounded.
    terms = (np.abs(step.start_weight) + 2.0 * np.abs(step.middle_weight) + np.abs(step.end_weight)) @ np.abs(forcing)
    rounding = np.finfo(float).eps * np.max(np.abs(T_inverse) @ terms)
    assert rounding < 1e-8 * np.max(np.abs(exact))
    np.testing.assert_allclose(T_inverse @ x, exact, rtol=0, atol=4.0 * rounding)


WEIGHTS = ("half", "full", "half_weight", "start_weight", "middle_weight", "end_weight")


def test_the_coordinates_change_nothing_but_the_rounding():
    A = random_matrix(5, 4, 8.0)
    T = np.diag([1.0, 8.0, 0.25, 2.0]) @ random_matrix(6, 4, 3.0)
    plain, other = exponential_step(A, 0.3, np.eye(4)), exponential_step(A, 0.3, T)
    for name in WEIGHTS:
        np.testing.assert_allclose(getattr(other, name), getattr(plain, name), rtol=0, atol=1e-11)


def test_coordinates_that_undo_a_bad_scaling_by_powers_of_two_give_the_same_bits():
    A, S = random_matrix(5, 4, 8.0), np.diag(np.exp2([0.0, 20.0, -35.0, 3.0]))
    plain, scaled = exponential_step(A, 0.3, np.eye(4)), exponential_step(S @ A @ np.linalg.inv(S), 0.3, S)
    for name in WEIGHTS:
        np.testing.assert_array_equal(getattr(scaled, name), S @ getattr(plain, name) @ np.linalg.inv(S))
