"""Opening .fmu and .ssp files, which are zip archives. Their content is checked and not trusted."""

from __future__ import annotations

import io
import os
import shutil
import stat
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from xml.parsers import expat

from ndob_fmu.errors import CouplingError, NdobError, UsageError

_MOST_ENTRIES = 20_000
_MOST_IN_DIRECTORY = 16 * 2**20  # bytes of the table of contents; an entry takes 46 and its name
_MOST_UNPACKED = 4 * 2**30  # bytes
KEPT_FREE = 64 * 2**20  # bytes of the disk that an archive may not take
_MOST_IN_XML = 64 * 2**20  # bytes; a tree of it takes some ten times as much memory
_LONGEST_NAME = 255  # bytes of a file's name, the most that common file systems take
_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
_ENCRYPTED = 0x1
_UNIX = (3, 19)  # systems whose archives say what kind of file an entry is
_DAMAGE = (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, ValueError)


class Archive:
    """An opened zip archive whose table of contents has been checked.

    Each method raises CouplingError for an entry that is damaged, UsageError where a file cannot be read or written.
    """

    def __init__(self, path: Path, archive: zipfile.ZipFile) -> None:
        self.path = path
        self._archive = archive

    def namelist(self) -> list[str]:
        """Return the names of all entries, in their order."""
        return self._archive.namelist()

    def infolist(self) -> list[zipfile.ZipInfo]:
        """Return what the table of contents says of each entry."""
        return self._archive.infolist()

    def read(self, name: str) -> bytes:
        """Return the content of an entry."""
        with self._reading(name):
            return self._archive.read(name)

    def read_xml(self, name: str) -> bytes:
        """Return the content of an XML file; raise CouplingError if it is too large, not well-formed or has a DOCTYPE.

        Neither FMI nor SSP needs a DOCTYPE, which may define entities that grow without end or name other files.
        """
        size = self._archive.getinfo(name).file_size
        if size > _MOST_IN_XML:
            raise _refused(self.path, f"{name} of at most {_MOST_IN_XML // 2**20} MiB", f"{size / 2**20:.0f} MiB")
        data = self.read(name)
        where = f"{self.path}, {name}"

        def refuse(*_: object) -> None:
            raise CouplingError.report(where, expected="XML without a DOCTYPE", received="one with a DOCTYPE")

        parser = expat.ParserCreate()
        parser.StartDoctypeDeclHandler = refuse
        try:
            parser.Parse(data, True)
        except (expat.ExpatError, ValueError, LookupError) as error:  # the last two: an encoding that Python lacks
            received = str(error) if data else "an empty file"
            raise CouplingError.report(where, expected="well-formed XML", received=received) from error
        return data

    def extract(self, name: str, folder: str | Path) -> Path:
        """Unpack one entry below ``folder`` and return its path."""
        self._require_space(folder, [self._archive.getinfo(name)])
        return self._extract(name, folder)

    def extractall(self, folder: str | Path) -> None:
        """Unpack all entries below ``folder``."""
        self._require_space(folder, self.infolist())
        for name in self.namelist():
            self._extract(name, folder)

    def _require_space(self, folder: str | Path, entries: list[zipfile.ZipInfo]) -> None:
        needed = sum(entry.file_size for entry in entries) + KEPT_FREE
        free = shutil.disk_usage(folder).free
        if needed > free:
            raise UsageError.report(
                str(self.path),
                expected=f"{needed / 2**20:.0f} MiB free in {folder} to unpack it",
                received=f"{free / 2**20:.0f} MiB",
                likely="the disk is full, or the archive is made to fill it; TMPDIR names another folder",
            )

    def _extract(self, name: str, folder: str | Path) -> Path:
        with self._reading(name):
            try:
                return Path(self._archive.extract(name, folder))
            except OSError as error:  # mostly while writing: a full disk must not be blamed on the archive
                raise UsageError.report(
                    f"unpacking {self.path.name}",
                    expected="a folder for temporary files that can be written",
                    received=str(error),
                    likely="the disk is full or TMPDIR names the wrong folder",
                ) from error

    def test(self) -> None:
        """Read all entries; raise CouplingError for the first one that is damaged."""
        for entry in self.infolist():
            with self._reading(entry.filename), self._archive.open(entry) as file:
                while file.read(2**20):
                    pass

    @contextmanager
    def _reading(self, name: str) -> Iterator[None]:
        try:
            yield
        except _DAMAGE as error:
            likely = "the file is damaged or incomplete"
            raise _refused(self.path, f"{name!r} to be whole", _first_line(error), likely) from error
        except OSError as error:
            raise _unreadable(self.path, error) from error


@contextmanager
def open_archive(path: Path) -> Iterator[Archive]:
    """Open a zip archive for reading.

    Raises UsageError if the file cannot be read, CouplingError if it is not a zip archive, or has entries that no FMU
    and no package needs: outside its folder, twice, links, encrypted, more than the disk holds.
    """
    try:
        file = _Bounded(path)
    except (OSError, ValueError) as error:  # ValueError: a name with a null character
        raise _unreadable(path, error) from error
    with file:
        try:
            archive = zipfile.ZipFile(file)
        except (*_DAMAGE, OSError, OverflowError) as error:
            raise _refused(path, "a zip archive", _first_line(error)) from error
        file.bounded = False
        with archive:
            _check(path, archive.infolist())
            yield Archive(path, archive)


class _Bounded(io.FileIO):
    """A file. While ``bounded`` is set, one read returns at most as many bytes as a table of contents may take."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self.bounded = True

    def read(self, size: int | None = -1, /) -> bytes:
        if self.bounded and size is not None and size > _MOST_IN_DIRECTORY:
            raise zipfile.BadZipFile(f"a table of contents of {size / 2**20:.0f} MiB")
        return super().read(-1 if size is None else size) or b""


def _check(path: Path, entries: list[zipfile.ZipInfo]) -> None:
    if len(entries) > _MOST_ENTRIES:
        raise _refused(path, f"at most {_MOST_ENTRIES} entries", str(len(entries)))
    unpacked = sum(entry.file_size for entry in entries)
    if unpacked > _MOST_UNPACKED:
        raise _refused(path, f"at most {_MOST_UNPACKED / 2**30:.0f} GiB unpacked", f"{unpacked / 2**30:.1f} GiB")
    files: set[str] = set()
    folders: set[str] = set()
    for entry in entries:
        _check_entry(path, entry)
        plain = "/".join(part for part in entry.filename.split("/") if part not in ("", ".")) or "."
        name = os.path.normcase(plain).replace(os.sep, "/")
        if entry.is_dir():
            folders.add(name)
        elif name in files:
            raise _refused(path, "each entry once", f"{entry.filename!r} twice")
        else:
            files.add(name)
        while (name := name.rpartition("/")[0] or ".") not in folders:
            folders.add(name)
    if clash := min(files & folders, default=None):
        raise _refused(path, "each entry once", f"{clash!r} as a file and as a folder")


def _check_entry(path: Path, entry: zipfile.ZipInfo) -> None:
    name = entry.filename
    parts = name.split("/")
    if name != entry.orig_filename or any(ord(letter) < 32 for letter in name):
        raise _refused(path, "names without control characters", repr(entry.orig_filename))
    if not name or name.startswith("/") or ":" in name or "\\" in name or ".." in parts:
        raise _refused(path, "entries that stay inside the archive's folder", repr(name))
    if any(len(part.encode("utf-8", "surrogatepass")) > _LONGEST_NAME for part in parts):
        raise _refused(path, f"names of at most {_LONGEST_NAME} bytes", repr(name))
    kind = stat.S_IFMT(entry.external_attr >> 16) if entry.create_system in _UNIX else 0
    if kind not in (0, stat.S_IFREG, stat.S_IFDIR):
        raise _refused(path, "files and folders only", f"{name!r}, a link or a device")
    if entry.flag_bits & _ENCRYPTED:
        raise _refused(path, "entries without encryption", f"{name!r}, which is encrypted")
    if entry.compress_type not in _METHODS:
        raise _refused(path, "entries that are stored or deflated", f"{name!r} of method {entry.compress_type}")


def _refused(path: Path, expected: str, received: str, likely: str = "") -> NdobError:
    return CouplingError.report(str(path), expected=expected, received=received, likely=likely)


def _unreadable(path: Path, error: Exception) -> NdobError:
    return UsageError.report(str(path), expected="a file that can be read", received=str(error))


def _first_line(error: Exception) -> str:
    return str(error).partition("\n")[0] or type(error).__name__
