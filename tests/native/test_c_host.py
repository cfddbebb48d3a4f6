"""Native FMUs in a C host: equal bits on 64-bit ARM, in any thread and rounding mode; no memory asked for in a step."""

from __future__ import annotations

import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ndob_fmu.model.loading import load_model
from ndob_fmu.native.build import build_native, build_native_components
from tests.helpers.native_experiments import NAMES as EXPERIMENTS
from tests.helpers.native_experiments import native_experiments
from tests.helpers.needs import ARM_IN_QEMU
from tests.helpers.played import ARM, Loaded, arm_in_qemu, memory_counter, this_machine

pytestmark = ARM_IN_QEMU
NAMES = ["FlexibleJointPlant", "FlexibleJointObserver", "DisturbanceSource", "Encoder", "Sensor", "TorsionSpring"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("c_host")


@pytest.fixture(scope="module")
def machine(folder):
    return this_machine(folder)


@pytest.fixture(scope="module")
def experiments(folder):
    return native_experiments(folder)


@pytest.fixture(scope="module")
def loaded(folder, machine):
    """Return each FMU by its name, for this machine; it has the binary for ARM too."""
    platforms = ["linux64", ARM]
    fmus = [*build_native(load_model("flexible_joint"), folder, platforms=platforms)]
    fmus += build_native_components(folder, platforms=platforms)
    return {fmu.stem: Loaded.unpacked(machine, fmu, folder / fmu.stem) for fmu in fmus}


@pytest.fixture(scope="module")
def played(loaded, experiments):
    """Return the rows of an experiment on this machine."""
    known = {}

    def play(name):
        if name not in known:
            known[name] = loaded[experiments[name].fmu].play(experiments[name])
        return known[name]

    return play


def bits(rows):
    """Return the bits of the numbers; the sign of NaN means nothing."""
    return np.where(np.isnan(rows), np.nan, rows).view(np.int64)


def test_every_fmu_and_every_experiment_is_tried(loaded, experiments):
    assert set(loaded) == set(NAMES)
    assert set(EXPERIMENTS) == set(experiments)
    assert {experiment.fmu for experiment in experiments.values()} == set(NAMES)


@pytest.mark.parametrize("name", EXPERIMENTS)
def test_64_bit_arm_gives_the_same_bits(loaded, experiments, played, folder, name):
    arm = replace(loaded[experiments[name].fmu], machine=arm_in_qemu(folder))
    here, there = played(name), arm.play(experiments[name])
    for variable, expected, found in zip(here.names, bits(here.rows[0]).T, bits(there.rows[0]).T, strict=True):
        np.testing.assert_array_equal(found, expected, variable)
    assert there.said == here.said
    moves = np.ptp(np.nan_to_num(here.rows[0]), axis=0) > 0.0
    assert moves.any() or name in ("DisturbanceSource, none", "DisturbanceSource, constant")


@pytest.mark.parametrize("name", EXPERIMENTS)
def test_a_step_asks_for_no_memory(loaded, experiments, played, folder, machine, name):
    counting = replace(loaded[experiments[name].fmu], machine=replace(machine, env=memory_counter(folder)))
    found = counting.play(experiments[name])
    assert found.blocks == 0
    np.testing.assert_array_equal(bits(found.rows), bits(played(name).rows))


@pytest.mark.parametrize("name", ["observer, faults", "Encoder"])
def test_memory_is_asked_for_by_an_instance_when_its_settings_are_known_and_by_a_saved_state_only(
    loaded, experiments, folder, machine, name
):
    experiment = experiments[name]
    counting = replace(loaded[experiment.fmu], machine=replace(machine, env=memory_counter(folder)))
    first, *begin = counting.begin(experiment)
    calls = [*begin, "getR 0", "step 0 0.001", "save", "restore", "save", "drop", "terminate", "reset", "free"]
    commands = ["memory", *(word for call in (first, *calls) for word in (call, "memory"))]
    replies, _ = counting.run(commands)
    blocks = [int(reply.split()[0]) for reply in replies if reply.endswith("memory OK")][1:]
    made, *others = blocks
    assert made == 1
    # An observer's settings tell how much it needs; the first one also takes what instances share.
    settings_known = {"exit": 5} if name.startswith("observer") else {}
    assert {call: count for call, count in zip(calls, others, strict=True) if count} == {**settings_known, "save": 1}


@pytest.mark.parametrize(
    "name", ["FlexibleJointObserver", "FlexibleJointObserver_paper", "FlexibleJointPlant", "Sensor"]
)
def test_the_thread_of_a_call_changes_nothing(loaded, experiments, played, name):
    fmu, alone = loaded[experiments[name].fmu], bits(played(name).rows[0])
    np.testing.assert_array_equal(bits(fmu.play(experiments[name], "moved").rows[0]), alone)
    for rows in fmu.play(experiments[name], "crowd", instances=5).rows:
        np.testing.assert_array_equal(bits(rows), alone)


@pytest.mark.parametrize("name", EXPERIMENTS)
def test_a_host_may_round_downward_and_flush_small_numbers_and_both_stay_as_they_are(loaded, experiments, played, name):
    """The host compares its control registers before and after each step: another value would be no OK."""
    found = loaded[experiments[name].fmu].play(experiments[name], "odd")
    np.testing.assert_array_equal(bits(found.rows), bits(played(name).rows))


def test_the_host_sees_when_the_floating_point_environment_is_not_what_it_was(loaded, experiments, played, tmp_path):
    """Without what the FMUs do about it, rounding downward would change bits."""
    name = "FlexibleJointPlant"
    native = loaded[name]
    (source,) = native.folder.glob("sources/*.c")
    text = source.read_text("utf-8")
    changed = re.sub(r"_mm_setcsr\([^;]*\);", ";", text)
    assert changed != text
    (tmp_path / "changed.c").write_text(changed, "utf-8")
    library = tmp_path / "changed.so"
    command = [
        "gcc",
        "-O2",
        "-w",
        "-shared",
        "-fPIC",
        "-I",
        source.parent,
        tmp_path / "changed.c",
        "-o",
        library,
        "-lm",
    ]
    subprocess.run(command, check=True)
    shutil.copytree(native.folder, tmp_path / "fmu")
    shutil.copy(library, tmp_path / "fmu" / "binaries" / "linux64" / f"{name}.so")
    found = replace(native, folder=tmp_path / "fmu").play(experiments[name], "odd")
    assert not np.array_equal(bits(found.rows), bits(played(name).rows))


@pytest.mark.parametrize("name", NAMES)
def test_a_process_with_a_native_fmu_has_the_c_library_and_no_other(loaded, experiments, name):
    experiment = next(each for each in experiments.values() if each.fmu == name)
    fmu = loaded[name]
    with subprocess.Popen(fmu.command(), stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env={}) as host:
        for command in (*fmu.begin(experiment), f"step 0 {experiment.step_size!r}"):
            host.stdin.write(f"{command}\n")
            host.stdin.flush()
            assert host.stdout.readline().endswith(" OK\n")
        mapped = re.findall(r"/\S*\.so\S*", Path(f"/proc/{host.pid}/maps").read_text("utf-8"))
        host.stdin.close()
    libraries = {Path(path).name for path in mapped}
    assert f"{name}.so" in libraries
    allowed = re.compile(r"(libc|libm|ld-linux-x86-64)[-.].*")
    assert [library for library in libraries - {f"{name}.so"} if not allowed.fullmatch(library)] == []
