"""What several commands share: the form of a command, the folder of builds, values of options."""

from __future__ import annotations

import argparse
import json
import os
import shlex
import subprocess
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeAlias

from ndob_fmu.errors import UsageError

BUILD = Path("build")
NATIVE = BUILD / "native"
DEMO_MODEL = "flexible_joint"
MODEL_HELP = f"a Python file that defines `model`, or the built-in model {DEMO_MODEL}"

Commands: TypeAlias = "argparse._SubParsersAction[argparse.ArgumentParser]"


def add_command(
    commands: Commands, name: str, run: Callable[[argparse.Namespace], int], text: str, *, slow: bool = False
) -> argparse.ArgumentParser:
    """Add a command and return its parser; ``run`` returns the exit code.

    slow: print what the command is doing when it takes long.
    """
    parser = commands.add_parser(name, help=text, description=text)
    parser.set_defaults(run=run, slow=slow)
    return parser


def as_json(data: Any) -> str:
    """Return data as indented JSON."""
    return json.dumps(data, indent=2)


def command_text(words: Sequence[str]) -> str:
    """Return a command as one types it in the shell of this system: words with spaces are quoted."""
    return subprocess.list2cmdline(words) if os.name == "nt" else shlex.join(words)


def pairs(option: str, words: Sequence[str]) -> dict[str, str]:
    """Return the NAME VALUE … of an option as a mapping."""
    if len(words) % 2:
        raise UsageError.report(
            option, expected="pairs NAME VALUE", received=f"{len(words)} words", likely="a value is missing"
        )
    return dict(zip(words[::2], words[1::2], strict=True))


def assignments(option: str, words: Sequence[str]) -> dict[str, str]:
    """Return the LEFT=RIGHT … of an option as a mapping."""
    found = {}
    for word in words:
        left, equals, right = word.partition("=")
        if not (left and equals and right):
            raise UsageError.report(option, expected="COLUMN=NAME, without spaces", received=repr(word))
        found[left] = right
    return found


def number_or_pairs(option: str, words: Sequence[str] | None) -> float | dict[str, float] | None:
    """Return the one number of an option, or its NAME NUMBER … as a mapping; None where it is not given."""
    if words is None:
        return None
    if len(words) == 1:
        return _number(option, words[0])
    return {name: _number(f"{option} {name}", text) for name, text in pairs(option, words).items()}


def _number(option: str, text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise UsageError.report(option, expected="a number, or pairs NAME NUMBER", received=repr(text)) from None


def positive(text: str) -> int:
    """Return a whole number of 1 or more; raise ValueError for anything else."""
    number = int(text)
    if number < 1:
        raise ValueError
    return number


positive.__name__ = "whole number of 1 or more"  # argparse's errors show this name
