"""Real FMUs, built by a stock pythonfmu, as components."""

from __future__ import annotations

import importlib.util
import logging
import os
import re
import subprocess
import sys
import zipfile
from pathlib import Path

import fmpy
import numpy as np
import pytest

from ndob_fmu.cosim import FmuComponent, System, simulate
from ndob_fmu.cosim.fmi import fmu_component
from ndob_fmu.cosim.fmi.buffers import fmi_call
from ndob_fmu.errors import CouplingError, SimulationError, UsageError
from tests.helpers.coupling_fmus import SLAVES, coupling_fmus
from tests.helpers.mock_components import Mock, constant


@pytest.fixture(scope="session")
def fmus(tmp_path_factory):
    return coupling_fmus(tmp_path_factory.getbasetemp())


@pytest.fixture(autouse=True)
def same_folder(nothing_left_behind):
    """Every test here also shows that the process stays in its folder, and leaves no temporary one."""
    here = Path.cwd()
    yield
    assert Path.cwd() == here


def changed(source, target, old, new, entry="modelDescription.xml"):
    """Copy an FMU with a text in one of its files replaced, or the file left out where `new` is None."""
    target.parent.mkdir(exist_ok=True)
    with zipfile.ZipFile(source) as before, zipfile.ZipFile(target, "w") as after:
        for name in before.namelist():
            data = before.read(name)
            if name == entry and new is None:
                continue
            if name == entry:
                assert re.search(old.encode(), data)
                data = re.sub(old.encode(), new.encode(), data, count=1)
            after.writestr(name, data)
    return target


def test_a_single_fmu_runs_with_its_own_default_experiment_and_bare_names(fmus):
    recording = simulate(fmus / "Integrator.fmu", start_values={"u": 2.0, "y": 1.0})
    np.testing.assert_array_equal(recording.time, [0.5, 0.75, 1.0, 1.25, 1.5])
    np.testing.assert_array_equal(recording["Integrator.y"], [1.0, 1.5, 2.0, 2.5, 3.0])
    assert recording["Integrator.positive"].tolist() == [True] * 5


def test_outputs_computed_on_leaving_initialization_are_in_the_first_row(fmus):
    recording = simulate(fmus / "Integrator.fmu", start_values={"y": 3.0})
    assert recording["Integrator.half"][0] == 1.5


def slave_class(name, script):
    spec = importlib.util.spec_from_file_location(f"plain_{script}", SLAVES / f"{script}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return getattr(module, name)


def test_an_fmu_gives_bit_for_bit_what_the_same_slave_gives_as_plain_python(fmus):
    names = ("position", "velocity", "energy")

    class Plain(Mock):
        def setup(self, start_time, stop_time, start_values, inputs, tolerance=None):
            super().setup(start_time, stop_time, start_values, inputs)
            self.slave = slave_class("MassSpring", "mass_spring")(instance_name="plain")
            for name, value in start_values.items():
                setattr(self.slave, name, value)

        def get_outputs(self, values):
            values[:] = [getattr(self.slave, name) for name in names]

        def step(self, time, step_size):
            self.slave.force = self.u["force"]
            self.slave.do_step(time, step_size)

    def run(component):
        def push(x, u, t, h):
            return t + h

        drive = Mock(["x"], ["force"], output=lambda x, u: [np.sin(3 * x) - u["x"]], step=push, x=0.0)
        connections = ((("drive", "force"), ("mass", "force")), (("mass", "position"), ("drive", "x")))
        system = System({"drive": drive, "mass": component}, connections, {("mass", "stiffness"): 7.0})
        return simulate(system, stop_time=2.0, step_size=1 / 128)

    variables = FmuComponent(fmus / "MassSpring.fmu").variables
    plain = run(Plain([v for v in variables if v.causality != "output"], names))
    real = run(FmuComponent(fmus / "MassSpring.fmu", "mass"))
    assert real.names == plain.names
    np.testing.assert_array_equal(real.columns, plain.columns)
    assert np.ptp(real["mass.energy"]) > 0.1


def test_every_fmi_type_goes_in_and_comes_out_as_it_is(fmus, tmp_path):
    file = tmp_path / "u.csv"
    file.write_text("time,level_in,on_in,count_in\n0,0.5,1,7\n1,-0.25,0,-2147483648\n")
    recording = simulate(
        fmus / "Mirror.fmu", stop_time=2.0, step_size=1.0, start_values={"label": "four"}, input_file=file
    )
    assert recording.names == ("Mirror.on", "Mirror.count", "Mirror.level", "Mirror.length")
    assert recording["Mirror.on"].tolist() == [False, True, False]
    assert recording["Mirror.count"].tolist() == [0, 7, -(2**31)]
    assert recording["Mirror.level"].tolist() == [0.0, 0.5, -0.25]
    assert recording["Mirror.length"].tolist() == [0, 4, 4]


def test_all_variables_of_one_type_travel_in_one_call(fmus, monkeypatch):
    calls = []

    def noted(fmu, name, *arguments):
        call = fmi_call(fmu, name, *arguments)

        def note_and_call():
            calls.append((name, arguments[1].value if "et" in name else 0))
            call()

        return note_and_call

    for module in ("fmu_component", "buffers"):
        monkeypatch.setattr(f"ndob_fmu.cosim.fmi.{module}.fmi_call", noted)
    simulate(
        fmus / "MassSpring.fmu",
        stop_time=2.0,
        step_size=1.0,
        start_values={"mass": 2.0, "stiffness": 3.0, "force": 0.0},
    )
    assert calls[0] == ("fmi2SetReal", 3)
    assert calls[-4:] == [("fmi2DoStep", 0), ("fmi2GetReal", 3)] * 2


def test_arrays_of_any_kind_and_another_one_each_time_carry_the_same_values(fmus):
    """An FMU reads and writes in place where the memory of the array admits it, and follows what changes there."""
    kept_in, kept_out, locked = np.zeros(3), np.zeros(4), np.array([7.25, 1.0, -4.0])
    locked.flags.writeable = False
    component = FmuComponent(fmus / "Mirror.fmu")
    component.setup(0.0, 10.0, {"label": "four"}, ("level_in", "on_in", "count_in"))
    try:
        component.initialize()
        for k, given in enumerate((kept_in, kept_in, np.zeros(6)[::2], kept_in, locked, kept_in)):
            if given is not locked:
                given[:] = 0.5 + k, k % 2, 10.0 * k
            component.set_inputs(given)
            component.step(float(k), 1.0)
            for taken in (kept_out, np.zeros(8)[::2], np.zeros(4, dtype=np.float32), kept_out):
                taken[:] = -1.0
                component.get_outputs(taken)
                assert taken.tolist() == [given[1], given[2], given[0], 4.0]
    finally:
        component.close()


def test_two_fmus_in_a_loop_are_right_at_the_start(fmus):
    parts = {"gain": FmuComponent(fmus / "Gain.fmu"), "mass": FmuComponent(fmus / "MassSpring.fmu")}
    connections = ((("mass", "position"), ("gain", "a")), (("gain", "y"), ("mass", "force")))
    starts = {("gain", "k"): -0.5, ("gain", "b"): 3.0}
    recording = simulate(System(parts, connections, starts), stop_time=1.0, step_size=0.5)
    assert recording["gain.y"][0] == -2.0
    assert recording["mass.velocity"][1] == 0.5 * (-2.0 - 1.0)


@pytest.mark.parametrize(
    ("how", "parts"),
    [
        ("raise", ["component bearing at t = 0.3 s", "fmi2DoStep to succeed", "received fatal", "bearing has seized"]),
        ("initialization", ["bearing at t = 0 s", "fmi2EnterInitializationMode", "fatal", "no equilibrium found"]),
    ],
)
def test_a_failing_fmu_is_named_with_time_and_its_last_words_and_the_others_are_released(fmus, how, parts):
    first, last = constant(1.0), constant(2.0)
    bearing = FmuComponent(fmus / "Fragile.fmu", "bearing")
    starts = {("bearing", "how"): how, ("bearing", "fails_at"): 0.25}
    with pytest.raises(SimulationError) as failed:
        simulate(System({"a": first, "bearing": bearing, "z": last}, (), starts), stop_time=1.0, step_size=0.1)
    assert all(text in str(failed.value) for text in parts), str(failed.value)
    assert "\n" not in str(failed.value)
    assert first.calls[-1] == "close"
    assert last.calls.count("setup") == last.calls.count("close")


def test_ctrl_c_inside_an_fmu_is_an_interrupt_and_not_a_failed_step(fmus):
    with pytest.raises(KeyboardInterrupt):
        simulate(fmus / "Fragile.fmu", stop_time=1.0, step_size=0.1, start_values={"how": "interrupt"})


def test_an_fmu_whose_neighbour_fails_is_terminated_and_freed(fmus, monkeypatch):
    freed = []
    for name in ("terminate", "freeInstance"):
        whole = getattr(fmpy.fmi2.FMU2Slave, name)
        monkeypatch.setattr(fmpy.fmi2.FMU2Slave, name, lambda fmu, n=name, w=whole: (freed.append(n), w(fmu))[1])

    def broken(x, u, t, h):
        raise ZeroDivisionError

    system = System(
        {"mass": FmuComponent(fmus / "MassSpring.fmu"), "bad": Mock(step=broken)}, (), {("mass", "force"): 0}
    )
    with pytest.raises(ZeroDivisionError):
        simulate(system, stop_time=1.0, step_size=0.5)
    assert freed == ["terminate", "freeInstance"]


def test_warnings_of_an_fmu_reach_python_logging_with_its_name(fmus, caplog):
    with caplog.at_level(logging.WARNING):
        starts = {"label": "careful", "count_in": 0, "on_in": False, "level_in": 0.0}
        simulate(fmus / "Mirror.fmu", stop_time=1.0, step_size=0.5, start_values=starts)
    assert [r.getMessage() for r in caplog.records] == ["Mirror: level is only mirrored"] * 2


def test_fmpy_still_prints_the_messages_of_its_own_instances(fmus, capfd):
    simulate(fmus / "MassSpring.fmu", stop_time=1.0, step_size=0.5)
    starts = {"label": "careful"}
    fmpy.simulate_fmu(fmus / "Mirror.fmu", stop_time=1.0, step_size=1.0, start_values=starts, debug_logging=True)
    assert "level is only mirrored" in capfd.readouterr().out


def test_units_of_the_model_description_are_checked(fmus, tmp_path):
    real = '(?s)(name="{}".*?<Real)'
    position = changed(fmus / "MassSpring.fmu", tmp_path / "m.fmu", real.format("position"), r'\1 unit="m"')
    gain = changed(fmus / "Gain.fmu", tmp_path / "g.fmu", real.format("a"), r'\1 unit="rad"')
    expected = r"m\.position → g\.a: expected the unit rad of g\.a, or one that converts to it, received m$"
    with pytest.raises(CouplingError, match=expected):
        System({"m": FmuComponent(position), "g": FmuComponent(gain)}, ((("m", "position"), ("g", "a")),))


@pytest.mark.parametrize(
    ("old", "new", "error", "parts"),
    [
        (
            'fmiVersion="2.0"',
            'fmiVersion="3.0"',
            CouplingError,
            ["FMI 2.0 co-simulation, received one for FMI 3.0"],
        ),
        ("CoSimulation", "ModelExchange", CouplingError, ["received one for FMI 2.0 model exchange"]),
        ("CoSimulation", "Simulation", CouplingError, ["received one for FMI 2.0 without an interface"]),
        ("<ModelVariables>", "<ModelVariables", CouplingError, ["modelDescription.xml: expected well-formed XML"]),
        ("", None, CouplingError, ["without modelDescription.xml"]),
    ],
)
def test_what_is_no_co_simulation_fmu_is_refused_in_one_line(fmus, tmp_path, old, new, error, parts):
    path = changed(fmus / "MassSpring.fmu", tmp_path / "x.fmu", old, new)
    with pytest.raises(error) as refused:
        FmuComponent(path)
    assert all(text in str(refused.value) for text in ["component x: ", "x.fmu", *parts]), str(refused.value)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("description", "kind"),
    [
        ('<fmiModelDescription fmiVersion="1.0"/>', "FMI 1.0 model exchange"),
        ('<fmiModelDescription fmiVersion="1.0"><Implementation/></fmiModelDescription>', "FMI 1.0 co-simulation"),
        (
            '<fmiModelDescription fmiVersion="3.0"><ModelExchange/><CoSimulation/></fmiModelDescription>',
            "FMI 3.0 model exchange and co-simulation",
        ),
        (
            '<fmiModelDescription fmiVersion="3.0"><ScheduledExecution/></fmiModelDescription>',
            "FMI 3.0 scheduled execution",
        ),
        ("<project/>", "FMI of unknown version without an interface"),
    ],
)
def test_an_fmu_of_another_kind_is_refused_by_the_name_of_its_component_with_what_it_is(tmp_path, description, kind):
    with zipfile.ZipFile(tmp_path / "x.fmu", "w") as archive:
        archive.writestr("modelDescription.xml", description)
    with pytest.raises(CouplingError) as refused:
        System().add("plant", tmp_path / "x.fmu")
    said = f"component plant: {tmp_path / 'x.fmu'}: expected an FMU for FMI 2.0 co-simulation, received one for {kind}"
    assert str(refused.value) == said


def test_files_that_are_no_archives_or_not_there_or_reach_outside_are_refused(tmp_path):
    (tmp_path / "text.fmu").write_text("not a zip")
    with pytest.raises(CouplingError, match=r"text\.fmu: expected a zip archive"):
        FmuComponent(tmp_path / "text.fmu")
    with pytest.raises(UsageError, match=r"absent\.fmu: expected a file that can be read, received.*No such file"):
        FmuComponent(tmp_path / "absent.fmu")
    for name in ("../evil.txt", "/evil.txt", "C:/evil.txt", "a\\..\\evil.txt"):
        with zipfile.ZipFile(tmp_path / "evil.fmu", "w") as archive:
            archive.writestr(zipfile.ZipInfo(name), "")
        with pytest.raises(CouplingError, match=r"evil\.fmu: expected entries that stay inside"):
            FmuComponent(tmp_path / "evil.fmu")


def test_an_fmu_without_a_binary_for_this_platform_or_with_a_broken_one_says_so(fmus, tmp_path):
    binary = f"binaries/{fmpy.platform}/MassSpring{fmpy.sharedLibraryExtension}"
    without = changed(fmus / "MassSpring.fmu", tmp_path / "without.fmu", "", None, binary)
    with pytest.raises(
        SimulationError, match=r"without.*a library that can be loaded, received Cannot find shared lib"
    ):
        simulate(without, stop_time=1.0, step_size=0.5)
    broken = changed(fmus / "MassSpring.fmu", tmp_path / "broken.fmu", "(?s).*", "no library", binary)
    with pytest.raises(SimulationError, match=r"broken.*a library that can be loaded, received Failed to load"):
        simulate(broken, stop_time=1.0, step_size=0.5)


def test_a_kept_fmu_is_instantiated_once_and_every_run_is_as_if_it_were_the_first(fmus, monkeypatch):
    counts = count_calls(monkeypatch)
    component = FmuComponent(fmus / "MassSpring.fmu", "mass")
    fresh = FmuComponent(fmus / "MassSpring.fmu", "mass")

    def run(part, **starts):
        system = System({"mass": part}, (), {("mass", name): value for name, value in ({"force": 0} | starts).items()})
        return simulate(system, stop_time=1.0, step_size=0.125).columns

    with component.kept():
        kept = [run(component), run(component, stiffness=9.0, force=2.0), run(component)]
        assert counts == {"fmi2Instantiate": 1, "reset": 3, "freeInstance": 0}
    assert counts["freeInstance"] == 1
    np.testing.assert_array_equal(kept[0], run(fresh))
    np.testing.assert_array_equal(kept[1], run(fresh, stiffness=9.0, force=2.0))
    np.testing.assert_array_equal(kept[2], kept[0])
    assert not np.array_equal(kept[1], kept[0])
    assert counts["fmi2Instantiate"] == 3


def count_calls(monkeypatch):
    counts = {"fmi2Instantiate": 0, "reset": 0, "freeInstance": 0}
    make = fmu_component.instantiate
    monkeypatch.setattr(fmu_component, "instantiate", lambda *given: (note("fmi2Instantiate"), make(*given))[1])

    def note(name):
        counts[name] += 1

    for name in ("reset", "freeInstance"):
        whole = getattr(fmpy.fmi2.FMU2Slave, name)
        monkeypatch.setattr(fmpy.fmi2.FMU2Slave, name, lambda fmu, n=name, w=whole: (note(n), w(fmu))[1])
    return counts


def test_a_kept_fmu_that_fails_makes_room_for_a_new_one(fmus, monkeypatch):
    counts = count_calls(monkeypatch)
    bearing = FmuComponent(fmus / "Fragile.fmu", "bearing")
    with bearing.kept():
        for how in ("raise", "", "raise", ""):
            system = System({"bearing": bearing}, (), {("bearing", "how"): how})
            if how == "":
                assert len(simulate(system, stop_time=1.0, step_size=0.5).time) == 3
            else:
                with pytest.raises(SimulationError, match="the bearing has seized"):
                    simulate(system, stop_time=1.0, step_size=0.5)
    assert counts["fmi2Instantiate"] == 3  # again only after the fatal status


def test_an_fmu_that_cannot_be_instantiated_says_so(fmus):
    system = System({"unlicensed": FmuComponent(fmus / "Fragile.fmu", "unlicensed")})
    with pytest.raises(SimulationError, match=r"component unlicensed at t = 0 s: expected an instance.*no licence"):
        simulate(system, stop_time=1.0, step_size=0.5)


@pytest.mark.parametrize(("given", "received"), [(None, 1e-5), (1e-8, 1e-8)])
def test_an_fmu_gets_the_tolerance_of_the_run_and_else_its_own(fmus, given, received):
    recording = simulate(fmus / "Ramp.fmu", start_values={"u": 0}, tolerance=given)
    assert recording["Ramp.tolerance"][0] == received


def test_an_fmu_without_a_tolerance_of_its_own_is_told_none(fmus, tmp_path):
    for number, own in enumerate(("", ' tolerance="0"')):
        path = changed(fmus / "Ramp.fmu", tmp_path / f"{number}" / "Ramp.fmu", ' tolerance="1e-5"', own)
        assert simulate(path, start_values={"u": 0})["Ramp.tolerance"][0] == -1.0  # as Ramp.fmu starts


@pytest.mark.parametrize("tolerance", [0.0, -1e-6, float("nan"), float("inf")])
def test_a_tolerance_that_is_not_a_positive_number_is_refused(fmus, tolerance):
    with pytest.raises(UsageError, match=f"tolerance: expected a finite number > 0, received {tolerance}"):
        simulate(fmus / "Ramp.fmu", start_values={"u": 0}, tolerance=tolerance)


def test_a_default_experiment_without_numbers_is_refused_in_one_line(fmus, tmp_path):
    path = changed(fmus / "Ramp.fmu", tmp_path / "Ramp.fmu", 'tolerance="1e-5"', 'tolerance="fine"')
    with pytest.raises(
        CouplingError, match=r"tolerance of DefaultExperiment: expected a finite number, received 'fine'"
    ):
        FmuComponent(path)


def test_a_run_in_a_fresh_process_exits_cleanly_and_leaves_nothing(fmus, tmp_path):
    call = f"simulate({str(fmus / 'MassSpring.fmu')!r}, stop_time=1, step_size=.1, start_values=dict(force=0))"
    code = f"from ndob_fmu import simulate; print(len({call}.time))"
    folder = tmp_path / "tmp"
    run = subprocess.run(
        [sys.executable, "-W", "error", "-c", code],
        capture_output=True,
        text=True,
        check=True,
        env=os.environ | {"TMPDIR": str(folder)},
    )
    assert (run.stdout, run.stderr) == ("11\n", "")
    assert list(folder.iterdir()) == []
