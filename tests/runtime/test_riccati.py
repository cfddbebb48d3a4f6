"""The observer Riccati equation, eqs. (8) and (24): right at every π from 1e-2 to 1e16, or refused.

(A + αI) Q + Q (A + αI)ᵀ − Q Cᵀ C Q + π G Gᵀ = 0
"""

from dataclasses import replace

import mpmath
import numpy as np
import pytest
import scipy.linalg
from hypothesis import given, settings
from hypothesis import strategies as st

from ndob_fmu.codegen.compile_model import linear_part
from ndob_fmu.errors import DesignError
from ndob_fmu.runtime.numerics.riccati import RiccatiSolution, controllability_staircase, lyapunov, solve_riccati
from tests.helpers.problems import BAD, MODELS, RANDOM, Problem, minimum_phase_systems

JOINT = linear_part(MODELS["flexible_joint"])
EPS = np.finfo(float).eps
random_problem = pytest.mark.parametrize("problem", RANDOM, ids=lambda problem: problem.name)


def solve(linear, *, pi, alpha):
    return solve_riccati(linear.A, linear.C, linear.G, pi=pi, alpha=alpha)


def shifted(linear, alpha):
    return linear.A + alpha * np.eye(len(linear.A))


def relative_residual(linear, Q, pi, alpha):
    """Eq. (8)/(24) in the user's own coordinates, with L = Q Cᵀ of eq. (7), relative to its largest term."""
    A, L = shifted(linear, alpha), Q @ linear.C.T
    terms = [A @ Q, Q @ A.T, -L @ L.T, pi * linear.G @ linear.G.T]
    return np.linalg.norm(sum(terms)) / max(np.linalg.norm(term) for term in terms)


def exact_solution(linear, pi, alpha, digits=60):
    """Q = Y X⁻¹ with [X; Y] the stable eigenvectors of the Hamiltonian matrix, in `digits` decimal digits."""
    n = len(linear.A)
    with mpmath.workdps(digits):
        A, C, G = (mpmath.matrix(M.tolist()) for M in (linear.A, linear.C, linear.G))
        A += mpmath.mpf(alpha) * mpmath.eye(n)
        hamiltonian = mpmath.zeros(2 * n)
        hamiltonian[:n, :n], hamiltonian[:n, n:] = A.T, -(C.T * C)
        hamiltonian[n:, :n], hamiltonian[n:, n:] = -mpmath.mpf(pi) * (G * G.T), -A
        values, vectors = mpmath.eig(hamiltonian)
        stable = [k for k in range(2 * n) if mpmath.re(values[k]) < 0]
        assert len(stable) == n
        X, Y = (mpmath.matrix([[vectors[i + top, k] for k in stable] for i in range(n)]) for top in (0, n))
        Q = Y * mpmath.inverse(X)
        return np.array([[float(mpmath.re(Q[i, j])) for j in range(n)] for i in range(n)])


def relative_difference(M, reference):
    return np.linalg.norm(M - reference) / np.linalg.norm(reference)


# -- the equation holds


@settings(max_examples=200, deadline=None, derandomize=True)
@given(problem=minimum_phase_systems(), decade=st.floats(-2.0, 16.0), alpha=st.sampled_from([0.1, 1.0, 1.5]))
def test_eq_8_and_24_hold_to_1e_8_for_every_minimum_phase_system_and_pi_from_1e_2_to_1e16(problem, decade, alpha):
    linear, pi = problem.linear, 10.0**decade
    solution = solve(linear, pi=pi, alpha=alpha)
    assert relative_residual(linear, solution.Q, pi, alpha) <= 1e-8
    assert solution.residual <= 1e-8


@settings(max_examples=100, deadline=None, derandomize=True)
@given(problem=minimum_phase_systems(), decade=st.floats(-2.0, 16.0), alpha=st.sampled_from([0.1, 1.0, 1.5]))
def test_q_is_symmetric_positive_definite_and_every_pole_lies_left_of_minus_alpha(problem, decade, alpha):
    """Q > 0 and A + αI − L C is Hurwitz (the paper, below eq. 8): checked where Q is balanced, z = T⁻¹ x.

    Not on T⁻¹ Q T⁻ᵀ: at π = 1e16 the rounding of Q alone changes that by the size of its entries.
    """
    linear = problem.linear
    solution = solve(linear, pi=10.0**decade, alpha=alpha)
    Q, T = solution.Q, solution.coordinates
    np.testing.assert_allclose(Q, Q.T, rtol=1e-12, atol=1e-14 * np.linalg.norm(Q))
    np.testing.assert_allclose(T @ solution.balanced @ T.T, Q, rtol=1e-12, atol=1e-14 * np.linalg.norm(Q))
    assert np.linalg.eigvalsh(solution.balanced).min() > 0
    closed = np.linalg.solve(T, (shifted(linear, alpha) - Q @ linear.C.T @ linear.C) @ T)
    assert np.linalg.eigvals(closed).real.max() < 0


def test_the_scaled_states_are_an_orthogonal_matrix_times_powers_of_two_in_which_q_is_near_one():
    for problem in RANDOM:
        solution = solve(problem.linear, pi=1e12, alpha=0.4)
        scale = np.linalg.norm(solution.coordinates, axis=0)
        np.testing.assert_allclose(np.log2(scale), np.round(np.log2(scale)), atol=1e-9)
        basis = solution.coordinates / scale
        np.testing.assert_allclose(basis.T @ basis, np.eye(len(basis)), atol=1e-12)
        balanced = np.linalg.solve(solution.coordinates, np.linalg.solve(solution.coordinates, solution.Q).T)
        assert np.all((np.diag(balanced) > 0.4) & (np.diag(balanced) < 2.5))


# -- the same answer from independent solvers


@settings(max_examples=100, deadline=None, derandomize=True)
@given(problem=minimum_phase_systems(), decade=st.floats(-2.0, 6.0), alpha=st.sampled_from([0.1, 1.0, 1.5]))
def test_up_to_pi_1e6_scipys_solver_gives_the_same_q(problem, decade, alpha):
    linear, pi = problem.linear, 10.0**decade
    reference = scipy.linalg.solve_continuous_are(
        shifted(linear, alpha).T, linear.C.T, pi * linear.G @ linear.G.T, np.eye(len(linear.C))
    )
    assert relative_difference(solve(linear, pi=pi, alpha=alpha).Q, reference) < 1e-10


@pytest.mark.parametrize("pi", [1e12, 1e16])
def test_every_entry_for_the_flexible_joint_is_that_of_60_digit_arithmetic(pi):
    """Where SciPy's solver is 1e-7 off at π = 1e12 and 7e-6 at 1e16."""
    np.testing.assert_allclose(solve(JOINT, pi=pi, alpha=1.0).Q, exact_solution(JOINT, pi, 1.0), rtol=1e-13)


@random_problem
def test_l_at_pi_1e16_is_that_of_60_digit_arithmetic_in_dense_coordinates(problem):
    """The hardest have channels of relative degrees 1 and 3, whose Q differ by π^{1/3} in the same direction of G."""
    linear = problem.linear
    L = solve(linear, pi=1e16, alpha=0.4).Q @ linear.C.T
    assert relative_difference(L, exact_solution(linear, 1e16, 0.4) @ linear.C.T) < 1e-9


@settings(max_examples=60, deadline=None, derandomize=True)
@given(problem=minimum_phase_systems(), decade=st.floats(0.0, 12.0))
def test_lyapunovs_equation_is_solved_as_scipy_solves_it_in_balanced_states(problem, decade):
    linear = problem.linear
    solution = solve(linear, pi=10.0**decade, alpha=1.0)
    T = solution.coordinates
    closed = np.linalg.solve(T, (shifted(linear, 1.0) - solution.Q @ linear.C.T @ linear.C) @ T)
    V = np.diag(np.arange(1.0, len(T) + 1.0))
    X = lyapunov(closed, V)
    assert relative_difference(X, scipy.linalg.solve_continuous_lyapunov(closed, -V)) < 1e-8


@pytest.mark.parametrize("modes", [[-3.0], [-3.0, -2.0], [-3.0, -0.1]])
@pytest.mark.parametrize("pi", [1.0, 1e12])
def test_modes_that_no_unknown_input_reaches_take_part_only_where_they_lie_right_of_minus_alpha(modes, pi):
    """Without controllability Q is only semidefinite: a mode left of −α needs no gain, and its rows of Q are zero."""
    linear, k = RANDOM[6].linear, len(modes)
    n = len(linear.A)
    A = scipy.linalg.block_diag(linear.A, np.diag(modes))
    C = np.hstack([linear.C, np.arange(1.0, 3.0 * k + 1).reshape(3, k)])
    G = np.vstack([linear.G, np.zeros((k, linear.G.shape[1]))])
    solution = solve_riccati(A, C, G, pi=pi, alpha=0.4)
    assert relative_residual(replace(linear, A=A, C=C, G_f=G[:, :1], G_d=G[:, 1:]), solution.Q, pi, 0.4) < 1e-10
    closed = A + 0.4 * np.eye(n + k) - solution.Q @ C.T @ C
    assert np.linalg.eigvals(closed).real.max() < 0
    slow = np.array(modes) > -0.4
    unneeded = solution.Q[n:][~slow]
    assert np.max(np.abs(unneeded)) < 1e-9 * np.linalg.norm(solution.Q)
    assert np.all(np.diag(solution.Q)[n:][slow] > 0.01)


# -- the staircase behind it


@random_problem
def test_the_staircase_is_an_orthogonal_change_of_states_with_exact_zeros(problem):
    A, G = problem.linear.A, problem.linear.G
    T, A_t, G_t, edges = controllability_staircase(A, G)
    np.testing.assert_allclose(T.T @ T, np.eye(len(A)), atol=1e-13)
    np.testing.assert_allclose(T @ A_t @ T.T, A, atol=1e-12 * np.linalg.norm(A))
    np.testing.assert_allclose(T @ G_t, G, atol=1e-12 * np.linalg.norm(G))
    assert (edges[0], edges[1], edges[-1]) == (0, G.shape[1], len(A))
    assert not np.any(G_t[edges[1] :])
    for start, stop, after in zip(edges, edges[1:], edges[2:], strict=False):
        assert not np.any(A_t[after:, start:stop])


# -- refused rather than wrong


@pytest.mark.parametrize("problem", [RANDOM[1], RANDOM[3], RANDOM[6]], ids=lambda problem: problem.name)
def test_a_pi_beyond_the_digits_of_dense_coordinates_is_refused(problem):
    with pytest.raises(DesignError, match="too large a pi") as refused:
        solve(problem.linear, pi=1e36, alpha=0.4)
    assert refused.value.exit_code == 1


@pytest.mark.parametrize(("problem", "pi"), [(RANDOM[1], 1e28), (RANDOM[3], 1e20), (RANDOM[6], 1e28)])
def test_an_extreme_pi_that_is_not_refused_has_a_right_gain(problem, pi):
    """The residual that is reported bounds the error of L, eq. (7), which may be smaller by chance."""
    linear = problem.linear
    solution = solve(linear, pi=pi, alpha=0.4)
    error = relative_difference(solution.Q @ linear.C.T, exact_solution(linear, pi, 0.4, digits=100) @ linear.C.T)
    assert solution.residual > 1e-11
    assert error < 5.0 * solution.residual


@pytest.mark.parametrize("pi", [1e-2, 1.0, 1e6, 1e16])
def test_a_mode_that_no_output_sees_is_refused_at_every_pi(pi):
    """The mode −7.5 is stable, yet not left of −α = −8: no gain can move it."""
    unseen = next(bad.linear for bad in BAD if bad.name == "an unobservable mode")
    with pytest.raises(DesignError, match="almost unobservable") as refused:
        solve(unseen, pi=pi, alpha=8.0)
    assert refused.value.exit_code == 1


@pytest.mark.parametrize("residual", [1.001e-8, 1.0, np.inf, np.nan])
def test_a_solution_with_a_residual_above_1e_8_or_none_cannot_be_constructed(residual):
    with pytest.raises(DesignError, match="expected a relative residual of at most 1e-08") as refused:
        RiccatiSolution(pi=1e12, alpha=1.0, Q=np.eye(3), coordinates=np.eye(3), balanced=np.eye(3), residual=residual)
    assert refused.value.exit_code == 1
    assert "\n" not in str(refused.value)


def test_a_solution_with_a_residual_of_1e_8_can_be_constructed():
    assert (
        RiccatiSolution(
            pi=1.0, alpha=1.0, Q=np.eye(3), coordinates=np.eye(3), balanced=np.eye(3), residual=1e-8
        ).residual
        == 1e-8
    )


def test_the_residual_that_is_reported_is_the_users_or_larger():
    for problem in (*RANDOM, Problem("joint", JOINT, (), (2, 2))):
        solution = solve(problem.linear, pi=1e14, alpha=0.4)
        assert relative_residual(problem.linear, solution.Q, 1e14, 0.4) <= 3.0 * solution.residual + 10 * EPS
