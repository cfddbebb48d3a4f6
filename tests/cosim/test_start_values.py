"""FMUs with other start values: the same as setting these, for tools that cannot or do not."""

from __future__ import annotations

import re
import zipfile

import fmpy
import pytest

from ndob_fmu.errors import CouplingError, UsageError
from ndob_fmu.packages import fmu_with_start_values
from tests.helpers.clean_process import fmpy as fmpy_command
from tests.helpers.fmi_instance import ERROR, OK, opened
from tests.helpers.native_host import compile_host, unpack

H = 1e-3
PAPER = {"method": 1, "pi_start": 1e3, "pi_end": 1e6, "motor_torque": 0.1 + 0.2, "link_angle_hat_start": -0.75}


@pytest.fixture
def paper(flexible_joint, tmp_path):
    path = tmp_path / "Paper.fmu"
    path.write_bytes(fmu_with_start_values(flexible_joint.observer, PAPER))
    return path


def steps(instance):
    return [instance.step(k * H, H, motor_angle=0.1 * k, link_angle=0.2) for k in range(20)]


def test_it_runs_as_the_fmu_does_when_these_values_are_set(paper, flexible_joint):
    with opened(paper) as one, opened(flexible_joint.observer) as other:
        one.begin()
        other.begin(**PAPER)
        expected = steps(other)
        assert steps(one) == expected
        assert one.reset() == OK
        one.begin()
        assert steps(one) == expected
        assert one.reset() == OK
        one.begin(method=2)
        assert steps(one) != expected


def test_a_native_host_runs_it_too(paper, flexible_joint, tmp_path):
    host = compile_host(tmp_path)
    fmus = [unpack(fmu, tmp_path / fmu.stem, host) for fmu in (paper, flexible_joint.observer)]
    assert fmus[0].guid != fmus[1].guid
    run = ("new fmu", "setup 0 10", "enter", "exit", f"run 20 0.001 - {fmus[0].references('load_torque_hat')}")
    replies = [fmu.run(*run) for fmu in fmus]
    assert [(reply.code, reply.log) for reply in replies] == [(0, []), (0, [])]
    assert replies[0].replies[-1] != replies[1].replies[-1]


def test_the_model_description_has_the_values_and_is_valid(paper, tmp_path):
    starts = {v.name: v.start for v in fmpy.read_model_description(paper).modelVariables}
    assert {name: float(starts[name]) for name in PAPER} == PAPER
    done = fmpy_command("validate", paper, cwd=tmp_path)
    assert (done.returncode, "No problems found" in done.stdout) == (0, True), done.stdout + done.stderr


def test_minus_zero_is_another_value_than_zero(flexible_joint):
    one, other = (fmu_with_start_values(flexible_joint.plant, {"load_torque": value}) for value in (0.0, -0.0))
    assert one != other


def test_the_same_values_give_the_same_bytes_and_others_another_guid(flexible_joint, tmp_path):
    guids = set()
    for value in (1e3, 1e4, 1e3):
        path = tmp_path / "one.fmu"
        path.write_bytes(fmu_with_start_values(flexible_joint.observer, {"pi_start": value}))
        again = fmu_with_start_values(flexible_joint.observer, {"pi_start": value})
        assert path.read_bytes() == again
        guids.add(fmpy.read_model_description(path).guid)
        with zipfile.ZipFile(path) as archive:
            front = archive.read("resources/front.txt").decode()
        assert re.findall("guid=(.*)", front) == [fmpy.read_model_description(path).guid]
    assert len(guids) == 2


def test_values_on_values_add_up(paper, tmp_path):
    again = tmp_path / "again.fmu"
    again.write_bytes(fmu_with_start_values(paper, {"pi_end": 1e7}))
    starts = {v.name: v.start for v in fmpy.read_model_description(again).modelVariables}
    assert (float(starts["pi_start"]), float(starts["pi_end"])) == (1e3, 1e7)


def test_a_value_out_of_its_range_is_refused_at_the_start_as_if_it_had_been_set(flexible_joint, tmp_path):
    path = tmp_path / "wrong.fmu"
    path.write_bytes(fmu_with_start_values(flexible_joint.observer, {"pi_end": -1.0}))
    with opened(path) as one:
        assert one.setupExperiment(startTime=0.0) == OK
        assert one.enterInitializationMode() == OK
        assert one.exitInitializationMode() == ERROR
        assert one.said[-1] == "pi_end: expected a finite number > 0, received -1.0"
        assert one.set("pi_end", 1e6) == OK
        assert one.exitInitializationMode() == OK


def test_an_fmu_of_others_is_left_as_it_is(flexible_joint, tmp_path):
    stock = tmp_path / "stock.fmu"
    with zipfile.ZipFile(flexible_joint.plant) as source, zipfile.ZipFile(stock, "w") as target:
        for name in source.namelist():
            if name != "resources/start_values.json":
                target.writestr(name, source.read(name))
    assert fmu_with_start_values(stock, {"load_torque": 1.0}) == stock.read_bytes()


@pytest.mark.parametrize(
    ("values", "error", "says"),
    [
        ({"pi_ende": 1.0}, CouplingError, "pi_ende: expected a variable that takes a start value, received none"),
        ({"valid": True}, CouplingError, "valid: expected a variable that takes a start value, received one of causal"),
        ({"pi_end": "much"}, UsageError, "pi_end: expected a number"),
    ],
)
def test_what_cannot_be_a_start_value_is_refused_in_one_line(flexible_joint, values, error, says):
    with pytest.raises(error, match=says):
        fmu_with_start_values(flexible_joint.observer, values)
