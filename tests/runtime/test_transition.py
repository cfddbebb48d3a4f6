"""One step of ξ' = F ξ + g w: against integrals in high precision, in small entries and for stiff F."""

from __future__ import annotations

from math import factorial

import mpmath
import numpy as np
import pytest

from ndob_fmu.runtime.numerics.transition import NO_PARTS, parts_of, transition


def exact(F, g, H):
    """Return Φ and the noise's covariance for different eigenvalues of F, by their exponentials in 60 digits."""
    with mpmath.workdps(60):
        values, V = mpmath.eig(mpmath.matrix(F.tolist()))
        N, V_inverse = len(F), mpmath.inverse(V)
        Phi = V * mpmath.diag([mpmath.exp(value * H) for value in values]) * V_inverse
        channel = V_inverse * mpmath.matrix(g.tolist())
        within = channel * channel.T
        for i in range(N):
            for j in range(N):
                both = values[i] + values[j]
                within[i, j] *= H if abs(both) < 1e-40 else mpmath.expm1(both * H) / both
        covariance = V * within * V.T
        return tuple(np.array([[float(z.real) for z in row] for row in M.tolist()]) for M in (Phi, covariance))


def sampled(F, g, H):
    done = transition(F, g, H, np.zeros((len(F), 0)), NO_PARTS)
    return done.Phi, done.noise


def chain(n):
    """Return n integrators in a row behind white noise."""
    return np.diag(np.ones(n - 1), 1), np.eye(n)[:, [n - 1]]


@pytest.mark.parametrize("H", [1e-6, 1e-3, 0.1])
@pytest.mark.parametrize("n", [2, 4, 7])
def test_a_row_of_integrators_keeps_the_digits_of_its_smallest_entries(n, H):
    """The covariance's entries are H^{i+j+1}/(i! j! (i+j+1)), over a hundred orders of magnitude at 1 µs."""
    Phi, noise = sampled(*chain(n), H)
    covariance = noise @ noise.T
    for i in range(n):
        for j in range(n):
            expected = H ** (i + j + 1) / (factorial(i) * factorial(j) * (i + j + 1))
            assert covariance[n - 1 - i, n - 1 - j] == pytest.approx(expected, rel=1e-10)
    assert Phi[0, -1] == pytest.approx(H ** (n - 1) / factorial(n - 1), rel=1e-12)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("H", [1e-3, 0.05, 0.6])
def test_it_is_the_integral_for_any_dynamics(seed, H):
    random = np.random.default_rng(seed)
    F, g = random.normal(size=(5, 5)), random.normal(size=(5, 2))
    Phi, noise = sampled(F, g, H)
    exact_Phi, covariance = exact(F, g, H)
    scale = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(Phi, exact_Phi, rtol=0, atol=1e-12 * np.max(np.abs(exact_Phi)))
    np.testing.assert_allclose(
        (noise @ noise.T) / np.outer(scale, scale), covariance / np.outer(scale, scale), rtol=0, atol=1e-11
    )


@pytest.mark.parametrize("fast", [1e2, 1e4, 1e6])
def test_a_stiff_plant_keeps_the_digits_of_its_slow_and_of_its_fast_state(fast):
    """A first-order actuator with a time constant down to a microsecond, before a mass, at 10 ms."""
    F = np.array([[0.0, 1.0, 0.0], [0.0, -0.5, 1.0], [0.0, 0.0, -fast]])
    g = np.array([[0.0], [0.0], [fast]])
    Phi, noise = sampled(F, g, 0.01)
    exact_Phi, covariance = exact(F, g, 0.01)
    scale = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(Phi[:2, :2], exact_Phi[:2, :2], rtol=1e-9)
    np.testing.assert_allclose(
        (noise @ noise.T) / np.outer(scale, scale), covariance / np.outer(scale, scale), rtol=0, atol=1e-8
    )


@pytest.mark.parametrize("H", [1e-3, 0.6])
def test_the_responses_within_a_step_are_those_of_steps_that_are_so_long(H):
    """Both for a step that one series spans and for one that is halved first."""
    random = np.random.default_rng(7)
    F, held, parts = random.normal(size=(5, 5)), random.normal(size=(5, 2)), (1.0, 0.887, 0.113)
    responses = transition(F, np.zeros((5, 1)), H, held, parts_of(parts)).responses
    assert responses.shape == (3, 5, 2)
    for part, response in zip(parts, responses, strict=True):
        expected = exact(F, np.zeros((5, 1)), part * H)[0] @ held
        np.testing.assert_allclose(response, expected, rtol=0, atol=1e-13 * np.max(np.abs(expected)))
