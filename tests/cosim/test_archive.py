"""Opening archives: what is not the archive's fault is not blamed on it."""

from __future__ import annotations

import shutil
import zipfile
from collections import namedtuple

import pytest

from ndob_fmu.cosim.fmi import zip_archive
from ndob_fmu.cosim.fmi.zip_archive import open_archive
from ndob_fmu.errors import CouplingError, UsageError


@pytest.fixture
def path(tmp_path):
    with zipfile.ZipFile(tmp_path / "a.fmu", "w") as new:
        new.writestr("resources/data.txt", b"0" * 5000)
    return tmp_path / "a.fmu"


def test_a_full_disk_is_not_blamed_on_the_archive(path, tmp_path, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(shutil, "copyfileobj", full)
    (tmp_path / "unpacked").mkdir()
    with open_archive(path) as opened, pytest.raises(UsageError, match=r"temporary files .*No space left.*TMPDIR"):
        opened.extractall(tmp_path / "unpacked")


def test_an_error_of_the_caller_goes_through_as_it_is(path):
    with pytest.raises(PermissionError, match="results"), open_archive(path):
        raise PermissionError("results/run.csv")


def test_an_archive_that_does_not_fit_on_the_disk_is_refused_before_it_is_unpacked(path, tmp_path, monkeypatch):
    usage = namedtuple("usage", "total used free")
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage(10**9, 9 * 10**8, zip_archive.KEPT_FREE + 4000))
    unpacked = tmp_path / "unpacked"
    unpacked.mkdir()
    with (
        open_archive(path) as opened,
        pytest.raises(UsageError, match=r"a\.fmu: expected 64 MiB free .*received 64 MiB"),
    ):
        opened.extractall(unpacked)
    assert list(unpacked.iterdir()) == []


@pytest.mark.parametrize("name", ["absent.fmu", "a\0b.fmu"])
def test_a_file_that_cannot_be_read_is_named(tmp_path, name):
    with pytest.raises(UsageError, match="expected a file that can be read"), open_archive(tmp_path / name):
        pass


def test_a_damaged_entry_is_named(path):
    data = bytearray(path.read_bytes())
    data[100] ^= 1
    path.write_bytes(data)
    with open_archive(path) as opened, pytest.raises(CouplingError, match=r"'resources/data.txt' to be whole.*CRC"):
        opened.test()
