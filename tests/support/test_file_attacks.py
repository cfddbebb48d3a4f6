"""Damaged files and interruptions: short forms of `python -m tests.attacks.…`."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]


def attack(name, *, trials, seed):
    """Return the line of counts; fail with the faults that the command prints."""
    command = [sys.executable, "-m", f"tests.attacks.{name}", "--trials", str(trials), "--seed", str(seed)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout.splitlines()[-1]


def test_damaged_and_malicious_archives_are_refused_in_one_line_or_read_as_what_they_were():
    line = attack("archives", trials=34, seed=2)
    assert "refuse" in line
    assert "accept" in line
    assert line.endswith("; 0 faults")


def test_study_files_with_any_value_in_any_place_are_valid_or_refused_in_one_line():
    line = attack("study_files", trials=150, seed=2)
    assert " valid" in line
    assert " refused in one line" in line
    assert line.endswith("; 0 faults")


def test_damaged_results_are_read_as_they_were_written_or_not_at_all():
    line = attack("bit_flips", trials=70, seed=2)
    assert "0 changed tables, 0 raw exceptions" in line
    assert "go on with a study: done again" in line
    assert "read a run: refused in one line" in line
    assert line.endswith("; 0 faults")


def test_a_command_that_is_interrupted_leaves_nothing_behind():
    line = attack("interrupts", trials=1, seed=2)
    assert "1 SIGTERM, 1 double Ctrl-C" in line
    assert line.endswith("; 0 faults")
