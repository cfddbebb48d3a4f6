"""fork(): a child never hangs in an FMU. It goes on where Python can, and is refused with one line where it cannot."""

from __future__ import annotations

import re
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest

from tests.helpers.native_host import compile_host, unpack
from tests.helpers.needs import FRONT

pytestmark = FRONT

TIMES = 8
STEPPING = ("new fmu", "setup 0", "enter", "exit")


@pytest.fixture(scope="module")
def plant(flexible_joint, tmp_path_factory):
    folder = tmp_path_factory.mktemp("plant")
    return unpack(flexible_joint.plant, folder / "fmu", compile_host(folder))


def forks(run):
    """How many children went on, were refused, hung."""
    return tuple(
        map(int, re.fullmatch(r"OK (\d+) refused (\d+) hung (\d+) fork OK", run.replies[len(STEPPING)]).groups())
    )


def test_children_of_a_native_host_go_on_with_what_they_inherit_between_two_calls(plant):
    done = plant.run(*STEPPING, f"fork {TIMES} rest", "getR 0", "free")
    assert (done.code, done.log, forks(done)) == (0, [], (TIMES, 0, 0))
    assert done.replies[-2:] == ["0 getR OK", "free OK"]


def test_children_that_are_forked_while_a_thread_steps_are_refused_at_once_and_the_parent_goes_on(plant):
    done = plant.run(*STEPPING, f"fork {TIMES} steps", "getR 0", "new another", "free", "at 0", "free")
    good, refused, hung = forks(done)
    assert (done.code, good + refused, hung) == (0, TIMES, 0)
    assert refused > 0
    assert [reply.split()[-1] for reply in done.replies[-5:]] == ["OK"] * 5
    calls = Counter(text.split(":")[0] for _, _, text in done.log)
    assert calls["fmi2GetReal"] == calls["fmi2DoStep"] == refused >= calls["fmi2Instantiate"]
    assert calls.keys() <= {"fmi2GetReal", "fmi2DoStep", "fmi2Instantiate"}
    assert {status for status, _, _ in done.log} == {"Error"}
    assert all("forked while a thread was calling an FMU" in text for _, _, text in done.log)


PROGRAM = """
import os, sys, threading, time, warnings
from pathlib import Path
from tests.fuzz.library import ERROR, OK, Library

library = Library(Path(sys.argv[1]))
stepped, other = library.new("stepped", logging=1), library.new("other")
library.begin(stepped), library.begin(other)
going = True

def steps():
    k = 0
    while going:
        library.step(stepped, k * 1e-3, 1e-3)
        k += 1

thread = threading.Thread(target=steps)
thread.start()
warnings.simplefilter("ignore", DeprecationWarning)  # from Python 3.12 on, of a fork while threads run: the matter here
codes = []
for k in range(int(sys.argv[2])):
    time.sleep(0.003)
    process = os.fork()
    if not process:
        import signal
        signal.alarm(20)
        assert library.step(other, 0.0, 1e-3) == OK
        another = library.new("child")
        library.begin(another)
        assert library.step(another, 0.0, 1e-3) == OK
        # Inherited in the middle of a call, or between two.
        status, said = library.get(stepped, [0])[0], [text for _, _, text in library.said]
        assert status == (ERROR if said else OK)
        assert all("forked while a thread was calling an FMU" in text for text in said)
        library.FreeInstance(stepped)
        library.FreeInstance(other)
        os._exit(7 if said else 6)
    codes.append(os.waitstatus_to_exitcode(os.waitpid(process, 0)[1]))
going = False
thread.join()
assert library.step(other, 0.0, 1e-3) == OK
print(*codes)
"""


def test_children_of_a_python_host_go_on_with_all_but_what_another_thread_was_calling(plant):
    command = [sys.executable, "-c", PROGRAM, str(plant.folder), str(TIMES)]
    root = Path(__file__).parents[2]
    done = subprocess.run(command, cwd=root, capture_output=True, text=True, timeout=200, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    codes = [int(code) for code in done.stdout.split()]
    assert set(codes) <= {6, 7}
    assert len(codes) == TIMES
    assert 7 in codes
