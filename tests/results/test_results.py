"""Files of a run: exact, readable by fmpy, and either whole or absent."""

from __future__ import annotations

import json
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from fmpy.util import read_csv as fmpy_read_csv
from fmpy.util import write_csv as fmpy_write_csv
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from ndob_fmu.errors import UsageError
from ndob_fmu.results.csv_files import read_csv, write_csv
from ndob_fmu.results.json_files import read_sealed_json, write_json, write_sealed_json
from ndob_fmu.results.plots import plot_signals
from ndob_fmu.results.recording import Recording
from ndob_fmu.support.files import atomic_folder, atomic_path


def recording():
    time = np.array([0.0, 0.1, 0.1 + 0.2])
    columns = np.array([[1 / 3, 7.0], [-1e-300, -8.0], [np.pi, 2.0**31]])
    return Recording(time, ("plant.link_angle", "observer.count"), columns, ("Real", "Integer"))


def with_valid():
    time, columns = np.array([0.0, 0.5]), np.array([[1.5, 1.0, 3.0], [np.inf, 0.0, -4.0]])
    return Recording(time, ("a.x", "a.valid", "a.n"), columns, ("Real", "Boolean", "Integer"))


def test_a_csv_file_is_read_by_fmpy_with_every_digit(tmp_path):
    original = recording()
    write_csv(tmp_path / "result.csv", original)
    table = fmpy_read_csv(tmp_path / "result.csv")
    assert table.dtype.names == ("time", "plant.link_angle", "observer.count")
    np.testing.assert_array_equal(table["time"], original.time)
    for name in original.names:
        np.testing.assert_array_equal(table[name], original[name])


def test_a_csv_file_has_a_quoted_header_and_whole_numbers_for_integers_and_booleans(tmp_path):
    write_csv(tmp_path / "result.csv", with_valid())
    assert (tmp_path / "result.csv").read_text() == '"time","a.x","a.valid","a.n"\n0.0,1.5,1,3\n0.5,inf,0,-4\n'


@given(st.data())
def test_what_is_written_is_read_back_bit_for_bit(tmp_path_factory, data):
    rows = data.draw(st.integers(1, 5))
    time = data.draw(arrays(float, rows, elements=st.floats(allow_nan=False)))
    columns = data.draw(arrays(float, (rows, 3), elements=st.floats()))
    path = tmp_path_factory.mktemp("csv") / "result.csv"
    write_csv(path, Recording(time, ("x[1,2]", 'say "y"', "z ä"), columns))
    back = read_csv(path)
    assert back.names == ("x[1,2]", 'say "y"', "z ä")
    np.testing.assert_array_equal(back.time, time)
    np.testing.assert_array_equal(back.columns, columns)


def test_a_recording_longer_than_a_block_is_written_row_by_row_in_order(tmp_path):
    rows = 30_000
    columns = np.random.default_rng(1).standard_normal((rows, 7))
    write_csv(tmp_path / "result.csv", Recording(np.arange(rows) * 1e-3, tuple("abcdefg"), columns))
    back = read_csv(tmp_path / "result.csv")
    np.testing.assert_array_equal(back.time, np.arange(rows) * 1e-3)
    np.testing.assert_array_equal(back.columns, columns)


def test_the_memory_for_writing_a_csv_file_does_not_grow_with_its_rows(tmp_path):
    def peak(rows):
        recording = Recording(np.arange(rows) * 1e-3, tuple("abcdefghi"), np.full((rows, 9), np.pi))
        tracemalloc.start()
        try:
            write_csv(tmp_path / "result.csv", recording)
            return tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()

    short, long = peak(10_000), peak(20_000)
    assert long < 1.1 * short
    assert long < 10e6


def test_a_csv_file_of_fmpy_is_read(tmp_path):
    table = np.array([(0.0, 1.5), (1.0, 2.5), (3.0, 3.5)], dtype=[("time", float), ("u", float)])
    fmpy_write_csv(tmp_path / "u.csv", table)
    np.testing.assert_array_equal(read_csv(tmp_path / "u.csv")["u"], table["u"])


def test_the_booleans_of_fmpys_files_are_read(tmp_path):
    path = tmp_path / "fmpy.csv"
    result = np.array([(0.0, True, 1.5), (0.1, False, 2.5)], dtype=[("time", float), ("valid", bool), ("y", float)])
    fmpy_write_csv(path, result)
    np.testing.assert_array_equal(read_csv(path)["valid"], [1.0, 0.0])


def test_a_recording_without_signals_still_has_its_times(tmp_path):
    empty = Recording(np.array([0.0, 1.0]), (), np.zeros((2, 0)))
    write_csv(tmp_path / "result.csv", empty)
    assert read_csv(tmp_path / "result.csv").columns.shape == (2, 0)


def test_signals_come_back_in_their_own_type():
    signals = with_valid()
    assert [signals[name].dtype for name in signals.names] == [np.float64, np.bool_, np.int64]
    assert signals["a.valid"].tolist() == [True, False]


def test_a_signal_that_was_not_recorded_is_named_beside_those_that_were():
    with pytest.raises(UsageError, match=r"one of the signals plant\.link_angle, observer\.count, received 'plant\.x'"):
        recording()["plant.x"]


def test_a_recording_whose_shapes_contradict_cannot_be_made():
    with pytest.raises(UsageError, match=r"columns \(3, 2\).*columns \(2, 3\)"):
        Recording(np.zeros(3), ("a", "b"), np.zeros((2, 3)))


WRITERS = {
    "csv": lambda path: write_csv(path, recording()),
    "json": lambda path: write_json(path, {"a": 1}),
}


@pytest.mark.parametrize("writer", WRITERS)
def test_a_write_that_fails_halfway_leaves_the_old_file_and_nothing_beside_it(tmp_path, monkeypatch, writer):
    path = tmp_path / f"result.{writer}"
    path.write_text("old")

    def full(self, target):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "replace", full)
    with pytest.raises(UsageError, match=rf"result\.{writer}: expected a file that can be written, received.*No space"):
        WRITERS[writer](path)
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt])
def test_a_block_that_fails_leaves_the_old_file_and_nothing_beside_it(tmp_path, error):
    path = tmp_path / "figure.png"
    path.write_text("old")

    def write():
        with atomic_path(path) as temporary:
            temporary.write_text("half")
            raise error

    with pytest.raises(error):
        write()
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_the_temporary_file_has_the_ending_of_the_target_and_folders_are_made(tmp_path):
    path = tmp_path / "results" / "run" / "figure.png"
    with atomic_path(path) as temporary:
        assert temporary.suffix == ".png"
        assert temporary.parent == path.parent
        assert not path.exists()
        temporary.write_text("whole")
    assert path.read_text() == "whole"
    assert list(path.parent.iterdir()) == [path]


def test_a_folder_that_is_a_file_ends_in_one_line(tmp_path):
    (tmp_path / "results").write_text("")
    with pytest.raises(UsageError, match=r"result\.csv: expected a file that can be written"):
        write_csv(tmp_path / "results" / "result.csv", recording())


def test_json_takes_numpy_values_and_paths_and_turns_what_json_lacks_into_null(tmp_path):
    data = {
        "final": np.float64(0.5),
        "steps": np.int64(3),
        "gain": np.array([[1.0, np.nan], [np.inf, 2.0]]),
        "ok": np.bool_(True),
        "never": float("nan"),
        "file": Path("a.csv"),
        "pair": (1, None),
    }
    write_json(tmp_path / "summary.json", data)
    text = (tmp_path / "summary.json").read_text()
    assert json.loads(text, parse_constant=pytest.fail) == {
        "final": 0.5,
        "steps": 3,
        "gain": [[1.0, None], [None, 2.0]],
        "ok": True,
        "never": None,
        "file": "a.csv",
        "pair": [1, None],
    }


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("0.25", "0.75"),
        ('"runs"', '"rubs"'),
        ('"runs": 3,', ""),
        ("{", '{"more": 1,'),
        ('"sha256"', '"sha257"'),
        ("}", ""),
    ],
)
def test_a_sealed_file_is_read_only_as_it_was_written(tmp_path, old, new):
    path, data = tmp_path / "study.json", {"step": 0.25, "runs": 3, "worst": float("nan")}
    write_sealed_json(path, data)
    assert read_sealed_json(path) == {"step": 0.25, "runs": 3, "worst": None}
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(UsageError, match=r"study\.json: expected"):
        read_sealed_json(path)


def test_results_load_without_fmpy():
    import subprocess
    import sys

    code = (
        "import sys, ndob_fmu.results.csv_files; "
        "print([m for m in ('fmpy', 'scipy', 'sympy', 'pythonfmu') if m in sys.modules])"
    )
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert loaded.stdout.strip() == "[]"


@pytest.mark.parametrize("writer", [atomic_path, atomic_folder])
def test_a_file_that_a_block_cannot_read_is_not_blamed_on_the_place_it_writes_to(tmp_path, writer):
    with pytest.raises(FileNotFoundError, match="source"), writer(tmp_path / "target"):
        (tmp_path / "source").read_text()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("writer", [atomic_path, atomic_folder])
@pytest.mark.parametrize(
    "error",
    [
        lambda temporary: OSError(28, "No space left on device"),
        lambda temporary: OSError(5, "Input/output error", str(temporary)),
        lambda temporary: OSError(f"Failed to open local file '{temporary}'"),  # as pyarrow has it
    ],
)
def test_what_a_block_cannot_write_is_told_of_the_place_it_writes_to(tmp_path, writer, error):
    with (
        pytest.raises(UsageError, match=r"target: expected a \w+ that can be written"),
        writer(tmp_path / "target") as new,
    ):
        raise error(new)


def test_the_figure_of_the_signals_gives_booleans_axes_of_their_own(tmp_path):
    plot_signals(tmp_path / "signals.png", with_valid())
    drawn = (tmp_path / "signals.svg").read_text("utf-8")
    assert [drawn.count(label) for label in (">a [1]<", ">a [Boolean]<")] == [1, 1]
