"""Sums of responses over all steps are those of step after step, however slowly a response decays."""

from __future__ import annotations

import numpy as np
import pytest

from ndob_fmu.analysis import summed_responses
from ndob_fmu.analysis.summed_responses import summed


def magnitudes(responses):
    """The sum over two inputs of the magnitudes of their responses, for each row and step."""
    return np.abs(responses.reshape(len(responses), -1, 2)).sum(axis=-1)


def problem(modes, seed=0):
    """Rows, step and inputs of a system with these modes, in coordinates that hide them."""
    random = np.random.default_rng(seed)
    blocks = np.zeros((len(modes), len(modes)))
    for i, mode in enumerate(modes):
        blocks[i, i] = np.real(mode)
        if np.imag(mode):
            other = i + 1 if np.imag(mode) > 0 else i - 1
            blocks[i, other] = np.imag(mode)
    hidden = np.linalg.qr(random.normal(size=blocks.shape))[0] + 0.2 * random.normal(size=blocks.shape)
    step = np.linalg.solve(hidden, blocks @ hidden)
    return (
        random.normal(size=(3, len(modes))) @ hidden,
        step,
        np.linalg.solve(hidden, random.normal(size=(len(modes), 2))),
    )


def step_by_step(rows, step, inputs, count):
    total, state = np.zeros(len(rows)), inputs
    for _ in range(count):
        total += np.abs(rows @ state).sum(axis=1)
        state = step @ state
    return total


@pytest.mark.parametrize(
    "modes",
    [
        (0.9995, 0.99, 0.5, 0.0),
        (0.9995, 0.95 + 0.2j, 0.95 - 0.2j, -0.9),
        (0.999 + 0.01j, 0.999 - 0.01j, 0.9, 0.1),
        (-0.999, 0.9, 0.5, 0.2),
    ],
    ids=["real", "fast oscillation", "slow oscillation", "alternating"],
)
def test_the_sum_is_that_of_all_steps(modes):
    rows, step, inputs = problem(modes)
    expected = step_by_step(rows, step, inputs, 60_000)
    found = summed(magnitudes, rows, step, inputs, by_element=True)
    assert np.all(found >= expected * (1.0 - 1e-9))
    assert np.all(found <= expected * 1.002)


@pytest.mark.parametrize("by_element", [True, False])
@pytest.mark.parametrize("seed", range(8))
def test_the_sum_of_slow_modes_of_many_paces_is_a_bound_and_hardly_more(seed, by_element):
    random = np.random.default_rng(seed)
    decay = 10.0 ** random.uniform(-3.3, -2.0, 2)
    turn = np.minimum(1.0, decay * 10.0 ** random.uniform(-1.0, 1.5, 2))
    pairs = (1.0 - decay) * np.exp(1j * turn)
    modes = (*[mode for pair in pairs for mode in (pair, np.conj(pair))], 1.0 - 10.0 ** random.uniform(-3.0, -1.0))
    rows, step, inputs = problem(modes, seed)
    expected = step_by_step(rows, step, inputs, int(40.0 / np.min(1.0 - np.abs(modes))))
    found = summed(magnitudes, rows, step, inputs, by_element=by_element)
    assert np.all(found >= expected * (1.0 - 1e-9))
    assert np.all(found <= expected * 1.005)


@pytest.mark.parametrize("mode", [0.0, 0.5, 0.99])
def test_equal_modes_that_cannot_be_told_apart_do_not_blow_the_bound_up(mode):
    step = mode * np.eye(5) + np.diag(np.full(4, 0.3), 1)
    random = np.random.default_rng(0)
    rows, inputs = random.normal(size=(3, 5)), random.normal(size=(5, 2))
    expected = step_by_step(rows, step, inputs, 20_000)
    found = summed(magnitudes, rows, step, inputs, by_element=True)
    np.testing.assert_allclose(found, expected, rtol=5e-3)


def test_a_slow_oscillation_takes_few_steps(monkeypatch):
    """A step counts where it is evaluated: of 100 000 hundreds are, and what is left is bounded by its modes."""
    rows, step, inputs = problem((1.0 - 1e-4 + 1e-4j, 1.0 - 1e-4 - 1e-4j, 0.9, 0.1))
    evaluated = 0

    def counted(responses):
        nonlocal evaluated
        terms = magnitudes(responses)
        evaluated += terms.shape[1]
        return terms

    found = summed(counted, rows, step, inputs, by_element=True)
    np.testing.assert_allclose(found, step_by_step(rows, step, inputs, 200_000), rtol=2e-3)
    assert evaluated < 8_000


def test_a_response_that_keeps_its_sign_is_exact_and_takes_few_steps(monkeypatch):
    rows, step, inputs = problem((1.0 - 1e-6, 0.99, 0.9 + 0.3j, 0.9 - 0.3j))
    monkeypatch.setattr(summed_responses, "_MOST_STEPS", 4096)
    found = summed(magnitudes, rows, step, inputs, by_element=True)
    start = step_by_step(rows, step, inputs, 2048)
    left = rows @ np.linalg.matrix_power(step, 2048) @ np.linalg.solve(np.eye(4) - step, inputs)
    np.testing.assert_allclose(found, start + np.abs(left).sum(axis=1), rtol=1e-8)
