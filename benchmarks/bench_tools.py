"""(i) The commands `check` and `build` of each example, beside the start of Python with the libraries they need."""

from __future__ import annotations

import os
import resource
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from benchmarks.figures import Section, Time, compared
from ndob_fmu.model.loading import BUILT_IN

ROUNDS = 3
EXAMPLES = Path(__file__).parents[1] / "examples"
MODELS = (*BUILT_IN, *map(str, sorted(EXAMPLES.glob("*.py"))))
# What a user waits for on an idle core at most (s).
LIMITS = {"check": 3.0, "build": 5.0}
# What either command cannot do without.
NEEDED = {
    "check": ("SymPy and SciPy", "import sympy, scipy.optimize"),
    "build": ("SymPy, Matplotlib and Pint", "import sympy, matplotlib.figure, pint; pint.UnitRegistry()"),
}
FIRST = "flexible_joint, the first build of an account, with the C compilers"


def processor_time(command: Sequence[str], cache: Path) -> float:
    """Return the processor time (s) of a command and of the processes that it starts, with a user's cache folder."""

    def spent() -> float:
        of_children = resource.getrusage(resource.RUSAGE_CHILDREN)
        return of_children.ru_utime + of_children.ru_stime

    before, environment = spent(), os.environ | {"XDG_CACHE_HOME": str(cache)}
    subprocess.run(command, check=True, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    return spent() - before


@pytest.mark.parametrize("command", LIMITS)
def test_tools(benchmark, section, tmp_path, command):
    libraries, program = NEEDED[command]
    peer = f"the start of Python with {libraries}"
    out = ["--out", str(tmp_path)] if command == "build" else []
    actions = {model: [sys.executable, "-m", "ndob_fmu", command, model, *out] for model in MODELS}
    benchmark.pedantic(processor_time, args=(actions[MODELS[0]], tmp_path / "cache"), rounds=1)
    actions[peer] = [sys.executable, "-c", program]
    times = {name: np.zeros(ROUNDS) for name in actions}
    first = np.zeros(ROUNDS)
    for k in range(ROUNDS):
        for name, words in actions.items():
            times[name][k] = processor_time(words, tmp_path / "cache")
        first[k] = processor_time(actions[MODELS[0]], tmp_path / f"empty {k}")
    least = {name: float(np.min(found)) for name, found in times.items()}
    slowest = max(MODELS, key=least.__getitem__)
    shown = {Path(name).stem if name in MODELS else name: found for name, found in least.items()}
    if command == "build":
        shown[FIRST] = float(np.min(first))
    section(
        Section(
            rank=9,
            title=f"`ndob-fmu {command}`",
            text=(
                f"The whole command, with the start of Python. The limit is {LIMITS[command]:g} s on an idle core. The "
                f"ratio is that of the slowest example. Least of {ROUNDS} rounds."
            ),
            ratios=(compared(f"{command} of {Path(slowest).stem}", peer, times[slowest], times[peer]),),
            times=tuple(Time(name, found) for name, found in shown.items()),
        )
    )
