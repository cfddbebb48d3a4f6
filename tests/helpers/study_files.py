"""Small studies of the tests' FMUs."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

import psutil

WALK = """
system = "{fmus}/Integrator.fmu"
[simulation]
stop_time = 1.0
[grid]
u = [1.0, 2.0, -3.0]
step_size = [0.125, 0.25]
[latin_hypercube]
runs = 4
y = {{ from = 1.0, to = 100.0, scale = "log" }}
[measures]
end = {{ of = "Integrator.y", take = "final" }}
least = {{ of = "Integrator.y", minus = "Integrator.half", take = "min", after = 0.75 }}
"""
SLOW = """
system = "{fmus}/Fragile.fmu"
[simulation]
stop_time = 1.0
step_size = 1.0
[fixed]
how = "slow"
[list]
fails_at = {{ from = 0.0, to = 1e-6, values = 60 }}
"""


def write(folder: Path, name: str, text: str, fmus: Path) -> Path:
    path = folder / f"{name}.toml"
    path.write_text(text.format(fmus=fmus), "utf-8")
    return path


def start(*words: str | Path) -> subprocess.Popen[str]:
    """Start `ndob-fmu` in a process of its own."""
    command = [sys.executable, "-m", "ndob_fmu", *map(str, words)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=os.environ)


def wait_for(found, seconds: float = 30.0):
    """Return the first true value of `found()`."""
    end = time.monotonic() + seconds
    while not (value := found()):
        assert time.monotonic() < end, "nothing happened"
        time.sleep(0.05)
    return value


def workers_of(process) -> list[psutil.Process]:
    """Return the processes of the workers; a nanny's other helper, the resource tracker, is not one."""
    return [child for child in psutil.Process(process.pid).children(recursive=True) if "spawn_main" in command(child)]


def command(process: psutil.Process) -> str:
    """Return the command line, empty for a process that is ending."""
    try:
        return " ".join(process.cmdline())
    except psutil.Error:
        return ""
