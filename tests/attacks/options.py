"""The command line that the attacks share."""

from __future__ import annotations

import argparse
from collections import Counter


def read_options(module: str, text: str, trials: int) -> argparse.Namespace:
    """Return ``trials`` and ``seed`` from the command line; trials: how many without the option."""
    parser = argparse.ArgumentParser(prog=f"python -m {module}", description=text.splitlines()[0])
    parser.add_argument("--trials", type=int, default=trials)
    parser.add_argument("--seed", type=int, default=1)
    return parser.parse_args()


def closing_line(options: argparse.Namespace, counts: Counter[str], faults: list[str]) -> int:
    """Print the faults and the counts; return the exit code."""
    for fault in faults[:20]:
        print(fault)
    found = ", ".join(f"{count} {name}" for name, count in counts.items())
    print(f"{options.trials} trials, seed {options.seed}: {found}; {len(faults)} faults")
    return 1 if faults else 0
