"""What the files of a package mean: scalings, units, boundaries, nested systems, dictionaries, parameters and steps."""

from __future__ import annotations

import math
import zipfile

import numpy as np
import pytest

from ndob_fmu.cosim import open_ssp, simulate
from ndob_fmu.errors import CouplingError, UsageError
from tests.helpers.coupling_fmus import coupling_fmus
from tests.helpers.ssp_text import (
    bindings,
    changed,
    component,
    connections,
    description,
    elements,
    linear,
    mapping,
    ports,
    unit,
    values,
)

pytestmark = pytest.mark.usefixtures("nothing_left_behind")


@pytest.fixture(scope="module")
def fmus(tmp_path_factory):
    return coupling_fmus(tmp_path_factory.getbasetemp())


@pytest.fixture
def pack(tmp_path, fmus):
    """Write test.ssp; fmu: another one than the plain gain, files: further entries."""

    def pack(ssd, fmu=None, files=()):
        path = tmp_path / "test.ssp"
        with zipfile.ZipFile(path, "w") as package:
            package.write(fmu or fmus / "Gain.fmu", "Gain.fmu")
            for name, text in {"SystemStructure.ssd": ssd, **dict(files)}.items():
                package.writestr(name, text)
        return path

    return pack


def start(path, **options):
    """The values after initialization."""
    recording = simulate(path, stop_time=1.0, step_size=1.0, **options)
    return {name: recording[name][0] for name in recording.names}


def chain(*inside, after="", first="one", **options):
    """Two gains in a row: one of 3 + 1 and one of what comes, times 1."""
    parts = component(first, "y<", bindings=values(a=3, b=1, k=1)), component("two", "a>", bindings=values(b=0, k=1))
    return description(elements(*parts) + connections(" ".join(("one.y two.a", *inside))), after)


@pytest.mark.parametrize(
    ("inside", "seen"), [("", 4), (linear(2), 8), (linear(2, -5), 3), ("suppress" + linear(2, -5), 3)]
)
def test_a_connection_may_have_a_linear_transformation(pack, inside, seen):
    assert start(pack(chain(inside)))["two.y"] == seen


@pytest.fixture
def turned(fmus, tmp_path):
    """A gain whose input a is in degrees and whose output is in rad."""
    return changed(fmus / "Gain.fmu", tmp_path / "Gain.fmu", a="deg", y="rad", k="m")


@pytest.mark.parametrize(
    ("inside", "seen"),
    [("", math.degrees(4)), (linear(2, 1), 2 * math.degrees(4) + 1), ("suppress", 4), ("suppress" + linear(2, 1), 9)],
)
def test_units_are_converted_before_the_transformation_unless_that_is_suppressed(pack, turned, inside, seen):
    assert start(pack(chain(inside), turned))["two.y"] == pytest.approx(seen, rel=1e-12)


def test_a_unit_that_the_package_defines_means_what_it_says_there(pack, fmus, tmp_path):
    """The FMU has no units; a "turn" is something else elsewhere, and so is an offset."""
    ssd = description(
        ports("x>[turn] y<[half]")
        + elements(component("one", "a>[rad] y<[rad]", bindings=values(b=0, k=1)))
        + connections("x one.a", "one.y y"),
        unit("turn", rad=1, factor=10.0).replace("</ssd:Units>", "")
        + '<ssc:Unit name="half"><ssc:BaseUnit rad="1" factor="0.5" offset="1"/></ssc:Unit>'
        + '<ssc:Unit name="rad"><ssc:BaseUnit rad="1"/></ssc:Unit></ssd:Units>',
    )
    found = start(pack(ssd), start_values={"x": 3})
    assert found["one.y"] == 30.0
    assert found["y"] == (30.0 - 1.0) / 0.5


def test_connectors_of_the_system_are_names_for_what_is_behind_them(pack, tmp_path):
    ssd = description(
        ports("u> stiffness= y<")
        + bindings(values(u=2, stiffness=5))
        + elements(component("one", "a> k= y<", bindings=values(b=1)), component("two", "a>", bindings=values(b=0)))
        + connections("u one.a", "two.a u " + linear(10), "stiffness one.k", "one.y y " + linear(-1))
    )
    path = pack(ssd)
    assert start(path) == {"one.y": 15.0, "two.y": 40.0, "y": -15.0}
    assert start(path, start_values={"u": 3, "stiffness": 1}) == {"one.y": 4.0, "two.y": 60.0, "y": -4.0}
    (tmp_path / "u.csv").write_text("time,u\n0,7\n")
    assert start(path, input_file=tmp_path / "u.csv") == {"one.y": 40.0, "two.y": 140.0, "y": -40.0}


def nested():
    """Two levels, with a transformation at each boundary: 3 → 2·3 → 2·3 + 1 → (k = 10) → ·100."""
    inner = (
        '<ssd:System name="inner">'
        + ports("u> y< k=")
        + bindings(values(k=10))
        + elements(component("gain", "a> k= y<", bindings=values(b=0, k=77)))
        + connections("u gain.a " + linear(1, 1), "gain.y y", "k gain.k")
        + "</ssd:System>"
    )
    outer = (
        '<ssd:System name="outer">'
        + ports("u> y<")
        + elements(inner)
        + connections("u inner.u " + linear(2), "inner.y y " + linear(100))
        + "</ssd:System>"
    )
    parts = (
        component("first", "y<", bindings=values(a=3, b=0, k=1)),
        outer,
        component("last", "a>", bindings=values(b=0, k=1)),
    )
    return elements(*parts) + connections("first.y outer.u", "last.a outer.y")


def test_nested_systems_are_made_flat(pack):
    path = pack(description(nested()))
    assert start(path) == {"first.y": 3.0, "outer.inner.gain.y": 70.0, "last.y": 7000.0}
    assert start(path, start_values={"outer.inner.gain.k": 1})["last.y"] == 700.0


@pytest.mark.parametrize(
    ("name", "value", "seen"), [("outer.inner.k", 2, 1400.0), ("outer.inner.gain.k", 3, 2100.0), ("first.a", 0, 1000.0)]
)
def test_a_binding_of_a_system_comes_before_those_inside_it(pack, name, value, seen):
    assert start(pack(description(bindings(values(**{name: value})) + nested())))["last.y"] == seen


def test_a_later_binding_replaces_an_earlier_one(pack):
    part = component("one", bindings=values(a=1, b=0, k=5) + values(k=7))
    assert start(pack(description(elements(part))))["one.y"] == 7.0


def test_signals_of_a_dictionary_are_shared_by_all_systems_that_refer_to_it(pack):
    entries = "".join(f'<ssb:DictionaryEntry name="{name}"><ssc:Real/></ssb:DictionaryEntry>' for name in ("s", "t"))
    head = '<ssb:SignalDictionary version="1.0"'
    namespaces = description("").partition("name=")[2].partition(" ")[2].partition(">")[0]
    reference = '<ssd:SignalDictionaryReference name="{}" dictionary="bus">{}</ssd:SignalDictionaryReference>'
    connectors = ports("s> t>").replace('"input"', '"inout"')
    inner = (
        '<ssd:System name="inner">'
        + elements(component("two", "a> y<", bindings=values(b=0, k=10)), reference.format("here", connectors))
        + connections("here.s two.a", "two.y here.t " + linear(1, 1))
        + "</ssd:System>"
    )
    ssd = description(
        elements(
            component("one", "y<", bindings=values(a=3, b=0, k=1)),
            component("three", "a>", bindings=values(b=0, k=1)),
            reference.format("wires", connectors),
            inner,
        )
        + connections("one.y wires.s " + linear(2), "three.a wires.t")
        + '<ssd:SignalDictionaries><ssd:SignalDictionary name="bus" source="bus.ssb"/></ssd:SignalDictionaries>'
    )
    files = {"bus.ssb": f"{head} {namespaces}>{entries}</ssb:SignalDictionary>"}
    assert start(pack(ssd, files=files))["three.y"] == 61.0
    inside = ssd.replace(
        '<ssd:SignalDictionary name="bus" source="bus.ssb"/>',
        f'<ssd:SignalDictionary name="bus">{head}>{entries}</ssb:SignalDictionary></ssd:SignalDictionary>',
    )
    assert start(pack(inside))["three.y"] == 61.0


def mapped(*entries, inside=True, **parameters):
    text = mapping(*entries)
    source = (
        f"<ssd:ParameterMapping>{text}</ssd:ParameterMapping>" if inside else '<ssd:ParameterMapping source="m.ssm"/>'
    )
    parts = component("one", bindings=values(a=1, b=0)), component("two", bindings=values(a=1, b=0))
    return description(bindings(values(mapping=source, **parameters)) + elements(*parts)), {"m.ssm": text}


@pytest.mark.parametrize("inside", [True, False])
def test_a_mapping_says_what_each_parameter_is_for(pack, inside):
    ssd, files = mapped("stiffness one.k", "stiffness two.k " + linear(2, 1), inside=inside, stiffness=5, unused=8)
    path = pack(ssd, files=files)
    assert start(path) == {"one.y": 5.0, "two.y": 11.0}
    assert start(path, start_values={"stiffness": 7}) == {"one.y": 7.0, "two.y": 15.0}


def test_parameters_are_converted_into_the_unit_of_their_variable(pack, turned):
    """Of k, which is in m here."""
    units = unit("inch", prefix="ssv", m=1, factor=0.0254)
    part = component("one", bindings=values(a="90 deg", b=0, k="2 inch", units=units))
    assert start(pack(description(elements(part)), turned))["one.y"] == pytest.approx(90 * 0.0508)
    ssd, _ = mapped("length one.k " + linear(2, 1), "length two.k", length="3 km")
    found = start(pack(ssd, turned))
    assert (found["one.y"], found["two.y"]) == (6001.0, 3000.0)


def test_a_prefix_makes_names_of_a_component_those_of_the_system(pack):
    ssd = description(bindings(values(prefix="one.", k=5)) + elements(component("one", bindings=values(a=1, b=0))))
    assert start(pack(ssd))["one.y"] == 5.0


HINT = (
    '<ssd:Annotations><ssc:Annotation type="com.opensimulationplatform"><osp:StepSizeHint value="{}"/>'
    "</ssc:Annotation></ssd:Annotations>"
)


def test_a_component_steps_at_its_own_step_size(pack):
    parts = (
        component("one", bindings=values(a=1, b=0)),
        component("two", bindings=values(a=1, b=0), after=HINT.format(0.3)),
    )
    path = pack(description(elements(*parts)))
    for step_size, ratios in ((0.1, {"two": 3}), (0.3, {}), (0.15, {"two": 2})):
        with open_ssp(path, step_size) as (system, _):
            assert system.step_ratios == ratios
    with pytest.raises(UsageError, match=r"step size of two: expected a whole multiple of .* 0\.2 s, received 0\.3 s"):
        simulate(path, stop_time=1.0, step_size=0.2)


def test_sources_are_uris(pack, fmus, tmp_path):
    part = component("one", bindings=values(a=1, b=0, k=3), source="./my%20gain.fmu")
    assert (
        start(pack(description(elements(part)), files={"my gain.fmu": (fmus / "Gain.fmu").read_bytes()}))["one.y"] == 3
    )


TWO = component("one", "a> b> y<", bindings=values(k=1)), component("two", "a> b> y<", bindings=values(a=0, b=0, k=1))


@pytest.mark.parametrize(
    ("system", "said"),
    [
        (elements(*TWO) + connections("one.y two.y"), "one.y → two.y: expected a source and a target, received output"),
        (elements(*TWO) + connections("one.a two.a"), "received input and input"),
        (
            elements(*TWO) + connections("one.y three.a"),
            "no connectors of three, received 'a'",
        ),
        (
            elements(*TWO) + connections("u one.a"),
            "no connectors of the system, received 'u'",
        ),
        (
            ports("u>") + elements(*TWO) + connections("u one.a", "two.y one.a"),
            "input one.a: expected exactly one driver, received u and two.y",
        ),
        (elements(*TWO, TWO[0]), "component one: expected a new name"),
        (elements(*TWO, '<ssd:System name="two"/>'), "element two: expected a new name"),
        (
            elements(*TWO, '<ssd:SignalDictionaryReference name="d" dictionary="bus"/>'),
            "but there are no signal dictionaries, received 'bus'",
        ),
        (
            ports("u>[kg]") + elements(component("one", "a>[m]", bindings=values(b=1))) + connections("u one.a"),
            "connection u → one.a: expected the unit m of one.a, or one that converts to it, received kg",
        ),
        (
            ports("u>").replace("Real", "Integer") + elements(*TWO) + connections("u one.a"),
            "expected the type Real of one.a, received Integer",
        ),
        (
            ports("u>").replace("input", "inout") + elements(*TWO) + connections("u one.a"),
            "u to be an input, an output or a parameter, received inout",
        ),
        (
            ports("u> u<") + elements(*TWO),
            "connector u: expected a new name",
        ),
        (bindings(values(x=1)) + elements(*TWO), "'x': expected component.variable"),
        (mapped("stiff one.k", stiffness=1)[0], "mapping to one.k: expected the parameter stiffness, received 'stiff'"),
        (
            bindings(values(**{"inner.u": 1}))
            + elements(*TWO, f'<ssd:System name="inner">{ports("u> y<")}{connections("u y")}</ssd:System>')
            + connections("inner.y inner.u"),
            "inner.u → inner.y → inner.u: expected a source, received a circle of connectors",
        ),
        (
            elements(component("one", source="../Gain.fmu")),
            "component one: expected a file in the package, received '../Gain.fmu'",
        ),
        (elements(component("one", source="http://example.org/Gain.fmu")), "expected a file in the package"),
        (elements(component("one", source="file:///tmp/Gain.fmu")), "expected a file in the package"),
    ],
)
def test_what_makes_no_sense_is_refused_by_name(pack, system, said):
    path = pack(system if system.startswith("<ssd:SystemStructure") else description(system))
    with pytest.raises(CouplingError) as refused:
        simulate(path, stop_time=1.0, step_size=1.0)
    assert said in str(refused.value), str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_variable_without_a_unit_takes_any(pack):
    assert start(pack(description(elements(component("one", bindings=values(a=1, b=0, k="3 kg"))))))["one.y"] == 3.0


def test_a_parameter_in_a_unit_that_does_not_convert_is_refused(pack, turned):
    path = pack(description(elements(component("one", bindings=values(a=0, b=0, k="1 kg")))), turned)
    with pytest.raises(
        CouplingError, match=r"parameter one\.k: expected the unit m, or one that converts to it, .* kg"
    ):
        start(path)


def test_an_empty_element_name_means_the_system_itself(pack):
    """OMSimulator writes it in all its exports."""
    system = ports("u> y<") + bindings(values(u=2)) + elements(component("one", bindings=values(b=1, k=3)))
    plain = connections("u one.a", "one.y y")
    empty = plain.replace('startConnector="u"', 'startElement="" startConnector="u"')
    empty = empty.replace('endConnector="y"', 'endElement="" endConnector="y"')
    assert empty.count('Element=""') == 2
    assert start(pack(description(system + plain))) == start(pack(description(system + empty))) == {"one.y": 9, "y": 9}
    unknown = empty.replace('startConnector="u"', 'startConnector="w"')
    with pytest.raises(CouplingError, match="one of the connectors u, y of the system, received 'w'"):
        start(pack(description(system + unknown)))


def test_connectors_of_systems_may_lead_nowhere_and_have_values(pack, tmp_path):
    """Also on the command line, in an input file, and of a system inside; an output that nothing drives is left out."""
    inner = f'<ssd:System name="inner">{ports("spare>")}</ssd:System>'
    part = component("one", bindings=values(a=1, b=1, k=3))
    own = bindings(values(**{"spare": 2, "mode": 1, "inner.spare": 4}))
    path = pack(description(ports("spare> mode= y<") + own + elements(part, inner)))
    assert start(path) == {"one.y": 6.0}
    assert start(path, start_values={"spare": 3}) == {"one.y": 6.0}
    (tmp_path / "u.csv").write_text("time,spare\n0,5\n")
    assert start(path, input_file=tmp_path / "u.csv") == {"one.y": 6.0}
    with pytest.raises(CouplingError, match=r"'sparse': expected .*did you mean 'spare'"):
        start(path, start_values={"sparse": 3})


def test_a_value_for_a_connected_input_is_its_start_value_and_no_second_driver(pack):
    parts = component("one", bindings=values(a=1, b=1)), component("two", bindings=values(a=7, b=0, k=1))
    path = pack(description(elements(*parts) + connections("one.y two.a")))
    assert start(path, strict=True) == {"one.y": 4.0, "two.y": 4.0}
    with open_ssp(path) as (system, _):
        assert system.start_values["two", "a"] == 7.0


def test_an_input_that_nothing_drives_keeps_its_start_value_and_strict_refuses_it(pack, caplog):
    path = pack(description(ports("u>") + elements(component("one", bindings=values(k=3))) + connections("u one.a")))
    assert start(path) == {"one.y": 0.0}
    (said,) = (record.getMessage() for record in caplog.records)
    assert said == "nothing drives the inputs one.a (behind u), one.b; they keep their own start values"
    with pytest.raises(CouplingError, match=r"inputs one\.a \(behind u\), one\.b: expected a connection, a column"):
        start(path, strict=True)


def test_a_signal_goes_through_a_system_without_components(pack):
    inner = f'<ssd:System name="inner">{ports("u> y<")}{connections("u y " + linear(3))}</ssd:System>'
    parts = component("one", "y<", bindings=values(a=1, b=0, k=2)), component("two", "a>", bindings=values(b=0, k=1))
    ssd = description(elements(inner, *parts) + connections("one.y inner.u", "inner.y two.a"))
    assert np.isclose(start(pack(ssd))["two.y"], 6.0)


def test_a_unit_of_the_fmu_that_it_does_not_define_is_that_of_the_package(pack, fmus, tmp_path):
    """And a variable without unit has that of its connector."""
    fmu = changed(fmus / "Gain.fmu", tmp_path / "Gain.fmu", a="turn")
    units = unit("turn", rad=1, factor=10.0).replace(
        "</ssd:Units>", '<ssc:Unit name="half"><ssc:BaseUnit rad="1" factor="0.5"/></ssc:Unit></ssd:Units>'
    )
    set_units = unit("rad", prefix="ssv", rad=1)
    part = component("one", "k=[half]", bindings=values(a="20 rad", b=0, k="3 rad", units=set_units))
    assert start(pack(description(elements(part), units), fmu))["one.y"] == 2.0 * 6.0
