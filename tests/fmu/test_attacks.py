"""Inputs that are wrong on purpose, through the built FMUs: short forms of `python -m tests.attacks.…`."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from tests.helpers.needs import FRONT

ROOT = Path(__file__).parents[2]
pytestmark = FRONT


def attack(name, fmus, trials):
    """Run the attack in processes of its own; return its counts by what was done."""
    command = [sys.executable, "-m", f"tests.attacks.{name}", "--trials", str(trials), "--fmus", str(fmus)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    lines = done.stdout.splitlines()
    assert lines[-1] == f"{trials} trials, seed 1: 0 crashes"
    return {words: int(count) for words, count in (line.rsplit(maxsplit=1) for line in lines[:-1])}


def test_malformed_texts_are_refused_with_one_line_and_well_formed_ones_taken(shipped):
    counts = attack("texts", shipped.fmus, 300)
    assert counts["names: refused"] + counts["names: taken"] == 60
    assert counts["strings: refused"] + counts["strings: taken"] == 60
    assert counts["folders: taken"] == 12
    assert min(counts.values()) > 10


def test_states_with_wrong_contents_and_right_checksums_are_refused_or_honest(shipped):
    counts = attack("states", shipped.fmus, 250)
    refused = sum(count for words, count in counts.items() if words.endswith("refused"))
    assert refused > 100
    assert sum(counts.values()) - refused > 20
