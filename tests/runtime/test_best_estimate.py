"""On linear plants the filter of method 2 finds the best estimate there is from all samples so far."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg
import sympy

from ndob_fmu.codegen.compile_model import compile_model
from ndob_fmu.model.model import Model
from tests.helpers.batch_estimate import Batch, sampled_by_van_loan
from tests.helpers.observers import sampled_observer

H, COUNT, SIGMA, BOUND = 0.05, 40, (1e-2, 2e-2), 2.0
WITHIN = 1e-9
PULL = sympy.Symbol("pull")
n, m, p, q, ORDER = 4, 3, 2, 1, 2
A = np.array([[0, 1, 0, 0], [-4.0, -0.6, 2.0, 0], [0, 0.5, -1.5, 1.0], [0.3, 0, -1.0, -2.0]])
G, C = np.array([0, 1.0, 0, 0]), np.array([[0, 1.0, 0, 0], [1.0, 0, 0.4, 0]])
PULLED = np.array([0, 0, 1.0, 0])  # what one newton of `pull` does to the rates
LINEAR = Model(
    name="Linear",
    states=["a", "v", "b", "c"],
    inputs=["on", "u2", "u3"],
    outputs=["v", "sum"],
    disturbances=["load"],
    parameters={"pull": 0.5},
    A=A.tolist(),
    B=[[0, 0, 0], [0, 0, 0], [PULL, 0, 0], [0, 0, 0]],
    C=C.tolist(),
    G_d=[[0], [1], [0], [0]],
)
U = (1.0, 0.0, 0.0)


class Case:
    """An observer of the linear plant, the batch that it is compared with, and samples."""

    def __init__(self, *, seed=0, tuned_at=H, pull_std=0.0, bias_std=(0.0, 0.0), state_noise=(0.0,) * n, **settings):
        self.observer = sampled_observer(
            compile_model(LINEAR),
            LINEAR.parameter_values(),
            x_hat=(0.0,) * n,
            order=ORDER,
            noise_std=SIGMA,
            disturbance_bound=(BOUND,),
            disturbance_rate=(40.0,),
            x_std=(0.1, 0.2, 0.3, 0.4),
            parameter_std=(pull_std,),
            bias_std=bias_std,
            state_noise=state_noise,
            adapt_noise=False,
            **settings,
        )
        self.tuned = self.observer.tuned(tuned_at)
        biased = [i for i in range(p) if bias_std[i]]
        N = n + ORDER + len(biased) + bool(pull_std)
        self.F, self.C, mean = np.zeros((N, N)), np.zeros((p, N)), np.zeros(N)
        self.F[:n, :n], self.F[:n, n], self.F[n, n + 1], self.C[:, :n] = A, G, 1.0, C
        for place, i in enumerate(biased):
            self.C[i, n + ORDER + place] = 1.0
        if pull_std:
            self.F[:n, -1], mean[-1] = PULLED, 0.5
        self.known_pull = 0.0 if pull_std else 0.5
        self.variance = self.tuned.model.noise_variance
        self.state_noise = np.diag([*state_noise, *[0.0] * (N - n)])
        self.batch = Batch(mean, self.tuned.model.start_std)
        # Errors of less than a standard deviation leave no sample suspicious.
        random = np.random.default_rng(seed)
        self.noise = random.uniform(-1.0, 1.0, (COUNT, p)) * SIGMA

    def sample(self, t, k):
        """Return a sample: what a plant with the known pull and a slow disturbance might measure, and noise."""
        moved = np.array([0.02 * np.sin(2.0 * t), 0.04 * np.cos(2.0 * t)])
        return moved * 0.3 + self.noise[k]

    def go(self, h):
        """Take the batch over a step."""
        G_noise = np.column_stack([self.state_noise, np.zeros((len(self.F), 1))])
        G_noise[n + ORDER - 1, -1] = np.sqrt(self.tuned.intensity(h, (1.0,) * p)[0])
        Phi, Q = sampled_by_van_loan(self.F, G_noise, h)
        self.batch.step(Phi, Q)
        if self.known_pull:
            extended = np.zeros((len(self.F) + 1,) * 2)
            extended[:-1, :-1], extended[:n, -1] = self.F, PULLED * self.known_pull
            mean, sources = self.batch.newest
            self.batch.nodes[-1] = (
                mean + sampled_by_van_loan(extended, np.zeros((len(extended), 1)), h)[0][:-1, -1],
                sources,
            )


def assert_best(estimate, batch):
    mean, _ = batch.estimate()
    np.testing.assert_allclose(estimate.x_at_sample, mean[:n], rtol=0, atol=WITHIN * BOUND)
    np.testing.assert_allclose(estimate.d_at_sample, mean[n : n + q], rtol=0, atol=WITHIN * BOUND)


def keep_within_bound(batch):
    """Count |d| ≤ D₀ as a sample of d where d is known no better than by that, so that the error bar becomes D₀."""
    variance = batch.estimate()[1][n, n]
    if variance > BOUND**2:
        row = np.eye(len(batch.newest[0]))[n]
        batch.measure(len(batch.nodes) - 1, row, 0.0, variance * BOUND**2 / (variance - BOUND**2))


def run(case, *, steps=None, hide=lambda k, y: y, delays=(0, 0), check=None):
    """Run observer and batch side by side over samples of which `hide` may take entries away; check every estimate.

    delays: of the outputs, in half steps
    """
    state, t = case.observer.init((0.0,) * n), 0.0
    half = any(delay % 2 for delay in delays)
    for k, h in enumerate([H] * COUNT if steps is None else steps):
        y = np.array(hide(k, case.sample(t, k)))
        node = len(case.batch.nodes) - 1
        for i in np.flatnonzero(np.isfinite(y)):
            at = node - (delays[i] if half else delays[i] // 2)
            if at >= 0:
                case.batch.measure(at, case.C[i], y[i], case.variance[i])
        keep_within_bound(case.batch)
        state, estimate = case.observer.step(state, U, y, h)
        check(k, estimate, case.batch)
        for _ in range(2 if half else 1):
            case.go(0.5 * h if half else h)
        t += h
        mean, covariance = case.batch.estimate()
        if not half:
            np.testing.assert_allclose(estimate.d_hat, mean[n : n + q], rtol=0, atol=WITHIN * BOUND)
            std = np.sqrt(covariance[n, n])
            assert estimate.d_std[0] == pytest.approx(min(std, BOUND), rel=1e-7)
    return state


def always_best(k, estimate, batch):
    assert_best(estimate, batch)


def test_with_steps_of_any_length_every_estimate_is_the_best_of_the_samples_so_far():
    steps = H * np.random.default_rng(1).uniform(0.7, 1.3, COUNT)
    run(Case(tuned_at=steps[0]), steps=steps, check=always_best)


def test_an_entry_that_is_missing_takes_nothing_from_the_others():
    """A second sensor at a fifth of the rate, with gaps of both; the time-varying filter is the best there is."""

    def hide(k, y):
        return (np.nan if k in (10, 11, 25) else y[0], y[1] if k % 5 == 0 and k != 25 else np.nan)

    steps = H * np.random.default_rng(2).uniform(0.99, 1.01, COUNT)
    run(Case(tuned_at=steps[0]), hide=hide, check=always_best, steps=steps)


@pytest.mark.parametrize("lag", [1, 5, 12])
def test_the_lagged_estimate_is_that_of_all_samples_until_now(lag):
    case = Case(lag=lag * H)
    at_lag = []

    def check(k, estimate, batch):
        assert_best(estimate, batch)
        if k >= lag:
            mean, covariance = batch.estimate(k - lag)
            assert estimate.d_lagged[0] == pytest.approx(mean[n], rel=0, abs=WITHIN * BOUND)
            assert estimate.d_lagged_std[0] == pytest.approx(np.sqrt(covariance[n, n]), rel=1e-7)
            at_lag.append(estimate.d_lagged_std[0] / min(estimate.d_std[0], BOUND))

    run(case, check=check)
    assert max(at_lag[20:]) < 1.0  # later is better


@pytest.mark.parametrize("delays", [(2, 0), (0, 6), (4, 2)])
def test_samples_that_are_late_by_whole_steps_count_as_if_they_had_been_stamped(delays):
    case = Case(delay=tuple(0.5 * H * delay for delay in delays))
    run(case, delays=delays, check=always_best)


@pytest.mark.parametrize("delays", [(1, 0), (0, 3), (5, 1)])
def test_samples_that_are_late_by_parts_of_a_step_count_nearly_so(delays):
    """The past between two samples is a line: what that leaves out is far below the error bar."""
    case = Case(delay=tuple(0.5 * H * delay for delay in delays))

    def check(k, estimate, batch):
        mean, covariance = batch.estimate()
        if k >= 10:
            assert abs(estimate.d_at_sample[0] - mean[n]) <= 0.05 * np.sqrt(covariance[n, n])

    run(case, delays=delays, check=check)


def test_offsets_of_sensors_are_estimated_with_the_rest():
    run(Case(bias_std=(0.0, 0.05)), check=always_best)


def test_noise_on_the_states_widens_what_the_filter_expects_of_them():
    run(Case(state_noise=(0.0, 0.0, 0.02, 0.1)), check=always_best)


def test_a_parameter_that_is_estimated_is_one_state_more():
    run(Case(pull_std=0.2, estimated=(True,)), check=always_best)


def test_the_error_bar_with_uncertain_parameters_is_that_of_the_errors_over_all_their_values():
    """The filter is a sum over its samples; its error's variance follows from each sample's share and its causes."""
    count, amplitude, std = 14, 0.3, 0.2
    case = Case(pull_std=std)
    shares = np.zeros((count, count, p))  # of sample j in the estimate after sample k

    def estimates(samples):
        state, found = case.observer.init((0.0,) * n), []
        for y in samples:
            state, estimate = case.observer.step(state, U, y, H)
            found.append(estimate)
        return found

    nothing = estimates(np.zeros((count, p)))
    for j in range(count):
        for i in range(p):
            samples = np.zeros((count, p))
            samples[j, i] = amplitude * SIGMA[i]
            moved = [e.d_hat[0] for e in estimates(samples)]
            shares[:, j, i] = (np.array(moved) - [e.d_hat[0] for e in nothing]) / samples[j, i]
    for _ in range(count):
        case.go(H)
    for k in (3, 8, 13):
        used = [case.batch.nodes[j][1] for j in range(k + 1)]
        error = -case.batch.nodes[k + 1][1][n]
        for j, sources in enumerate(used):
            error[: sources.shape[1]] += shares[k, j] @ (case.C @ sources)
        variance = error @ error + np.sum(shares[k, : k + 1] ** 2 * case.variance)
        assert nothing[k].d_std[0] == pytest.approx(min(np.sqrt(variance), BOUND), rel=1e-6)
    blind = Case()
    state = blind.observer.init((0.0,) * n)
    for _ in range(count):
        state, estimate = blind.observer.step(state, U, (0.0, 0.0), H)
    assert estimate.d_std[0] < 0.9 * nothing[-1].d_std[0]


# Where a jump is expected, in parts of a step, and the shares of its variance.
AT_SAMPLE = (((0.0, 1.0),), ((0.5 - 0.15**0.5, 5 / 18), (0.5, 8 / 18), (0.5 + 0.15**0.5, 5 / 18)))


def knowing(batch, F, instants, V):
    """Return a batch at the end of a step that knows that d jumped in this step, by sizes of the shares of V."""
    told = Batch(np.zeros(len(F)), np.ones(len(F)))
    told.nodes = list(batch.nodes)
    told.rows, told.values, told.variances = (list(part) for part in (batch.rows, batch.values, batch.variances))
    for instant, share in instants:
        told.add(scipy.linalg.expm(F * H * (1.0 - instant))[:, n], share * V)
    return told


def test_a_hypothesis_of_a_jump_is_the_filter_that_was_told_of_it():
    """One filter and corrections of rank three, against a batch for each hypothesis, which knows when d jumped."""
    case, V = Case(seed=3), 2.0 * BOUND**2
    state, told, expected, checked = case.observer.init((0.0,) * n), [], [], 0
    for k in range(COUNT):
        y = case.sample(k * H, k)
        for batch in (case.batch, *told):
            for i in range(p):
                batch.measure(k, case.C[i], y[i], case.variance[i])
        state, _ = case.observer.step_by_definition(state, U, y, H)
        plain = case.batch
        for batch in (plain, *told):
            case.batch = batch
            case.go(H)
        case.batch = plain
        bank, xi = state.memory.jumps, np.array(state.xi_hat[: n + ORDER])
        columns = state.memory.columns.signatures[: n + ORDER]
        if bank.newest_age == 0.0:
            told += [knowing(plain, case.F, instants, V) for instants in AT_SAMPLE]
            expected += [bank.rate * 0.7, bank.rate * 0.3]
        told, expected = told[-len(bank.log_weight) :], expected[-len(bank.log_weight) :]
        for batch, hypothesis in zip(reversed(told), reversed(range(len(bank.log_weight))), strict=False):
            shares = np.array([share for _, share in AT_SAMPLE[hypothesis % 2]])
            nodes = len(shares)
            root = bank.sizes[hypothesis, :nodes, :nodes]
            size = bank.sizes[hypothesis, :nodes, 3]
            # Each step has one signature of the first kind, and three of the other.
            first = 4 * (hypothesis // 2) + hypothesis % 2
            signatures = columns[:, first : first + nodes]
            mean, covariance = batch.estimate()
            corrected = plain.estimate()[1] + signatures @ root @ root.T @ signatures.T
            np.testing.assert_allclose(xi + signatures @ size, mean, rtol=0, atol=1e-8 * BOUND)
            np.testing.assert_allclose(corrected, covariance, rtol=0, atol=1e-7 * np.max(covariance))
            gained = bank.log_weight[hypothesis] - np.log(expected[hypothesis - len(bank.log_weight)])
            gained += 0.5 * (bank.misfit[0, hypothesis] - bank.misfit[1, hypothesis])
            assert gained == pytest.approx(batch.log_likelihood() - plain.log_likelihood(), abs=1e-6)
            checked += 1
    assert len(told) >= 6
    assert checked > 60
