"""Disturbances with orders of their own: the observer is the Kalman filter of just that system."""

import numpy as np
import pytest
from scipy.linalg import expm

from ndob_fmu.codegen.compile_model import compile_model
from tests.helpers.general_plants import TROLLEY
from tests.helpers.observers import sampled_observer

EQ, H = compile_model(TROLLEY), 0.02


def observer(own_order):
    return sampled_observer(EQ, (), order=2, own_order=own_order, adapt_noise=False, lag=H, x_hat=EQ.xhat0)


def std_after(own_order, steps=600):
    """Return the error bars (q2,) of d̂ after samples of a plant that stands still."""
    one = observer(own_order)
    state = one.init(EQ.xhat0)
    for _ in range(steps):
        state, said = one.step(state, (0.0,), (0.0, 0.0), H)
    return np.array(said.d_std)


def kalman_std(F, C, variance, intensity, steps=600):
    """Return the standard deviation of the last state, one step ahead, of a system that noise on it alone drives."""
    n = len(F)
    noise = np.zeros((n, n))
    noise[-1, -1] = intensity
    both = expm(H * np.block([[-F, noise], [np.zeros((n, n)), F.T]]))
    Phi = both[n:, n:].T
    Q, P = Phi @ both[:n, n:], np.eye(n)
    for _ in range(steps):
        gain = P @ C / (C @ P @ C + variance)
        P = Phi @ (P - np.outer(gain, C @ P)) @ Phi.T + Q
    return np.sqrt(P[-1, -1])


def test_one_that_wanders_beside_a_smooth_one_has_the_error_bar_of_a_random_walk():
    """The sway does not depend on the trolley, so that its filter is one of three states."""
    one = observer((0, 1))
    intensity = one.tuned(H).intensity(H, [1.0, 1.0])
    F, C = np.array([[0.0, 1.0, 0.0], [-1.2, 0.0, 1.0], [0.0, 0.0, 0.0]]), np.array([1.0, 0.0, 0.0])
    assert std_after((0, 1))[1] == pytest.approx(kalman_std(F, C, 0.1**2, intensity[1]), rel=1e-4)


def test_the_other_disturbance_keeps_its_error_bar():
    assert std_after((0, 1))[0] == pytest.approx(std_after((0, 0))[0], rel=1e-9)


def test_one_as_high_as_all_or_higher_changes_nothing():
    assert std_after((2, 3)).tolist() == std_after((0, 0)).tolist()


def test_white_noise_behind_fewer_derivatives_has_the_same_spectrum_at_the_bandwidth():
    """So a disturbance is followed about as fast with either order."""
    of_all, own = (observer(one).tuned(H) for one in ((0, 0), (0, 1)))
    lower, higher = (one.intensity(H, [1.0, 1.0])[1] for one in (own, of_all))
    assert own.intensity(H, [1.0, 1.0])[0] == of_all.intensity(H, [1.0, 1.0])[0]
    # The bandwidth at which d, behind r integrations and the two of the plant, meets the noise of the camera.
    bandwidth = (higher / (0.1**2 * H)) ** (1.0 / 8.0)
    assert lower == pytest.approx(higher / bandwidth**2, rel=1e-9)
