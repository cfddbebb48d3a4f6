"""The bank of hypotheses of a jump, by itself."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ndob_fmu.runtime.step.jump_bank import accepted, empty_bank, full_bank, inverse_variances, mixture

ROWS, Q, LENGTH = 5, 2, 12


def test_what_a_certain_jump_adds_has_the_mean_and_the_variance_of_the_mixture():
    random = np.random.default_rng(1)
    bank = full_bank([random.normal(size=(ROWS, 4 * Q)) for _ in range(LENGTH)])
    rho = random.normal(size=bank.evidence.shape)
    # Three innovations of five standard deviations each.
    bank = replace(
        bank,
        evidence=15.0 * rho,
        precision=3.0 * rho[:, :, None] * rho[:, None, :],
        misfit=np.tile([75.0, 3.0], (len(rho), 1)),
    )
    W = inverse_variances(np.array([2.0, 3.0]))
    expected = mixture(bank, W)
    assert np.max(expected.variance) > 0.0
    shift, columns = accepted(bank, W)
    np.testing.assert_allclose(shift, expected.shift, rtol=1e-9)
    np.testing.assert_allclose(np.sum(columns**2, axis=1), expected.variance, rtol=1e-9)


def test_an_empty_bank_adds_nothing():
    added = mixture(empty_bank(ROWS, Q), inverse_variances(np.array([2.0, 3.0])))
    assert not added.certain
    assert not np.any(added.shift)
    assert not np.any(added.variance)
