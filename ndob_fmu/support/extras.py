"""Parts of the package whose dependencies are not installed with it."""

from __future__ import annotations

import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec

from ndob_fmu.errors import UsageError


@contextmanager
def extra(name: str) -> Iterator[None]:
    """Import, inside the block, what needs the extra ``name``; raise UsageError if that is not installed.

    A module that is missing inside an installed package is that package's fault: its error is raised as it is.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        if not _is_package_of_ours(error):
            raise
        raise UsageError.report(
            f"the extra {name}",
            expected="its packages to be installed",
            received=f"no package {error.name}",
            likely=f'python -m pip install "ndob-fmu[{name}]" has not been run',
        ) from error


def _is_package_of_ours(error: ModuleNotFoundError) -> bool:
    """Return whether a whole package is missing that this package's own code imports."""
    if error.name is None or find_spec(error.name.partition(".")[0]) is not None:
        return False
    modules = [str(frame.f_globals.get("__name__")) for frame, _ in traceback.walk_tb(error.__traceback__)]
    importer = [module for module in modules if module.partition(".")[0] != "importlib"][-1]
    return importer.partition(".")[0] == __name__.partition(".")[0]
