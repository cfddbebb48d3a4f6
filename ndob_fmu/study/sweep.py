"""Doing the runs of a study in batches on workers. Each batch is kept as soon as it is finished."""

from __future__ import annotations

import sys
import time
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from distributed import CancelledError, Client, Future, TimeoutError, wait  # noqa: A004 # Python 3.10's own is another one

from ndob_fmu.cosim.master.progress_bar import tqdm
from ndob_fmu.errors import NdobError, SimulationError
from ndob_fmu.study.columns import FAILED, REASON, RUN, WALL_TIME
from ndob_fmu.study.lock import locked
from ndob_fmu.study.points import Points
from ndob_fmu.study.store import Store
from ndob_fmu.study.study import Study
from ndob_fmu.study.workers import StudyPlugin, connected, run_batch
from ndob_fmu.support.interrupts import check_interrupt

_BATCH_SECONDS = 0.5  # as much is lost when a worker dies, and a batch costs some milliseconds
_MOST_IN_A_BATCH = 500
_AHEAD = 2  # batches for each thread, so that none waits for the client
_GONE = (OSError, TimeoutError, CancelledError)  # what distributed raises of a connection that is lost
_LOST_AFTER = 30.0  # seconds without any worker


@dataclass(frozen=True)
class Tally:
    """What one call of `sweep` did: runs done and failed in it, seconds for them, and threads of workers."""

    done: int
    failed: int
    seconds: float
    workers: int


def sweep(
    study: Study,
    folder: str | Path,
    *,
    workers: int | None = None,
    scheduler: str | None = None,
    retry_failed: bool = False,
    progress: bool | None = None,
) -> Tally:
    """Do the runs of the study that ``folder`` does not have yet, and return their counts and times.

    workers: processes on this machine; None means one for each core
    scheduler: the address of a running scheduler of dask.distributed instead, whose workers have this package installed
    retry_failed: whether to do failed runs again
    progress: whether to show a bar on stderr with rate and time left; None shows it on terminals only

    A run that fails is a row with its reason. Whatever ends the call, the runs that were finished before are kept, and
    the same call goes on from there. Raises UsageError for a folder that cannot be used or that another call works on,
    and for a scheduler that cannot be reached, SimulationError if the workers are lost.
    """
    with locked(Path(folder)):
        return _sweep(study, Path(folder), workers, scheduler, retry_failed, progress)


def _sweep(
    study: Study, folder: Path, workers: int | None, scheduler: str | None, retry_failed: bool, progress: bool | None
) -> Tally:
    store = Store(folder, study)
    if retry_failed:
        store.forget_failures()
    missing = np.flatnonzero(~store.finished)
    if not len(missing):
        return Tally(0, 0, 0.0, 0)
    with connected(workers, scheduler) as client, _bar(store, progress) as bar:
        plugin = StudyPlugin(study, own=scheduler is None)
        with while_connected(client):
            client.register_plugin(plugin)
        try:
            began = time.perf_counter()
            crew = _Crew(client, plugin.name, study.points)
            for rows in crew.work(missing.tolist()):
                store.save(rows)
                bar.update(len(rows))
                if store.failed.any():
                    bar.set_postfix(failed=int(store.failed.sum()))
            seconds = time.perf_counter() - began
        finally:
            if scheduler is not None:
                with suppress(Exception):  # of a scheduler that is gone
                    client.unregister_worker_plugin(plugin.name)
    return Tally(len(missing), int(store.failed[missing].sum()), seconds, crew.threads)


def _bar(store: Store, progress: bool | None) -> Any:
    shown = sys.stderr.isatty() if progress is None else progress
    return tqdm(
        total=len(store.finished), initial=int(store.finished.sum()), unit="run", disable=not shown, smoothing=0.05
    )


class _Crew:
    """The workers and their batches: a few at a time, whatever the number of runs."""

    def __init__(self, client: Client, plugin: str, points: Points) -> None:
        self._client = client
        self._points = points
        self._plugin = plugin
        self._batches: dict[Future, list[int]] = {}
        self._suspects: list[int] = []
        self.threads = self._count()

    def work(self, runs: Sequence[int]) -> Iterator[list[dict[str, Any]]]:
        """Yield the rows of finished batches until all runs are done."""
        todo, size = deque(runs), 1
        while todo or self._batches:
            while todo and len(self._batches) < _AHEAD * self.threads:
                self._submit([todo.popleft() for _ in range(min(size, len(todo)))])
            for rows in self._finished():
                yield rows
                mean = sum(row[WALL_TIME] for row in rows) / len(rows)
                fair = -(-len(todo) // (_AHEAD * self.threads))  # so that all workers are busy until the last batch
                size = max(1, min(_MOST_IN_A_BATCH, int(_BATCH_SECONDS / max(mean, 1e-6)), fair))
        # A worker died during a batch. Its runs are done one at a time, so that only the one at fault fails.
        for run in self._suspects[:]:
            self._submit([run])
            while self._batches:
                yield from self._finished(alone=True)

    def _submit(self, batch: list[int]) -> None:
        with while_connected(self._client):
            future = self._client.submit(run_batch, self._plugin, batch, pure=False)
        self._batches[future] = batch

    def _finished(self, *, alone: bool = False) -> Iterator[list[dict[str, Any]]]:
        for future in self._wait():
            batch = self._batches.pop(future)
            with while_connected(self._client):
                error = future.exception()
                rows = [] if error else future.result()
            if error is None:
                yield rows
                continue
            if isinstance(error, _GONE):
                raise _lost(str(error))
            if type(error).__name__ != "KilledWorker":
                raise _failed(error) from error
            if alone:
                fate = {FAILED: True, REASON: "the worker's process died in this run, and another one's too"}
                yield [{RUN: batch[0], **self._points[batch[0]], **fate}]
            else:
                self._suspects += batch

    def _wait(self) -> list[Future]:
        patience = time.monotonic() + _LOST_AFTER
        check_interrupt()
        while not (done := self._done_within(1.0)):
            check_interrupt()
            alive = self._count()
            self.threads = alive or self.threads  # workers may have come
            if alive:
                patience = time.monotonic() + _LOST_AFTER
            elif time.monotonic() > patience:
                raise _lost("none left")
        return done

    def _done_within(self, seconds: float) -> list[Future]:
        with while_connected(self._client), suppress(TimeoutError):
            return list(wait(list(self._batches), timeout=seconds, return_when="FIRST_COMPLETED").done)
        return []

    def _count(self) -> int:
        with while_connected(self._client):
            return sum(self._client.nthreads().values())


@contextmanager
def while_connected(client: Client) -> Iterator[None]:
    """Raise SimulationError for what distributed raises where the scheduler is gone; other errors stay as they are.

    A client that has lost its scheduler raises errors of many kinds.
    """
    try:
        yield
    except Exception as error:
        if client.status == "running" and not isinstance(error, _GONE):
            raise
        raise _lost(str(error) or repr(error)) from error


def _failed(error: BaseException) -> NdobError:
    """Return the error for a batch that a worker could not do, where the failure of one run would be a row."""
    return SimulationError.report(
        "sweep",
        expected="workers that can do its runs",
        received=f"{type(error).__name__}: {' '.join(str(error).split())}",
        likely="a worker without ndob-fmu, or with another version of it or of what it needs",
    )


def _lost(received: str) -> NdobError:
    return SimulationError.report(
        "sweep",
        expected="workers that go on to the end",
        received=" ".join(received.split())[:300],
        likely="finished runs are kept; the same command goes on from there",
    )
