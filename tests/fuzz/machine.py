"""The walk as a state machine of hypothesis, which shortens a sequence of calls that goes wrong.

It runs inside the process that calls the FMUs (`python -m tests.fuzz --examples N`): where that dies there is nothing
to shorten, and the calls that were noted tell what happened.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable

from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule, run_state_machine_as_test

from .library import Library
from .walk import ACTIONS, Walk


def explore(libraries: list[Library], note: Callable[[str], None], examples: int) -> tuple[int, Counter]:
    """Run this many walks of eighty actions each; return the number of calls and how often each had which status."""
    counts: Counter[tuple[str, str]] = Counter()

    class Calls(RuleBasedStateMachine):
        """FMI calls on instances of two FMUs."""

        def __init__(self) -> None:
            super().__init__()
            note("new walk")
            self.walk = Walk(libraries, None, note)

        @invariant()
        def witnesses_are_undisturbed(self) -> None:
            if self.walk.made % 10 == 0:
                self.walk.check_witnesses()

        def teardown(self) -> None:
            counts.update(self.walk.counts)
            self.walk.close()

    for name in ACTIONS:
        setattr(Calls, name, _rule(name))
    wanted = settings(
        max_examples=examples,
        stateful_step_count=80,
        deadline=None,
        derandomize=True,
        database=None,
        suppress_health_check=list(HealthCheck),
    )
    run_state_machine_as_test(Calls, settings=wanted)
    return sum(counts.values()), counts


def _rule(name: str):
    def act(self, random) -> None:
        self.walk.random = random
        getattr(self.walk, name)()

    act.__name__ = name
    return rule(random=st.randoms(use_true_random=False))(act)
