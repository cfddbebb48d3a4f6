"""How the front gets into an FMU: compiled by the build, the same bytes each time, left out where nothing compiles."""

from __future__ import annotations

import ctypes
import itertools
import os
import shlex
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path
from random import Random

import pytest

from ndob_fmu import build, load_model
from ndob_fmu.fmu import compile_front as front
from ndob_fmu.fmu.fmu_description import FmuDescription
from ndob_fmu.runtime.equations import Experiment
from tests.helpers.clean_process import ENVIRONMENT, run_clean
from tests.helpers.native_host import unpack
from tests.helpers.needs import FRONT

pytestmark = FRONT


@pytest.fixture
def fresh_compiler(monkeypatch, tmp_path):
    """Forget what was compiled, in this process and before, and afterwards what this test made."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    front.forget_compiled()
    yield monkeypatch
    front.forget_compiled()


@pytest.fixture
def quick_compiler(fresh_compiler):
    """A fresh compiler that does not optimise, for tests of what is kept."""
    fresh_compiler.setattr(front, "_FLAGS", tuple("-O0" if flag == "-O2" else flag for flag in front._FLAGS))
    return fresh_compiler


def stock_binary():
    import pythonfmu

    return Path(pythonfmu.__file__).parent.joinpath("resources/binaries/linux64/libpythonfmu-export.so").read_bytes()


COMPILERS = [name for name in (os.environ.get("CC"), "gcc", "clang") if name and shutil.which(shlex.split(name)[0])]


@pytest.mark.parametrize("compiler", COMPILERS)
def test_the_sources_compile_without_a_warning(compiler, tmp_path):
    command = [*shlex.split(compiler), "-std=gnu11", "-O2", "-fsyntax-only", "-Wall", "-Wextra", "-Werror"]
    done = subprocess.run(
        [*command, "-I", str(front.HEADERS), "-I", str(front.write_rules(tmp_path)), *front.sources()],
        cwd=front.SOURCES,
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, "")


# Each range that the rules of UTF-8 tell apart, by its first and last bytes.
BYTES = bytes.fromhex("01 41 7f 80 8f 90 9f a0 bf c0 c1 c2 df e0 e1 ec ed ee ef f0 f1 f3 f4 f5 f8 ff")


@pytest.fixture(scope="module")
def is_utf8(tmp_path_factory):
    """The front's own function, from bytes without NUL to bool."""
    folder = tmp_path_factory.mktemp("utf8")
    library = folder / "utf8.so"
    command = [*shlex.split(os.environ.get("CC", "cc")), "-std=gnu11", "-O2", "-shared", "-fPIC"]
    command += ["-I", front.HEADERS, "-I", front.write_rules(folder)]
    subprocess.run([*command, front.SOURCES / "shell" / "utf8.c", "-o", library], check=True)
    function = ctypes.CDLL(str(library)).is_utf8
    function.restype = ctypes.c_bool
    return function


def decodes(data):
    try:
        data.decode()
    except UnicodeDecodeError:
        return False
    return True


def test_the_front_takes_exactly_the_bytes_that_pythons_strict_decoder_takes(is_utf8):
    ends = [bytes(c) for length in (1, 2, 3, 4) for c in itertools.product(BYTES, repeat=length)]
    pairs = [bytes(c) for c in itertools.product(range(1, 256), repeat=2)]
    random = Random(1)
    characters = [chr(random.randrange(1, 0x110000)).encode("utf-8", "surrogatepass") for _ in range(20_000)]
    spoilt = [c[:i] + bytes([random.randrange(1, 256)]) + c[i + 1 :] for c in characters for i in range(len(c))]
    assert [data for data in (*ends, *pairs, *characters, *spoilt) if is_utf8(data) != decodes(data)] == []


def test_an_fmu_runs_from_a_folder_whose_name_the_hosts_python_does_not_decode_as_utf8(flexible_joint, tmp_path):
    folder = tmp_path / "ä"
    guid = unpack(flexible_joint.plant, folder, folder).guid
    program = """
import ctypes, os, sys, urllib.parse
assert sys.getfilesystemencoding() == "ascii"
folder = os.fsencode(sys.argv[1])
library = ctypes.CDLL(os.fsdecode(folder + b"/binaries/linux64/FlexibleJointPlant.so"))
library.fmi2Instantiate.restype = ctypes.c_void_p
location = b"file://" + urllib.parse.quote_from_bytes(folder + b"/resources").encode()
callbacks = (ctypes.c_void_p * 5)()
assert library.fmi2Instantiate(b"one", 1, sys.argv[2].encode(), location, callbacks, 0, 0)
"""
    environment = ENVIRONMENT | {"PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0", "LC_ALL": "POSIX"}
    command = [sys.executable, "-c", program, folder, guid]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


def test_sources_in_another_folder_and_another_temporary_folder_give_the_same_bytes(fresh_compiler, tmp_path):
    (before,) = front.compiled([front.LINUX])
    moved = tmp_path / "some where else"
    for folder in front.FOLDERS:
        shutil.copytree(front.SOURCES / folder, moved / folder)
    headers = tmp_path / "headers"
    shutil.copytree(front.HEADERS, headers)
    front.forget_compiled()
    fresh_compiler.setenv("XDG_CACHE_HOME", str(tmp_path / "another cache"))
    fresh_compiler.setattr(front, "SOURCES", moved)
    fresh_compiler.setattr(front, "HEADERS", headers)
    fresh_compiler.setattr("tempfile.tempdir", str(tmp_path))
    assert front.compiled([front.LINUX]) == [before]
    assert before is not None
    for name in (front.SOURCES, headers, Path.home(), tmp_path):
        assert str(name).encode() not in before


def test_what_was_compiled_before_is_kept_for_other_processes(quick_compiler):
    before = front.compiled([front.LINUX])
    front.forget_compiled()
    with pytest.MonkeyPatch.context() as patch:
        patch.delattr("subprocess.Popen")
        assert front.compiled([front.LINUX]) == before


def test_what_is_damaged_in_the_cache_is_compiled_again(quick_compiler, tmp_path):
    before = front.compiled([front.LINUX])
    (kept,) = (tmp_path / "cache" / "ndob-fmu").iterdir()
    whole = kept.read_bytes()
    kept.write_bytes(whole[:-1])
    front.forget_compiled()
    assert front.compiled([front.LINUX]) == before
    assert kept.read_bytes() == whole


def test_other_sources_and_another_compiler_have_a_front_of_their_own(quick_compiler, tmp_path):
    compiler = tmp_path / "cc"
    compiler.write_text(f'#!/bin/sh\nexec {COMPILERS[0]} "$@"\n')
    compiler.chmod(0o755)
    front.compiled([front.LINUX])
    changed = tmp_path / "changed"
    for folder in front.FOLDERS:
        shutil.copytree(front.SOURCES / folder, changed / folder)
    with (changed / "shell" / "log.c").open("a") as source:
        source.write("/* changed */\n")
    front.forget_compiled()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(front, "SOURCES", changed)
        assert front.compiled([front.LINUX]) != [None]
    front.forget_compiled()
    quick_compiler.setenv("CC", str(compiler))
    assert front.compiled([front.LINUX]) != [None]
    assert len(list((tmp_path / "cache" / "ndob-fmu").iterdir())) == 3


def test_where_no_cache_can_be_written_the_front_is_compiled_without_a_word(quick_compiler, tmp_path, caplog):
    (tmp_path / "file").write_text("")
    quick_compiler.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    assert front.compiled([front.LINUX]) != [None]
    assert caplog.text == ""


def test_the_binary_asks_the_loader_for_no_python_and_shows_nothing_but_fmi(flexible_joint, tmp_path):
    native = unpack(flexible_joint.plant, tmp_path, tmp_path)
    said = subprocess.run(["readelf", "-dWn", str(native.library)], capture_output=True, text=True, check=True).stdout
    assert "python" not in said
    assert "Build ID" not in said
    stock = native.library.parent / "pythonfmu-export.so"
    assert functions(native.library) == {name for name in functions(stock) if name.startswith("fmi2")} | {
        "ndob_fmu_python"
    }


def functions(library):
    done = subprocess.run(["nm", "-D", "--defined-only", str(library)], capture_output=True, text=True, check=True)
    return {line.split()[-1] for line in done.stdout.splitlines()}


def test_pythonfmus_binary_lies_beside_the_front_and_the_variables_are_listed(flexible_joint):
    with zipfile.ZipFile(flexible_joint.plant) as archive:
        assert archive.read(front.LINUX.slave_binary) == stock_binary()
        assert archive.read("binaries/linux64/FlexibleJointPlant.so") == front.compiled([front.LINUX])[0]
        lines = archive.read(front.DESCRIPTION).decode().splitlines()
    variables = [line.removeprefix("variable=") for line in lines if line.startswith("variable=")]
    assert variables[:3] == ["Ri motor_torque", "Ri load_torque", "Ro motor_angle"]
    assert "If disturbance.kind" in variables
    assert "Rf gravity_torque" in variables


@pytest.mark.parametrize(
    ("compiler", "reason"),
    [("/not/here/cc", "/not/here/cc"), ("false", "false"), (None, "none of cc, gcc, clang")],
)
def test_without_a_working_compiler_the_fmus_are_pythonfmus_and_one_line_says_what_is_lost(
    fresh_compiler, caplog, tmp_path, compiler, reason
):
    fresh_compiler.setenv("CC_WIN64", "false")
    if compiler is None:
        fresh_compiler.delenv("CC", raising=False)
        fresh_compiler.setenv("PATH", str(tmp_path))
    else:
        fresh_compiler.setenv("CC", compiler)
    plant, _ = build(load_model("flexible_joint"), tmp_path)
    record, of_windows = caplog.records
    message = record.getMessage()
    assert record.levelname == "WARNING"
    assert "no front for Windows" in of_windows.getMessage()
    assert "\n" not in message
    for word in ("no front", "Python processes only", "expected", "received", reason):
        assert word in message
    with zipfile.ZipFile(plant) as archive:
        assert archive.read("binaries/linux64/FlexibleJointPlant.so") == stock_binary()
        added = {front.LINUX.slave_binary, front.WINDOWS.slave_binary, front.DESCRIPTION}
        assert not added & set(archive.namelist())
    program = "import sys; from fmpy import simulate_fmu; print(len(simulate_fmu(sys.argv[1], stop_time=0.1)))"
    done = run_clean(program, plant, cwd=tmp_path)
    assert done.returncode == 0, done.stderr


def test_where_the_front_is_not_for_the_fmu_is_as_pythonfmu_makes_it(monkeypatch, caplog):
    monkeypatch.setattr("platform.machine", lambda: "aarch64")
    contents = {"modelDescription.xml": b"", "binaries/linux64/X.so": b"stock"}
    assert front.with_front(contents, FmuDescription("X", "", (), Experiment()), "{}") == contents
    assert caplog.text == ""
