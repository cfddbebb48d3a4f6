"""The bank of hypotheses of a jump, by itself."""

from __future__ import annotations

import numpy as np

from ndob_fmu.runtime.step.jump_bank import (
    FIRST_RATE,
    accepted,
    columns_of,
    empty_bank,
    explained,
    full_bank,
    if_used,
    mixture,
)

ROWS, Q = 5, 2
BOUND = np.array([2.0, 3.0])


def test_what_a_certain_jump_adds_has_the_mean_and_the_variance_of_the_mixture():
    random = np.random.default_rng(1)
    bank, signatures = full_bank(BOUND, FIRST_RATE), random.normal(size=(ROWS, columns_of(Q)))
    for row in np.eye(ROWS)[:2]:
        bank = if_used(bank, explained(bank, row @ signatures, 5.0, 0.3))
    expected = mixture(bank, signatures)
    assert np.max(expected.variance) > 0.0
    shift, columns = accepted(bank, signatures)
    np.testing.assert_allclose(shift, expected.shift, rtol=1e-9)
    np.testing.assert_allclose(np.sum(columns**2, axis=1), expected.variance, rtol=1e-9)


def test_an_empty_bank_adds_nothing():
    added = mixture(empty_bank(BOUND, FIRST_RATE), np.zeros((ROWS, columns_of(Q))))
    assert not added.certain
    assert added.shift is None
    assert added.variance is None
