"""The smoother against the best estimate from all samples at once, and the events that it finds."""

from dataclasses import replace

import numpy as np
import pytest

from ndob_fmu.log.smooth.event_search import explained
from ndob_fmu.log.smooth.events import Events, Jumps
from ndob_fmu.log.smooth.jump_instants import mixed
from ndob_fmu.log.smooth.linear_record import LinearRecord, Smoothed
from ndob_fmu.log.smooth.smoother import backward, forward
from ndob_fmu.log.smooth.whole_record import WholeRecord
from tests.helpers.batch_estimate import Batch

SIZES = [(2, 1, 9), (3, 2, 12), (5, 2, 15), (4, 3, 20)]


def random_record(N, p, K, seed, missing=0.2):
    """A record in which some samples are missing; instants, states and outputs are of different numbers."""
    random = np.random.default_rng(seed)
    Phi = np.eye(N) + 0.3 * random.standard_normal((K - 1, N, N))
    noise = np.tril(random.standard_normal((K - 1, N, N))) * 0.3
    misfit = random.standard_normal((K, p))
    misfit[random.random((K, p)) < missing] = np.nan
    return LinearRecord(
        Phi=Phi,
        noise=noise,
        shift=random.standard_normal((K - 1, N)),
        rows=random.standard_normal((K, p, N)),
        misfit=misfit,
        variance=random.uniform(0.01, 1.0, (K, p)),
        start=random.standard_normal(N),
        start_factor=np.diag(random.uniform(0.5, 2.0, N)),
    )


def batch_of(record, jumps):
    batch = Batch(record.start, np.diag(record.start_factor))
    for k in range(len(record.rows)):
        if k:
            batch.step(record.Phi[k - 1], record.noise[k - 1] @ record.noise[k - 1].T)
            mean, sources = batch.newest
            batch.nodes[-1] = (mean + record.shift[k - 1], sources)
        for column in jumps.get(k, np.zeros((1, 0))).T:
            batch.add(column, 1.0)
        for i in np.flatnonzero(np.isfinite(record.misfit[k])):
            batch.measure(k, record.rows[k, i], record.misfit[k, i], record.variance[k, i])
    return batch


@pytest.mark.parametrize(("N", "p", "K"), SIZES)
@pytest.mark.parametrize("jump", [None, 4])
def test_forward_and_backward_together_are_the_least_squares_solution(N, p, K, jump):
    record = random_record(N, p, K, seed=N)
    jumps = {} if jump is None else {jump: np.random.default_rng(1).standard_normal((N, 2))}
    run = forward(record, jumps)
    found, batch = Smoothed(run, backward(record, run)), batch_of(record, jumps)
    for k in range(K):
        mean, covariance = batch.estimate(k)
        np.testing.assert_allclose(found.xi[k], mean, rtol=0, atol=1e-9 * np.abs(mean).max())
        np.testing.assert_allclose(found.covariance[k], covariance, rtol=0, atol=1e-9 * np.abs(covariance).max())


def test_the_likelihoods_of_two_records_differ_as_those_of_all_samples_at_once():
    """The constant that the batch leaves out depends on the number of samples only."""
    records = [random_record(3, 2, 12, seed, missing=0.0) for seed in (5, 6)]
    own, batch = zip(
        *((forward(r).log_likelihoods.sum(), batch_of(r, {}).log_likelihood()) for r in records), strict=True
    )
    assert own[0] - own[1] == pytest.approx(batch[0] - batch[1], rel=1e-9)


def test_the_adjoint_is_the_slope_of_the_likelihood():
    record = random_record(3, 2, 12, seed=8)
    run = forward(record)
    adjoint = backward(record, run)
    k, step = 5, 1e-5
    for direction in np.eye(3):
        shift = record.shift.copy()
        ends = []
        for sign in (1.0, -1.0):
            shift[k - 1] = record.shift[k - 1] + sign * step * direction
            moved = LinearRecord(**{**vars(record), "shift": shift})
            ends.append(forward(moved).log_likelihoods.sum())
        assert (ends[0] - ends[1]) / (2 * step) == pytest.approx(adjoint.of_state[k] @ direction, rel=1e-5)


def double_integrator(K, d, seed, sigma=1e-3, rate=0.05, H=0.01, bad=()):
    """A record of ẍ = d, of which x is measured, and the columns of jumps of at most ± 3."""
    random = np.random.default_rng(seed)
    Phi = np.array([[1.0, H, H**2 / 2], [0.0, 1.0, H], [0.0, 0.0, 1.0]])
    x, v, places = 0.0, 0.0, []
    for value in d:
        places.append(x)
        x, v = x + H * v + H**2 / 2 * value, v + H * value
    noise = rate * np.sqrt(H) * np.array([[H**2 / 6, 0, 0], [H / 2, H / 12**0.5, 0], [1.0, 0, 0]])
    jump = np.sqrt(2.0) * 3.0
    record = LinearRecord(
        Phi=np.broadcast_to(Phi, (K - 1, 3, 3)),
        noise=np.broadcast_to(noise, (K - 1, 3, 3)),
        shift=np.zeros((K - 1, 3)),
        rows=np.broadcast_to(np.array([[1.0, 0.0, 0.0]]), (K, 1, 3)),
        misfit=(np.array(places) + sigma * random.standard_normal(K))[:, None],
        variance=np.full((K, 1), sigma**2),
        start=np.zeros(3),
        start_factor=np.diag([0.1, 0.1, 3.0]),
    )
    at_sample = np.zeros((K, 3, 1))
    at_sample[:, 2, 0] = jump
    nodes = np.array([0.5 - 0.15**0.5, 0.5, 0.5 + 0.15**0.5])
    left = H * (1.0 - nodes)
    one = np.array([left**2 / 2, left, np.ones(3)]) * np.sqrt(np.array([5, 8, 5]) / 18.0) * jump
    for k, error in bad:
        record.misfit[k] += error
    return WholeRecord(record), Jumps(at_sample, np.broadcast_to(one, (K, 3, 3)))


def test_a_steady_disturbance_has_no_events():
    record, columns = double_integrator(600, np.full(600, 0.7), seed=1)
    assert explained(record, columns, 5, 9).events == Events()


@pytest.mark.parametrize("size", [-2.0, 1.0, 3.0])
def test_a_jump_is_found_where_it_is(size):
    d = np.where(np.arange(600) < 250, 0.2, 0.2 + size)
    record, columns = double_integrator(600, d, seed=2)
    found = explained(record, columns, 20, 9)
    assert len(found.events.jumps) == 1
    assert abs(next(iter(found.events.jumps)) - 250) <= 3
    error = Smoothed(found.forward, found.adjoint).xi[:, 2] - d
    without = forward(record.whole)
    plain = Smoothed(without, backward(record.whole, without)).xi[:, 2] - d
    assert np.sqrt(np.mean(error**2)) < 0.4 * np.sqrt(np.mean(plain**2))


def test_outliers_are_found_and_do_not_become_jumps():
    bad = {100: 0.1, 101: -0.2, 300: 0.05, 480: 3.0}
    record, columns = double_integrator(600, np.full(600, 0.7), seed=3, bad=bad.items())
    known = Events(outliers=frozenset({(101, 0)}))  # as the observer has refused
    assert explained(record, columns, 20, 9, known).events == Events({}, frozenset((k, 0) for k in bad))


def test_what_is_no_event_after_all_is_given_up():
    record, columns = double_integrator(600, np.full(600, 0.7), seed=4)
    known = Events({200: False, 400: True}, frozenset({(77, 0)}))
    assert explained(record, columns, 5, 9, known).events == Events()


def test_the_bar_says_where_a_row_may_be_before_or_behind_a_jump():
    """A jump in the middle of a step looks nearly as one at the sample before it, or as one late in the step."""
    d, effective = (np.where(np.arange(300) <= 150, at_jump, 1.2) for at_jump in (0.2, 0.7))
    d[:150], effective[:150], K = 0.2, 0.2, slice(140, 160)
    far, squares = np.zeros(2), np.zeros(2)
    for seed in range(20):
        record, columns = double_integrator(300, effective, seed, sigma=3e-4)
        found = explained(record, columns, 20, 9)
        plain = Smoothed(found.forward, found.adjoint)
        xi, variance = plain.xi[:, 2:], plain.std[:, 2:] ** 2
        for i, (value, of_it) in enumerate([(xi, variance), mixed(found, columns, xi, variance)]):
            error = (value[:, 0] - d)[K]
            far[i] += np.any(np.abs(error) > 3.0 * np.sqrt(of_it[K, 0]))
            squares[i] += np.mean(error**2)
    assert far[0] >= 5
    assert far[1] <= 1
    assert squares[1] < 0.8 * squares[0]


@pytest.mark.parametrize("rate", [3.0, 1e-4, 0.0])
def test_a_record_in_pieces_side_by_side_is_filtered_as_from_end_to_end(rate):
    """With the low rates a filter does not forget its start."""
    d = np.where(np.arange(900) < 400, 0.2, 1.5)
    record, columns = double_integrator(900, d, 7, rate=rate)
    jumps = columns.at({0: False, 400: False, 431: True, 650: True, 899: False})
    variance = np.where(np.arange(900) % 100 == 60, 1e4, 1.0)[:, None] * record.whole.variance
    record.whole.misfit[[0, 5, 450, 451, 899]] = np.nan
    told = replace(record.whole, variance=variance)
    run = forward(told, jumps)
    found, own = record.passes(variance, jumps), (run, backward(told, run))
    for mine, theirs in zip(found, own, strict=True):
        for name, values in vars(theirs).items():
            given = getattr(mine, name)
            if name == "factor":  # the signs of its columns are of no matter
                given, values = (one @ np.swapaxes(one, 1, 2) for one in (given, values))
            size = np.where(np.isfinite(values), np.abs(values), 0.0).max()
            np.testing.assert_allclose(given, values, rtol=0, atol=1e-9 * size, err_msg=name)


@pytest.mark.parametrize("K", [2, 3, 7, 64, 65, 97])
def test_a_record_of_any_length_fits_into_pieces(K):
    record = random_record(3, 2, K, seed=K)
    (run, adjoint), own = WholeRecord(record).passes(record.variance, {}), forward(record)
    np.testing.assert_allclose(Smoothed(run, adjoint).xi, Smoothed(own, backward(record, own)).xi, atol=1e-9)
