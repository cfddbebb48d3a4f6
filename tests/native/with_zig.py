"""Native FMUs by zig's compiler for all platforms: the bits of gcc's on Linux, and both processors of macOS.

make native-all      the usual run does not collect it: zig takes 400 MB, and minutes for its first build
"""

from __future__ import annotations

import importlib.util
import re
import struct
import zipfile
from dataclasses import replace

import numpy as np
import pytest

from ndob_fmu.model.loading import load_model
from ndob_fmu.native.build import build_native, build_native_components
from ndob_fmu.native.compile import PLATFORMS
from tests.helpers.native_experiments import NAMES, native_experiments
from tests.helpers.played import ARM, Loaded, arm_in_qemu, this_machine

if not importlib.util.find_spec("ziglang"):
    pytest.exit("expected zig's compiler, received none: pip install ziglang", returncode=1)

X86_64, ARM64 = 0x01000007, 0x0100000C  # Apple's numbers of processors
MACH_O, LIBRARY = 0xFEEDFACF, 6


def all_fmus(folder, platforms):
    model = load_model("flexible_joint")
    fmus = [
        *build_native(model, folder, platforms=platforms),
        *build_native_components(folder, platforms=platforms),
    ]
    return {fmu.stem: fmu for fmu in fmus}


@pytest.fixture(scope="module")
def by_zig(tmp_path_factory):
    return all_fmus(tmp_path_factory.mktemp("zig"), list(PLATFORMS))


@pytest.fixture(scope="module")
def by_gcc(tmp_path_factory):
    """Return FMUs for this machine, made as if there were no zig."""
    found = importlib.util.find_spec
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("importlib.util.find_spec", lambda name: None if name == "ziglang" else found(name))
        return all_fmus(tmp_path_factory.mktemp("gcc"), ["linux64"])


@pytest.mark.parametrize("name", NAMES)
def test_zig_gives_the_bits_of_gcc_on_x86_64_and_on_arm(by_zig, by_gcc, tmp_path, name):
    experiment = native_experiments(tmp_path)[name]
    here = this_machine(tmp_path)
    gcc = Loaded.unpacked(here, by_gcc[experiment.fmu], tmp_path / "gcc").play(experiment)
    zig = Loaded.unpacked(here, by_zig[experiment.fmu], tmp_path / "zig")
    for each in (zig, replace(zig, machine=arm_in_qemu(tmp_path))):
        np.testing.assert_array_equal(each.play(experiment).rows, gcc.rows)


def test_a_library_for_macos_has_both_processors_and_shows_nothing_but_fmi(by_zig):
    for name, fmu in by_zig.items():
        with zipfile.ZipFile(fmu) as archive:
            data = archive.read(f"binaries/darwin64/{name}.dylib")
        magic, count = struct.unpack_from(">II", data)
        parts = [struct.unpack_from(">5I", data, 8 + 20 * i) for i in range(count)]
        assert (magic, {part[0] for part in parts}) == (0xCAFEBABE, {X86_64, ARM64})
        for processor, _, begin, size, alignment in parts:
            assert begin % 2**alignment == 0
            part = data[begin : begin + size]
            assert len(part) == size
            own_magic, own_processor, _, kind = struct.unpack_from("<4I", part)
            assert (own_magic, own_processor, kind) == (MACH_O, processor, LIBRARY)
            exported = set(re.findall(rb"_(fmi2[A-Z]\w+)", part))
            assert {b"fmi2Instantiate", b"fmi2DoStep"} <= exported


def test_every_platform_is_in_the_fmu(by_zig):
    assert ARM in PLATFORMS
    for name, fmu in by_zig.items():
        with zipfile.ZipFile(fmu) as archive:
            binaries = {path for path in archive.namelist() if path.startswith("binaries/")}
        assert binaries == {f"binaries/{one.folders[0]}/{name}{one.suffix}" for one in PLATFORMS.values()}
