"""The page of the benchmarks says what was measured: every ratio, whether its bound is met, and the times behind it."""

from __future__ import annotations

import json

import numpy as np
import pytest

from benchmarks.figures import Section, Time, compared
from benchmarks.performance_page import duration, text
from benchmarks.timing import take_turns

OURS = np.array([3.0, 1.0, 2.0])


def sections(required):
    return [
        Section(2, "Later", "How it was measured.", (compared("ours", "a peer", OURS, np.array([2.0, 1.0, 2.0])),)),
        Section(
            1, "Earlier", "", (compared("mine", "theirs", OURS, OURS / 1.25, required),), (Time("a step", 2.5e-5),)
        ),
    ]


@pytest.mark.parametrize(("required", "verdict"), [(1.3, "≤ 1.3 | met"), (1.2, "≤ 1.2 | **not met**")])
def test_ratios_come_first_in_the_order_of_their_sections_and_tell_whether_a_bound_is_met(required, verdict):
    page = text(sections(required))
    assert f"| mine | theirs | **1.25** | 1.25 – 1.25 | {verdict} |" in page
    assert "| ours | a peer | **1** | 1 – 1.25 |  |  |" in page
    where = [
        page.index(words) for words in ("| mine |", "| ours | a peer", "## Earlier", "| a step | 25 µs |", "## Later")
    ]
    assert where == sorted(where)


def test_a_section_survives_the_file_that_pytest_benchmark_writes():
    (kept, _) = sections(1.0)
    assert Section.from_dict(json.loads(json.dumps(kept.as_dict()))) == kept


@pytest.mark.parametrize(("seconds", "words"), [(2.5, "2.5 s"), (0.25, "250 ms"), (1e-3, "1 ms"), (4.2e-7, "0.42 µs")])
def test_a_time_has_a_unit_that_fits(seconds, words):
    assert duration(seconds) == words


def test_in_each_round_every_peer_has_its_turn_and_another_one_begins():
    said = []
    times = take_turns({name: lambda name=name: said.append(name) for name in "abc"}, 3)
    assert said == list("bca") + list("cab") + list("abc")
    assert [len(found) for found in times.values()] == [3, 3, 3]
