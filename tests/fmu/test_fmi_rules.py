"""Every call in every mode, against the one table of FMI's rules: in the front, and in the slave without one."""

from __future__ import annotations

import ctypes
import re
from dataclasses import replace

import pytest
from fmpy import fmi2

from ndob_fmu import build, load_model
from ndob_fmu.fmu import compile_front as front
from ndob_fmu.interface.fmi_rules import CALLS, DEAD_MODES, MODES, NOT_SETTABLE, SETTABLE, UNSUPPORTED, role
from ndob_fmu.interface.variables import Variable
from tests.helpers.fmi_instance import ERROR, OK, opened, unpacked
from tests.helpers.needs import FRONT

H = 1e-3
# A variable of the observer that each call of this kind names, and a value that it takes.
INPUT = "motor_angle"
VARIABLES = {"Real": INPUT, "Integer": "disturbance_order", "Boolean": "valid"}


@pytest.fixture(scope="module")
def observers(flexible_joint):
    with unpacked(flexible_joint.observer) as instance:
        yield instance


@pytest.fixture(scope="module")
def observer_without_front(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(front.platform, "machine", lambda: "another")
        return build(load_model("flexible_joint"), tmp_path_factory.mktemp("stock"))[1]


def bring(instance, mode):
    """Lead a fresh instance to a mode, and return it."""
    if mode != "instantiated":
        assert instance.setupExperiment(startTime=0.0) == OK
        assert instance.enterInitializationMode() == OK
    if mode in ("stepping", "terminated"):
        assert instance.exitInitializationMode() == OK
        assert instance.doStep(0.0, H) == OK
    if mode == "terminated":
        assert instance.terminate() == OK
    return instance


def raw(instance, call, state):
    """Make one FMI call with right arguments and return its status; `state` is an FMU state of the instance."""
    dll, component = instance.fmu.dll, instance.fmu.component
    function = getattr(dll, f"fmi2{call}")
    function.restype = ctypes.c_int
    real, size = ctypes.c_double, ctypes.c_size_t
    place = ctypes.c_void_p()

    def references(name):
        return (ctypes.c_uint * 1)(instance.variables[name].valueReference), size(1)

    kind = re.sub("^[GS]et", "", call)
    count = ctypes.c_int()
    number = real()
    buffer = ctypes.create_string_buffer(1 << 16)
    arguments = {
        "SetDebugLogging": (ctypes.c_int(1), size(0), None),
        "SetupExperiment": (ctypes.c_int(0), real(0.0), real(0.0), ctypes.c_int(0), real(0.0)),
        "DoStep": (real(H if instance.stepped else 0.0), real(H), ctypes.c_int(1)),
        "GetFMUstate": (ctypes.byref(place),),
        "SetFMUstate": (state,),
        "FreeFMUstate": (ctypes.byref(ctypes.c_void_p()),),
        "SerializedFMUstateSize": (state, ctypes.byref(size())),
        "SerializeFMUstate": (state, buffer, size(len(buffer))),
        "GetRealStatus": (ctypes.c_int(fmi2.fmi2LastSuccessfulTime), ctypes.byref(number)),
        "GetBooleanStatus": (ctypes.c_int(fmi2.fmi2Terminated), ctypes.byref(count)),
    }
    if call == "DeSerializeFMUstate":
        data = instance.data
        return function(component, data, size(len(data)), ctypes.byref(place))
    if call in arguments:
        return function(component, *arguments[call])
    if kind == "String" and call in CALLS:
        return function(component, (ctypes.c_uint * 1)(), size(0), (ctypes.c_char_p * 1)())
    if kind in VARIABLES:
        name = VARIABLES[kind]
        values = {"Real": (real * 1)(0.1), "Integer": (ctypes.c_int * 1)(2), "Boolean": (ctypes.c_int * 1)(1)}
        if call.startswith("Set") and kind != "Real":  # there is no input of these types
            return function(component, (ctypes.c_uint * 1)(), size(0), values[kind])
        return function(component, *references(name), values[kind])
    if call in UNSUPPORTED:
        zeros = (ctypes.c_uint * 1)(), size(0), (ctypes.c_int * 1)(), (real * 1)()
        if call == "GetDirectionalDerivative":
            zeros = zeros[0], size(0), zeros[0], size(0), (real * 1)(), (real * 1)()
        if call == "CancelStep":
            zeros = ()
        if call in ("GetStatus", "GetIntegerStatus", "GetStringStatus"):
            zeros = ctypes.c_int(0), None
        return function(component, *zeros)
    return function(component)


@FRONT
@pytest.mark.parametrize("call", [call for call in CALLS if call != "FreeInstance"])
@pytest.mark.parametrize("mode", MODES)
def test_the_front_allows_each_call_in_the_modes_of_the_table_and_refuses_it_in_the_others(observers, mode, call):
    instance = bring(observers(), mode)
    instance.stepped = mode in ("stepping", "terminated")
    state = instance.state()
    instance.data = instance.bytes_of(state)
    before = instance.get()
    allowed = CALLS[call]
    # FMI wants an experiment before initialization; tests/fmu/test_fmu_guards.py tests that rule.
    if call == "EnterInitializationMode" and mode == "instantiated":
        assert instance.setupExperiment(startTime=0.0) == OK
    status = raw(instance, call, state)
    if mode in allowed:
        assert (status, instance.said) == (OK, [])
        return
    assert status == ERROR
    expected = " or ".join(MODES[name] for name in MODES if name in allowed)
    assert instance.said == [f"fmi2{call}: expected an instance that is {expected}, received one that is {MODES[mode]}"]
    assert instance.get() == before
    assert instance.setFMUState(state) == OK


@FRONT
@pytest.mark.parametrize("call", UNSUPPORTED)
@pytest.mark.parametrize("mode", MODES)
def test_the_front_refuses_in_every_mode_what_the_fmus_do_not_have(observers, mode, call):
    instance = bring(observers(), mode)
    instance.stepped = False
    assert raw(instance, call, None) == ERROR
    (message,) = instance.said
    assert message.startswith(f"fmi2{call}: expected")


@FRONT
@pytest.mark.parametrize("mode", MODES)
def test_the_front_frees_an_instance_in_every_mode(flexible_joint, mode):
    with opened(flexible_joint.observer) as instance:
        bring(instance, mode)
    assert instance.said == []
    assert set(MODES) < set(CALLS["FreeInstance"])
    assert set(DEAD_MODES) < set(CALLS["FreeInstance"])


def of_role(name):
    """Return a variable of the observer that has the role, and a value."""
    return {"input": (INPUT, 0.3), "fixed": ("link_angle_noise_std", 0.5), "calculated": ("load_torque_hat", 1.0)}[name]


@FRONT
@pytest.mark.parametrize("kind", ["input", "fixed", "calculated"])
@pytest.mark.parametrize("mode", MODES)
def test_the_front_lets_a_variable_be_set_in_the_modes_of_its_role(observers, mode, kind):
    instance = bring(observers(), mode)
    name, value = of_role(kind)
    status = instance.set(name, value)
    if mode not in CALLS["SetReal"]:
        assert (status, len(instance.said)) == (ERROR, 1)
    elif mode in SETTABLE[kind]:
        assert (status, instance.said) == (OK, [])
    else:
        expected, received = NOT_SETTABLE[kind]
        assert status == ERROR
        assert instance.said == [f"fmi2SetReal: {name}: expected {expected}, received {received}"]


@pytest.mark.parametrize("kind", ["input", "fixed", "calculated"])
@pytest.mark.parametrize("mode", [mode for mode in MODES if mode != "terminated"])
def test_the_slave_alone_lets_a_variable_be_set_in_the_same_modes(observer_without_front, mode, kind):
    """It does not learn that a simulation has ended."""
    with opened(observer_without_front) as instance:
        bring(instance, mode)
        name, value = of_role(kind)
        instance.set(name, value)
        if mode in SETTABLE[kind]:
            assert instance.said == []
        else:
            expected, received = NOT_SETTABLE[kind]
            assert instance.said == [f"{name}: expected {expected}, received {received}"]


def test_the_table_names_every_function_of_fmi_that_acts_on_an_instance_once():
    names = {name.removeprefix("fmi2") for name in functions_of_the_shell()} - {
        "Instantiate",
        "GetTypesPlatform",
        "GetVersion",
    }
    assert names == set(CALLS) | set(UNSUPPORTED)
    assert not set(CALLS) & set(UNSUPPORTED)


def functions_of_the_shell():
    text = "".join((front.SOURCES / "shell" / name).read_text("utf-8") for name in ("instance.c", "state.c", "step.c"))
    values = [f"fmi2{access}{kind}" for access in ("Get", "Set") for kind in ("Real", "Integer", "Boolean", "String")]
    return [*re.findall(r"(?m)^(?:fmi2\w+|void|const char \*) ?\*?(fmi2\w+)\(", text), *values]


def test_roles_are_those_of_causality_and_variability():
    parameter = Variable("k", "parameter", "")
    roles = [role(replace(parameter, causality=causality)) for causality in ("input", "output", "parameter", "local")]
    assert roles == ["input", "calculated", "fixed", "calculated"]
    assert set(SETTABLE) == {*roles, "tunable"}
    assert all(set(modes) <= set(MODES) for modes in SETTABLE.values())
