"""The model description against what other tools demand of it: fmpy, the fmu-manipulation-toolbox and the schema."""

from __future__ import annotations

import re
import zipfile
from importlib.metadata import version
from xml.etree import ElementTree

import fmpy
import pytest
from fmpy.validation import validate_fmu

import ndob_fmu
from ndob_fmu import Model, build
from ndob_fmu.fmu.fmi2_xml import model_description
from ndob_fmu.fmu.fmu_description import FmuDescription
from ndob_fmu.interface.model_variables import METHOD
from ndob_fmu.interface.variables import Variable
from ndob_fmu.runtime.equations import Experiment
from tests.helpers.checkers import toolbox_findings
from tests.helpers.clean_process import fmpy as fmpy_command
from tests.helpers.fmi_instance import OK, opened
from tests.helpers.problems import MODELS

# Several disturbances, no unit at all, names with underscores, and names that types have elsewhere.
PLAIN = Model(
    name="Plain_Plant_2",
    states=["Method", "Angle_", "s_3"],
    inputs=["DisturbanceKind", "u_2"],
    outputs=["o_1", "Method", "o_3"],
    disturbances=["d_1_", "Time"],
    A=[[-1, 1, 0], [0, -2, 1], [1, 0, -3]],
    B=[[1, 0], [0, 1], [0, 0]],
    C=[[1, 0, 1], [1, 0, 0], [0, 1, 0]],
    G_d=[[1, 0], [0, 1], [0, 0]],
)
# The same where these names are also those of types: FMI wants them to differ.
CLASHING = Model(
    name="Clashing",
    states=["Angle", "Torque", "Unit_kN"],
    outputs=["y_1", "Torque"],
    disturbances=["Method", "DisturbanceKind"],
    inputs=["Time"],
    A=[[-1, 1, 0], [0, -2, 1], [1, 0, -3]],
    B=[[1], [0], [0]],
    C=[[1, 0, 1], [0, 1, 0]],
    G_d=[[1, 0], [0, 1], [0, 0]],
    units={"Angle": "rad", "Torque": "N.m", "Unit_kN": "kN", "Time": "s", "y_1": "kN^1", "Method": "rad^2/s"},
)


@pytest.fixture(scope="module")
def fmus(tmp_path_factory):
    """Return the FMUs of all models by their names."""
    folder = tmp_path_factory.mktemp("described")
    return {fmu.stem: fmu for model in [*MODELS.values(), PLAIN, CLASHING] for fmu in build(model, folder)}


def root_of(fmu):
    with zipfile.ZipFile(fmu) as archive:
        return ElementTree.fromstring(archive.read("modelDescription.xml"))


def altered(fmu, folder, old, new):
    """Return a copy of the FMU with this text of its description replaced."""
    copy = folder / fmu.name
    with zipfile.ZipFile(fmu) as source, zipfile.ZipFile(copy, "w") as target:
        for name in source.namelist():
            data = source.read(name)
            if name == "modelDescription.xml":
                assert old in data
                data = data.replace(old, new)
            target.writestr(name, data)
    return copy


def test_fmpy_finds_no_problem_in_the_fmus_of_any_model(fmus):
    assert len(fmus) >= 14
    assert {name: validate_fmu(str(fmu)) for name, fmu in fmus.items()} == {name: [] for name in fmus}


def test_the_command_that_users_type_says_so(fmus, tmp_path):
    done = fmpy_command("validate", fmus["Plain_Plant_2Observer"], cwd=tmp_path)
    assert (done.returncode, done.stdout, done.stderr) == (0, "No problems found.\n", "")


def test_the_manipulation_toolbox_finds_no_error_against_schema_and_rules(fmus):
    assert {name: toolbox_findings(fmu) for name, fmu in fmus.items()} == {name: [] for name in fmus}


def test_the_checks_do_find_what_is_wrong(fmus, tmp_path):
    plant = fmus["FlexibleJointPlant"]
    no_start = altered(plant, tmp_path, b'<Real start="0.0" declaredType="Torque"', b'<Real declaredType="Torque"')
    assert any("start" in problem for problem in validate_fmu(str(no_start)))
    assert any("start value is required" in finding for finding in toolbox_findings(no_start))
    unknown = altered(plant, tmp_path, b'causality="input"', b'causality="inlet"')
    assert any("inlet" in finding for finding in toolbox_findings(unknown))


# One variable of each type, with all that FMI 2.0 lets a description say of one.
SMALL = FmuDescription(
    name="Small",
    text="An FMU <of> nothing",
    variables=(
        Variable("angle", "input", "Angle", start=0.5, unit="rad"),
        Variable("torque", "output", "Torque", unit="N.m", depends_on=("angle",), nominal=5.0, minimum=0.0),
        Variable("valid", "output", "Flag", type="Boolean"),
        Variable("gain", "parameter", "Gain", start=0.1 + 0.2, minimum=0, maximum=1e300),
        Variable("method", "parameter", "Method", "Enumeration", 2, enumeration=METHOD),
        Variable("seed", "parameter", "Seed", "Integer", 7, minimum=0),
        Variable("on", "parameter", "Switch", "Boolean", True),
        Variable("file", "parameter", "Path", "String", "a&b"),
    ),
    experiment=Experiment(stop_time=2, step_size=0.25),
)
SMALL_TEXT = """\
<fmiModelDescription fmiVersion="2.0" modelName="Small" guid="" generationTool="TOOL" \
variableNamingConvention="structured" description="An FMU &lt;of&gt; nothing">
  <CoSimulation CAPABILITIES />
  <UnitDefinitions>
    <Unit name="N.m">
      <BaseUnit kg="1" m="2" s="-2" />
    </Unit>
    <Unit name="rad">
      <BaseUnit rad="1" />
    </Unit>
  </UnitDefinitions>
  <TypeDefinitions>
    <SimpleType name="Method">
      <Enumeration>
        <Item name="paper" value="1" \
description="the paper's observer, eqs. (22) to (24), integrated inside the step" />
        <Item name="sampled_data" value="2" description="the sampled-data design, exact at the communication points" />
      </Enumeration>
    </SimpleType>
    <SimpleType name="Torque">
      <Real quantity="Torque" unit="N.m" />
    </SimpleType>
    <SimpleType name="Angle">
      <Real quantity="Angle" unit="rad" />
    </SimpleType>
  </TypeDefinitions>
  <LogCategories>
    <Category name="logStatusWarning" description="Log messages with fmi2Warning status." />
    <Category name="logStatusDiscard" description="Log messages with fmi2Discard status." />
    <Category name="logStatusError" description="Log messages with fmi2Error status." />
    <Category name="logStatusFatal" description="Log messages with fmi2Fatal status." />
    <Category name="logAll" description="Log all messages." />
  </LogCategories>
  <DefaultExperiment startTime="0.0" stopTime="2.0" stepSize="0.25" />
  <ModelVariables>
    <ScalarVariable name="angle" valueReference="0" description="Angle" causality="input" variability="continuous">
      <Real start="0.5" declaredType="Angle" unit="rad" />
    </ScalarVariable>
    <ScalarVariable name="torque" valueReference="1" description="Torque" causality="output" variability="continuous" \
initial="calculated">
      <Real declaredType="Torque" unit="N.m" min="0.0" nominal="5.0" />
    </ScalarVariable>
    <ScalarVariable name="valid" valueReference="2" description="Flag" causality="output" variability="discrete" \
initial="calculated">
      <Boolean />
    </ScalarVariable>
    <ScalarVariable name="gain" valueReference="3" description="Gain" causality="parameter" variability="fixed" \
initial="exact">
      <Real start="0.30000000000000004" min="0.0" max="1e+300" />
    </ScalarVariable>
    <ScalarVariable name="method" valueReference="4" description="Method" causality="parameter" variability="fixed" \
initial="exact">
      <Enumeration start="2" declaredType="Method" />
    </ScalarVariable>
    <ScalarVariable name="seed" valueReference="5" description="Seed" causality="parameter" variability="fixed" \
initial="exact">
      <Integer start="7" min="0" />
    </ScalarVariable>
    <ScalarVariable name="on" valueReference="6" description="Switch" causality="parameter" variability="fixed" \
initial="exact">
      <Boolean start="true" />
    </ScalarVariable>
    <ScalarVariable name="file" valueReference="7" description="Path" causality="parameter" variability="fixed" \
initial="exact">
      <String start="a&amp;b" />
    </ScalarVariable>
  </ModelVariables>
  <ModelStructure>
    <Outputs>
      <Unknown index="2" dependencies="" />
      <Unknown index="3" dependencies="" />
    </Outputs>
    <InitialUnknowns>
      <Unknown index="2" dependencies="1 4 5 6 7 8" />
      <Unknown index="3" dependencies="4 5 6 7 8" />
    </InitialUnknowns>
  </ModelStructure>
</fmiModelDescription>"""


def test_the_whole_description_follows_from_the_list_of_variables():
    text = ElementTree.tostring(model_description(SMALL), encoding="unicode")
    text = re.sub(r'generationTool="[^"]*"', 'generationTool="TOOL"', text)
    assert re.sub(r"<CoSimulation [^>]* />", "<CoSimulation CAPABILITIES />", text) == SMALL_TEXT


def test_an_fmu_has_the_values_that_its_description_gives_before_anything_is_set(shipped):
    """The description is written from the same list of variables as the values in the slave, by other code."""
    checked = 0
    for path in sorted(shipped.fmus.glob("*.fmu")):
        with opened(path) as instance:
            for variable in instance.variables.values():
                if variable.start is None:
                    continue
                kind = {"Enumeration": "Integer"}.get(variable.type, variable.type)
                (value,) = getattr(instance.fmu, f"get{kind}")([variable.valueReference])
                value = value.decode() if isinstance(value, bytes) else value
                given = {"Real": float, "Integer": int, "Boolean": lambda text: int(text == "true"), "String": str}
                assert value == given[kind](variable.start), (path.name, variable.name)
                checked += 1
            assert not instance.said
            assert instance.setupExperiment(startTime=0.0) == OK
    assert checked > 60


def test_every_type_is_declared_once_used_and_named_like_no_variable(fmus):
    for fmu in fmus.values():
        root = root_of(fmu)
        types = [simple.get("name") for simple in root.iterfind("TypeDefinitions/SimpleType")]
        variables = {variable.get("name") for variable in root.iterfind("ModelVariables/ScalarVariable")}
        used = {typed.get("declaredType") for typed in root.iterfind("ModelVariables/ScalarVariable/*")} - {None}
        assert len(types) == len(set(types))
        assert set(types) == used
        assert not set(types) & variables


def test_types_of_units_carry_the_variables_unit_and_the_common_ones_their_quantity(fmus):
    for fmu in fmus.values():
        root = root_of(fmu)
        types = {simple.get("name"): simple[0] for simple in root.iterfind("TypeDefinitions/SimpleType")}
        units = {unit.get("name") for unit in root.iterfind("UnitDefinitions/Unit")}
        for typed in root.iterfind("ModelVariables/ScalarVariable/*"):
            if typed.get("unit"):
                assert types[typed.get("declaredType")].get("unit") == typed.get("unit")
                assert typed.get("unit") in units
    plant = fmpy.read_model_description(str(fmus["FlexibleJointPlant"]))
    quantities = {t.name: (t.quantity, t.unit) for t in plant.typeDefinitions if t.unit}
    assert quantities["Angle"] == ("Angle", "rad")
    assert quantities["Torque"] == ("Torque", "N.m")
    car = fmpy.read_model_description(str(fmus["CarInCrosswindPlant"]))
    assert {t.name: (t.quantity, t.unit) for t in car.typeDefinitions}["Unit_kN_per_rad"] == (None, "kN/rad")


def test_a_model_without_units_has_only_the_units_of_its_generator_and_its_tuning(fmus):
    for part, expected in (("Plant", {"Hz", "s"}), ("Observer", {"1/s", "s"})):
        root = root_of(fmus[f"Plain_Plant_2{part}"])
        assert {unit.get("name") for unit in root.iterfind("UnitDefinitions/Unit")} == expected


def test_enumeration_items_say_what_they_mean(fmus):
    for name in ("FlexibleJointPlant", "FlexibleJointObserver"):
        items = list(root_of(fmus[name]).iterfind("TypeDefinitions/SimpleType/Enumeration/Item"))
        assert items
        assert all(item.get("description") for item in items)


def test_what_has_the_size_of_a_disturbance_or_a_size_far_from_one_declares_it(fmus):
    nominals = {
        variable.name: float(variable.nominal)
        for name in ("FlexibleJointPlant", "FlexibleJointObserver")
        for variable in fmpy.read_model_description(str(fmus[name])).modelVariables
        if variable.nominal is not None
    }
    assert nominals == {
        **dict.fromkeys(
            [f"load_torque_{of}" for of in ("total", "hat", "at_sample", "std", "lagged", "lagged_std")], 5.0
        ),
        "pi_end": 1e12,
    }


def test_ranges_are_those_that_the_observer_accepts(fmus):
    ranges = {
        variable.name: tuple(None if bound is None else float(bound) for bound in (variable.min, variable.max))
        for variable in fmpy.read_model_description(str(fmus["FlexibleJointObserver"])).modelVariables
        if (variable.min, variable.max) != (None, None)
    }
    assert ranges["disturbance_order"] == (0.0, 3.0)
    for name in (
        "link_angle_noise_std",
        "disturbance_bound",
        "disturbance_rate",
        "alpha",
        "pi_end",
        "link_angle_hat_start_std",
    ):
        assert ranges[name] == (0.0, None)


def test_every_variable_has_a_description_and_what_fmi_fixes_for_its_causality(fmus):
    expected = {
        "input": ({"continuous", "discrete"}, "exact"),  # fmpy fills in what the standard says for inputs
        "output": ({"continuous", "discrete"}, "calculated"),
        "parameter": ({"fixed"}, "exact"),
    }
    for fmu in fmus.values():
        for variable in fmpy.read_model_description(str(fmu)).modelVariables:
            variabilities, initial = expected[variable.causality]
            assert variable.description, variable.name
            assert variable.variability in variabilities, variable.name
            assert variable.initial == initial, variable.name


def test_the_capabilities_are_those_that_the_fmus_have(fmus):
    for fmu in fmus.values():
        assert root_of(fmu).find("CoSimulation").attrib == {
            "modelIdentifier": fmu.stem,
            "needsExecutionTool": "false",
            "canHandleVariableCommunicationStepSize": "true",
            "canInterpolateInputs": "false",
            "maxOutputDerivativeOrder": "0",
            "canRunAsynchronuously": "false",
            "canBeInstantiatedOnlyOncePerProcess": "false",
            "canNotUseMemoryManagementFunctions": "true",
            "canGetAndSetFMUstate": "true",
            "canSerializeFMUstate": "true",
            "providesDirectionalDerivative": "false",
        }


def test_the_description_names_its_makers_and_no_time(fmus):
    for fmu in fmus.values():
        root = root_of(fmu)
        assert re.fullmatch(r"\{[0-9a-f]{8}(-[0-9a-f]{4}){3}-[0-9a-f]{12}\}", root.get("guid"))
        assert root.get("generationTool") == f"ndob-fmu {ndob_fmu.__version__}, with PythonFMU {version('pythonfmu')}"
        assert root.get("generationDateAndTime") is None


def test_no_tolerance_is_suggested_that_would_change_nothing(fmus):
    for fmu in fmus.values():
        assert set(root_of(fmu).find("DefaultExperiment").attrib) == {"startTime", "stopTime", "stepSize"}


def test_log_categories_are_those_of_the_standard(fmus):
    names = [c.get("name") for c in root_of(fmus["FlexibleJointPlant"]).iterfind("LogCategories/Category")]
    assert names == ["logStatusWarning", "logStatusDiscard", "logStatusError", "logStatusFatal", "logAll"]
