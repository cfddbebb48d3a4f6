"""The functions φ₀ … φ₄ of a matrix, against closed forms and the exponential of SciPy."""

import math

import numpy as np
import pytest
from scipy.linalg import expm

from ndob_fmu.runtime.numerics.phi import HIGHEST, phi_functions

# Each of s doublings doubles the relative error of e^Z: 2^s is about the norm of Z.
ROUNDING = 1e-15


def of_scalar(z):
    """Return φ₀ … φ₄ of a number, by their series or, where that cancels, by the recursion from e^z."""
    if abs(z) < 1.0:
        return [sum(z**j / math.factorial(j + k) for j in range(30)) for k in range(HIGHEST + 1)]
    values = [math.exp(z)]
    for k in range(HIGHEST):
        values.append((values[-1] - 1.0 / math.factorial(k)) / z)
    return values


@pytest.mark.parametrize("z", [0.0, 1e-9, 0.3, -0.9, 3.0, -20.0, 50.0, -1e3, -1e5, -1e9])
def test_of_a_number(z):
    half, phi = phi_functions(np.array([[z]]))
    expected = of_scalar(z)
    within = ROUNDING * (10.0 + 10.0 * abs(z)) if z > 0.0 else 1e-13
    np.testing.assert_allclose(phi[1:, 0, 0], expected[1:], rtol=within)
    np.testing.assert_allclose(phi[0, 0, 0], expected[0], rtol=ROUNDING * (10.0 + 10.0 * abs(z)), atol=1e-300)
    np.testing.assert_allclose(half[0, 0], of_scalar(z / 2.0)[1], rtol=within)


@pytest.mark.parametrize("seed", range(5))
def test_of_a_matrix_they_are_blocks_of_an_exponential(seed):
    """e^{[Z I 0 …; 0 0 I …; …]} has φ₀(Z), φ₁(Z), … in its first row of blocks."""
    random = np.random.default_rng(seed)
    n = 3 + seed
    Z = random.normal(size=(n, n)) * 4.0
    blocks = np.eye((HIGHEST + 1) * n, k=n)
    blocks[:n, :n] = Z
    expected = expm(blocks)[:n]
    half, phi = phi_functions(Z)
    for k in range(HIGHEST + 1):
        block = expected[:, k * n : (k + 1) * n]
        np.testing.assert_allclose(phi[k], block, rtol=0, atol=1e-12 * np.max(np.abs(block)))
    np.testing.assert_allclose(
        half @ (Z / 2.0), expm(Z / 2.0) - np.eye(n), rtol=0, atol=1e-12 * np.max(np.abs(expm(Z)))
    )


def test_the_units_of_the_states_do_not_matter():
    """A stiff oscillator in m and m/s, whose matrix has entries from 1 to 1e12, and in units that make them alike."""
    w = 1e6
    h = 1e-3
    Z = h * np.array([[0.0, 1.0], [-(w**2), -0.6 * w]])
    T = np.diag([1.0, w])
    _, phi = phi_functions(Z)
    _, alike = phi_functions(np.linalg.inv(T) @ Z @ T)
    for k in range(1, HIGHEST + 1):
        np.testing.assert_allclose(
            np.linalg.inv(T) @ phi[k] @ T, alike[k], rtol=1e-10, atol=1e-10 * np.max(np.abs(alike[k]))
        )
    np.testing.assert_allclose(phi[4] @ Z + np.eye(2) / 6.0, phi[3], rtol=1e-10, atol=1e-13)


def test_of_a_nilpotent_matrix_the_series_ends():
    Z = np.diag([1e8, 1e8], k=1)
    half, phi = phi_functions(Z)
    np.testing.assert_allclose(phi[0], np.eye(3) + Z + Z @ Z / 2.0, rtol=1e-15)
    np.testing.assert_allclose(phi[4], np.eye(3) / 24.0 + Z / 120.0 + Z @ Z / 720.0, rtol=1e-15)
    np.testing.assert_allclose(half, np.eye(3) + Z / 4.0 + Z @ Z / 24.0, rtol=1e-15)
