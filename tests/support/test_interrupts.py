"""Signals end a command once and whole: nothing is left of it, and nothing interrupts its cleaning up."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from contextlib import suppress

import pytest

from ndob_fmu.errors import UsageError
from ndob_fmu.support import temporary
from ndob_fmu.support.files import atomic_folder
from ndob_fmu.support.interrupts import Interrupted, deferred_interrupt, exit_code, held, interruptible
from ndob_fmu.support.temporary import make_folder, remove_folder, remove_folders, temporary_folder


@pytest.fixture
def place(tmp_path, monkeypatch):
    """A folder for temporary files that this process has not looked through yet."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setattr(temporary, "_swept", set())
    return tmp_path


def send(number):
    os.kill(os.getpid(), number)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_the_first_signal_ends_a_command_and_a_second_one_does_not_interrupt_its_cleaning_up(number):
    cleaned = []
    before = {each: signal.getsignal(each) for each in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}

    def command():
        with interruptible(terminate=True):
            try:
                send(number)
            finally:
                for other in before:
                    send(other)
                cleaned.append("whole")

    with pytest.raises(Interrupted) as ended:
        command()
    assert exit_code(ended.value) == 128 + number
    assert cleaned == ["whole"]
    assert {each: signal.getsignal(each) for each in before} == before


def test_a_signal_waits_for_the_end_of_what_must_not_be_left_half_done():
    done = []

    def command():
        with interruptible():
            with held():
                with held():
                    send(signal.SIGINT)
                    send(signal.SIGINT)
                done.append("all")
            done.append("too much")

    with pytest.raises(Interrupted):
        command()
    assert done == ["all"]


def test_an_exception_that_a_callback_has_swallowed_comes_again_at_the_next_step():
    steps = []

    def command():
        with deferred_interrupt() as check:
            for step in range(5):
                check()
                steps.append(step)
                with suppress(KeyboardInterrupt):
                    send(signal.SIGINT)
                    send(signal.SIGINT)

    with pytest.raises(Interrupted):
        command()
    assert steps == [0]


class Callback:
    """Python drops what is raised in its `__del__`."""

    def __del__(self):
        send(signal.SIGINT)
        self.ended = True  # a call's signal is handled before the next instruction


def test_a_signal_whose_exception_python_drops_comes_again_and_nothing_is_printed(monkeypatch):
    """Also where the main thread waits, as for a worker."""
    reported, lock = [], threading.Lock()
    monkeypatch.setattr(sys, "unraisablehook", lambda dropped: reported.append(dropped.exc_value))
    hook = sys.unraisablehook

    def command():
        with interruptible(), lock:
            Callback()
            lock.acquire(timeout=20)

    with pytest.raises(Interrupted) as ended:
        command()
    assert ended.value.number == signal.SIGINT
    assert reported == []
    assert sys.unraisablehook is hook


def test_what_python_drops_besides_is_reported_as_before(monkeypatch):
    reported, error = [], RuntimeError("own")
    monkeypatch.setattr(sys, "unraisablehook", lambda dropped: reported.append(dropped.exc_value))

    class Failing:
        def __del__(self):
            raise error

    with interruptible():
        Failing()
    assert reported == [error]


def test_other_threads_and_handlers_of_the_program_are_left_alone():
    found = []
    thread = threading.Thread(target=lambda: found.append(use()))

    def use():
        with interruptible(terminate=True), held():
            return signal.getsignal(signal.SIGTERM)

    thread.start()
    thread.join()
    assert found == [signal.SIG_DFL]
    handler = signal.signal(signal.SIGINT, lambda *_: found.append("own"))
    try:
        with interruptible():
            send(signal.SIGINT)
    finally:
        signal.signal(signal.SIGINT, handler)
    assert found[-1] == "own"


def test_a_temporary_folder_is_gone_after_its_block(place):
    with temporary_folder() as folder:
        (folder / "file").write_text("x")
        assert len(list(place.iterdir())) == 1
    assert list(place.iterdir()) == []


def test_the_folders_of_a_killed_process_are_removed_and_those_of_a_living_one_stay(place, monkeypatch):
    program = "import sys; from ndob_fmu.support.temporary import make_folder\nprint(make_folder(), flush=True)\n"
    program += "sys.stdin.read()"
    environment = os.environ | {"TMPDIR": str(place)}
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True, "env": environment}
    with (
        subprocess.Popen([sys.executable, "-c", program], **pipes) as killed,
        subprocess.Popen([sys.executable, "-c", program], **pipes) as living,
    ):
        stale, used = (place / process.stdout.readline().strip() for process in (killed, living))
        (stale / "library.so").write_text("x")
        killed.kill()
        killed.wait()
        foreign = place / "ndob_fmu_of_somebody"
        foreign.mkdir()
        long_ago = time.time() - 1000
        for folder in (stale.parent, used.parent, foreign):
            os.utime(folder, (long_ago, long_ago))
        own = make_folder()
        assert sorted(place.iterdir()) == sorted([used.parent, foreign, own.parent])
        remove_folder(own)
        living.kill()


def test_all_folders_of_a_process_can_be_removed_at_its_end(place):
    folders = [make_folder(), make_folder()]
    remove_folders()
    assert not any(folder.exists() for folder in folders)
    assert list(place.iterdir()) == []


def test_without_a_place_for_temporary_files_a_command_ends_in_one_line(monkeypatch, tmp_path):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "absent"))
    with pytest.raises(UsageError, match=r"folder for temporary files: expected one that can be written.*TMPDIR"):
        make_folder()


@pytest.mark.parametrize("exists", [True, False])
def test_results_are_written_whole_or_not_at_all(tmp_path, exists):
    folder = tmp_path / "results"
    if exists:
        folder.mkdir()
        (folder / "result.csv").write_text("old")

    def interrupted():
        with atomic_folder(folder) as new:
            (new / "result.csv").write_text("half")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert folder.exists() == exists
    if exists:
        assert [(path.name, path.read_text()) for path in folder.iterdir()] == [("result.csv", "old")]
    with atomic_folder(folder) as new:
        (new / "result.csv").write_text("new")
        (new / "summary.json").write_text("new")
    assert {path.name: path.read_text() for path in folder.iterdir()} == {"result.csv": "new", "summary.json": "new"}
