"""The lagged estimate once a jump of the disturbance is accepted: the best of a filter that was told of the jump."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
import scipy.linalg

from ndob_fmu.codegen.compile_model import compile_model
from ndob_fmu.model.model import Model
from ndob_fmu.runtime.step.jump_bank import log_weights
from tests.helpers.batch_estimate import Batch, sampled_by_van_loan
from tests.helpers.observers import MASS, sampled_observer

H, BOUND = 0.05, 2.0
V = 2.0 * BOUND**2
# Where a jump is expected, in parts of a step, and the shares of its variance.
INSTANTS = {
    "at a sample": ((0.0, 1.0),),
    "in a step": ((0.5 - 0.15**0.5, 5 / 18), (0.5, 8 / 18), (0.5 + 0.15**0.5, 5 / 18)),
}
# The jump, and the sample at which it is accepted.
JUMP, ACCEPTED, COUNT = 12, 16, 28


@dataclass(frozen=True)
class Plant:
    """ẋ = A x + B u + G d, y = C x."""

    A: np.ndarray
    G: np.ndarray
    C: np.ndarray
    sigma: tuple[float, ...]

    def model(self):
        n, q, p = len(self.A), self.G.shape[1], len(self.C)
        return Model(
            name="Linear",
            states=[f"x{i}" for i in range(n)],
            inputs=["u"] if q > 1 else ["u", "u2", "u3"],
            outputs=[f"y{i}" for i in range(p)],
            disturbances=[f"d{i}" for i in range(q)],
            parameters={},
            A=self.A.tolist(),
            B=np.zeros((n, 1 if q > 1 else 3)).tolist(),
            C=self.C.tolist(),
            G_d=self.G.tolist(),
        )


ONE = Plant(
    np.array([[0, 1.0, 0, 0], [-4.0, -0.6, 2.0, 0], [0, 0.5, -1.5, 1.0], [0.3, 0, -1.0, -2.0]]),
    np.array([[0], [1.0], [0], [0]]),
    np.array([[0, 1.0, 0, 0], [1.0, 0, 0.4, 0]]),
    (1e-2, 2e-2),
)
TWO = Plant(
    np.array(
        [
            [0, 1.0, 0, 0, 0],
            [-4.0, -0.6, 2.0, 0, 0.2],
            [0, 0, 0, 1.0, 0],
            [1.0, 0, -3.0, -0.4, 0],
            [0.3, 0, 0.5, 0, -2.0],
        ]
    ),
    np.array([[0, 0], [1.0, 0.3], [0, 0], [0, 1.5], [0, 0]]),
    np.array([[1.0, 0, 0, 0, 0], [0, 1.0, 0, 0, 0.3], [0, 0, 0.2, 1.0, 0]]),
    (1e-2, 2e-2, 3e-2),
)


class Case:
    """An observer, and the batch that is told of a jump."""

    def __init__(self, plant, *, order, lag, delays=None):
        self.n, self.q = plant.G.shape
        self.delays = (0,) * len(plant.C) if delays is None else delays
        model = plant.model()
        self.observer = sampled_observer(
            compile_model(model),
            {},
            x_hat=(0.0,) * self.n,
            order=order,
            noise_std=plant.sigma,
            disturbance_bound=(BOUND,) * self.q,
            disturbance_rate=(10.0,) * self.q,
            x_std=tuple(0.1 * (1.0 + np.arange(self.n))),
            adapt_noise=False,
            lag=lag * H,
            delay=tuple(H * delay for delay in self.delays),
        )
        self.m = len(model.inputs)
        tuned = self.observer.tuned(H)
        n, q, N = self.n, self.q, self.n + order * self.q
        F, G = np.zeros((N, N)), np.zeros((N, q))
        F[:n, :n], F[:n, n : n + q] = plant.A, plant.G
        F[n : N - q, n + q :] = np.eye(N - n - q)
        G[N - q :] = np.diag(np.sqrt(tuned.intensity(H, (1.0,) * len(plant.C))))
        self.F, self.noise = F, sampled_by_van_loan(F, G, H)
        self.C = np.hstack([plant.C, np.zeros((len(plant.C), N - n))])
        self.variance = tuned.model.noise_variance
        self.start = (np.zeros(N), tuned.model.start_std)
        # Errors of less than a standard deviation leave no sample suspicious.
        self.samples = np.random.default_rng(3).uniform(-1.0, 1.0, (COUNT, len(plant.C))) * plant.sigma

    def batches(self, kind, which):
        """Return, for each sample, the batch of all samples until then that was told of the jump, or was not."""
        batch, after = Batch(*self.start), []
        for k, y in enumerate(self.samples):
            for i, value in enumerate(y):
                if k >= self.delays[i]:
                    batch.measure(k - self.delays[i], self.C[i], value, self.variance[i])
            if not JUMP < k < ACCEPTED:  # meanwhile the filter does not know the jump
                self.keep_within_bound(batch)
            after.append(copied(batch))
            batch.step(*self.noise)
            if k == JUMP and kind:
                self.tell(batch, INSTANTS[kind], self.n + which)
        return after

    def keep_within_bound(self, batch):
        """Count |d| ≤ D₀ as a sample of d where d is known no better than by that, so that the error bar becomes D₀."""
        for place in range(self.n, self.n + self.q):
            variance = batch.estimate()[1][place, place]
            if variance > BOUND**2:
                row = np.eye(len(self.F))[place]
                batch.measure(len(batch.nodes) - 1, row, 0.0, variance * BOUND**2 / (variance - BOUND**2))

    def tell(self, batch, instants, place):
        """Add a jump in the last step; d is continuous from the right, so that one at its sample counts there."""
        for instant, share in instants:
            batch.add(scipy.linalg.expm(self.F * H * (1.0 - instant))[:, place], share * V)
            if instant == 0.0:
                mean, sources = batch.nodes[-2]
                wider = np.zeros((len(mean), batch.newest[1].shape[1]))
                wider[:, : sources.shape[1]] = sources
                wider[place, -1] = np.sqrt(V)
                batch.nodes[-2] = (mean, wider)

    def run(self, kind, which, weight):
        """Yield the samples from that on which a hypothesis gets so much weight at, with estimate and state after."""
        state, born = self.observer.init((0.0,) * self.n), []
        for k, y in enumerate(self.samples):
            if k == ACCEPTED:
                bank = state.memory.jumps
                place = len(bank.log_weight) - 2 * self.q * (len(born) - born.index(JUMP))
                place += 2 * which + list(INSTANTS).index(kind)
                weights = np.full(len(bank.log_weight), -np.inf)
                weights[place] = weight
                memory = replace(state.memory, jumps=replace(bank, log_weight=weights))
                state = replace(state, memory=memory)
            state, estimate = self.observer.step(state, (0.0,) * self.m, y.tolist(), H)
            if state.memory.jumps.newest_age == 0.0:
                born.append(k)
            if k >= ACCEPTED:
                yield k, estimate, state


def copied(batch):
    """Return a batch that stays as it is now."""
    now = Batch(np.zeros(1), np.ones(1))
    now.nodes = list(batch.nodes)
    now.rows, now.values, now.variances = list(batch.rows), list(batch.values), list(batch.variances)
    return now


def at_lag(case, batches, k, lag):
    """Return mean (q,) and variance (q,) of d a lag before sample k."""
    mean, covariance = batches[k].estimate(k - lag)
    d = slice(case.n, case.n + case.q)
    return mean[d], np.diag(covariance)[d]


CERTAIN = {
    "one disturbance": (ONE, {"order": 2, "lag": 9}, "at a sample", 0),
    "one disturbance of order 1": (ONE, {"order": 1, "lag": 5}, "at a sample", 0),
    "in a step": (ONE, {"order": 1, "lag": 4}, "in a step", 0),
    "in a step, order 2": (ONE, {"order": 2, "lag": 6}, "in a step", 0),
    "the second of two disturbances": (TWO, {"order": 1, "lag": 6}, "at a sample", 1),
    "the first of two disturbances, in a step": (TWO, {"order": 2, "lag": 4}, "in a step", 0),
    "late samples": (ONE, {"order": 2, "lag": 6, "delays": (2, 0)}, "at a sample", 0),
    "late samples, in a step": (TWO, {"order": 1, "lag": 5, "delays": (0, 1, 3)}, "in a step", 1),
}


@pytest.mark.parametrize("name", CERTAIN)
def test_after_a_certain_jump_the_lagged_estimate_is_that_of_all_samples_and_a_filter_that_was_told(name):
    plant, settings, kind, which = CERTAIN[name]
    case, lag = Case(plant, **settings), settings["lag"]
    told, moved = case.batches(kind, which), 0.0
    plain = case.batches(None, which)
    for k, estimate, state in case.run(kind, which, 60.0):
        assert state.memory.jumps.since_jump == k - ACCEPTED
        mean, variance = at_lag(case, told, k, lag)
        np.testing.assert_allclose(estimate.d_lagged, mean, rtol=0, atol=1e-9 * BOUND)
        np.testing.assert_allclose(estimate.d_lagged_std, np.sqrt(variance), rtol=1e-9)
        moved = max(moved, np.max(np.abs(mean - at_lag(case, plain, k, lag)[0])))
    assert moved > 0.01 * BOUND


def test_while_a_jump_is_only_likely_the_lagged_estimate_is_between_both():
    case, lag = Case(ONE, order=1, lag=3), 3
    told, plain = case.batches("at a sample", 0), case.batches(None, 0)
    k, estimate, state = next(case.run("at a sample", 0, 1.0))
    weight = 1.0 / (1.0 + np.exp(-np.max(log_weights(state.memory.jumps)[: -2 * case.q])))
    assert 0.5 < weight < 0.9
    weights = np.array([weight, 1.0 - weight])
    means, variances = np.array([at_lag(case, batches, k, lag) for batches in (told, plain)])[:, :, 0].T
    mean = weights @ means
    assert estimate.d_lagged[0] == pytest.approx(mean, abs=1e-9 * BOUND)
    assert estimate.d_lagged_std[0] ** 2 == pytest.approx(weights @ (variances + means**2) - mean**2, rel=1e-9)


def test_after_a_step_of_the_disturbance_the_lagged_estimate_is_nearer_at_the_edge_and_after_it():
    """A mass with a noisy encoder, pushed by a force that jumps: 20 ms later the edges are where they were."""
    step, lag, size, std, edges = 1e-3, 20, 1.5, 5e-7, (100, 180)
    observer = sampled_observer(
        compile_model(MASS),
        {},
        x_hat=(0.0, 0.0),
        order=1,
        noise_std=(std,),
        disturbance_bound=(BOUND,),
        disturbance_rate=(4.0,),
        lag=lag * step,
    )
    Phi = scipy.linalg.expm(np.array([[0, 1, 0], [0, -0.5, 1], [0, 0, 0]]) * step)
    random, x, state = np.random.default_rng(1), np.zeros(3), observer.init((0.0, 0.0))
    truth, estimates = [], []
    for k in range(edges[-1] + 80):
        x[2] = size if edges[0] <= k < edges[1] else 0.0
        y = float(x[0] + std * random.standard_normal())
        state, estimate = observer.step(state, (0.0,), (y,), step)
        truth.append(x[2])
        estimates.append(estimate)
        x = Phi @ x
    now, then = estimates[:-lag], estimates[lag:]
    online = np.abs([e.d_at_sample[0] for e in now] - np.array(truth[:-lag]))
    lagged = np.abs([e.d_lagged[0] for e in then] - np.array(truth[:-lag]))
    std_lagged = np.array([e.d_lagged_std[0] for e in then])
    after = np.concatenate([np.arange(edge, edge + 60) for edge in edges])
    for edge in edges:
        assert np.all(lagged[edge : edge + 2] < 0.5 * online[edge : edge + 2])
    assert np.sqrt(np.mean(lagged[after] ** 2)) < 0.3 * np.sqrt(np.mean(online[after] ** 2))
    assert np.mean(lagged[after] <= 2.0 * std_lagged[after]) > 0.95
