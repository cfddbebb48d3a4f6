"""Progress of long commands: the package logs what it is doing, and the command line shows it after a while."""

from __future__ import annotations

import logging
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress

PATIENCE = 2.0  # s
_IS_DETAIL = "is_detail"

_log = logging.getLogger(__name__)


def begin(activity: str) -> None:
    """Log an activity that begins, in words that can follow "still"."""
    _log.info(activity)


def go_on(detail: str) -> None:
    """Log how far the activity that began last is, in words that can follow it and a comma."""
    _log.info(detail, extra={_IS_DETAIL: True})


@contextmanager
def shown_after(patience: float) -> Iterator[None]:
    """Within this block, print the current activity to stderr after `patience` s, and each later one when it begins.

    How far an activity is, is printed where nothing else was for `patience` s.
    """
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
        self._late, self._patience, self._shown_at = False, patience, time.monotonic()
        self._timer = threading.Timer(patience, self._wait_is_long)
        self._timer.daemon = True
        self._timer.start()

    def emit(self, record: logging.LogRecord) -> None:
        if not hasattr(record, _IS_DETAIL):
            self._latest = record
            if self._late:
                self._show()
        elif self._late and time.monotonic() - self._shown_at > self._patience:
            self._show(f", {record.getMessage()}")

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

    def _show(self, how_far: str = "") -> None:
        self._shown_at = time.monotonic()
        if self._latest is not None:
            with suppress(OSError):  # nobody reads it
                print(f"ndob-fmu: still {self._latest.getMessage()}{how_far}", file=sys.stderr, flush=True)
