"""What several commands share: the form of a command, the folder of builds, values of options."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeAlias

from ndob_fmu.errors import UsageError

BUILD = Path("build")
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


def pairs(words: Sequence[str]) -> dict[str, str]:
    """Return NAME VALUE … as a mapping; `simulate` converts each value to the variable's type."""
    if len(words) % 2:
        raise UsageError.report(
            "--start-values", expected="pairs NAME VALUE", received=f"{len(words)} words", likely="a value is missing"
        )
    return dict(zip(words[::2], words[1::2], strict=True))


def positive(text: str) -> int:
    """Return a whole number of 1 or more; raise ValueError for anything else."""
    number = int(text)
    if number < 1:
        raise ValueError
    return number


positive.__name__ = "whole number of 1 or more"  # argparse's errors show this name
