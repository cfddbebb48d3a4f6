"""The scores of a record after an event, beside those of another pass over it, and the search that uses them."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from ndob_fmu.log.smooth import event_effects, event_scores, event_search
from ndob_fmu.log.smooth.event_search import Search, explained
from ndob_fmu.log.smooth.events import Events, Jumps, with_events
from ndob_fmu.log.smooth.whole_record import WholeRecord
from tests.log.test_smoother import double_integrator, random_record

NONE = Events()
MANY = Events({7: False, 9: True, 30: False}, frozenset({(6, 1), (9, 0), (9, 2), (31, 2)}))
OTHER = Events({9: True, 12: True, 30: False}, frozenset({(9, 0), (9, 1), (0, 1), (39, 2)}))


def calm_record():
    """A random record of 40 instants, 4 states and 3 outputs that a filter forgets, with columns of jumps."""
    record, random = random_record(4, 3, 40, seed=4), np.random.default_rng(2)
    jumps = Jumps(random.standard_normal((40, 4, 2)), random.standard_normal((40, 4, 3)))
    return WholeRecord(record), jumps


@pytest.mark.parametrize(("before", "after"), [(NONE, MANY), (MANY, NONE), (MANY, OTHER)])
def test_scores_with_other_events_are_those_of_another_pass(monkeypatch, before, after):
    monkeypatch.setattr(event_effects, "_FORGOTTEN", 0.0)
    record, columns = calm_record()
    search = Search(with_events(record, columns, before), columns, 1, 0, Counter())
    search.change(after)
    for name, expected in vars(with_events(record, columns, after).adjoint).items():
        found = getattr(search.scores, name)
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-8 * np.abs(expected).max(), err_msg=name)


def test_what_events_explain_without_another_pass_is_what_they_do_after_one():
    """Of each event that is there, and of any other one; among them events that explain nearly all of their samples."""
    d = np.where(np.arange(600) < 250, 0.2, 1.5)
    record, columns = double_integrator(600, d, seed=2, bad={100: 3.0, 240: 0.1}.items())
    after = Events({250: False, 300: True}, frozenset({(100, 0), (240, 0)}))
    known = Events({200: False, 250: False}, frozenset({(99, 0)}))
    search = Search(with_events(record, columns, known), columns, 20, 9, Counter())
    search.change(after)
    other = Search(with_events(record, columns, after), columns, 20, 9, Counter())
    for mine, theirs in zip(search.gained, other.gained, strict=True):
        np.testing.assert_allclose(mine, theirs, rtol=1e-4, atol=1e-3)


@pytest.mark.parametrize("times", [10.0, 100.0])
def test_events_that_take_turns_end_the_search(monkeypatch, times):
    """With a noise that is told far too small, each event makes another one likely."""
    monkeypatch.setattr(event_search, "_MOST_PASSES", 200)
    monkeypatch.setattr(event_search, "_MOST_ROUNDS", 200)
    d, changes = np.where(np.arange(600) % 200 < 100, 0.2, 1.2), []
    record, columns = double_integrator(600, d, seed=3)
    told = replace(record.whole, variance=record.whole.variance / times**2)
    change = Search.change
    monkeypatch.setattr(
        Search, "change", lambda self, better, **how: changes.append(better) or change(self, better, **how)
    )
    explained(WholeRecord(told), columns, 5, 9)
    assert len(changes) < 200


def calm_steps(between=0.0):
    """A record of a disturbance that is steady but for a jump at 250, or so much of a step before."""
    record, columns = double_integrator(600, np.where(np.arange(600) < 250, 0.2, 1.5), seed=2, sigma=1e-4, rate=1e-4)
    H, size = 0.01, 1.3
    record.whole.misfit[250:, 0] += size * between * H * (0.5 * between * H + H * np.arange(350))
    return record, columns


def test_of_the_events_that_explain_one_jump_of_a_calm_disturbance_only_the_best_one_is_taken(monkeypatch):
    """A filter that forgets slowly shows the jump in all rows, each of which would explain a part of it."""
    record, columns = calm_steps()
    added, add = [], event_scores.EventScores.add
    monkeypatch.setattr(event_scores.EventScores, "add", lambda self, one: added.append(one.k) or add(self, one))
    assert explained(record, columns, 3, 9).events == Events({250: False})
    assert added == [250]


@pytest.mark.parametrize(
    "known", [{249: False}, {250: True}, {247: False, 251: False}, {246: True, 250: True, 254: False}]
)
def test_a_jump_moves_to_its_instant_and_false_ones_beside_it_are_given_up(known):
    record, columns = calm_steps()
    assert explained(record, columns, 3, 9, Events(known)).events == Events({250: False})


@pytest.mark.parametrize("known", [{250: False}, {249: False, 253: False}, {246: True, 254: True}])
@pytest.mark.parametrize("between", [0.02, 0.3, 0.5, 0.7, 0.9])
def test_a_jump_between_two_samples_is_one_jump(between, known):
    record, columns = calm_steps(between)
    assert [*explained(record, columns, 3, 9, Events(known)).events.jumps.values()] == [True]


def jumping_record():
    """A record of a disturbance that jumps at 250, with an outlier at 100."""
    return double_integrator(600, np.where(np.arange(600) < 250, 0.2, 1.5), seed=2, bad={100: 3.0}.items())


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("name", "spoilt"),
    [
        # −1 / JᵀJ, so that I + M of a jump is singular; and less than nothing for a sample
        ("of_state_variance", np.diag([0.0, 0.0, -1.0 / 18.0])),
        ("of_sample_variance", -1.0),
    ],
)
def test_a_variance_that_rounding_errors_leave_none_does_not_change_what_is_found(monkeypatch, name, spoilt):
    record, columns = jumping_record()
    columns = Jumps(columns.at_sample * (18.0**0.5 / columns.at_sample.max()), columns.in_step)
    expected, changes, add = explained(record, columns, 20, 9).events, [], event_scores.EventScores.add

    def spoiling(self, source):
        touched = add(self, source)
        if not changes:
            getattr(self, name)[touched] = spoilt
        changes.append(touched)
        return touched

    monkeypatch.setattr(event_scores.EventScores, "add", spoiling)
    assert explained(record, columns, 20, 9).events == expected
    assert len(changes) > 1


@pytest.mark.parametrize("in_step", [False, True])
@pytest.mark.parametrize("times", [1.0, 1e5, 1e7, 1e10])
def test_a_jump_that_explains_nearly_everything_stays(times, in_step):
    """Of I − M only rounding errors are left then."""
    record, columns = double_integrator(600, np.where(np.arange(600) < 250, 0.2, 1.5), seed=2)
    calm = replace(record.whole, variance=record.whole.variance / times**2, noise=1e-6 * record.whole.noise)
    known, told = Events({250: in_step}), WholeRecord(calm)
    search = Search(with_events(told, columns, known), columns, 20, 9, Counter())
    search.run()
    assert 250 in search.events.jumps
