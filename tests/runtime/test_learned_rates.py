"""How often outliers and jumps come, as the observer learns it: a mass with an encoder, pushed by an unknown force."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
import scipy.linalg

from ndob_fmu.codegen.compile_model import compile_model
from tests.helpers.observers import MASS, sampled_observer

H, BOUND, STD, SIZE = 1e-3, 2.0, 2e-8, 1.5
EVERY = 125  # samples from one edge to the next
CLEAN = 1000


class Log:
    """The observer over samples of the mass; the lag keeps its covariance running, and with it what it learns."""

    def __init__(self, edges, outliers, count):
        observer = sampled_observer(
            compile_model(MASS),
            {},
            x_hat=(0.0, 0.0),
            order=1,
            noise_std=(STD,),
            disturbance_bound=(BOUND,),
            disturbance_rate=(4.0,),
            lag=H,
        )
        Phi = scipy.linalg.expm(np.array([[0, 1, 0], [0, -0.5, 1], [0, 0, 0]]) * H)
        random, x, state = np.random.default_rng(4), np.zeros(3), observer.init((0.0, 0.0))
        errors = []
        for k in range(count):
            if k in edges:
                x[2] = 0.0 if x[2] else SIZE
            y = x[0] + STD * random.standard_normal() + outliers.get(k, 0.0) * STD
            state, estimate = observer.step(state, (0.0,), (float(y),), H)
            errors.append(estimate.d_at_sample[0] - x[2])
            x = Phi @ x
        self.error = np.abs(errors) / BOUND
        self.sensor, self.bank = state.memory.sensors[0], state.memory.jumps


@cache
def clean_until_an_edge():
    return Log((100, CLEAN), {}, CLEAN + 10)


@cache
def with_edges():
    return Log(range(100, CLEAN, EVERY), {}, CLEAN)


@cache
def with_outliers(share, size):
    random = np.random.default_rng(5)
    at = np.flatnonzero(random.random(2 * CLEAN) < share)
    return Log((), {k: size * random.choice([-1.0, 1.0]) for k in at.tolist() if k > 60}, 2 * CLEAN)


def test_after_a_thousand_good_samples_the_first_one_that_an_edge_moves_tells_of_it():
    """The sample of the edge itself cannot show it: a force needs a step to move the mass."""
    error = clean_until_an_edge().error
    assert error[CLEAN] > 0.9 * SIZE / BOUND
    assert error[CLEAN + 1] < 0.3 * SIZE / BOUND


def test_samples_that_a_jump_explains_do_not_count_as_outliers():
    assert with_edges().sensor.outlier_rate < 0.002


def test_the_share_of_jumps_is_learned_from_those_that_were_found():
    assert with_edges().bank.rate > 0.005
    assert with_outliers(0.02, 40.0).bank.rate < 0.0006


@pytest.mark.parametrize("share", [0.02, 0.05])
def test_the_share_of_outliers_is_learned_from_those_that_were_found(share):
    """About 600 samples have a weight in it, of which few are outliers."""
    assert with_outliers(share, 400.0).sensor.outlier_rate == pytest.approx(share, abs=2.0 * np.sqrt(share / 600.0))


def test_where_no_jump_has_come_no_outlier_is_taken_for_one():
    """A jump of 0.8 D₀ would move the mass as far as these outliers do."""
    assert np.max(with_outliers(0.02, 40.0).error[CLEAN:]) < 0.1
