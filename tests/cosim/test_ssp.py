"""System descriptions in SSP packages: read, refused by name, and packed."""

from __future__ import annotations

import re
import zipfile
from pathlib import Path

import numpy as np
import pytest
from fmpy.ssp.simulation import simulate_ssp

from ndob_fmu.cosim import FmuComponent, System, open_ssp, simulate
from ndob_fmu.errors import CouplingError, SimulationError, UsageError
from ndob_fmu.packages import build_ssp
from tests.helpers.coupling_fmus import coupling_fmus

pytestmark = pytest.mark.usefixtures("nothing_left_behind")

OPEN_LOOP = Path(__file__).parents[2] / "ssp" / "open_loop"

SSD = """<?xml version="1.0" encoding="UTF-8"?>
<ssd:SystemStructureDescription version="1.0" name="spring"
    xmlns:ssd="http://ssp-standard.org/SSP1/SystemStructureDescription"
    xmlns:ssc="http://ssp-standard.org/SSP1/SystemStructureCommon"
    xmlns:ssv="http://ssp-standard.org/SSP1/SystemStructureParameterValues"
    xmlns:ssb="http://ssp-standard.org/SSP1/SystemStructureSignalDictionary"
    xmlns:ssm="http://ssp-standard.org/SSP1/SystemStructureParameterMapping"
    xmlns:osp="http://opensimulationplatform.com/SSP/OSPAnnotations">
  <ssd:System name="spring">
    <ssd:ParameterBindings>
      <ssd:ParameterBinding prefix="gain.">
        <ssd:ParameterValues>
          <ssv:ParameterSet version="1.0" name="spring">
            <ssv:Parameters><ssv:Parameter name="b"><ssv:Real value="3.0"/></ssv:Parameter></ssv:Parameters>
          </ssv:ParameterSet>
        </ssd:ParameterValues>
      </ssd:ParameterBinding>
    </ssd:ParameterBindings>
    <ssd:Elements>
      <ssd:Component name="gain" source="resources/Gain.fmu">
        <ssd:Connectors>
          <ssd:Connector name="a" kind="input"><ssc:Real/></ssd:Connector>
          <ssd:Connector name="y" kind="output"><ssc:Real/></ssd:Connector>
        </ssd:Connectors>
        <ssd:ParameterBindings>
          <ssd:ParameterBinding source="gain.ssv"/>
        </ssd:ParameterBindings>
      </ssd:Component>
      <ssd:Component name="mass" source="resources/MassSpring.fmu">
        <ssd:Connectors>
          <ssd:Connector name="position" kind="output"/>
          <ssd:Connector name="force" kind="input"/>
        </ssd:Connectors>
      </ssd:Component>
    </ssd:Elements>
    <ssd:Connections>
      <ssd:Connection startElement="mass" startConnector="position" endElement="gain" endConnector="a"/>
      <ssd:Connection startElement="mass" startConnector="force" endElement="gain" endConnector="y"/>
    </ssd:Connections>
    <ssd:Annotations><ssc:Annotation type="org.example"><x/></ssc:Annotation></ssd:Annotations>
  </ssd:System>
  <ssd:DefaultExperiment startTime="1.0" stopTime="3.0">
    <ssd:Annotations>
      <ssc:Annotation type="com.opensimulationplatform">
        <osp:Algorithm><osp:FixedStepAlgorithm baseStepSize="0.25"/></osp:Algorithm>
      </ssc:Annotation>
    </ssd:Annotations>
  </ssd:DefaultExperiment>
</ssd:SystemStructureDescription>
"""

SSV = """<?xml version="1.0" encoding="UTF-8"?>
<ssv:ParameterSet version="1.0" name="spring"
    xmlns:ssv="http://ssp-standard.org/SSP1/SystemStructureParameterValues">
  <ssv:Parameters>
    <ssv:Parameter name="k"><ssv:Real value="-0.5"/></ssv:Parameter>
  </ssv:Parameters>
</ssv:ParameterSet>
"""


@pytest.fixture(scope="session")
def fmus(tmp_path_factory):
    return coupling_fmus(tmp_path_factory.getbasetemp())


@pytest.fixture
def pack(tmp_path, fmus):
    """Write spring.ssp; replace maps pieces of the .ssd or .ssv to others, without leaves entries out."""

    def pack(replace=(), without=()):
        texts = {"SystemStructure.ssd": SSD, "gain.ssv": SSV}
        for old, new in replace:
            assert any(old in text for text in texts.values()), old
            texts = {name: text.replace(old, new) for name, text in texts.items()}
        path = tmp_path / "spring.ssp"
        with zipfile.ZipFile(path, "w") as package:
            for name in ("Gain.fmu", "MassSpring.fmu"):
                if name not in without:
                    package.write(fmus / name, f"resources/{name}")
            for name, text in texts.items():
                if name not in without:
                    package.writestr(name, text)
        return path

    return pack


def test_a_package_runs_like_the_same_system_wired_by_hand(pack, fmus):
    parts = {"gain": FmuComponent(fmus / "Gain.fmu"), "mass": FmuComponent(fmus / "MassSpring.fmu")}
    connections = ((("mass", "position"), ("gain", "a")), (("gain", "y"), ("mass", "force")))
    starts = {("gain", "k"): -0.5, ("gain", "b"): 3.0}
    by_hand = simulate(System(parts, connections, starts), start_time=1.0, stop_time=3.0, step_size=0.25)
    packed = simulate(pack())
    assert packed.names == by_hand.names == ("gain.y", "mass.position", "mass.velocity", "mass.energy")
    np.testing.assert_array_equal(packed.time, np.linspace(1.0, 3.0, 9))
    np.testing.assert_array_equal(packed.columns, by_hand.columns)


def test_times_and_start_values_of_the_call_come_before_those_of_the_package(pack):
    recording = simulate(pack(), start_time=0.0, stop_time=1.0, step_size=0.5, start_values={"gain.k": 4.0})
    np.testing.assert_array_equal(recording.time, [0.0, 0.5, 1.0])
    assert recording["gain.y"][0] == 4.0 * (1.0 + 3.0)


def test_a_package_without_a_default_experiment_asks_for_the_times(pack):
    bare = pack([(re.search(r"(?s)  <ssd:DefaultExperiment.*DefaultExperiment>\n", SSD).group(), "")])
    with pytest.raises(UsageError, match="stop time: expected a number of seconds, received none"):
        simulate(bare, step_size=0.1)
    assert len(simulate(bare, stop_time=1.0, step_size=0.5).time) == 3


def test_only_the_step_size_of_the_open_simulation_platform_is_taken(pack):
    with pytest.raises(UsageError, match="step size: expected a number of seconds, received none"):
        simulate(pack([("com.opensimulationplatform", "com.example")]))


CONNECTION = '<ssd:Connection startElement="mass" startConnector="position" endElement="gain" endConnector="a"/>'
OPENED = CONNECTION.replace("/>", ">{}</ssd:Connection>")
BINDING = '<ssd:ParameterBinding source="gain.ssv"/>'
MAPPED = '<ssd:ParameterBinding source="gain.ssv"><ssd:ParameterMapping {}/></ssd:ParameterBinding>'


@pytest.mark.parametrize(
    ("old", "new", "part"),
    [
        (
            CONNECTION,
            OPENED.format(
                '<ssc:BooleanMappingTransformation><ssc:MapEntry source="true" target="false"/>'
                "</ssc:BooleanMappingTransformation>"
            ),
            "BooleanMappingTransformation in connection mass.position → gain.a",
        ),
        (BINDING, BINDING.replace("/>", ' sourceBase="component"/>'), "sourceBase='component'"),
        (BINDING, BINDING.replace("/>", ' type="text/csv"/>'), "type='text/csv'"),
        (BINDING, MAPPED.format('source="m.ssm" sourceBase="component"'), "sourceBase='component' of ParameterMapping"),
        (
            'source="resources/Gain.fmu"',
            'source="resources/Gain.fmu" type="application/x-ssp-package"',
            "x-ssp-package",
        ),
        ('source="resources/Gain.fmu"', 'source="resources/Gain.fmu" implementation="ModelExchange"', "ModelExchange"),
        ('kind="output"><ssc:Real/>', 'kind="output"><ssc:Binary/>', "Binary in Connector 'y'"),
        ('<ssv:Real value="-0.5"/>', '<ssv:Binary value="00"/>', "Binary in Parameter 'k'"),
    ],
)
def test_what_would_not_be_honoured_is_refused_by_name(pack, old, new, part):
    with pytest.raises(CouplingError) as refused:
        simulate(pack([(old, new)]))
    assert part in str(refused.value)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("replace", "without", "parts"),
    [
        ((), ["SystemStructure.ssd"], ["a package with SystemStructure.ssd"]),
        (
            (),
            ["Gain.fmu"],
            ["component gain", "resources/Gain.fmu in the package", "received resources/MassSpring.fmu"],
        ),
        ((), ["gain.ssv"], ["source of a ParameterBinding", "gain.ssv in the package", "received no .ssv file"]),
        ([("</ssd:System>", "")], (), ["SystemStructure.ssd", "well-formed XML", "line"]),
        ([("</ssv:Parameters>\n</ssv", "</ssv:Para>\n</ssv")], (), ["gain.ssv", "well-formed XML", "line"]),
        (
            [('version="1.0" name="spring"\n    xmlns:ssd', 'version="2.0" name="x"\n    xmlns:ssd')],
            (),
            ["version 1.x", "2.0"],
        ),
        ([(' name="gain" source', " source")], (), ["a file that follows SSP 1.0", "'name' is required", "line 20"]),
        (
            [("</ssv:Parameters>\n</ssv", "</ssv:Parameters><x/>\n</ssv")],
            (),
            ["gain.ssv", "a file that follows SSP 1.0"],
        ),
        ([('<ssv:Parameter name="b">', "<ssv:Parameter>")], (), ["SystemStructure.ssd", "'name' is required"]),
        (
            [('xmlns:ssd="http:', 'xmlns:ssd="https:')],
            (),
            ["SystemStructureDescription of http://ssp-standard.org/SSP1"],
        ),
        ([('baseStepSize="0.25"', 'baseStepSize="often"')], (), ["baseStepSize", "finite number", "'often'"]),
        (
            [('startConnector="position"', 'startConnector="positoin"')],
            (),
            ["variable of mass", "did you mean 'position'?"],
        ),
        (
            [('name="position" kind="output"', 'name="position" kind="input"')],
            (),
            ["mass.position", "causality output"],
        ),
        ([("<ssc:Real/>", "<ssc:Integer/>")], (), ["gain.a", "the type Real", "received Integer"]),
        ([('name="k"', 'name="kk"')], (), ["variable of gain", "did you mean 'k'?"]),
        ([('<ssv:Real value="-0.5"/>', '<ssv:String value="x"/>')], (), ["gain.k", "type Real", "String"]),
        ([('<ssv:Real value="-0.5"/>', '<ssv:Boolean value="true"/>')], (), ["gain.k", "a number (Real)", "'true'"]),
        ([('prefix="gain."', 'prefix="gian."')], (), ["'gian.b'", "did you mean 'gain.b'?"]),
        ([("</ssd:Connections>", CONNECTION + "</ssd:Connections>")], (), ["input gain.a", "exactly one driver"]),
    ],
)
def test_a_package_that_is_damaged_or_contradicts_itself_ends_in_one_line(pack, replace, without, parts):
    path = pack(replace, without)
    with pytest.raises(CouplingError) as refused:
        simulate(path)
    assert all(text in str(refused.value) for text in parts), str(refused.value)
    assert "\n" not in str(refused.value)


def test_files_that_are_no_packages_are_refused(tmp_path):
    (tmp_path / "text.ssp").write_text("not a zip")
    with pytest.raises(CouplingError, match=r"text\.ssp: expected a zip archive"):
        simulate(tmp_path / "text.ssp")
    with pytest.raises(UsageError, match=r"absent\.ssp: expected a file that can be read"):
        simulate(tmp_path / "absent.ssp")


@pytest.mark.parametrize("name", ["../evil.ssv", "/evil.ssv", "C:/evil.ssv", "resources/../../evil.ssv"])
def test_an_entry_that_reaches_outside_is_refused_and_not_written(pack, tmp_path, name):
    path = pack()
    with zipfile.ZipFile(path, "a") as package:
        package.writestr(zipfile.ZipInfo(name), "")
    with pytest.raises(CouplingError, match=r"spring\.ssp: expected entries that stay inside"):
        simulate(path)
    assert not list(tmp_path.parent.rglob("evil.ssv"))


def test_a_component_that_fails_in_a_package_leaves_nothing_behind(pack):
    with pytest.raises(SimulationError, match="component mass"):
        simulate(pack(), start_values={"mass.mass": 0.0})


def folder_with(tmp_path, ssd=SSD):
    folder = tmp_path / "spring"
    folder.mkdir()
    (folder / "SystemStructure.ssd").write_text(ssd)
    (folder / "gain.ssv").write_text(SSV)
    (folder / "notes.txt").write_text("not for the package")
    return folder


def test_a_folder_is_packed_with_the_fmus_that_it_names_and_runs(tmp_path, fmus, pack):
    path = build_ssp(folder_with(tmp_path), fmus, tmp_path / "build" / "ssp")
    assert path == tmp_path / "build" / "ssp" / "spring.ssp"
    with zipfile.ZipFile(path) as package:
        assert package.namelist() == [
            "SystemStructure.ssd",
            "gain.ssv",
            "resources/Gain.fmu",
            "resources/MassSpring.fmu",
        ]
    np.testing.assert_array_equal(simulate(path).columns, simulate(pack()).columns)


def test_the_same_files_pack_to_the_same_bytes(tmp_path, fmus):
    folder = folder_with(tmp_path)
    first = build_ssp(folder, fmus, tmp_path / "one").read_bytes()
    (folder / "gain.ssv").touch()
    assert build_ssp(folder, fmus, tmp_path / "two").read_bytes() == first


def test_packing_says_what_is_missing_and_leaves_the_old_package(tmp_path, fmus):
    folder = folder_with(tmp_path)
    whole = build_ssp(folder, fmus, tmp_path).read_bytes()
    with pytest.raises(
        CouplingError, match=r"expected Gain\.fmu in .*received no such file; likely cause: not built yet"
    ):
        build_ssp(folder, tmp_path, tmp_path)
    assert (tmp_path / "spring.ssp").read_bytes() == whole
    with pytest.raises(UsageError, match=r"expected a folder with SystemStructure\.ssd"):
        build_ssp(tmp_path / "absent", fmus, tmp_path)
    (folder / "SystemStructure.ssd").write_text("<ssd")
    with pytest.raises(CouplingError, match=r"SystemStructure\.ssd: expected well-formed XML"):
        build_ssp(folder, fmus, tmp_path)


def test_the_open_loop_of_the_project_packs_runs_and_drives_every_input(tmp_path, fmus):
    path = build_ssp(OPEN_LOOP, fmus, tmp_path)
    recording = simulate(path, output_interval=0.5)
    np.testing.assert_array_equal(recording.time, np.arange(41) * 0.5)
    with open_ssp(path) as (_, experiment):
        assert (experiment.start_time, experiment.stop_time, experiment.step_size) == (0.0, 20.0, 1e-3)
    np.testing.assert_allclose(recording["plant.motor_angle"], np.cos(recording.time), rtol=1e-12)
    # Jacobi: the observer ends a step with what it was given at the beginning.
    late = np.cos(recording.time[1:] - 1e-3)
    np.testing.assert_allclose(recording["observer.motor_angle_hat"][1:], late, rtol=1e-9)
    np.testing.assert_array_equal(recording["plant.link_angle"], 0)
    np.testing.assert_array_equal(recording["observer.motor_torque_hat"], 0)
    np.testing.assert_array_equal(recording["observer.used"], 1)


def test_the_open_loop_runs_in_fmpys_own_ssp_simulation(tmp_path, fmus):
    path = build_ssp(OPEN_LOOP, fmus, tmp_path)
    result = simulate_ssp(str(path), stop_time=0.1, step_size=1e-3)
    # It stamps each row with the beginning of the step.
    np.testing.assert_allclose(result["observer.motor_angle"], np.cos(result["time"] + 1e-3), rtol=1e-9)
