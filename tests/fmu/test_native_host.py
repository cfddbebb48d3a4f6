"""The built FMUs in the C host tests/helpers/native/host.c, which starts with an empty environment."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import urllib.parse
import venv
from pathlib import Path

import numpy as np
import pytest

from ndob_fmu.cosim.fmi.fmu_component import FmuComponent
from tests.helpers.clean_process import ENVIRONMENT
from tests.helpers.native_host import IN_FMPY, RUN_AND_LEAVE, Native, compile_host, moved, unpack
from tests.helpers.needs import FRONT

pytestmark = FRONT

STEP = ("new fmu", "setup 0 10", "enter", "exit")


@pytest.fixture(scope="module")
def host(tmp_path_factory):
    return compile_host(tmp_path_factory.mktemp("host"))


@pytest.fixture(scope="module")
def observer(flexible_joint, host, tmp_path_factory):
    return unpack(flexible_joint.observer, tmp_path_factory.mktemp("observer"), host)


@pytest.fixture(scope="module")
def plant(flexible_joint, host, tmp_path_factory):
    return unpack(flexible_joint.plant, tmp_path_factory.mktemp("plant"), host)


@pytest.fixture(scope="module")
def without_numpy(tmp_path_factory):
    """Return the path of an interpreter that has no NumPy."""
    folder = tmp_path_factory.mktemp("bare") / "venv"
    venv.create(folder, symlinks=True, with_pip=False)
    return folder / "bin" / "python"


def elsewhere(native: Native, folder: Path) -> Native:
    """Return the FMU as on a machine that did not build it."""
    copy = moved(native, folder)
    text = copy.front.read_text("utf-8")
    copy.front.write_text(re.sub(r"(?m)^(python|libpython|packages)=.*", r"\1=/not/here", text), "utf-8")
    return copy


def suitable(python: str | Path = sys.executable) -> dict[str, str]:
    return {"NDOB_FMU_PYTHON": str(python)}


def assert_one_error(run, *words):
    """One line in the log, an instance that is NULL, and a host that goes on to its end."""
    assert (run.code, run.replies) == (0, ["new NULL"])
    ((status, category, text),) = run.log
    assert (status, category) == ("Error", "logStatusError")
    for word in words:
        assert word in text


# -- it runs


def test_a_native_host_gets_the_trajectory_that_python_gets(plant, flexible_joint):
    outputs = ("motor_angle", "link_angle", "link_rate", "motor_rate", "load_torque_total")
    done = plant.run(*STEP, f"run 50 0.01 - {plant.references(*outputs)}", "last", "terminate", "free")
    assert (done.code, done.log, done.replies[-2:]) == (0, [], ["terminate OK", "free OK"])
    assert done.replies[-3] == "0.5 last OK"
    component = FmuComponent(flexible_joint.plant)
    expected = np.empty(len(outputs))
    try:
        component.setup(0.0, 10.0, {}, [])
        component.initialize()
        for k in range(50):
            component.step(k * 0.01, 0.01)
        component.get_outputs(expected)
    finally:
        component.close()
    got = [float(value) for value in done.replies[4].split()[:5]]
    np.testing.assert_allclose(got, expected, rtol=1e-12)


NAMES = ("plain", "with space", "ä # + [ ( , ' x", "100%", "%41", "a%20b", "日本")


@pytest.mark.parametrize("name", NAMES)
def test_it_runs_from_any_folder(plant, name, tmp_path):
    done = moved(plant, tmp_path / name).run(*RUN_AND_LEAVE)
    assert (done.code, done.log, done.replies[-1]) == (0, [], "free OK")


@pytest.mark.parametrize("form", ["file:{}", "file://{}", "file://localhost{}", "FILE://{}/", "file:{}/."])
@pytest.mark.parametrize("encoded", [True, False])
def test_every_form_of_the_resource_uri_is_read(plant, form, encoded, tmp_path):
    copy = moved(plant, tmp_path / "ä # + [ ( , ' x")
    path = str(copy.resources)
    done = copy.run("new fmu", "free", uri=form.format(urllib.parse.quote(path) if encoded else path))
    assert (done.code, done.log, done.replies) == (0, [], ["new OK", "free OK"])


@pytest.mark.parametrize(
    ("uri", "received"),
    [("-", "NULL"), ("file:///not/here", "file:///not/here"), ("http://x/y", "http://x/y"), ("100%s%n%", "100%s%n%")],
)
def test_resources_that_cannot_be_read_end_in_one_line_and_no_instance(plant, uri, received):
    assert_one_error(plant.run("new fmu", uri=uri), "fmuResourceLocation", "expected", received)


def test_a_wrong_guid_and_an_empty_name_end_in_one_line_and_no_instance(plant):
    assert_one_error(plant.run("new fmu", guid="{another}"), "fmuGUID", plant.guid, "{another}")
    assert_one_error(plant.run("new "), "instanceName", "empty")


def test_the_process_ends_with_code_zero_every_time(observer):
    """A few times; `make exits` does it a hundred times, and all tests here look at the code."""
    assert [observer.run(*RUN_AND_LEAVE).code for _ in range(5)] == [0] * 5


def test_a_host_that_frees_nothing_ends_with_code_zero_too(observer):
    assert {observer.run(*RUN_AND_LEAVE[:-2]).code for _ in range(3)} == {0}


def test_fmpy_ends_with_code_zero_every_time(flexible_joint):
    command = [sys.executable, "-c", IN_FMPY, str(flexible_joint.observer)]
    codes = [subprocess.run(command, env=ENVIRONMENT, check=False).returncode for _ in range(3)]
    assert codes == [0] * 3


def test_two_threads_step_two_instances_to_the_bits_of_one(observer):
    outputs = observer.references("link_angle_hat", "motor_rate_hat", "load_torque_hat")
    inputs = observer.references("motor_angle", "link_angle")
    start = ("setup 0 10", "enter", f"setR {inputs} 0.5,0.25", "exit")
    alone = observer.run("new a", *start, "run 300 0.001 - -", f"getR {outputs}").replies[-1]
    commands = ("new a", "new b", "at 0", *start, "at 1", *start, "threads 300")
    done = observer.run(*commands, f"getR {outputs}", "free", "at 0", f"getR {outputs}", "free")
    got = [reply for reply in done.replies if reply.endswith("getR OK")]
    assert (done.code, done.log, got) == (0, [], [alone, alone])


def test_a_host_that_traps_floating_point_errors_lives_keeps_its_traps_and_gets_the_same_bits(observer):
    """LAPACK divides by zero on purpose."""
    outputs = observer.references("link_angle_hat", "load_torque_hat")
    run = (*STEP, f"run 20 0.001 - {outputs}")
    expected = observer.run(*run).replies[-1]
    done = observer.run("traps", *run, "traps")
    assert (done.code, done.log) == (0, [])
    assert done.replies[0] == "traps off"
    assert done.replies[-2:] == [expected, "traps on"]


def test_threads_may_make_and_free_instances_with_their_states_at_once(plant):
    done = plant.run("new keeper", "storm 60", "setup 0", "enter", "exit", "step 0 0.001")
    assert (done.code, done.log) == (0, [])
    assert done.replies == ["new OK", "storm OK", "setup OK", "enter OK", "exit OK", "step OK"]


@pytest.mark.parametrize(
    ("file", "content", "words"),
    [
        ("slavemodule.txt", None, ["expected the file slavemodule.txt of the build, received none"]),
        ("slavemodule.txt", b"", ["slavemodule.txt: expected FlexibleJointPlant_"]),
        ("FlexibleJointPlant_*.py", None, ["expected the file FlexibleJointPlant_"]),
        ("FlexibleJointPlant_*.py", b"", ["received code that does not run"]),
        ("ndob_runtime_*/blocks/plant.py", None, ["plant.py of the build, received none"]),
        ("ndob_runtime_*/blocks/plant.py", b"\0", ["received code that does not run", "SyntaxError"]),
        ("pythonfmu/enums.py", None, ["expected the file pythonfmu/enums.py of the build, received none"]),
        ("front.txt", b"guid={1}\n", ["front.txt: expected the file that the build wrote"]),
    ],
)
def test_an_fmu_with_missing_or_damaged_files_ends_in_one_line_and_no_instance(plant, file, content, words, tmp_path):
    copy = moved(plant, tmp_path / "damaged")
    (path,) = copy.resources.glob(file)
    if content is None:
        path.unlink()
    else:
        path.write_bytes(content)
    assert_one_error(copy.run("new fmu", guid=plant.guid), *words)


# -- which Python


def test_a_python_whose_path_ends_like_one_that_was_tried_is_tried_too(plant, tmp_path):
    copy = elsewhere(plant, tmp_path / "fmu")
    second = tmp_path / "bin"
    first = Path(f"{tmp_path}/pre{second}")
    for folder, program in ((first, "exit 1"), (second, f'exec "{sys.executable}" "$@"')):
        folder.mkdir(parents=True)
        (folder / "python3").write_text(f"#!/bin/sh\n{program}\n", "utf-8")
        (folder / "python3").chmod(0o755)
    done = copy.run(*RUN_AND_LEAVE, env={"PATH": f"{first}:{second}"})
    assert (done.code, done.log, done.replies[0]) == (0, [], "new OK")


def test_the_building_environments_python_is_found_with_nothing_set(plant):
    recorded = dict(line.split("=", 1) for line in plant.front.read_text("utf-8").splitlines())
    assert recorded["python"] == sys.executable
    assert Path(recorded["packages"], "numpy").is_dir()
    assert plant.run("new fmu").replies == ["new OK"]


def test_elsewhere_the_environment_variable_names_an_interpreter(plant, tmp_path):
    copy = elsewhere(plant, tmp_path / "copy")
    done = copy.run(*RUN_AND_LEAVE, env=suitable())
    assert (done.code, done.log, done.replies[-1]) == (0, [], "free OK")


def test_elsewhere_the_systems_python_on_the_path_serves(plant, tmp_path):
    copy = elsewhere(plant, tmp_path / "copy")
    done = copy.run("new fmu", env={"PATH": str(Path(sys.executable).parent)})
    assert (done.code, done.log, done.replies) == (0, [], ["new OK"])


def test_settings_for_another_python_do_no_harm(plant, tmp_path):
    other = {"PYTHONHOME": "/not/here", "PYTHONPATH": "/not/here", "LC_ALL": "C", "PYTHONUTF8": "0"}
    for native, env in ((plant, other), (elsewhere(plant, tmp_path / "ä"), other | suitable())):
        assert native.run("new fmu", env=env).replies == ["new OK"]


def test_without_numpy_one_line_tells_what_was_tried_and_the_host_goes_on(plant, without_numpy, tmp_path):
    copy = elsewhere(plant, tmp_path / "copy")
    env = suitable(without_numpy) | {"PATH": str(without_numpy.parent)}
    assert_one_error(copy.run("new fmu", env=env), f"{without_numpy} has no NumPy", "/not/here", "NDOB_FMU_PYTHON")
    again = copy.run("new fmu", "new fmu", env=env)
    assert (again.code, again.replies, len(again.log)) == (0, ["new NULL", "new NULL"], 2)


@pytest.mark.parametrize(
    ("named", "reason"),
    [
        ("/not/here", "which cannot be read"),
        ("/bin/true", "no Python that runs"),
        (os.devnull, "cannot be run"),
        ("/bin/x%n.so", "which cannot be read"),
    ],
)
def test_what_is_no_python_is_passed_over_with_a_warning_if_another_serves(plant, named, reason):
    done = plant.run("new fmu - on", env={"NDOB_FMU_PYTHON": named})
    ((status, category, text),) = done.log
    assert (done.replies, status, category) == (["new OK"], "Warning", "logStatusWarning")
    assert named in text
    assert reason in text
    assert plant.run("new fmu", env={"NDOB_FMU_PYTHON": named}).log == []


# -- what a host can do by mistake


def refused(native, *commands):
    """Return the text of the error that the last command gives, after which all goes on."""
    done = native.run(*STEP, *commands, "step 0 0.01", "free")
    assert (done.code, done.replies[-2:]) == (0, ["step OK", "free OK"])
    assert done.replies[-3].endswith(" Error")
    ((status, category, text),) = done.log
    assert (status, category) == ("Error", "logStatusError")
    return text


@pytest.mark.parametrize(
    ("command", "words"),
    [
        ("getR 0,99", ["fmi2GetReal", "99"]),
        ("getR {valid}", ["fmi2GetReal", "valid", "Boolean"]),
        ("setB {alpha} 1", ["fmi2SetBoolean", "alpha", "Real"]),
        ("setR {alpha} 2", ["fmi2SetReal", "alpha", "fixed parameter", "step mode"]),
        ("setI {method} 1", ["fmi2SetInteger", "method", "fixed parameter"]),
        ("setR {link_angle_hat} 1", ["fmi2SetReal", "link_angle_hat", "calculates"]),
        ("setup 0 1", ["fmi2SetupExperiment", "instantiated", "step mode"]),
        ("enter", ["fmi2EnterInitializationMode", "instantiated", "step mode"]),
        ("exit", ["fmi2ExitInitializationMode", "initialization mode", "step mode"]),
    ],
)
def test_a_call_that_fmi_does_not_allow_is_an_error_that_says_why_and_changes_nothing(observer, command, words):
    name = re.search(r"\{(.*)\}", command)
    text = refused(observer, re.sub(r"\{(.*)\}", lambda found: observer.references(found[1]), command))
    for word in [*words, "expected", "received", *([name[1]] if name else [])]:
        assert word in text


def test_a_refused_set_changes_none_of_its_variables(plant):
    both = plant.references("motor_torque", "gravity_torque")
    done = plant.run(*STEP, f"setR {both} 7,8", f"getR {both}")
    assert done.replies[-2:] == ["setR Error", "0 10 getR OK"]


def test_calls_before_their_time_are_errors_and_the_right_order_still_works(plant):
    done = plant.run(
        "new a", "enter", "exit", "step 0 0.1", "terminate", "setup 3 1", "setup nan", *STEP[1:], "step 0 0.1"
    )
    replies = [reply.split()[-1] for reply in done.replies]
    assert replies == ["OK", *["Error"] * 6, *["OK"] * 4]
    assert len(done.log) == 6
    assert "fmi2SetupExperiment" in done.log[0][2]


def test_after_the_end_values_can_be_read_but_not_set_nor_stepped_until_a_reset(plant):
    end = (*STEP, "terminate", "getR 2", "setR 0 1", "step 0 0.1", "terminate")
    done = plant.run(*end, "reset", *STEP[1:], "step 0 0.1")
    assert [reply.split()[-1] for reply in done.replies[5:10]] == ["OK", "Error", "Error", "Error", "OK"]
    assert done.replies[-1] == "step OK"


def test_a_freed_instance_is_known_as_such_also_when_another_has_come_after_it(plant):
    done = plant.run("new a", "free", "free", "getR 2", "reset", "new b", "at 0", "getR 2", "free", "at 1", "getR 2")
    assert done.code == 0
    assert [reply.split()[-1] for reply in done.replies[1:]] == [
        *["OK", "OK", "Error", "Error", "OK", "OK", "Error", "OK", "OK", "OK"]
    ]


def test_nothing_is_logged_when_all_is_well_and_categories_choose_what_is(plant):
    wrong = plant.references("gravity_torque") + " 1"
    assert plant.run("new a - on", *STEP[1:], "run 20 0.01 - 2", "terminate", "free").log == []
    done = plant.run("new a - on", "log 1 logStatusError,notOne", "log 0 logAll", *STEP[1:], f"setR {wrong}")
    # The warning about the unknown category is itself not in the categories chosen; errors are told in any case.
    assert [status for status, _, _ in done.log] == ["Error"]
    assert done.replies[1:3] == ["log Warning", "log OK"]


def test_what_the_slave_refuses_is_an_error_until_it_is_put_right(observer):
    alpha = observer.references("alpha")
    done = observer.run(
        "new a", *STEP[1:3], f"setR {alpha} nan", "exit", "getR 3", f"setR {alpha} 1", "exit", "step 0 0.1"
    )
    assert [reply.split()[-1] for reply in done.replies[3:]] == ["Error", "Error", "Error", "OK", "OK", "OK"]
    assert len(done.log) == 3
    for status, category, text in done.log:
        assert (status, category) == ("Error", "logStatusError")
        assert "alpha: expected" in text
        assert "received nan" in text


def test_a_step_that_cannot_be_taken_is_discarded_and_the_right_one_follows(plant):
    wrong = ("step 0.1 0", "step 0.1 -1", "step 0.1 nan", "step 0.1 inf", "step 7 0.1", "step nan 0.1")
    done = plant.run(*STEP, "step 0 0.1", "getR 2,3", *wrong, "getR 2,3", "last", "step 0.1 0.1", "last", "step 0.2 20")
    before, *statuses, after, last, step, end, beyond = done.replies[5:]
    assert before == after
    assert statuses == ["step Discard"] * 6
    assert (last, step, end, beyond) == (
        "0.10000000000000001 last OK",
        "step OK",
        "0.20000000000000001 last OK",
        "step Error",
    )
    assert [status for status, _, _ in done.log] == ["Discard"] * 6 + ["Error"]


def test_warnings_are_told_only_to_those_who_asked(plant):
    steps = (*STEP[1:], "setR 0 nan", "step 0 0.1", "free")
    for instance, logged in (("new a", []), ("new a - on", ["Warning"])):
        done = plant.run(instance, *steps)
        assert done.replies[-2:] == ["step Warning", "free OK"]
        assert [status for status, _, _ in done.log] == logged


# -- state


@pytest.mark.parametrize("name", ["plant", "observer"])
def test_a_state_goes_on_with_the_same_bits_in_another_process_and_after_a_reset(request, name, tmp_path):
    native = request.getfixturevalue(name)
    saved, outputs = tmp_path / "state", "3,4,5,6"
    start = ("new a", "setup 0 10", "enter", "exit", f"run 5 0.01 0,1 {outputs}", "save", f"bytes {saved}")
    following = [f"step {0.05 + 0.01 * k!r} 0.01" for k in range(3)]
    going_on = ("last", "setR 0,1 0.5,0.25", *following, f"getR {outputs}", "last")
    first = native.run(*start, *going_on, "reset", "restore", *going_on)
    other = native.run("new b", f"unbytes {saved}", "restore", *going_on)
    assert first.log == other.log == []
    assert first.replies[7:14] == first.replies[16:23] == other.replies[3:10]
    assert first.replies[7] == "0.050000000000000003 last OK"


def test_a_state_of_another_fmu_a_freed_or_damaged_one_is_refused(plant, observer, tmp_path):
    saved = tmp_path / "state"
    saving = ("new a", "setup 0", "enter", "exit", "save", f"bytes {saved}", "drop", "drop", "restore", "free")
    done = plant.run(*saving)
    assert done.replies[4:] == ["save OK", "bytes OK", "drop OK", "drop OK", "restore Error", "free OK"]
    assert "NULL" in done.log[0][2]
    whole = saved.read_bytes()
    damaged = {
        "short": whole[:-1],
        "empty": b"",
        "other": bytes(len(whole)),
        "flipped": whole[:-1] + bytes([whole[-1] ^ 1]),
    }
    for name, content in damaged.items():
        (tmp_path / name).write_bytes(content)
    for native, files in ((plant, damaged), (observer, {"state": whole})):
        done = native.run("new a", *(f"unbytes {tmp_path / name}" for name in files), "free")
        assert (done.code, done.replies) == (0, ["new OK", *["unbytes Error"] * len(files), "free OK"])
        assert len(done.log) == len(files)
    done = plant.run("new a", f"unbytes {saved}", "restore", "last")
    assert done.replies == ["new OK", "unbytes OK", "restore OK", "0 last OK"]


def test_a_state_is_gone_with_the_instance_that_made_it(plant):
    done = plant.run("new a", "new b", "at 0", "save", "at 1", "restore", "at 0", "free", "at 1", "restore", "free")
    assert (done.code, done.replies[5], done.replies[-2:]) == (0, "restore OK", ["restore Error", "free OK"])
