"""What a system may look like; every mistake ends in one line that names the place."""

from __future__ import annotations

import ast
import copy
from pathlib import Path

import numpy as np
import pytest

import ndob_fmu
from ndob_fmu.cosim import System, Variable, simulate
from ndob_fmu.errors import CouplingError, ModelError, UsageError
from ndob_fmu.support.units import BaseUnit, base_unit, likely_unit
from tests.helpers.mock_components import Mock, constant, gain, integrator

PLANT = [Variable("motor_torque", "input", unit="N.m"), Variable("load_torque", "input", unit="N.m")]
ANGLES = [Variable(name, "output", unit="rad", settable=False) for name in ("motor_angle", "link_angle")]
PARAMETERS = [
    Variable("mass", "parameter"),
    Variable("kind", "parameter", "Integer"),
    Variable("on", "parameter", "Boolean"),
    Variable("label", "parameter", "String"),
    Variable("derived", "calculatedParameter", settable=False),
]
OBSERVER = [
    Variable("motor_angle", "input", unit="rad"),
    Variable("angle_deg", "input", unit="deg"),
    Variable("count", "input", "Integer"),
    Variable("name", "input", "String"),
    Variable("free", "input"),
]


def plant():
    more = [*ANGLES, Variable("note", "output", "String")]
    return Mock(PLANT, more, output=lambda x, u: [u["motor_torque"], u["load_torque"]], parameters=PARAMETERS)


def observer():
    return Mock(OBSERVER, ["a_hat", "b_hat", "c_hat"], output=lambda x, u: [u["motor_angle"], u["count"], u["free"]])


def couple(*connections, starts=None):
    pairs = tuple((tuple(a.split(".")), tuple(b.split("."))) for a, b in connections)
    values = {tuple(name.split(".")): value for name, value in (starts or {}).items()}
    return System({"plant": plant(), "observer": observer()}, pairs, values)


GOOD = ("plant.motor_angle", "observer.motor_angle")
STARTS = {
    "plant.motor_torque": 2.0,
    "plant.load_torque": 3.0,
    "observer.angle_deg": 0,
    "observer.count": 4,
    "observer.name": "",
    "observer.free": 5.0,
}


def test_a_well_wired_system_runs():
    recording = simulate(couple(GOOD, starts=STARTS), stop_time=1.0, step_size=0.5)
    assert recording.names == (
        "plant.motor_angle",
        "plant.link_angle",
        "observer.a_hat",
        "observer.b_hat",
        "observer.c_hat",
    )
    np.testing.assert_array_equal(recording.columns, [[2, 3, 2, 4, 5]] * 3)


@pytest.mark.parametrize(
    ("connection", "parts"),
    [
        (("plnat.motor_angle", "observer.motor_angle"), ["component of plnat.motor_angle", "did you mean 'plant'?"]),
        (("plant.moter_angle", "observer.motor_angle"), ["variable of plant", "'moter_angle'", "mean 'motor_angle'?"]),
        (
            ("plant.motor_angle", "observer.link_angel"),
            ["variable of observer", "one of the variables a_hat", "'link_angel'"],
        ),
        (("plant.mass", "observer.motor_angle"), ["an output as the source plant.mass", "received parameter"]),
        (("plant.motor_angle", "observer.a_hat"), ["an input as the target observer.a_hat", "received output"]),
        (("plant.motor_angle", "observer.count"), ["the type Integer of observer.count", "received Real"]),
        (("plant.motor_angle", "plant.motor_torque"), ["the unit N.m of plant.motor_torque", "received rad"]),
        (("plant.note", "observer.name"), ["a numeric or Boolean signal", "String"]),
    ],
)
def test_a_connection_that_cannot_be_is_refused_and_the_nearest_name_suggested(connection, parts):
    with pytest.raises(CouplingError) as refused:
        couple(connection)
    assert all(text in str(refused.value) for text in parts), str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_unit_declared_on_one_side_only_is_no_mismatch():
    assert couple(("plant.motor_angle", "observer.free")).connections


def test_a_signal_is_converted_to_its_targets_unit_and_then_scaled():
    system = System().add("plant", plant()).add("observer", observer())
    system = system.connect("plant.motor_angle", "observer.angle_deg", factor=2.0, offset=1.0)
    assert system.connections[0].factor == pytest.approx(2 * 180 / np.pi, rel=1e-14)
    assert system.connections[0].offset == 1.0
    again = System(system.components, system.connections)  # what was converted is not converted twice
    assert again.connections == system.connections


def test_a_unit_that_two_components_define_differently_is_shown_with_both_definitions():
    pressure, temperature = (1, -1, -2, 0, 0, 0, 0, 0), (0, 0, 0, 0, 1, 0, 0, 0)
    gauge, tank = constant(1.0), integrator()
    gauge.variables = (Variable("y", "output", unit="bar", base_unit=BaseUnit(pressure, 1e5), settable=False),)
    tank.variables = (Variable("u", "input", unit="bar", base_unit=BaseUnit(temperature, 0.5, -2.5)), tank.variables[1])
    with pytest.raises(CouplingError) as refused:
        System().add("gauge", gauge).add("tank", tank).connect("gauge.y", "tank.u")
    assert str(refused.value) == (
        "connection gauge.y → tank.u: expected the unit bar (0.5 K - 2.5) of tank.u, or one that converts to it, "
        "received bar (100000 kg.m-1.s-2)"
    )
    assert str(BaseUnit((0,) * 8)) == "1"


def test_units_with_an_offset_are_converted_as_the_components_define_them():
    celsius, kelvin = BaseUnit((0, 0, 0, 0, 1, 0, 0, 0), 1.0, 273.15), BaseUnit((0, 0, 0, 0, 1, 0, 0, 0))
    sensor = constant(25.0)
    sensor.variables = (Variable("y", "output", unit="C", base_unit=celsius, settable=False),)
    stove = Mock([Variable("u", "input", unit="T", base_unit=kelvin)], ["y"], output=lambda x, u: [u["u"]])
    system = System().add("sensor", sensor).add("stove", stove).connect("sensor.y", "stove.u")
    np.testing.assert_allclose(simulate(system, stop_time=2.0, step_size=1.0)["stove.y"], 298.15)


def in_place(system):
    system.add("a", integrator(), {"u": 1.0})
    system.add("b", integrator(), step_ratio=2)
    system.connect("a.y", "b.u")
    system.expose("end", "b.y")
    return system


@pytest.mark.parametrize(
    "grow",
    [
        in_place,
        lambda s: s.add("a", integrator(), {"u": 1.0}).add("b", integrator(), step_ratio=2).connect("a.y", "b.u"),
    ],
)
def test_a_system_grows_by_calls_on_lines_of_their_own_and_by_chained_ones(grow):
    system = grow(System())
    assert system.step_ratios == {"b": 2}
    by_hand = System({"a": integrator(), "b": integrator()}, ((("a", "y"), ("b", "u")),), {("a", "u"): 1.0}, {"b": 2})
    run = {"stop_time": 4.0, "step_size": 1.0}
    for name in ("a.y", "b.y"):
        np.testing.assert_array_equal(simulate(system, **run)[name], simulate(by_hand, **run)[name])


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda s: s.add("a", integrator()), "component a: expected a new name"),
        (lambda s: s.add("c", integrator(), {"nonsense": 1.0}), "variable of c"),
        (lambda s: s.connect("a.y", "b.u"), "exactly one driver"),
        (lambda s: s.expose("u", "b.u"), "exactly one driver"),
    ],
)
def test_a_call_that_is_refused_leaves_the_system_as_it_was(call, message):
    system = in_place(System())
    before = dict(vars(system))
    with pytest.raises(CouplingError, match=message):
        call(system)
    assert vars(system) == before


def test_a_copy_of_a_system_grows_on_its_own():
    system = in_place(System())
    copy.copy(system).add("c", integrator())
    assert list(system.components) == ["a", "b"]


def test_a_name_at_the_boundary_sets_all_inputs_behind_it_and_records_an_output(tmp_path):
    system = System().add("a", integrator()).add("b", integrator()).expose("u", "a.u", "b.u").expose("y", "b.y")
    run = {"stop_time": 2.0, "step_size": 1.0}
    with pytest.raises(CouplingError, match=r"a\.u \(behind u\), b\.u \(behind u\): expected a connection"):
        simulate(system, strict=True, **run)
    held = simulate(system, start_values={"u": 3.0}, **run)
    assert held.names == ("a.y", "b.y", "y")
    np.testing.assert_array_equal(held["y"], [0.0, 3.0, 6.0])
    (tmp_path / "u.csv").write_text('"time","u"\n0,1\n1,5\n')
    np.testing.assert_array_equal(simulate(system, input_file=tmp_path / "u.csv", **run)["a.y"], [0.0, 1.0, 6.0])


@pytest.mark.parametrize(
    ("build", "parts"),
    [
        (lambda s: s.expose("u", "b.u"), ["input b.u", "exactly one driver", "a.y and the input u"]),
        (lambda s: s.expose("u", "a.u").expose("v", "a.u"), ["input a.u", "the input u and the input v"]),
        (lambda s: s.expose("y", "a.y", "b.y"), ["input y", "variables that can be set", "a.y of causality output"]),
        (lambda s: System(s.components, outputs={"y": (("a", "u"),)}), ["output y", "a.u of causality input"]),
    ],
)
def test_a_boundary_that_cannot_be_is_refused(build, parts):
    system = System().add("a", integrator()).add("b", integrator()).connect("a.y", "b.u")
    with pytest.raises(CouplingError) as refused:
        build(system)
    assert all(text in str(refused.value) for text in parts), str(refused.value)


@pytest.mark.parametrize(
    ("build", "parts"),
    [
        (
            lambda: couple(GOOD, ("plant.link_angle", "observer.motor_angle")),
            ["input observer.motor_angle", "exactly one driver", "plant.motor_angle and plant.link_angle"],
        ),
    ],
)
def test_an_input_with_two_drivers_is_refused(build, parts):
    with pytest.raises(CouplingError) as refused:
        build()
    assert all(text in str(refused.value) for text in parts), str(refused.value)


def test_inputs_that_nothing_drives_keep_their_own_start_values_with_one_warning_and_strict_refuses_them(caplog):
    """SSP 1.0.1: an input without a connection keeps its start value."""
    system = couple(GOOD, starts={k: v for k, v in STARTS.items() if k not in ("plant.load_torque", "observer.free")})
    with pytest.raises(CouplingError, match=r"inputs plant\.load_torque, observer\.free: expected a connection, a col"):
        simulate(system, stop_time=1.0, step_size=0.5, strict=True)
    assert system.components["plant"].calls == []
    recording = simulate(system, stop_time=1.0, step_size=0.5)
    np.testing.assert_array_equal(recording["observer.c_hat"], [0, 0, 0])  # as Mock starts
    assert [record.getMessage() for record in caplog.records] == [
        "nothing drives the inputs plant.load_torque, observer.free; they keep their own start values"
    ]
    caplog.clear()
    simulate(couple(GOOD, starts=STARTS), stop_time=1.0, step_size=0.5, strict=True)
    assert caplog.records == []


def test_the_warning_of_a_thousand_inputs_is_one_short_line(caplog):
    names = [f"contact_patch_of_wheel_{k}" for k in range(1000)]
    simulate(System({"car": Mock(names, ["y"], output=lambda x, u: [0.0])}), stop_time=1.0, step_size=0.5)
    (said,) = (record.getMessage() for record in caplog.records)
    assert len(said) < 300
    assert said.startswith("nothing drives the inputs car.contact_patch_of_wheel_0, ")
    assert "more; they keep" in said


def test_a_start_value_of_a_connected_input_is_what_it_has_before_the_first_exchange():
    """In an algebraic loop with two solutions it chooses one: y = u² and u = y meet at 0 and at 1."""

    def run(start, **more):
        square = Mock(["u"], ["y"], output=lambda x, u: [u["u"] ** 2])
        system = System({"a": square, "b": gain()}, ((("a", "y"), ("b", "u")), (("b", "y"), ("a", "u"))), **more)
        return simulate(system, stop_time=1.0, step_size=1.0, start_values=start)["a.y"][0]

    assert run({"a.u": 0.25, "b.u": 0.0625}) == pytest.approx(0.0, abs=1e-9)
    assert run({"a.u": 1.0, "b.u": 1.0}) == pytest.approx(1.0)
    assert run({}, start_values={("a", "u"): 1.0, ("b", "u"): 1.0}) == pytest.approx(1.0)


def input_file(folder, *columns):
    path = folder / "u.csv"
    path.write_text(",".join(["time", *columns]) + "\n" + ",".join(["0"] + ["9"] * len(columns)) + "\n")
    return path


def test_a_column_of_the_input_file_replaces_a_start_value_of_the_system(tmp_path):
    file = input_file(tmp_path, "plant.load_torque")
    recording = simulate(couple(GOOD, starts=STARTS), stop_time=1.0, step_size=0.5, input_file=file)
    np.testing.assert_array_equal(recording["plant.link_angle"], [9, 9, 9])
    np.testing.assert_array_equal(recording["plant.motor_angle"], [2, 2, 2])


def test_a_column_for_an_input_that_is_connected_is_refused(tmp_path):
    file = input_file(tmp_path, "observer.motor_angle")
    with pytest.raises(CouplingError, match=r"a column of the input file and the connection from plant\.motor_angle"):
        simulate(couple(GOOD, starts=STARTS), stop_time=1.0, step_size=0.5, input_file=file)


def test_a_column_drives_an_input_whatever_its_start_value(tmp_path):
    run = {"stop_time": 1.0, "step_size": 0.5, "input_file": input_file(tmp_path, "observer.free")}
    recording = simulate(couple(GOOD, starts=STARTS), start_values={"observer.free": 1.0}, **run)
    np.testing.assert_array_equal(recording["observer.c_hat"], [9, 9, 9])


def test_start_values_of_a_run_replace_those_of_the_system_for_this_run_only():
    system = couple(GOOD, starts=STARTS)
    for starts, expected in (({"plant.motor_torque": 7.0}, 7.0), (None, 2.0)):
        recording = simulate(system, stop_time=1.0, step_size=0.5, start_values=starts)
        np.testing.assert_array_equal(recording["observer.a_hat"], [expected] * 3)


@pytest.mark.parametrize(
    ("name", "value", "error", "parts"),
    [
        ("plant.mas", 1.0, CouplingError, ["variable of plant", "did you mean 'mass'?"]),
        ("plnt.mass", 1.0, CouplingError, ["'plnt.mass'", "no such component", "mean 'plant.mass'?"]),
        ("mass", 1.0, CouplingError, ["'mass'", "components plant, observer", "mean 'plant.mass'?"]),
        ("plant.derived", 1.0, CouplingError, ["takes a start value", "causality calculatedParameter"]),
        ("plant.motor_angle", 1.0, CouplingError, ["takes a start value", "causality output"]),
        ("plant.mass", "heavy", UsageError, ["plant.mass", "a number (Real)", "'heavy'"]),
        ("plant.kind", 1.5, UsageError, ["plant.kind", "a whole number (Integer)", "'1.5'"]),
        ("plant.kind", float("inf"), UsageError, ["a whole number (Integer)", "'inf'"]),
        ("plant.on", "yes", UsageError, ["plant.on", "true, false, 1 or 0 (Boolean)", "'yes'"]),
        ("plant.on", 2, UsageError, ["plant.on", "true, false, 1 or 0 (Boolean)", "'2'"]),
    ],
)
def test_a_start_value_that_does_not_fit_is_refused(name, value, error, parts):
    system = couple(GOOD, starts=STARTS)
    with pytest.raises(error) as refused:
        simulate(system, stop_time=1.0, step_size=0.5, start_values={name: value})
    assert all(text in str(refused.value) for text in parts), str(refused.value)
    assert system.components["plant"].calls == []


def test_start_values_arrive_in_the_type_of_their_variable_also_when_written_as_text():
    system = couple(GOOD, starts=STARTS)
    written = {"plant.mass": "2.5", "plant.kind": "3", "plant.on": "true", "plant.label": "arm"}
    simulate(system, stop_time=1.0, step_size=0.5, start_values=written)
    u = system.components["plant"].u
    assert [u["mass"], u["kind"], u["on"], u["label"]] == [2.5, 3, True, "arm"]
    assert [type(u[name]) for name in ("kind", "on")] == [int, bool]


def test_a_system_of_one_component_understands_bare_names_with_and_without_dots():
    part = Mock(["u"], ["y"], output=lambda x, u: [u["u"]], parameters=[Variable("disturbance.kind", "parameter")])
    simulate(System({"a": part}), stop_time=1, step_size=1, start_values={"u": 1, "disturbance.kind": 2})
    assert part.u == {"u": 1.0, "disturbance.kind": 2.0}
    simulate(System({"a": part}), stop_time=1, step_size=1, start_values={"a.u": 3, "a.disturbance.kind": 4})
    assert part.u == {"u": 3.0, "disturbance.kind": 4.0}


def test_one_output_may_drive_several_inputs():
    parts = {"one": constant(2.0), "a": integrator(), "b": gain(3.0)}
    system = System(parts, ((("one", "y"), ("a", "u")), (("one", "y"), ("b", "u"))))
    recording = simulate(system, stop_time=1.0, step_size=0.5)
    np.testing.assert_array_equal(recording.columns, [[2, 0, 6], [2, 1, 6], [2, 2, 6]])


def test_a_system_that_is_neither_a_system_nor_a_known_file_is_refused():
    with pytest.raises(
        UsageError, match=r"system: expected a System or the path of an \.ssp or \.fmu, received 'a\.txt'"
    ):
        simulate("a.txt", stop_time=1.0, step_size=0.5)


def test_the_coupling_knows_nothing_of_models_and_observers_so_that_it_runs_any_fmu():
    imported = {
        name
        for file in (Path(ndob_fmu.__file__).parent / "cosim").rglob("*.py")
        for node in ast.walk(ast.parse(file.read_text()))
        for name in (
            [node.module]
            if isinstance(node, ast.ImportFrom)
            else [alias.name for alias in node.names]
            if isinstance(node, ast.Import)
            else []
        )
        if name.startswith("ndob_fmu")
    }
    outside = {name for name in imported if not name.startswith("ndob_fmu.cosim")}
    general = ("errors", "results", "support", "runtime.arrays")
    assert [name for name in outside if not name.removeprefix("ndob_fmu.").startswith(general)] == []


@pytest.mark.parametrize("kind", [AttributeError, TypeError, KeyError, ValueError, AssertionError, ZeroDivisionError])
def test_an_error_inside_the_library_of_units_is_not_blamed_on_the_unit(monkeypatch, kind):
    class Broken:
        def Quantity(self, value, formula):
            raise kind("a fault of this library")

    monkeypatch.setattr("ndob_fmu.support.units._registry", Broken)
    with pytest.raises(kind, match="of this library"):
        base_unit("N.m")


@pytest.mark.parametrize("text", ["parsec_", "kg.", "1/0", "N.m)", "rad0", "0xm", "kg+rad", "{", "nan$"])
def test_a_text_that_is_no_unit_is_reported_as_such(text):
    with pytest.raises(ModelError, match="expected a unit of physics"):
        base_unit(text)


@pytest.mark.parametrize(
    ("text", "meant"),
    [
        *(("Volt", "V"), ("Newton.Meter", "N.m"), ("kgm2", "kg.m2"), ("bananas", "")),
        *(("Vs", "V.s"), ("Nmm", "N.mm"), ("Ncm/rad", "N.cm/rad")),
    ],
)
def test_a_unit_in_words_or_without_its_dot_is_told_as_it_is_written(text, meant):
    assert likely_unit(text) == (f"did you mean {meant!r}?" if meant else "")


@pytest.mark.parametrize(
    ("written", "meant"),
    [
        *(("Nm", "N.m"), ("kNm", "kN.m"), ("Nm/A", "N.m/A"), ("Nms/rad", "N.m.s/rad"), ("kOhm", "kohm")),
        *(("rev/min", "rpm"), ("PS", "metric_horsepower"), ("pu", "1"), ("counts", "1"), ("inc/s", "Hz"), ("bit", "1")),
    ],
)
def test_units_mean_what_engineers_write_them_for(written, meant):
    found, expected = base_unit(written), base_unit(meant)
    assert found.powers == expected.powers
    assert found.factor == pytest.approx(expected.factor, rel=1e-9)
