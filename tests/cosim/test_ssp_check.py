"""`ndob-fmu check SYSTEM.ssp`, what broken packages end in, and the picture."""

from __future__ import annotations

import json
import zipfile
from xml.etree import ElementTree

import pytest

from ndob_fmu.cli import main
from ndob_fmu.cosim import System, check_ssp, simulate
from ndob_fmu.cosim.system.picture import draw_system
from ndob_fmu.errors import UsageError
from ndob_fmu.packages import write_ssp
from tests.cosim.test_coupling_order import declared, unknowns
from tests.helpers.coupling_fmus import coupling_fmus
from tests.helpers.ssp_text import (
    bindings,
    changed,
    component,
    connections,
    description,
    elements,
    linear,
    ports,
    values,
)

SYSTEM = (
    ports("u>[m] y<")
    + bindings(values(u=2))
    + elements(
        component("one", "a>[m] y<", source="resources/Gain.fmu", bindings=values(b=0)),
        component("two", "a> b> y<", source="resources/Gain.fmu", bindings=values(k=3)),
    )
    + connections("u one.a", "one.y two.a " + linear(2, -1), "two.y two.b", "two.y y")
)


@pytest.fixture(autouse=True)
def own_folder(nothing_left_behind, tmp_path, monkeypatch):
    """Every test here works in a folder of its own, and leaves no temporary one."""
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def package(tmp_path, tmp_path_factory):
    """Write test.ssp; change: pieces of the description, extra: further entries, fmu: whether it has one."""
    gain = coupling_fmus(tmp_path_factory.getbasetemp()) / "Gain.fmu"

    def package(*change, extra=(), fmu=True, text=None):
        ssd = description(SYSTEM) if text is None else text
        for old, new in change:
            assert old in ssd
            ssd = ssd.replace(old, new)
        with zipfile.ZipFile("test.ssp", "w") as archive:
            archive.writestr("SystemStructure.ssd", ssd)
            if fmu:
                archive.write(changed(gain, tmp_path / "Gain.fmu", a="m"), "resources/Gain.fmu")
                (tmp_path / "Gain.fmu").unlink()
            for name in extra:
                archive.writestr(zipfile.ZipInfo(name), "evil")

    return package


def test_a_sound_package_passes_and_says_what_is_in_it(package, capsys):
    package()
    assert main(["check", "test.ssp"]) == 0
    said = capsys.readouterr().out.splitlines()
    assert said[0] == "test.ssp: all 6 checks pass"
    assert [line.split()[:2] for line in said[1:]] == [
        ["ok", name.split()[0]]
        for name in ("archive", "files", "components", "connections", "inputs", "algebraic loops")
    ]
    assert said[4].endswith("2 connections, 1 of them scaled or converted, 1 inputs and 1 outputs at the boundary")
    assert main(["check", "test.ssp", "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["passed"]
    assert [row["passed"] for row in report["rows"]] == [True] * 6


BROKEN = {
    "a missing FMU": ({"fmu": False}, "components", "resources/Gain.fmu in the package, received no .fmu file"),
    "an unknown connector": (
        {"change": [('endConnector="a"><ssc:Linear', 'endConnector="aa"><ssc:Linear')]},
        "connections",
        "variable of two: expected one of the variables a, b, k, y, received 'aa'; likely cause: did you mean 'a'?",
    ),
    "a wrong unit": ({"change": [('unit="m"', 'unit="kg"')]}, "connections", "connector one.a: expected the unit m"),
    "a unit that does not convert": (
        {"change": [('name="u" kind="input"><ssc:Real unit="m"', 'name="u" kind="input"><ssc:Real unit="kg"')]},
        "connections",
        "connection u → one.a: expected the unit m of one.a, or one that converts to it, received kg",
    ),
    "an entry that points outside": (
        {"extra": ["../evil.txt"]},
        "archive",
        "expected entries that stay inside the archive's folder, received '../evil.txt'",
    ),
    "an entry with an absolute path": ({"extra": ["/tmp/evil.txt"]}, "archive", "received '/tmp/evil.txt'"),
    "bad XML": (
        {"change": [("</ssd:System>", "</ssd:Sytem>")]},
        "files",
        "SystemStructure.ssd: expected well-formed XML",
    ),
    "XML that does not follow the schema": (
        {"change": [("ssd:Elements>", "ssd:Parts>")]},
        "files",
        "SystemStructure.ssd: expected a file that follows SSP 1.0, received Element 'ssd:Parts'",
    ),
    "entities that grow": (
        {"text": '<!DOCTYPE x [<!ENTITY a "aa"><!ENTITY b "&a;&a;">]>' + description("<x>&b;</x>")},
        "files",
        "SystemStructure.ssd: expected XML without a DOCTYPE",
    ),
    "no description": ({"change": [], "text": ""}, "files", "SystemStructure.ssd: expected well-formed XML"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_a_broken_package_gives_one_clear_message_and_leaves_nothing_behind(package, tmp_path, capsys, name):
    options, row, said = BROKEN[name]
    package(*options.pop("change", ()), **options)
    before = sorted(tmp_path.rglob("*"))
    assert main(["check", "test.ssp", "--picture", "test.svg"]) == 1
    lines = capsys.readouterr().out.splitlines()
    (failed,) = (line for line in lines if line.startswith("  FAIL"))
    assert failed.split()[1] == row.split()[0]
    assert said in failed
    assert main(["simulate", "test.ssp", "--stop-time", "1", "--step-size", "1", "--output-file", "out.csv"]) == 2
    streams = capsys.readouterr()
    assert streams.out == ""
    assert streams.err.startswith("ndob-fmu: ")
    assert streams.err.count("\n") == 1
    assert said in streams.err
    # Neither results nor a picture, nothing that was unpacked (the fixture looks there), nothing beside the package.
    assert sorted(tmp_path.rglob("*")) == before


def test_an_input_that_nothing_drives_is_a_warning_and_with_strict_a_failure(package, capsys, caplog):
    package(('<ssv:Parameter name="b">', '<ssv:Parameter name="k">'))
    assert main(["check", "test.ssp"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "test.ssp: all 6 checks pass, 1 with a warning"
    said = "nothing drives the input one.b; it keeps its own start value"
    assert lines[5].split(None, 2) == ["warn", "inputs", said]
    assert main(["check", "test.ssp", "--json"]) == 0
    assert [row["warning"] for row in json.loads(capsys.readouterr().out)["rows"]] == [False] * 4 + [True, False]
    run = ["simulate", "test.ssp", "--stop-time", "1", "--step-size", "1"]
    assert main(run) == 0
    assert said in caplog.text
    refused = "input one.b: expected a connection, a column of the input file or a start value, received none of them"
    capsys.readouterr()
    assert main(["check", "test.ssp", "--strict"]) == 1
    assert refused in capsys.readouterr().out
    assert main([*run, "--strict"]) == 2
    assert refused in capsys.readouterr().err


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("Variant.ssd", description(SYSTEM).replace("</ssd:System>", "</ssd:Sytem>"), "expected well-formed XML"),
        ("Variant.ssd", description(SYSTEM).replace("ssd:Elements>", "ssd:Parts>"), "a file that follows SSP 1.0"),
        ("Variant.ssd", description(SYSTEM).replace('version="1.0"', 'version="2.0"'), "of version 1.x"),
        ("other.ssv", "", "expected well-formed XML"),
    ],
)
def test_a_broken_variant_that_is_not_used_is_a_warning_in_check_and_simulate(
    package, capsys, caplog, name, content, said
):
    package()
    with zipfile.ZipFile("test.ssp", "a") as archive:
        archive.writestr(name, content)
    assert main(["check", "test.ssp"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "test.ssp: all 6 checks pass, 1 with a warning"
    words = f"{name} could not be used, but SystemStructure.ssd does not name it"
    assert lines[2].split()[:2] == ["warn", "files"]
    assert words in lines[2]
    assert said in lines[2]
    command = ["simulate", "test.ssp", "--stop-time", "1", "--step-size", "1"]
    for more in ([], ["--results", "r"]):  # which opens the package several times
        caplog.clear()
        assert main([*command, *more]) == 0
        (record,) = caplog.records
        assert words in record.getMessage()
        assert said in record.getMessage()
        assert len(record.getMessage()) <= 300


def test_a_variant_that_is_used_fails_in_check_and_simulate(package, capsys):
    first = "<ssd:ParameterBindings>"
    package((first, f'{first}<ssd:ParameterBinding source="other.ssv"/>'))
    with zipfile.ZipFile("test.ssp", "a") as archive:
        archive.writestr("other.ssv", "<nothing/>")
    assert main(["check", "test.ssp"]) == 1
    assert "FAIL  files" in capsys.readouterr().out
    assert main(["simulate", "test.ssp", "--stop-time", "1", "--step-size", "1"]) == 2
    assert "other.ssv: expected ParameterSet" in capsys.readouterr().err


def test_a_damaged_entry_that_nothing_uses_is_a_warning(package, tmp_path):
    package()
    with zipfile.ZipFile("test.ssp", "a") as archive:
        archive.writestr("notes.txt", "a note of some length, stored as it is")
    data = (tmp_path / "test.ssp").read_bytes()
    (tmp_path / "test.ssp").write_bytes(data.replace(b"a note of some length", b"a note of some lenght"))
    report = check_ssp("test.ssp")
    assert report.passed
    assert [row.name for row in report.rows if row.warning] == ["archive"]
    assert "notes.txt" in report.rows[0].found
    simulate("test.ssp", stop_time=1.0, step_size=1.0)


def test_an_output_of_the_system_that_nothing_drives_is_a_warning(package, capsys, caplog):
    package(text=description(SYSTEM.replace(ports("u>[m] y<"), ports("u>[m] y< spare<"))))
    assert main(["check", "test.ssp"]) == 0
    assert "warn  connections      nothing drives spare at the boundary" in capsys.readouterr().out


@pytest.mark.parametrize("command", [["check"], ["simulate", "--stop-time", "1", "--step-size", "1"]])
def test_a_component_of_another_kind_is_named_with_what_it_is(capsys, tmp_path, command):
    with zipfile.ZipFile("x.fmu", "w") as archive:
        text = '<fmiModelDescription fmiVersion="3.0"><CoSimulation/></fmiModelDescription>'
        archive.writestr("modelDescription.xml", text)
    with zipfile.ZipFile("test.ssp", "w") as archive:
        archive.writestr("SystemStructure.ssd", description(elements(component("motor", source="resources/x.fmu"))))
        archive.write("x.fmu", "resources/x.fmu")
    assert main([command[0], "test.ssp", *command[1:]]) != 0
    streams = capsys.readouterr()
    said = "component motor: test.ssp, resources/x.fmu: expected an FMU for FMI 2.0 co-simulation, received one for FMI"
    assert f"{said} 3.0 co-simulation" in streams.out + streams.err


def test_what_is_no_package_is_refused(capsys, tmp_path):
    assert main(["check", "absent.ssp"]) == 2
    (tmp_path / "text.ssp").write_text("not a zip")
    assert main(["check", "text.ssp"]) == 1
    assert "expected a zip archive" in capsys.readouterr().out


def test_a_damaged_entry_is_found(package, tmp_path):
    package()
    data = bytearray((tmp_path / "test.ssp").read_bytes())
    data[len(data) // 2] ^= 0xFF
    (tmp_path / "test.ssp").write_bytes(data)
    assert not check_ssp("test.ssp").passed


def test_the_picture_shows_components_and_signals(package, tmp_path, capsys):
    package()
    assert main(["check", "test.ssp", "--picture", "system.svg"]) == 0
    root = ElementTree.parse(tmp_path / "system.svg").getroot()
    texts = [element.text for element in root.iter("{http://www.w3.org/2000/svg}text")]
    assert texts == ["test", "one", "Gain", "two", "Gain", "u → a", "y → a (· 2 -1)", "y → b", "y"]


def test_the_picture_has_a_block_for_each_component_in_order_and_feedback_below(tmp_path_factory):
    gain = coupling_fmus(tmp_path_factory.getbasetemp()) / "Gain.fmu"
    system = System().add("a", gain).add("b", gain, step_ratio=4).connect("a.y", "b.a").connect("b.y", "a.a")
    svg = draw_system(system, "loop")
    assert svg == draw_system(system, "loop")
    root = ElementTree.fromstring(svg)
    place = {
        element.text: (float(element.get("x")), float(element.get("y")))
        for element in root.iter("{http://www.w3.org/2000/svg}text")
    }
    assert place["a"][0] < place["b"][0]
    assert place["a"][1] < place["b"][1]
    assert "Gain, every 4 steps" in place
    width, height = float(root.get("width")), float(root.get("height"))
    assert all(0 < x < width and 0 < y < height for x, y in place.values())


def test_a_picture_of_another_kind_or_of_a_model_is_refused(package, capsys):
    package()
    assert main(["check", "test.ssp", "--picture", "system.png"]) == 2
    assert "picture: expected the path of an .svg, received 'system.png'" in capsys.readouterr().err
    assert main(["check", "flexible_joint", "--picture", "system.svg"]) == 2
    with pytest.raises(UsageError):
        check_ssp("test.ssp", picture="system.txt")


def test_loops_that_the_fmus_declare_are_named(tmp_path_factory, tmp_path):
    through = [unknowns("Outputs", dependencies="1"), unknowns("InitialUnknowns", dependencies="1")]
    path = declared(coupling_fmus(tmp_path_factory.getbasetemp()) / "Gain.fmu", tmp_path / "Gain.fmu", through)
    system = System().add("one", path, {"b": 0.0}).add("two", path, {"b": 0.0})
    loop = write_ssp(system.connect("one.y", "two.a").connect("two.y", "one.a"), tmp_path / "loop.ssp")
    assert check_ssp(loop).rows[-1].found == "one.y → two.a → two.y → one.a → one.y"
