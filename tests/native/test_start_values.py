"""Native FMUs with other start values: the same as setting these, in binaries and source, without a compiler."""

from __future__ import annotations

import hashlib
import struct
import subprocess
import sys
import zipfile

import fmpy
import pytest

from ndob_fmu.errors import UsageError
from ndob_fmu.fmu.fmu_description import FmuDescription
from ndob_fmu.native.mach_o import signed
from ndob_fmu.native.package import package
from ndob_fmu.packages import fmu_with_start_values
from tests.helpers.needs import C_COMPILER
from tests.native.test_shell import COUNTER, COUNTER_CODE

pytestmark = [
    C_COMPILER,
    pytest.mark.skipif(sys.platform != "linux", reason="expected Linux, for which the tests compile"),
]
VALUES = {"by": 0.1 + 0.2, "from": 7, "rule": 2, "stays": False, "limit": 20.5, "note": 'a "ä"\n*/ \\1'}


@pytest.fixture(scope="module")
def counter(tmp_path_factory):
    return package(tmp_path_factory.mktemp("counter") / "Counter.fmu", COUNTER, COUNTER_CODE, {}, platforms=["linux64"])


@pytest.fixture
def started(counter, tmp_path):
    path = tmp_path / "Started.fmu"
    path.write_bytes(fmu_with_start_values(counter, VALUES))
    return path


def run(fmu, values=None):
    """Return the counter's rows, those after a reset, and its note, under start values that are set."""
    description = fmpy.read_model_description(str(fmu))
    folder = str(fmu) if fmu.is_dir() else fmpy.extract(str(fmu))
    instance = fmpy.instantiate_fmu(folder, description)
    references = {v.name: v.valueReference for v in description.modelVariables}
    kinds = {v.name: {"Enumeration": "Integer"}.get(v.type, v.type) for v in description.modelVariables}
    rows = []
    for _ in range(2):
        for name, value in (values or {}).items():
            getattr(instance, f"set{kinds[name]}")([references[name]], [value])
        instance.setupExperiment(startTime=0.0)
        instance.enterInitializationMode()
        instance.exitInitializationMode()
        for k in range(4):
            rows.append((*instance.getReal([references["sum"]]), *instance.getBoolean([references["odd"]])))
            instance.doStep(0.1 * k, 0.1)
        instance.reset()
    note = instance.getString([references["note"]])
    instance.freeInstance()
    return rows, note


def test_it_runs_as_the_fmu_does_when_these_values_are_set_also_after_a_reset(started, counter):
    expected, _ = run(counter, VALUES)
    assert run(started) == (expected, [VALUES["note"].encode()])
    assert expected != run(counter)[0]


def test_its_source_has_the_values_too(started, tmp_path):
    with zipfile.ZipFile(started) as archive:
        archive.extractall(tmp_path / "unpacked")
    sources, (binary,) = tmp_path / "unpacked" / "sources", (tmp_path / "unpacked").glob("binaries/*/*.so")
    expected = run(started)
    binary.unlink()
    options = ["-O2", "-shared", "-fPIC", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Werror"]
    subprocess.run(["cc", "-std=c99", *options, "Counter.c", "-o", binary, "-lm"], cwd=sources, check=True)
    assert run(tmp_path / "unpacked") == expected


def test_the_description_has_the_values_and_the_same_values_give_the_same_bytes(started, counter):
    description = fmpy.read_model_description(str(started))
    starts = {v.name: v.start for v in description.modelVariables}
    assert (float(starts["by"]), starts["from"], starts["rule"], starts["note"]) == (
        0.1 + 0.2,
        "7",
        "2",
        VALUES["note"],
    )
    assert description.guid != fmpy.read_model_description(str(counter)).guid
    assert started.read_bytes() == fmu_with_start_values(counter, VALUES)


def test_values_on_values_add_up(started, tmp_path):
    again = tmp_path / "again.fmu"
    again.write_bytes(fmu_with_start_values(started, {"from": 8}))
    rows, note = run(again)
    assert (rows[0][0], rows[1][0], note) == (8.0, 8.0 - VALUES["by"], [VALUES["note"].encode()])


def test_a_value_out_of_its_range_is_refused_at_the_start_as_if_it_had_been_set(counter, tmp_path):
    path = tmp_path / "wrong.fmu"
    path.write_bytes(fmu_with_start_values(counter, {"limit": -1.0}))
    said = []
    with pytest.raises(Exception, match="fmi2ExitInitializationMode"):
        fmpy.simulate_fmu(str(path), stop_time=0.1, logger=lambda *arguments: said.append(arguments[-1].decode()))
    assert said[-1] == "limit: expected a finite number > 0 and at most 1e+06, received -1.0"


def test_a_text_that_is_too_long_and_a_binary_of_another_fmu_are_refused_in_one_line(counter, tmp_path):
    with pytest.raises(UsageError, match="note: expected a text of fewer than 1024 bytes, received a longer one"):
        fmu_with_start_values(counter, {"note": "ä" * 512})
    renamed = FmuDescription("Counter", "Another one", COUNTER.variables, COUNTER.experiment)
    other = package(tmp_path / "other.fmu", renamed, COUNTER_CODE, {}, platforms=["linux64"])
    mixed = tmp_path / "mixed.fmu"
    with zipfile.ZipFile(other) as one, zipfile.ZipFile(counter) as two, zipfile.ZipFile(mixed, "w") as target:
        for name in one.namelist():
            target.writestr(name, (two if name.startswith("binaries/") else one).read(name))
    with pytest.raises(
        UsageError, match=r"Counter\.so: expected the start values of its modelDescription\.xml, received none"
    ):
        fmu_with_start_values(mixed, {"by": 2.0})


def mac_binary(text):
    """Return a universal binary for macOS with the text in both parts, of which the second is signed."""
    page, parts = 12, []
    for command in (0x2, 0x1D):  # of symbols, of a signature
        head = struct.pack("<4sIIIIIII", b"\xcf\xfa\xed\xfe", 0, 0, 6, 1, 16, 0, 0)
        body = (head + struct.pack("<IIII", command, 16, 3 << page, 0) + text).ljust(3 << page, b"\1")
        slots = b"".join(hashlib.sha256(body[k << page : (k + 1) << page]).digest() for k in range(3))
        directory = struct.pack(">IIIIIIIIIBBBB", 0xFADE0C02, 0, 0, 2, 40, 0, 0, 3, len(body), 32, 2, 0, page)
        signature = struct.pack(">IIIII", 0xFADE0CC0, 0, 1, 0, 20) + directory + slots
        parts.append(body + (signature if command == 0x1D else b""))
    head = b"\xca\xfe\xba\xbe" + struct.pack(">I", 2)
    places = (1 << 14, 2 << 14)
    for place, part in zip(places, parts, strict=True):
        head += struct.pack(">IIIII", 0, 0, place, len(part), 14)
    return head.ljust(1 << 14, b"\0") + parts[0].ljust(1 << 14, b"\0") + parts[1]


def test_a_binary_for_macos_has_the_hashes_of_its_changed_pages():
    """A Mac loads no other; zig signs the part for Apple's own processors."""
    before, after = (mac_binary(text) for text in (b"one text", b"and this"))
    assert signed(before.replace(b"one text", b"and this")) == after != before
    assert signed(b"\x7fELF one text") == b"\x7fELF one text"
