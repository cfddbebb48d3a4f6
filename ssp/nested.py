"""The full form of `two_joints`: a system for each joint, and a signal dictionary for the signals between the links.

Our authoring function writes flat systems, which every tool reads; this is SSP for tools that read all of it.
"""

from __future__ import annotations

from collections.abc import Mapping

from ndob_fmu.cosim.component import Value
from ndob_fmu.cosim.ssp.schema import NAMESPACES
from ndob_fmu.cosim.ssp.supported import FMU_TYPE

_SPACES = " ".join(f'xmlns:{prefix}="{namespace}"' for prefix, namespace in NAMESPACES.items())
_HEAD = '<?xml version="1.0" encoding="UTF-8"?>\n'
_UNITS = """<ssc:Unit name="rad"><ssc:BaseUnit rad="1"/></ssc:Unit>
    <ssc:Unit name="N.m"><ssc:BaseUnit kg="1" m="2" s="-2"/></ssc:Unit>"""
_FMU = f'type="{FMU_TYPE}" implementation="CoSimulation"'
_MEASURED = ("motor_angle", "link_angle")
_WIRES = {"angle_a": "rad", "angle_b": "rad", "torque_a": "N.m", "torque_b": "N.m"}


def two_joints_full(
    plant: Mapping[str, Value], observer: Mapping[str, Value], stiffness: float, turned: Mapping[str, float]
) -> dict[str, bytes]:
    """Return the files of the package.

    plant, observer: start values in both joints. turned: joint → the angle (rad) at which its arm starts. stiffness of
    the spring between the links in N·m/rad.
    """
    angles = {f"start_angle_{joint}": angle for joint, angle in turned.items()}
    texts = {
        "SystemStructure.ssd": _description(),
        "links.ssb": _dictionary(),
        "plant.ssv": _values(plant),
        "observer.ssv": _values(observer),
        "spring.ssv": _values({"stiffness": stiffness}),
        "arms.ssv": _values({"gravity_torque": 10.0, **angles}),
        "arms.ssm": _mapping(turned),
    }
    return {name: (_HEAD + text + "\n").encode() for name, text in texts.items()}


def _description() -> str:
    return f"""<ssd:SystemStructureDescription version="1.0" name="two_joints_full" {_SPACES}
    xmlns:osp="http://opensimulationplatform.com/SSP/OSPAnnotations"
    description="Two joints as systems of their own, whose links share a signal dictionary with a spring">
  <ssd:System name="two_joints_full">
    <ssd:Connectors>
      {_connectors({"load_torque_hat_a": ("output", "N.m"), "load_torque_hat_b": ("output", "N.m")})}
    </ssd:Connectors>
    <ssd:ParameterBindings>
      <ssd:ParameterBinding source="arms.ssv"><ssd:ParameterMapping source="arms.ssm"/></ssd:ParameterBinding>
    </ssd:ParameterBindings>
    <ssd:Elements>
      {_joint("a")}
      {_joint("b")}
      <ssd:Component name="spring" source="resources/spring_TorsionSpring.fmu" {_FMU}>
        <ssd:Connectors>
          {_connectors({n: ("output" if "torque" in n else "input", unit) for n, unit in _WIRES.items()})}
        </ssd:Connectors>
        {_bound("spring")}
      </ssd:Component>
      {_reference(_WIRES)}
    </ssd:Elements>
    <ssd:Connections>
      {_connection("links", "angle_a", "spring", "angle_a")}
      {_connection("links", "angle_b", "spring", "angle_b")}
      {_connection("spring", "torque_a", "links", "torque_a")}
      {_connection("spring", "torque_b", "links", "torque_b")}
      {_connection("joint_a", "load_torque_hat", "", "load_torque_hat_a")}
      {_connection("joint_b", "load_torque_hat", "", "load_torque_hat_b")}
    </ssd:Connections>
    <ssd:SignalDictionaries>
      <ssd:SignalDictionary name="links" source="links.ssb"/>
    </ssd:SignalDictionaries>
  </ssd:System>
  <ssd:Units>
    {_UNITS}
  </ssd:Units>
  <ssd:DefaultExperiment startTime="0.0" stopTime="10.0">
    <ssd:Annotations>
      <ssc:Annotation type="com.opensimulationplatform">
        <osp:Algorithm><osp:FixedStepAlgorithm baseStepSize="0.001"/></osp:Algorithm>
      </ssc:Annotation>
    </ssd:Annotations>
  </ssd:DefaultExperiment>
</ssd:SystemStructureDescription>"""


def _joint(joint: str) -> str:
    angles = dict.fromkeys(_MEASURED, ("output", "rad"))
    measured = dict.fromkeys(_MEASURED, ("input", "rad"))
    estimate = {"load_torque_hat": ("output", "N.m")}
    wires = "\n          ".join(_connection("plant", angle, "observer", angle) for angle in _MEASURED)
    return f"""<ssd:System name="joint_{joint}">
        <ssd:Connectors>{_connectors(estimate)}</ssd:Connectors>
        <ssd:Elements>
          <ssd:Component name="plant" source="resources/joint_{joint}_plant_FlexibleJointPlant.fmu" {_FMU}>
            <ssd:Connectors>{_connectors({"load_torque": ("input", "N.m"), **angles})}</ssd:Connectors>
            {_bound("plant")}
          </ssd:Component>
          <ssd:Component name="observer" source="resources/joint_{joint}_observer_FlexibleJointObserver.fmu" {_FMU}>
            <ssd:Connectors>{_connectors({**measured, **estimate})}</ssd:Connectors>
            {_bound("observer")}
          </ssd:Component>
          {_reference([f"angle_{joint}", f"torque_{joint}"])}
        </ssd:Elements>
        <ssd:Connections>
          {wires}
          {_connection("plant", "link_angle", "links", f"angle_{joint}")}
          {_connection("links", f"torque_{joint}", "plant", "load_torque")}
          {_connection("observer", "load_torque_hat", "", "load_torque_hat")}
        </ssd:Connections>
      </ssd:System>"""


def _connectors(kinds: Mapping[str, tuple[str, str]]) -> str:
    return "".join(
        f'<ssd:Connector name="{name}" kind="{kind}"><ssc:Real unit="{unit}"/></ssd:Connector>'
        for name, (kind, unit) in kinds.items()
    )


def _reference(names: Mapping[str, str] | list[str]) -> str:
    connectors = _connectors({name: ("inout", _WIRES[name]) for name in names})
    inside = f"<ssd:Connectors>{connectors}</ssd:Connectors>"
    return f'<ssd:SignalDictionaryReference name="links" dictionary="links">{inside}</ssd:SignalDictionaryReference>'


def _connection(start: str, output: str, end: str, target: str) -> str:
    ends = f'startElement="{start}" startConnector="{output}"' + f' endElement="{end}"' * bool(end)
    return f'<ssd:Connection {ends} endConnector="{target}"/>'


def _bound(name: str) -> str:
    return f'<ssd:ParameterBindings><ssd:ParameterBinding source="{name}.ssv"/></ssd:ParameterBindings>'


def _dictionary() -> str:
    entries = "".join(
        f'\n  <ssb:DictionaryEntry name="{name}"><ssc:Real unit="{unit}"/></ssb:DictionaryEntry>'
        for name, unit in _WIRES.items()
    )
    units = f"<ssb:Units>\n    {_UNITS}\n  </ssb:Units>"
    return f'<ssb:SignalDictionary version="1.0" {_SPACES}>{entries}\n  {units}\n</ssb:SignalDictionary>'


def _values(values: Mapping[str, Value]) -> str:
    lines = "".join(
        f'\n    <ssv:Parameter name="{name}"><ssv:{"Real" if isinstance(value, float) else "Integer"} value="{value}"/>'
        "</ssv:Parameter>"
        for name, value in values.items()
    )
    return (
        f'<ssv:ParameterSet version="1.0" name="nominal" {_SPACES}>\n'
        f"  <ssv:Parameters>{lines}\n  </ssv:Parameters>\n</ssv:ParameterSet>"
    )


def _mapping(joints: Mapping[str, float]) -> str:
    targets = [
        ("gravity_torque", f"joint_{joint}.{part}.gravity_torque") for joint in joints for part in ("plant", "observer")
    ]
    targets += [
        (f"start_angle_{joint}", f"joint_{joint}.plant.{angle}_start") for joint in joints for angle in _MEASURED
    ]
    entries = "".join(f'\n  <ssm:MappingEntry source="{source}" target="{target}"/>' for source, target in targets)
    return f'<ssm:ParameterMapping version="1.0" {_SPACES}>{entries}\n</ssm:ParameterMapping>'
