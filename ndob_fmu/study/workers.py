"""The code that runs on the workers of dask.distributed, and the connection to them."""

from __future__ import annotations

import logging
import multiprocessing
import os
import signal
import threading
import uuid
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from multiprocessing import resource_tracker
from pathlib import Path
from typing import Any

import dask
from distributed import Client, LocalCluster, Security, TimeoutError, Worker, WorkerPlugin, get_worker  # noqa: A004 # 3.10's differs
from distributed.comm.addressing import get_address_host_port

from ndob_fmu.errors import NdobError, SimulationError, UsageError
from ndob_fmu.study.session import Session
from ndob_fmu.study.study import Study
from ndob_fmu.support.interrupts import held
from ndob_fmu.support.temporary import make_folder, remove_folder, temporary_folder

_SCHEDULER = "a scheduler of dask.distributed that answers, as tcp://HOST:PORT or tls://HOST:PORT"
_LARGEST_PORT = 65535
_PATIENCE = 10.0  # s, for a scheduler to answer
# A worker is often started with its scheduler, and on a busy machine loads its libraries for half a minute.
_FIRST_WORKER = 60.0  # s
_CONFIGURATION = {
    "distributed.comm.timeouts.connect": "5s",
    # A run that ends its worker is tried on one more before it counts as failed.
    "distributed.scheduler.allowed-failures": 1,
}


class StudyPlugin(WorkerPlugin):  # type: ignore[misc] # distributed counts as untyped: pyproject.toml
    """Brings a study to every worker, present and future, and keeps its sessions between batches there."""

    def __init__(self, study: Study, *, own: bool) -> None:
        """Take the study; own: the workers are of this command's making."""
        self.name = f"ndob-fmu-{uuid.uuid4().hex}"  # two commands may share a scheduler
        self._study = study
        self._own = own

    def setup(self, worker: Worker) -> None:
        """Write the study's files into a folder of this worker."""
        if self._own and threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the command, which then ends its workers
        self._log = logging.getLogger("ndob_fmu.cosim")
        self._level = self._log.level
        self._log.setLevel(logging.ERROR)  # its warnings were logged when the study was read
        self._folder = make_folder()
        self._files: dict[str, Path] = {}
        for index, (name, content) in enumerate(self._study.files.items()):
            path = self._folder / str(index) / Path(name).name
            path.parent.mkdir()
            path.write_bytes(content)
            self._files[name] = path
        self._idle: list[Session] = []

    def teardown(self, worker: Worker) -> None:
        """Free the FMUs, and let warnings be logged again."""
        while self._idle:
            self._idle.pop().close()
        remove_folder(self._folder)
        self._log.setLevel(self._level)

    def run(self, runs: Sequence[int]) -> list[dict[str, Any]]:
        """Return a row for each run, made in a session that no other thread of the worker uses meanwhile."""
        session = self._idle.pop() if self._idle else Session(self._study, self._files)
        try:
            return [session.run(run) for run in runs]
        finally:
            self._idle.append(session)


def run_batch(plugin: str, runs: Sequence[int]) -> list[dict[str, Any]]:
    """Do some runs on the worker that this is called on."""
    found: StudyPlugin = get_worker().plugins[plugin]
    return found.run(runs)


@contextmanager
def connected(workers: int | None, scheduler: str | None) -> Iterator[Client]:
    """Give a client of the scheduler at an address, or of a new cluster of processes on this machine.

    Raises UsageError if no scheduler answers there, SimulationError if it has no worker.
    """
    with dask.config.set(_CONFIGURATION), _quiet():
        if scheduler is not None:
            with _remote(scheduler) as client:
                yield client
            return
        # Workers that are killed leave their files behind; these go with the folder.
        with temporary_folder() as folder, _processes_ended(), ExitStack() as stack:
            stack.enter_context(dask.config.set({"temporary-directory": str(folder)}))  # of the scheduler
            yield _local(workers or os.cpu_count() or 1, str(folder), stack)


def _local(workers: int, folder: str, stack: ExitStack) -> Client:
    try:
        with held(), _without_ctrl_c():
            cluster = LocalCluster(
                n_workers=workers,
                threads_per_worker=1,
                processes=True,
                host="127.0.0.1",
                dashboard_address=None,
                worker_dashboard_address="127.0.0.1:0",
                scheduler_kwargs={"dashboard_address": "127.0.0.1:0"},  # of its HTTP server, which goes without it too
                # Other accounts of this machine reach these ports, and could have their code run.
                security=Security.temporary(),
                local_directory=folder,
                env={"TMPDIR": folder},
                silence_logs=logging.CRITICAL,
            )
            return stack.enter_context(Client(stack.enter_context(cluster)))
    except (OSError, RuntimeError, TimeoutError) as error:
        raise SimulationError.report(
            "workers",
            expected=f"{workers} processes that start on this machine",
            received=" ".join(str(error).split())[:200],
            likely='too little memory, or a script that calls sweep outside of `if __name__ == "__main__":`',
        ) from error


@contextmanager
def _without_ctrl_c() -> Iterator[None]:
    """Start threads and processes that Ctrl-C does not reach: a terminal sends it to all, but it is for the command."""
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    resource_tracker.ensure_running()  # its start would unblock the signal
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def _processes_ended() -> Iterator[None]:
    """End the processes that were started in the block and outlive it, as those of a cluster that did not come up."""
    before = multiprocessing.active_children()
    try:
        yield
    finally:
        for process in multiprocessing.active_children():
            if process not in before:
                process.kill()
                process.join(_PATIENCE)


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep distributed's diary off the terminal; what matters of it comes back as an error or a row."""
    names = ("distributed", "distributed.client", "tornado.application", "asyncio")  # each with a level of its own
    loggers = [logging.getLogger(name) for name in names]
    before = [logger.level for logger in loggers]
    try:
        for logger in loggers:
            logger.setLevel(logging.CRITICAL + 1)
        yield
    finally:
        for logger, level in zip(loggers, before, strict=True):
            logger.setLevel(level)


def _security(address: str) -> Security:
    """Return the keys and certificates of dask's configuration; raise UsageError where tls:// has none that work."""
    found = Security()
    if address.startswith("tls://"):
        try:
            context = found.get_connection_args("client").get("ssl_context")
        except (OSError, ValueError) as error:  # of ssl, which is an OSError, and of its files
            raise _no_tls(address, str(error)) from error
        if context is None:
            raise _no_tls(address, "none")
    return found


def _no_tls(address: str, received: str) -> NdobError:
    return UsageError.report(
        f"scheduler {address}",
        expected="certificate and key for TLS in dask's configuration",
        received=received,
        likely="distributed.comm.tls.ca-file, .client.cert or .client.key is missing or wrong: docs/studies.md",
    )


def _require_address(address: str) -> None:
    try:
        _, port = get_address_host_port(address)
    except (ValueError, ImportError) as error:  # ImportError: of a scheme whose library is not installed
        raise _no_address(address, str(error).partition("\n")[0]) from error
    if not 0 < port <= _LARGEST_PORT:
        raise _no_address(address, f"the port {port}")


def _no_address(address: str, received: str) -> NdobError:
    likely = f"the address is incomplete, or its port is not a number from 1 to {_LARGEST_PORT}"
    return UsageError.report(f"scheduler {address}", expected=_SCHEDULER, received=received, likely=likely)


@contextmanager
def _remote(address: str) -> Iterator[Client]:
    _require_address(address)
    security = _security(address)
    try:
        client = Client(address, timeout=_PATIENCE, security=security)
    except (OSError, TimeoutError) as error:
        raise UsageError.report(
            f"scheduler {address}",
            expected=_SCHEDULER,
            received=str(error).partition("\n")[0] or "no answer",
            likely="`dask scheduler` does not run there, speaks the other protocol, or a firewall is in between",
        ) from error
    with client:
        try:
            client.wait_for_workers(1, timeout=_FIRST_WORKER)
        except TimeoutError as error:
            raise SimulationError.report(
                f"scheduler {address}", expected="a worker", received=f"none in {_FIRST_WORKER:g} s"
            ) from error
        yield client
