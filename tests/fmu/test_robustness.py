"""Whatever a host calls, how long and how often: FMUs answer as FMI says, keep their memory and leave each other alone.

Short runs of `make soak`. What may end a process runs in one of its own.
"""

from __future__ import annotations

import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from math import sin
from pathlib import Path

import pytest

from ndob_fmu import build, load_model
from ndob_fmu.fmu import compile_front as front
from ndob_fmu.fmu.components import records
from tests import soak
from tests.helpers.counted_calls import calls_of
from tests.helpers.fmi_instance import DISCARD, ERROR, OK, opened

ROOT = Path(__file__).parents[2]
FLOAT = 24  # bytes


def fuzz(folder, *words):
    command = [sys.executable, "-m", "tests.fuzz", *words, "--fmus", str(folder)]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=300, check=False)


@pytest.fixture(params=["plant", "observer"])
def fmu(request, flexible_joint):
    return getattr(flexible_joint, request.param)


def test_any_calls_in_any_order_have_the_status_of_the_reference(flexible_joint, components):
    done = fuzz(flexible_joint.plant.parent, "--calls", "5000", "--seed", "7")
    assert done.returncode == 0, done.stderr
    counts = dict(line.rsplit(maxsplit=1) for line in done.stdout.splitlines()[:-1])
    steps = {tuple(name.split()): int(count) for name, count in counts.items() if name.startswith("DoStep")}
    assert {status for _, status in steps} >= {"OK", "Discard", "Error"}


def test_a_state_machine_of_hypothesis_finds_no_call_that_is_answered_wrongly(flexible_joint, components):
    done = fuzz(flexible_joint.plant.parent, "--examples", "15")
    assert done.returncode == 0, done.stdout + done.stderr


def test_a_call_that_is_answered_wrongly_is_shown_with_those_before_it_and_how_to_repeat_it(tmp_path):
    """pythonfmu's binary alone takes what FMI forbids."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(front.platform, "machine", lambda: "another")
        build(load_model("flexible_joint"), tmp_path)
    done = fuzz(tmp_path, "--calls", "500", "--seed", "7")
    assert done.returncode == 1
    assert "again: python -m tests.fuzz --calls 500 --seed 7" in done.stderr
    assert "Instantiate i0" in done.stderr


@pytest.mark.parametrize("method", [1, 2])
@pytest.mark.parametrize("size", [1e-300, 1e3, 1e6, 1e9, 1e300])
def test_a_step_of_a_size_that_no_arithmetic_can_take_is_discarded_at_once(flexible_joint, size, method):
    with opened(flexible_joint.observer) as observer:
        observer.begin(method=method)
        observer.step(0.0, 1e-3, motor_angle=0.2)
        before = observer.get()
        statuses = []
        refused = calls_of(lambda: statuses.append(observer.doStep(1e-3, size)))
        assert "expected" in observer.said[-1]
        assert observer.get() == before
        usual = calls_of(lambda: statuses.append(observer.doStep(1e-3, 1e-3)))
        assert statuses == [DISCARD, OK]
        assert refused <= 2 * usual


@pytest.mark.parametrize("size", [1e3, 1e6, 1e9, 1e300])
def test_a_step_that_a_plant_cannot_be_integrated_over_is_discarded_at_once(flexible_joint, size):
    with opened(flexible_joint.plant) as plant:
        plant.begin()
        before = plant.get()
        statuses = []
        refused = calls_of(lambda: statuses.append(plant.doStep(0.0, size)))
        assert plant.get() == before
        long = calls_of(lambda: statuses.append(plant.doStep(0.0, 10.0)))
        assert statuses == [DISCARD, OK]
        assert refused <= 10 * long  # four times as many; forty times with ten times the substeps


def test_a_state_can_be_restored_that_was_saved_after_parameters_that_admit_no_design(flexible_joint):
    with opened(flexible_joint.observer) as observer:
        assert observer.setupExperiment(startTime=0.0) == OK
        assert observer.enterInitializationMode() == OK
        observer.get()
        assert observer.set("motor_damping", 1e12) == OK
        state = observer.state()
        assert observer.reset() == OK
        assert observer.setFMUState(state) == OK
        assert observer.exitInitializationMode() == ERROR
        assert observer.set("motor_damping", 1.0) == OK
        assert observer.exitInitializationMode() == OK


# Half a number a step is more than what does not grow: Python 3.10 makes caches of a function in its 1024th call, 150
# blocks of 10 kB.
STEPS, FEWER = 2000, 0.5


def test_no_step_leaves_as_much_as_a_number_behind(fmu):
    grown = soak.measure(fmu, "steady", STEPS)
    assert grown.blocks < FEWER * STEPS
    assert grown.heap < FEWER * STEPS * FLOAT


@pytest.mark.parametrize("name", [record.name for record in records()])
def test_no_step_of_a_component_leaves_as_much_as_a_number_behind(components, name):
    grown = soak.measure(components[name], "steady", STEPS)
    assert grown.blocks < FEWER * STEPS
    assert grown.heap < FEWER * STEPS * FLOAT


def test_a_hundred_instances_freed_in_any_order_leave_little_behind(fmu):
    grown = soak.measure(fmu, "crowds", 1)
    assert grown.blocks < 25 * 100
    assert grown.heap < 1000 * 100


INTERRUPTED = """
import os, signal, sys, threading
sys.path.insert(0, sys.argv[2])
from tests.helpers.fmi_instance import OK, unpacked

def told(number, frame):
    raise TimeoutError

signal.signal(signal.SIGALRM, told)
came = []
with unpacked(sys.argv[1]) as instance:
    for n in range(30):
        one, k = instance(str(n)), 0
        one.begin()
        number, expected = ((signal.SIGINT, KeyboardInterrupt), (signal.SIGALRM, TimeoutError))[n % 2]
        try:
            threading.Timer(0.01 + 0.0007 * n, os.kill, (os.getpid(), number)).start()
            while True:
                assert one.doStep(k * 1e-3, 1e-3) == OK
                one.get()
                k += 1
        except expected:
            came.append(one.get() is not None and not one.said)
print(len(came), all(came))
"""


def test_ctrl_c_and_other_signals_reach_the_python_host_and_leave_the_fmu_alone(fmu):
    command = [sys.executable, "-c", INTERRUPTED, str(fmu), str(ROOT)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert (done.returncode, done.stdout.split()) == (0, ["30", "True"]), done.stderr


def test_two_threads_step_two_instances_to_the_bits_of_one(fmu, tmp_path):
    folder = soak.unpacked(fmu, tmp_path)
    instances = [soak.Stepped(folder, name) for name in ("one", "other")]

    def run(instance, phase):
        return [instance.step(soak.H, sin(0.1 * k + phase)) for k in range(300)]

    with ThreadPoolExecutor(2) as threads:
        together = list(threads.map(run, instances, (0.0, 1.0)))
    for instance in instances:
        instance.fmu.reset()
        instance.begin()
    assert [run(instance, phase) for instance, phase in zip(instances, (0.0, 1.0), strict=True)] == together
    assert together[0] != together[1]
    for instance in instances:
        instance.fmu.freeInstance()
