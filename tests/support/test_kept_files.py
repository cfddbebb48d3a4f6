"""What is kept for later processes comes back whole, and the oldest makes room."""

import os

import pytest

from ndob_fmu.support import kept_files
from ndob_fmu.support.kept_files import keep, kept


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    return tmp_path / "ndob-fmu"


def test_what_is_kept_comes_back_under_its_key_alone(folder):
    keep("one", b"content")
    assert kept("one") == b"content"
    assert kept("two") is None


def test_a_file_that_was_cut_or_changed_counts_as_missing(folder):
    keep("one", b"content")
    file = folder / "one"
    for damaged in (b"", file.read_bytes()[:-1], file.read_bytes()[:-1] + b"T"):
        file.write_bytes(damaged)
        assert kept("one") is None


def test_the_oldest_files_make_room(folder, monkeypatch):
    monkeypatch.setattr(kept_files, "_MOST", 2)
    for age, key in enumerate(("new", "old", "older")):
        keep(key, key.encode())
        os.utime(folder / key, (1e9 - age, 1e9 - age))
    keep("newest", b"newest")
    assert {path.name for path in folder.iterdir()} == {"new", "newest"}
