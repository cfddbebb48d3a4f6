"""The noise of a record in few columns: the same covariance for all paces of the disturbances, with fewer columns."""

import numpy as np
import pytest

from ndob_fmu.log.fit.noise_columns import in_few_columns, of_each_disturbance

K, N = 6, 5


def noise_of(moved, random):
    """Noise (K,N,·) with N columns for each direction, which moves some rows."""
    columns = np.zeros((len(moved), K, N, N))
    for one, rows in zip(columns, moved, strict=True):
        one[:, rows] = random.standard_normal((K, len(rows), N))
    return np.concatenate([*columns], axis=2)


@pytest.mark.parametrize("others", [[], [[0, 1, 2]], [[2, 3], [0, 4], [1]]])
@pytest.mark.parametrize("factors", [[1.0, 1.0], [4.0, 0.3]])
def test_noise_in_few_columns_has_the_same_covariance_at_each_pace(others, factors):
    noise = noise_of([[0, 3], [1, 3, 4], *others], np.random.default_rng(1))
    few = in_few_columns(noise, 2)
    for j, (columns, factor) in enumerate(zip(of_each_disturbance(few, 2), factors, strict=True)):
        columns *= factor
        noise[:, :, j * N : (j + 1) * N] *= factor
    covariance, expected = (one @ np.swapaxes(one, 1, 2) for one in (few, noise))
    np.testing.assert_allclose(covariance, expected, rtol=0, atol=1e-13 * np.abs(expected).max())


def test_a_disturbance_has_as_many_columns_as_the_rows_that_it_moves():
    few = in_few_columns(noise_of([[0, 3], [1, 3, 4], [2], [0, 1]], np.random.default_rng(2)), 2)
    assert few.shape == (K, N, 2 * 3 + N)
    assert [np.count_nonzero(one.any(axis=(0, 1))) for one in of_each_disturbance(few, 2)] == [2, 3]
