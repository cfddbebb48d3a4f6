"""What a host can do by mistake: one message, a status, and an instance that is as good as before.

The same slave behind its front, which makes the status of what the slave says, and without one, as on Windows.
"""

from __future__ import annotations

import hashlib
import json
from math import inf, nan

import pytest
import sympy

from fmus.slave_messages import printable
from ndob_fmu import Model, build, load_model
from ndob_fmu.fmu import compile_front as front
from tests.fmu.test_fmu_state import forged
from tests.helpers.fmi_instance import DISCARD, ERROR, OK, opened

H = 1e-3


@pytest.fixture(scope="module")
def without_front(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(front.platform, "machine", lambda: "another")
        return build(load_model("flexible_joint"), tmp_path_factory.mktemp("stock"))


@pytest.fixture(params=["with a front", "without"])
def host(request, flexible_joint, without_front):
    """An observer, and the status that a refusal has there outside doStep."""
    guarded = request.param == "with a front"
    with opened(flexible_joint.observer if guarded else without_front[1]) as instance:
        instance.refusal = ERROR if guarded else OK
        yield instance


@pytest.mark.parametrize("text", ["\ud800", "a\0b", "100%n%s", "two\nlines", "x" * 10**6, "ä €", "\x1b[31m\x85\u2028"])
def test_any_message_is_one_short_line_of_utf_8_that_printf_prints(text):
    message = printable(text)
    assert message.encode()
    assert (message % ()).isprintable()
    assert len(message % ()) <= 300
    assert printable("a plain one, with ä") == "a plain one, with ä"


def test_nothing_is_said_when_all_is_well(host):
    host.begin()
    for k in range(20):
        host.step(k * H, H, motor_angle=0.1, link_angle=nan if k == 10 else 0.2)
    assert not host.said


@pytest.mark.parametrize(
    ("t", "step"), [(0.0, 0.0), (0.0, -H), (0.0, nan), (0.0, inf), (H, H), (-H, H), (nan, H), (inf, H)]
)
def test_a_step_that_cannot_be_is_discarded_and_the_right_one_taken(host, t, step):
    host.begin()
    before = host.get()
    assert host.doStep(t, step) == DISCARD
    assert host.get() == before
    (message,) = host.said
    assert (
        "expected a finite time > 0 s" in message
        if step != H
        else "expected 0.0 s, where the last one ended" in message
    )
    assert host.doStep(0.0, H) == OK
    assert host.doStep(H * (1.0 + 1e-9), H) == OK  # a host's rounding error


def test_steps_follow_on_at_times_that_rounding_blurs(host):
    """Unix time in steps of 0.1 ms: a double tells such times apart by 2.4e-7 s."""
    t = 1.7e9
    host.begin(start_time=t)
    for _ in range(20):
        assert host.doStep(t, 1e-4) == OK
        t += 1e-4


def test_a_step_that_no_double_shows_at_its_time_is_discarded(host):
    host.begin(start_time=1e13)
    assert host.doStep(1e13, H / 2.0) == DISCARD
    (message,) = host.said
    assert message.startswith("communication step: expected one that moves the time, received 0.0005 s, which is lost")
    assert host.doStep(1e13, 1.0) == OK


@pytest.mark.parametrize(("start", "stop"), [(nan, None), (inf, None), (1.0, 0.5), (0.0, nan)])
def test_an_experiment_of_impossible_times_is_refused_and_one_of_possible_times_taken(host, start, stop):
    assert host.setupExperiment(startTime=start, stopTime=stop) == host.refusal
    (message,) = host.said
    assert "expected a finite start time and no stop time before it" in message
    host.begin(start_time=1.0, stop_time=2.0)
    host.step(1.0, H, motor_angle=1.0, link_angle=1.0)
    assert len(host.said) == 1


@pytest.mark.parametrize("spoil", [lambda b: b[:-1], lambda b: b"", lambda b: b"x" + b[1:]])
def test_bytes_that_are_no_state_change_nothing(host, spoil):
    """Without a front the bytes are read by a class that cannot log: the refusal comes where they are used."""
    host.begin()
    before = host.step(0.0, H, motor_angle=0.3, link_angle=0.1)
    status, state = host.from_bytes(spoil(host.bytes_of(host.state())))
    assert status == host.refusal
    if not host.refusal:
        assert host.bytes_of(state) == b""
        assert host.setFMUState(state) == OK
    assert len(host.said) == 1
    assert host.get() == before
    assert host.doStep(H, H) == OK


@pytest.mark.parametrize(
    ("place", "value"), [(1, "\ud800"), (9, 10**400), (4, {"tuple": [1.0]}), (2, {"tuple": ["text"]})]
)
def test_a_state_with_wrong_contents_and_the_right_checksum_changes_nothing(host, place, value):
    host.begin()
    before = host.step(0.0, H, motor_angle=0.3, link_angle=0.1)
    data = host.bytes_of(host.state())
    if host.refusal:
        names = (
            "",
            "slave",
            "values",
            "started_with",
            "core",
            "initializing",
            "stale",
            "start_time",
            "stop_time",
            "time",
        )
        data = forged(data, **{names[place]: lambda _: value})
    else:
        tree = json.loads(data[32:])
        tree["state"][place] = value
        content = json.dumps(tree, separators=(",", ":")).encode()
        data = hashlib.sha256(content).digest() + content
    status, state = host.from_bytes(data)
    if status == OK:
        status = host.setFMUState(state)
    assert (status, len(host.said)) == (host.refusal, 1)
    assert host.get() == before
    assert host.doStep(H, H) == OK


def test_a_step_past_the_stop_time_is_refused(host):
    host.begin(stop_time=2.0 * H)
    assert host.doStep(0.0, H) == OK
    assert host.doStep(H, 2.0 * H) == (ERROR if host.refusal else DISCARD)
    assert host.said == ["end of the step: expected at most the stop time 0.002 s, received 0.003 s"]
    assert host.doStep(H, H) == OK


@pytest.mark.parametrize(
    ("name", "wrong", "right", "says"),
    [
        ("pi_end", -1.0, 1e8, "pi_end: expected a finite number > 0, received -1.0"),
        ("joint_stiffness", nan, 1.0, "joint_stiffness: expected a finite number, received nan"),
        (
            "disturbance_order",
            7,
            2,
            "disturbance_order: expected a finite number of at least 0 and at most 3, received 7",
        ),
        ("disturbance_bound", 0.0, 5.0, "disturbance_bound: expected a finite number > 0, received 0.0"),
        ("method", 3, 2, "method: expected one of 1 (paper), 2 (sampled_data), received 3"),
    ],
)
def test_a_parameter_out_of_its_range_is_refused_until_it_is_set_right(host, name, wrong, right, says):
    assert host.setupExperiment(startTime=0.0) == OK
    assert host.set(name, wrong) == host.refusal
    assert host.enterInitializationMode() == OK
    assert host.exitInitializationMode() == host.refusal
    assert host.said == [says, says]
    if not host.refusal:
        assert host.doStep(0.0, H) == DISCARD
    assert host.set(name, right) == OK
    assert host.exitInitializationMode() == OK
    host.step(0.0, H, motor_angle=1.0, link_angle=1.0)


def test_parameters_that_admit_no_design_can_be_corrected_too(host):
    """Such a damping is within the declared range, but nothing shows in the outputs then."""
    assert host.setupExperiment(startTime=0.0) == OK
    assert host.set("motor_damping", 1e12) == OK
    assert host.enterInitializationMode() == OK
    assert host.exitInitializationMode() == host.refusal
    (message,) = host.said
    assert message.startswith("transmission zeros: expected 1 unknown inputs that the 2 outputs tell apart")
    assert host.set("motor_damping", 1.0) == OK
    assert host.exitInitializationMode() == OK


def test_fixed_parameters_and_outputs_are_not_set_in_step_mode(host):
    host.begin()
    first = host.step(0.0, H, motor_angle=0.3, link_angle=0.1)
    assert host.set("link_angle_noise_std", 1.0) == host.refusal
    assert host.set("load_torque_hat", 1.0) == host.refusal
    assert len(host.said) == 2
    assert host.get() == first


def test_references_that_are_none_or_of_another_type_change_nothing(host):
    host.begin()
    real, integer = (host.variables[name].valueReference for name in ("motor_angle", "disturbance_order"))
    for references in ([999], [real, integer]):
        assert host.setReal(references, [5.0] * len(references)) == host.refusal
        assert host.getReal(references) == host.refusal
    assert len(host.said) == 4
    assert host.fmu.getReal([real]) == [0.0]


def test_a_plant_whose_solution_leaves_the_finite_numbers_discards_the_step_and_keeps_its_state(flexible_joint):
    with opened(flexible_joint.plant) as plant:
        plant.begin(motor_damping=-1e5)
        before = plant.get()
        assert plant.doStep(0.0, 1.0) == DISCARD
        assert plant.get() == before
        assert plant.doStep(0.0, 1e-6) == OK


@pytest.mark.parametrize(
    ("parameters", "expected"),
    [
        ({"joint_stiffness": 1e100}, "expected a stationary gain"),
        ({"motor_angle_noise_std": 1e300, "link_angle_noise_std": 1e300}, "expected each to show in an output"),
    ],
)
def test_parameters_of_sizes_that_no_design_can_take_discard_the_step_and_the_instance_lives(
    host, parameters, expected
):
    host.begin(**parameters)
    assert host.doStep(0.0, H) == DISCARD
    assert expected in host.said[-1]
    assert host.reset() == OK
    host.begin()
    assert host.doStep(0.0, H) == OK


def test_equations_without_a_real_value_are_no_fatal_error(tmp_path):
    """A fractional power of a negative number is complex in Python. An observer has no slopes there to start with."""
    model = Model(
        name="Vessel",
        states=["level", "flow"],
        inputs=["pump"],
        outputs=["level"],
        disturbances=["leak"],
        A=[[0, 1], [0, -1]],
        B=[[0], [1]],
        C=[[1, 0]],
        G_d=[[0], [1]],
        f=lambda x, u, p: [sympy.sin((p.height + sympy.sin(x.level)) ** sympy.Rational(3, 2))],
        parameters={"height": 3.0},
        lipschitz=4.0,
        disturbance_bound=1.0,
        x0=[-1.0, 0.0],
    )
    build(model, tmp_path)
    with opened(tmp_path / "VesselPlant.fmu") as plant:
        plant.begin(height=-3.0)
        assert plant.doStep(0.0, H) == DISCARD
        (message,) = plant.said
        assert "expected numbers that can be computed with" in message or "cannot be evaluated" in message
    with opened(tmp_path / "VesselObserver.fmu") as observer:
        assert observer.setupExperiment(startTime=0.0, stopTime=None) == OK
        assert observer.set("height", -3.0) == OK
        assert observer.enterInitializationMode() == OK
        assert observer.exitInitializationMode() == ERROR
        (message,) = observer.said
        assert "Vessel, linearised at its start values: expected finite slopes" in message
