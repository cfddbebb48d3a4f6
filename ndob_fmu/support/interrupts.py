"""Ctrl-C, and for a command also SIGTERM and a closed terminal: they end a run once, and never its cleaning up.

Within a block of `interruptible` the first signal raises Interrupted, and later ones are ignored: they cannot interrupt
the cleaning up. A signal waits while a component steps and while a block of `held` runs. Python drops what is raised in
`__del__` and in a callback of C: where Interrupted is dropped, nothing is printed, and the signal comes again.
"""

from __future__ import annotations

import _thread
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

_ENDING = ("SIGTERM", "SIGHUP", "SIGBREAK")  # as far as the system has them
_AGAIN_AFTER = 0.01  # seconds, in which a `__del__` or a callback has ended


class Interrupted(KeyboardInterrupt):
    """The user or the system has asked to end, by the signal ``number``."""

    def __init__(self, number: int) -> None:
        super().__init__()
        self.number = number


def exit_code(interrupt: KeyboardInterrupt) -> int:
    """Return the exit code of a command that was interrupted, as shells have it."""
    return 128 + (interrupt.number if isinstance(interrupt, Interrupted) else signal.SIGINT)


class _Watch:
    """What has become of the signals of the main thread."""

    def __init__(self) -> None:
        self.stepping = 0
        self.holding = 0
        self.pending: int | None = None
        self.raised = False
        self._thread = threading.get_ident()

    def receive(self, number: int, _frame: FrameType | None) -> None:
        """Take a signal; a second one during a step is raised at once, since the step may never end."""
        waits = self.holding or (self.stepping and self.pending is None)
        self.pending = number if self.pending is None else self.pending
        if not waits:
            self.check()

    def check(self) -> None:
        """Raise Interrupted if a signal has come and nothing is being cleaned up yet."""
        if not self.raised:
            self.check_again()

    def check_again(self) -> None:
        """Raise Interrupted if a signal has come, also if that was raised before and went lost in a callback."""
        if self.pending is not None and not self.holding:
            self.raised = True
            raise Interrupted(self.pending)

    def come_again(self, number: int) -> None:
        """Let a signal come again soon, since what it raised was dropped; not if it was raised again meanwhile."""
        self.raised = False
        # Not a threading.Thread, which takes a lock that this thread may hold where it was interrupted.
        _thread.start_new_thread(self._send, (number,))

    def _send(self, number: int) -> None:
        time.sleep(_AGAIN_AFTER)
        if self.raised:
            return
        if hasattr(signal, "pthread_kill"):  # which also ends the main thread's waiting
            signal.pthread_kill(self._thread, number)
        else:
            _thread.interrupt_main(signal.Signals(number))


_watch: _Watch | None = None


def received() -> Interrupted | None:
    """Return the interrupt that has come in this block of `interruptible`, None if there was none.

    What runs in C, an import of NumPy for instance, turns an exception that is raised inside it into another one.
    """
    return None if _watch is None or _watch.pending is None else Interrupted(_watch.pending)


@contextmanager
def interruptible(*, terminate: bool = False) -> Iterator[None]:
    """Raise Interrupted for the first signal in the block and ignore those after it, to the end of the block.

    terminate: not only for Ctrl-C. Signals that the program has a handler of its own for, or ignores, are left alone;
    so are all outside the main thread. A block inside another one changes nothing.
    """
    global _watch
    if _watch is not None or threading.current_thread() is not threading.main_thread():
        yield
        return
    names = [name for name in _ENDING if hasattr(signal, name)] if terminate else []
    numbers = [number for name in names if signal.getsignal(number := getattr(signal, name)) is signal.SIG_DFL]
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        numbers.append(signal.SIGINT)
    watch = _watch = _Watch()
    report = sys.unraisablehook

    def notice(dropped: sys.UnraisableHookArgs) -> None:
        if isinstance(dropped.exc_value, Interrupted):
            watch.come_again(dropped.exc_value.number)
        else:
            report(dropped)

    sys.unraisablehook = notice
    before = {number: signal.signal(number, watch.receive) for number in numbers}
    try:
        yield
    finally:
        _watch = None
        sys.unraisablehook = report
        for number, handler in before.items():
            signal.signal(number, handler)


def _watched() -> _Watch:
    """Return the watch of this thread; outside the main thread and outside of `interruptible` one without signals."""
    return _watch if _watch is not None and threading.current_thread() is threading.main_thread() else _Watch()


@contextmanager
def held() -> Iterator[None]:
    """Let signals wait to the end of the block: it makes or removes what must not be left half-done."""
    watch = _watched()
    watch.holding += 1
    try:
        yield
    finally:
        watch.holding -= 1
        if not watch.stepping:
            watch.check()


def check_interrupt() -> None:
    """Raise Interrupted again, between two parts of long work, if that was raised and went lost."""
    _watched().check_again()


@contextmanager
def deferred_interrupt() -> Iterator[Callable[[], None]]:
    """Hold back the first signal until the yielded function is called, which then raises Interrupted.

    An FMU that runs Python in this process would else catch the exception and report a failed step: the user's
    interrupt would look like an error of the model. A second signal raises at once, for a step that never ends.
    """
    with interruptible():
        watch = _watched()
        watch.stepping += 1
        try:
            yield watch.check_again
        finally:
            watch.stepping -= 1
            watch.check()
