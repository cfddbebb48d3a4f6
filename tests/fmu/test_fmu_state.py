"""States of FMUs: what is restored replays to the last bit, wherever and whenever it is."""

from __future__ import annotations

import ctypes
import dataclasses
import hashlib
import json
import os
import struct
import subprocess
import sys
from itertools import count
from math import inf, nan
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from fmus.slave_state import Snapshot, from_bytes, to_bytes
from ndob_fmu import build
from ndob_fmu.codegen.compile_model import compile_model
from ndob_fmu.errors import NdobError
from ndob_fmu.runtime.blocks.plant import PlantState
from ndob_fmu.runtime.numerics.hold import History
from tests.helpers.fmi_instance import DISCARD, ERROR, OK, opened, unpacked
from tests.helpers.problems import MODELS

H = 1e-3
# What ndob_fmu/fmu/shell/state.c writes before the slave's bytes: magic, FMU, size, hash, mode, experiment, time.
HEAD_FIELDS = struct.Struct("<8sQQQIId")
HEAD = HEAD_FIELDS.size
PAPER = {"method": 1, "pi_end": 1e6, "pi_ramp_time": 0.02}


def sample(t):
    return {"motor_angle": np.sin(3.0 * t), "link_angle": np.cos(2.0 * t), "motor_torque": np.sin(t)}


def go_on(instance, start, steps, inputs=sample):
    """Step on and return all outputs; the steps change their length on the way, and a sample is lost."""
    t, rows = start, []
    for k in range(steps):
        h = H if k < steps // 2 else 3.0 * H
        now = dict.fromkeys(inputs(t), float("nan")) if k == steps // 3 else inputs(t)
        rows.append(instance.step(t, h, **now))
        t += h
    return rows


@pytest.fixture(scope="module", params=["paper", "sampled_data", "order 0"])
def observer(request, flexible_joint):
    starts = {"paper": PAPER, "sampled_data": {"method": 2}, "order 0": {"method": 2, "disturbance_order": 0}}
    return flexible_joint.observer, starts[request.param]


@pytest.mark.parametrize("before", [0, 1, 15, 60], ids="after {} steps".format)
def test_what_follows_a_restored_state_is_what_followed_it_before(observer, before):
    path, parameters = observer
    with unpacked(path) as instance:
        one, other = instance(), instance("other")
        one.begin(**parameters)
        go_on(one, 0.0, before)
        t = sum(H if k < before // 2 else 3.0 * H for k in range(before))
        state = one.state()
        data = one.bytes_of(state)
        follows = go_on(one, t, 30)
        assert follows[0] != follows[-1]
        assert one.setFMUState(state) == OK
        assert go_on(one, t, 30) == follows
        # After a reset, and in an instance that has done nothing yet.
        for fresh in (one, other):
            assert fresh.reset() == OK
            status, restored = fresh.from_bytes(data)
            assert status == OK
            assert fresh.setFMUState(restored) == OK
            assert go_on(fresh, t, 30) == follows
        assert not one.said
        assert not other.said


def test_a_state_replays_in_another_process(flexible_joint, tmp_path):
    with opened(flexible_joint.observer) as one:
        one.begin(**PAPER)
        go_on(one, 0.0, 0)
        rows = [one.step(k * H, H, **sample(k * H)) for k in range(25)]
        (tmp_path / "state").write_bytes(one.bytes_of(one.state()))
        rows = [one.step(k * H, H, **sample(k * H)) for k in range(25, 50)]
    program = """
import json, sys
from tests.helpers.fmi_instance import OK, opened
from tests.fmu.test_fmu_state import H, sample
with opened(sys.argv[1]) as one:
    status, state = one.from_bytes(open(sys.argv[2], "rb").read())
    assert status == OK and one.setFMUState(state) == OK
    print(json.dumps([one.step(k * H, H, **sample(k * H)) for k in range(25, 50)]))
"""
    done = subprocess.run(
        [sys.executable, "-c", program, str(flexible_joint.observer), str(tmp_path / "state")],
        cwd=Path(__file__).parents[2],
        # The same processor's kernels: others differ in the last bits.
        env={"PYTHONPATH": ":".join(filter(None, sys.path))} | {k: v for k, v in os.environ.items() if "BLAS" in k},
        capture_output=True,
        text=True,
        check=True,
    )
    assert json.loads(done.stdout) == rows


def test_the_plants_state_holds_its_time_its_integrator_and_its_last_inputs(flexible_joint):
    with opened(flexible_joint.plant) as plant:
        plant.begin(**{"disturbance.kind": 3, "disturbance.amplitude": 2.0, "disturbance.start_time": 0.0105})
        torque = lambda t: {"motor_torque": np.sin(40.0 * t), "load_torque": 1.0}  # noqa: E731
        go_on(plant, 0.0, 9, torque)
        t = sum(H if k < 4 else 3.0 * H for k in range(9))
        state = plant.state()
        follows = go_on(plant, t, 30, torque)
        assert plant.reset() == OK
        assert plant.setFMUState(state) == OK
        assert go_on(plant, t, 30, torque) == follows


def test_a_state_of_initialization_mode_brings_its_mode_and_parameters_back(flexible_joint):
    with unpacked(flexible_joint.observer) as instance:
        one, other = instance(), instance()
        assert one.setupExperiment(startTime=0.5) == OK
        assert one.set("link_angle_hat_start", 0.25) == OK
        assert one.enterInitializationMode() == OK
        state, outputs = one.bytes_of(one.state()), one.get()
        assert one.exitInitializationMode() == OK
        follows = one.step(0.5, H, **sample(0.0))
        status, restored = other.from_bytes(state)
        assert (status, other.setFMUState(restored)) == (OK, OK)
        assert other.get() == outputs
        assert other.doStep(0.5, H) == ERROR  # still in initialization mode
        assert other.exitInitializationMode() == OK
        assert other.step(0.5, H, **sample(0.0)) == follows


@pytest.mark.parametrize("name", ["tool_on_arm", "car_in_crosswind"])
def test_models_with_a_turning_channel_or_several_disturbances_replay_too(name, tmp_path):
    model = MODELS[name]
    _, path = build(model, tmp_path)
    names = [*compile_model(model).inputs, *compile_model(model).outputs]

    def inputs(t):
        return {name: 0.1 * np.sin((2.0 + i) * t) for i, name in enumerate(names)}

    with opened(path) as one:
        one.begin()
        go_on(one, 0.0, 20, inputs)
        data = one.bytes_of(one.state())
        t = 10 * H + 30 * H
        follows = go_on(one, t, 20, inputs)
        assert one.reset() == OK
        _, state = one.from_bytes(data)
        assert one.setFMUState(state) == OK
        assert go_on(one, t, 20, inputs) == follows


def test_a_step_that_is_refused_after_a_restored_state_is_judged_by_the_restored_time(flexible_joint):
    with opened(flexible_joint.plant) as plant:
        plant.begin()
        state = plant.state()
        plant.step(0.0, H)
        assert plant.setFMUState(state) == OK
        assert plant.doStep(H, H) == DISCARD
        assert plant.doStep(0.0, H) == OK


@pytest.mark.parametrize(
    "spoil", [lambda b: b[:-1], lambda b: b[: len(b) // 2], lambda b: b"", lambda b: b[:99] + b"x" + b[100:]]
)
def test_bytes_that_are_no_state_are_refused_and_the_instance_goes_on(flexible_joint, spoil):
    with unpacked(flexible_joint.observer) as instance:
        one, twin = instance(), instance()
        for each in (one, twin):
            each.begin()
            each.step(0.0, H, **sample(0.0))
        status, _ = one.from_bytes(spoil(one.bytes_of(one.state())))
        assert status == ERROR
        assert len(one.said) == 1
        assert one.step(H, H, **sample(H)) == twin.step(H, H, **sample(H))


# -- the bytes themselves

numbers = st.floats() | st.integers() | st.booleans() | st.text() | st.none()
cores = st.recursive(
    numbers | arrays.arrays(np.float64, arrays.array_shapes(max_dims=3, min_side=0)),
    lambda inner: (
        st.lists(inner).map(tuple) | st.builds(PlantState, inner, inner, inner) | st.builds(History, inner, inner)
    ),
    max_leaves=8,
)


def same(a, b):
    if isinstance(a, np.ndarray):
        return a.shape == b.shape and a.dtype == b.dtype and np.array_equal(a, b, equal_nan=True)
    if isinstance(a, tuple):
        return len(a) == len(b) and all(map(same, a, b))
    if isinstance(a, (PlantState, History)):
        return type(a) is type(b) and all(map(same, vars(a).values(), vars(b).values()))
    return type(a) is type(b) and (a == b or a != a)


@settings(max_examples=150, deadline=None, derandomize=True)
@given(cores, st.lists(numbers).map(tuple))
def test_any_memory_comes_back_from_its_bytes(core, values):
    snapshot = Snapshot("module.Slave", values, None, core, True, False, 0.0, None, 0.1 + 0.2, 1e-3)
    data = to_bytes(snapshot)
    assert to_bytes(snapshot) == data
    back = from_bytes(data, (PlantState, History)).snapshot
    assert same(back.core, core)
    assert same(back.values, values)
    assert (back.slave, back.time) == (snapshot.slave, snapshot.time)


def test_bytes_name_only_the_states_that_the_slave_has():
    data = to_bytes(Snapshot("module.Slave", (), None, PlantState(1.0, 2.0, 3.0), True, False, 0.0, None, 0.0, 0.0))
    with pytest.raises(NdobError, match="FMU state: expected the bytes of a state of this FMU, received 'PlantState'"):
        from_bytes(data, (History,))


@pytest.mark.parametrize(
    "respell",
    [
        lambda text: text.replace(",", ", ", 1),
        lambda text: text.replace('{"state"', '{"state":0,"state"', 1),
        lambda text: text.replace("0.5", "0.50"),
        lambda text: text.replace("0.5", "1e400"),
        lambda text: text.replace('"module', '"\\u006dodule'),
        lambda text: "\ufeff" + text,
    ],
)
def test_bytes_that_are_not_spelt_as_a_slave_spells_them_are_no_state(respell):
    data = to_bytes(Snapshot("module.Slave", (), None, None, True, False, 0.0, None, 0.5, 0.0))
    assert from_bytes(data, ()).snapshot.time == 0.5
    content = respell(data[32:].decode()).encode()
    with pytest.raises(NdobError, match="FMU state: expected the bytes of a state of this FMU"):
        from_bytes(hashlib.sha256(content).digest() + content, ())


@pytest.mark.parametrize(
    "content", [b"", b"1", b"{}", b'{"state":["Snapshot"]}', b'{"array":["|O",[1],""]}', b"[" * 10**5]
)
def test_bytes_with_a_right_checksum_that_no_snapshot_was_made_into_are_no_state(content):
    with pytest.raises(NdobError, match="FMU state: expected the bytes of a state of this FMU"):
        from_bytes(hashlib.sha256(content).digest() + content, ())


def forged(data, mode=None, **changes):
    """The bytes of a state with other contents, and the checksums of front and slave that go with these."""
    head, content = data[:HEAD], json.loads(data[HEAD + 32 :])
    fields = [field.name for field in dataclasses.fields(Snapshot)]
    for name, change in changes.items():
        place = 1 + fields.index(name)
        content["state"][place] = change(content["state"][place])
    text = json.dumps(content, separators=(",", ":")).encode()
    inner = hashlib.sha256(text).digest() + text
    magic, fmu, _, _, *progress = HEAD_FIELDS.unpack(head)
    progress[0] = progress[0] if mode is None else mode
    progress_bytes = HEAD_FIELDS.pack(magic, fmu, 0, 0, *progress)[32:]
    check = 0xCBF29CE484222325
    for byte in progress_bytes + inner:
        check = (check ^ byte) * 0x100000001B3 % 2**64
    return HEAD_FIELDS.pack(magic, fmu, len(inner), check, *progress) + inner


@pytest.fixture(scope="module")
def two_that_step(flexible_joint):
    """Two equal observers after one step, and the numbers of the next steps."""
    with unpacked(flexible_joint.observer) as instance:
        pair = instance(), instance("twin")
        for each in pair:
            each.begin()
            each.step(0.0, H, **sample(0.0))
        yield *pair, count(1)


def entry(place, value):
    """Return the change of one entry of a tuple."""
    return lambda before: {"tuple": [value if i == place else old for i, old in enumerate(before["tuple"])]}


@pytest.mark.parametrize(
    "changes",
    [
        {"started_with": lambda value: {"tuple": [0.0] * len(value["tuple"])}},
        {"started_with": lambda value: {"tuple": value["tuple"][1:]}},
        {"started_with": entry(0, 2.0)},
        {"started_with": lambda _: None},
        {"values": lambda value: {"tuple": [*value["tuple"], 0.0]}},
        {"values": lambda _: 3.0},
        {"values": entry(0, "text")},
        {"values": entry(0, 1)},
        {"values": entry(0, True)},
        {"slave": lambda _: "another.Slave"},
        {"slave": lambda _: "\ud800%n"},
        {"slave": lambda _: 1.0},
        {"initializing": lambda _: 0.5},
        {"initializing": lambda _: True},
        {"stale": lambda _: True},
        {"start_time": lambda _: nan},
        {"start_time": lambda _: 1.0},
        {"stop_time": lambda _: "late"},
        {"stop_time": lambda _: -1.0},
        {"time": lambda _: None},
        {"time": lambda _: inf},
        {"time": lambda _: 10**400},
        {"step_size": lambda _: 10**400},
        {"step_size": lambda _: -1e-3},
        {"step_size": lambda _: 1e3},
        {"core": lambda _: None},
        {"core": lambda value: {"state": [*value["state"][:-1], 1.0]}},
        {"core": lambda value: {"state": [value["state"][0], {"tuple": [nan] * 7}, *value["state"][2:]]}},
        {"core": lambda value: {"state": [value["state"][0], {"tuple": [1] * 7}, *value["state"][2:]]}},
        {"core": lambda value: {"state": [value["state"][0], {"tuple": [1.0] * 8}, *value["state"][2:]]}},
    ],
)
def test_a_state_that_no_instance_can_have_had_leaves_the_instance_as_it_was(two_that_step, changes):
    one, twin, k = two_that_step
    data = one.bytes_of(one.state())
    status, state = one.from_bytes(forged(data, **changes))
    if status == OK:
        status = one.setFMUState(state)
    assert status == ERROR
    assert len(one.said) == 1
    one.said.clear()
    assert one.bytes_of(one.state()) == data
    t = next(k) * H
    assert one.step(t, H, **sample(t)) == twin.step(t, H, **sample(t))


@pytest.mark.parametrize("mode", [0, 3, 16, 1024])
def test_a_state_of_a_mode_that_there_is_not_is_refused(flexible_joint, mode):
    with opened(flexible_joint.plant) as one:
        one.begin()
        data = one.bytes_of(one.state())
        assert one.from_bytes(forged(data))[0] == OK
        assert one.from_bytes(forged(data, mode))[0] == ERROR
        assert one.said[-1].endswith("received a state that no instance can have")
        assert one.doStep(0.0, H) == OK


def test_a_state_that_is_overwritten_by_another_instance_belongs_to_that_one(flexible_joint):
    with unpacked(flexible_joint.plant) as instance:
        one, other = instance(), instance()
        for each in (one, other):
            each.begin()
        state = one.state()
        get = other.fmu.dll.fmi2GetFMUstate
        assert get(other.fmu.component, ctypes.byref(state)) == OK
        step = other.step(0.0, H)
        one.fmu.freeInstance()
        one.fmu.freeInstance = lambda: None  # by the fixture, once more
        assert other.setFMUState(state) == OK
        assert other.step(0.0, H) == step
