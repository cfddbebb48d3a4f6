"""Progress of long commands: the package logs what it is doing, and the command line shows it after a while."""

from __future__ import annotations

import logging
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress

PATIENCE = 2.0  # s

_log = logging.getLogger(__name__)


def begin(activity: str) -> None:
    """Log an activity that begins, in words that can follow "still"."""
    _log.info(activity)


@contextmanager
def shown_after(patience: float) -> Iterator[None]:
    """Within this block, print the current activity to stderr after `patience` s, and each later one when it begins."""
    handler = _Lines(patience)
    level, propagate = _log.level, _log.propagate
    _log.addHandler(handler)
    _log.setLevel(logging.INFO)
    _log.propagate = False
    try:
        yield
    finally:
        _log.removeHandler(handler)
        _log.setLevel(level)
        _log.propagate = propagate
        handler.close()


class _Lines(logging.Handler):
    def __init__(self, patience: float) -> None:
        super().__init__()
        self._latest: logging.LogRecord | None = None
        self._late = False
        self._timer = threading.Timer(patience, self._wait_is_long)
        self._timer.daemon = True
        self._timer.start()

    def emit(self, record: logging.LogRecord) -> None:
        self._latest = record
        if self._late:
            self._show()

    def close(self) -> None:
        self._timer.cancel()
        super().close()

    def _wait_is_long(self) -> None:
        self.acquire()
        try:
            self._late = True
            self._show()
        finally:
            self.release()

    def _show(self) -> None:
        if self._latest is not None:
            with suppress(OSError):  # nobody reads it
                print(f"ndob-fmu: still {self._latest.getMessage()}", file=sys.stderr, flush=True)
