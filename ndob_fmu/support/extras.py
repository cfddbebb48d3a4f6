"""Parts of the package whose dependencies are not installed with it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from ndob_fmu.errors import UsageError


@contextmanager
def extra(name: str) -> Iterator[None]:
    """Import, inside the block, what needs the extra ``name``; raise UsageError if that is not installed."""
    try:
        yield
    except ModuleNotFoundError as error:
        raise UsageError.report(
            f"the extra {name}",
            expected="its packages to be installed",
            received=f"no package {error.name}",
            likely=f'python -m pip install "ndob-fmu[{name}]" has not been run',
        ) from error
