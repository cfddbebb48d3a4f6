"""Many instances of many FMUs in one process, and a host with a package of the same name: each computes as if alone."""

from __future__ import annotations

import json
import random
import shutil
import subprocess
import sys
from contextlib import ExitStack
from pathlib import Path

import pytest

from ndob_fmu import build
from ndob_fmu.fmu import bundle as bundling
from tests.helpers.clean_process import run_clean
from tests.helpers.fmi_instance import OK, unpacked
from tests.helpers.problems import MODELS

H = 1e-3
STEPS = 12


@pytest.fixture(scope="module")
def fmus(tmp_path_factory, flexible_joint):
    """FMUs of three models."""
    folder = tmp_path_factory.mktemp("many")
    others = [path for name in ("dc_motor", "three_tank") for path in build(MODELS[name], folder)]
    return [flexible_joint.plant, flexible_joint.observer, *others]


@pytest.fixture(scope="module")
def other_code(tmp_path_factory):
    """The plant of the first model, its constant disturbance three times as large by other code of the same names."""
    folder = tmp_path_factory.mktemp("other_code")
    copy = shutil.copytree(bundling._RUNTIME, folder / "runtime")
    text = (copy / "blocks" / "disturbance.py").read_text("utf-8")
    changed = text.replace("return self.amplitude\n", "return 3.0 * self.amplitude\n")
    (copy / "blocks" / "disturbance.py").write_text(changed, "utf-8")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(bundling, "_RUNTIME", copy)
        return build(MODELS["flexible_joint"], folder)[0]


def run(instance):
    """Yield the outputs of one run, step by step."""
    names = [variable.name for variable in instance.variables.values() if variable.causality == "input"]
    instance.begin()
    yield instance.get()
    for k in range(STEPS):
        yield instance.step(k * H, H, **{name: 0.1 * (i + 1) * (k % 5) for i, name in enumerate(names)})


def alone(path):
    with unpacked(path) as instance:
        return list(run(instance()))


def test_instances_of_several_models_in_any_order_give_the_bits_of_each_alone(fmus):
    expected = [alone(path) for path in fmus]
    with ExitStack() as stack:
        makers = [stack.enter_context(unpacked(path)) for path in fmus]
        runs = [(which, run(makers[which](f"{which}.{copy}"))) for which in range(len(fmus)) for copy in range(3)]
        rows = [[] for _ in runs]
        turns = [i for i in range(len(runs)) for _ in range(STEPS + 1)]
        random.Random(1).shuffle(turns)
        for turn in turns:
            rows[turn].append(next(runs[turn][1]))
        for (which, _), row in zip(runs, rows, strict=True):
            assert row == expected[which]


def test_what_happens_to_one_instance_changes_no_other(fmus):
    path = fmus[1]
    expected = alone(path)
    with unpacked(path) as instance:
        one, other = run(instance()), instance()
        rows = [next(one)]
        other.begin(method=1, link_angle_noise_std=1e-3)
        for step, row in enumerate(one):
            rows.append(row)
            other.doStep(step * H, H)
            other.set("motor_angle", float("nan"))
            if step == 4:
                other.setFMUState(other.state())
            if step == 8:
                assert other.reset() == OK
                other.setupExperiment(startTime=0.0)
        assert rows == expected


def test_other_code_under_the_same_names_runs_beside_this_one(fmus, other_code):
    shown = "load_torque_total"
    with unpacked(fmus[0]) as this, unpacked(other_code) as other:
        one, two = run(this()), run(other())
        assert [next(one)[shown], next(two)[shown]] == [2.0, 6.0]
        for first, second in zip(one, two, strict=True):
            assert second[shown] - first[shown] == pytest.approx(4.0)


def test_a_host_with_packages_of_our_names_gets_the_same_bits(fmus, tmp_path):
    for name in ("ndob_fmu", "fmus", "runtime"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").write_text("THIS_IS = 'something else'\n", "utf-8")
    program = """
import json, sys
import ndob_fmu
of_this_name = ndob_fmu
from fmpy import extract, read_model_description
from fmpy.fmi2 import FMU2Slave
rows = []
for path in sys.argv[1:]:
    read, folder = read_model_description(path), extract(path)
    references = [v.valueReference for v in read.modelVariables if v.causality == "output" and v.type == "Real"]
    fmu = FMU2Slave(instanceName="x", guid=read.guid, modelIdentifier=read.modelName, unzipDirectory=folder)
    fmu.instantiate()
    fmu.setupExperiment(startTime=0.0)
    fmu.enterInitializationMode()
    fmu.exitInitializationMode()
    for k in range(12):
        fmu.doStep(k * 1e-3, 1e-3)
    rows.append(fmu.getReal(references))
    fmu.freeInstance()
assert sys.modules["ndob_fmu"] is of_this_name
print(json.dumps([hasattr(of_this_name, "THIS_IS"), rows]))
"""

    def run_with(first):
        done = subprocess.run(
            [sys.executable, "-c", program, *map(str, fmus[:2])],
            env={"PYTHONPATH": str(first)},
            cwd=tmp_path.parent,
            capture_output=True,
            text=True,
            check=True,
        )
        return json.loads(done.stdout)

    of_others, rows = run_with(tmp_path)
    ours, expected = run_with(Path(__file__).parents[2])
    assert (of_others, ours) == (True, False)
    assert rows == expected


GLOBALS = """
import gc, sys
from fmpy import extract, read_model_description
from fmpy.fmi2 import FMU2Slave

description = read_model_description(sys.argv[1])
identifier = description.coSimulation.modelIdentifier
folder = extract(sys.argv[1], sys.argv[2])
for i in range(20):
    fmu = FMU2Slave(guid=description.guid, unzipDirectory=folder, modelIdentifier=identifier, instanceName=str(i))
    fmu.instantiate()
    fmu.freeInstance()
held = next(vars(module) for name, module in sys.modules.items() if name.startswith(f"{identifier}_"))

def counted_beside_owners(what):
    return sys.getrefcount(what) - len(gc.get_referrers(what))

print(counted_beside_owners(held) - counted_beside_owners({"a dictionary": ["as sound as any"]}))
"""


def test_the_code_of_an_fmu_has_all_the_references_that_are_counted_on_after_many_instances(fmus, tmp_path):
    """With fewer the process crashes at its end, after a correct run."""
    done = run_clean(GLOBALS, fmus[1], tmp_path / "unpacked", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) == 0


KEYS = """
import ctypes, sys
from pathlib import Path
from shutil import copytree
from fmpy import extract, read_model_description
from fmpy.fmi2 import FMU2Slave

def keys_left():
    made, key = [], ctypes.c_uint()
    while ctypes.CDLL(None).pthread_key_create(ctypes.byref(key), None) == 0:
        made.append(key.value)
    for each in made:
        ctypes.CDLL(None).pthread_key_delete(each)
    return len(made)

description = read_model_description(sys.argv[1])
identifier = description.coSimulation.modelIdentifier
folder = extract(sys.argv[1], sys.argv[2])
left = []
for i in range(4):
    copy = copytree(folder, f"{folder}{i}")
    fmu = FMU2Slave(guid=description.guid, unzipDirectory=copy, modelIdentifier=identifier, instanceName=str(i))
    fmu.instantiate()
    fmu.freeInstance()
    left.append(keys_left())
print(left[0] - left[-1])
"""


def test_every_further_folder_that_an_fmu_is_unpacked_to_takes_no_key_of_the_process(fmus, tmp_path):
    """There are 1024: a study that unpacks anew for each run came to an end at the thousandth."""
    done = run_clean(KEYS, fmus[0], tmp_path / "unpacked", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) == 0


def test_a_damaged_copy_of_an_fmu_spoils_no_other(fmus, tmp_path):
    """In a process that has not loaded the code before."""
    program = """
import sys
from pathlib import Path
from fmpy import extract, read_model_description
from fmpy.fmi2 import FMU2Slave

def load(fmu, name, damage=None):
    description = read_model_description(fmu)
    folder = extract(fmu, f"{sys.argv[1]}/{name}")
    if damage:
        next(Path(folder).glob(damage)).write_bytes(b"\\0")
    identifier = description.coSimulation.modelIdentifier
    slave = FMU2Slave(guid=description.guid, unzipDirectory=folder, modelIdentifier=identifier, instanceName=name)
    try:
        slave.instantiate()
    except Exception:
        return "refused"
    slave.freeInstance()
    return "loaded"

plant, observer = sys.argv[2:]
damaged = load(plant, "damaged", "resources/ndob_runtime_*/numerics/zeros.py")
print(damaged, load(plant, "plant"), load(observer, "observer"))
"""
    done = run_clean(program, tmp_path, fmus[0], fmus[1], cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1] == "refused loaded loaded"


def test_folders_with_an_encoded_space_in_their_names_are_told_apart(fmus, tmp_path):
    """pythonfmu reads such through a name that the next one gets too; Python remembers what lay there by its time."""
    folders = [tmp_path / "a%20b", tmp_path / "c%20d"]
    program = """
import os, sys
from pathlib import Path
from fmpy import extract, read_model_description
from fmpy.fmi2 import FMU2Slave

for number, fmu in enumerate(sys.argv[1:3]):
    description = read_model_description(fmu)
    folder = extract(fmu, sys.argv[3 + number])
    for path in [Path(folder), *Path(folder).rglob("*")]:
        os.utime(path, (1e9, 1e9))
    identifier = description.coSimulation.modelIdentifier
    slave = FMU2Slave(guid=description.guid, unzipDirectory=folder, modelIdentifier=identifier, instanceName="one")
    slave.instantiate()
    slave.freeInstance()
print("both")
"""
    done = run_clean(program, fmus[0], fmus[1], *folders, cwd=tmp_path)
    assert (done.returncode, done.stdout.splitlines()[-1:]) == (0, ["both"]), done.stdout + done.stderr
