"""Studies on real workers: a scheduler and two workers over TCP, and the local cluster that a command starts."""

from __future__ import annotations

import asyncio
import importlib
import json
import operator
import os
import re
import resource
import shutil
import subprocess
import sys
import tempfile
import threading
from types import SimpleNamespace

import dask
import psutil
import pyarrow.parquet as pq
import pytest
from distributed import CancelledError, Client, LocalCluster, Security, rpc
from distributed.comm import CommClosedError

from ndob_fmu.cli import main
from ndob_fmu.cosim import simulate
from ndob_fmu.errors import SimulationError, UsageError
from ndob_fmu.study import read_study, sweep, workers
from ndob_fmu.study.store import read_runs
from ndob_fmu.study.summary import as_text, summarize
from tests.helpers.coupling_fmus import coupling_fmus
from tests.helpers.study_files import SLOW, WALK, start, wait_for, workers_of, write

sweeping = importlib.import_module("ndob_fmu.study.sweep")  # the function has the name of its module


@pytest.fixture(scope="session")
def fmus(tmp_path_factory):
    return coupling_fmus(tmp_path_factory.getbasetemp())


@pytest.fixture(scope="module")
def cluster(tmp_path_factory):
    """Start `dask scheduler` and two `dask worker`; yield the scheduler's address and the three processes."""
    folder = tmp_path_factory.mktemp("cluster")
    file = folder / "scheduler.json"
    common = ["--scheduler-file", str(file)]

    def run(command, *words):
        return subprocess.Popen(
            [sys.executable, "-m", f"distributed.cli.dask_{command}", *common, *words],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            cwd=folder,
        )

    processes = [run("scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard")]
    wait_for(file.exists)
    processes += [
        run("worker", "--nthreads", "1", "--no-dashboard", "--local-directory", str(folder)) for _ in range(2)
    ]
    yield json.loads(file.read_text())["address"], processes
    everyone = [child for p in processes for child in psutil.Process(p.pid).children(recursive=True)]
    for process in reversed(processes):
        process.terminate()
        process.wait(20)
    assert psutil.wait_procs(everyone, timeout=20)[1] == []


@pytest.fixture(scope="module")
def walk(fmus, cluster, tmp_path_factory):
    """Do a study on the two workers; return it with its folder and tally."""
    folder = tmp_path_factory.mktemp("walk")
    study = read_study(write(folder, "walk", WALK, fmus))
    return study, folder / "results", sweep(study, folder / "results", scheduler=cluster[0])


def test_every_run_is_a_row_that_is_what_simulate_gives(walk):
    study, folder, tally = walk
    rows = read_runs(folder).to_pylist()
    assert [row["run"] for row in rows] == list(range(24))
    assert (tally.done, tally.failed, tally.workers) == (24, 0, 2)
    for row in rows:
        point = study.points[row["run"]]
        assert {name: row[name] for name in point} == point
        starts = {name: value for name, value in point.items() if name != "step_size"}
        recording = simulate(study.system, stop_time=1.0, step_size=point["step_size"], start_values=starts)
        assert row["end"] == recording["Integrator.y"][-1]
        late = recording.time >= 0.75
        assert row["least"] == min(recording["Integrator.y"][late] - recording["Integrator.half"][late])
        assert row["reason"] is None
        assert row["wall_time"] > 0.0


def test_a_study_takes_its_things_from_the_workers_when_it_is_done(walk, cluster):
    with Client(cluster[0]) as client:
        plugins = client.run(lambda dask_worker: [name for name in dask_worker.plugins if "ndob" in name])
        assert list(plugins.values()) == [[], []]


def test_a_study_goes_on_where_it_was_stopped_and_redoes_nothing(walk, cluster, tmp_path, capsys):
    study, folder, _ = walk
    results = tmp_path / "results"
    (results / "shards").mkdir(parents=True)
    (results / "study.json").write_bytes((folder / "study.json").read_bytes())
    kept = sorted((folder / "shards").iterdir())[::2]
    for shard in kept:
        (results / "shards" / shard.name).write_bytes(shard.read_bytes())
    (results / "shards" / ".runs_00000000_00000001-0123456789ab.parquet").write_bytes(
        b"half a file of a killed command"
    )
    before = set(read_runs(results)["run"].to_pylist())
    capsys.readouterr()
    tally = sweep(study, results, scheduler=cluster[0], progress=True)
    assert tally.done == 24 - len(before)
    last = capsys.readouterr().err.split("\r")[-1]
    assert re.search(r"100%.* 24/24 \[\d\d:\d\d<\d\d:\d\d, .*(run/s|s/run)\]", last), last
    for shard in kept:
        assert (results / "shards" / shard.name).read_bytes() == shard.read_bytes()
    assert [path for path in (results / "shards").iterdir() if not path.name.startswith("runs_")] == []
    columns = ["run", "u", "y", "step_size", "end", "least"]
    assert read_runs(results).select(columns) == read_runs(folder).select(columns)
    assert sweep(study, results, scheduler="tcp://127.0.0.1:1").done == 0  # nobody is asked for nothing


def test_a_folder_with_another_study_is_not_touched(walk, fmus, tmp_path):
    _, folder, _ = walk
    other = read_study(write(tmp_path, "walk", WALK.replace("-3.0", "-4.0"), fmus))
    with pytest.raises(UsageError, match=r"differs in varied; likely cause: .*--out names another folder"):
        sweep(other, folder)


def test_a_full_disk_ends_the_study_in_one_line_and_keeps_what_was_finished(walk, cluster, tmp_path):
    study, folder, _ = walk
    results = tmp_path / "results"
    (results / "shards").mkdir(parents=True)
    (results / "study.json").write_bytes((folder / "study.json").read_bytes())
    first = min((folder / "shards").iterdir())
    (results / "shards" / first.name).write_bytes(first.read_bytes())
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, before[1]))  # no file of this process may become larger
    try:
        with pytest.raises(
            UsageError, match=r"runs_\d+_\d+_\w+\.parquet: expected a file that can be written, received"
        ):
            sweep(study, results, scheduler=cluster[0])
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert [path.name for path in (results / "shards").iterdir()] == [first.name]
    assert read_runs(results).num_rows == pq.read_table(first).num_rows


def test_a_folder_that_cannot_be_written_is_refused_before_anything_runs(walk, tmp_path):
    (tmp_path / "file").write_text("no folder")
    with pytest.raises(UsageError, match=r"file: expected a folder that can be written"):
        sweep(walk[0], tmp_path / "file", scheduler="tcp://127.0.0.1:1")


def test_runs_in_a_damaged_shard_are_done_again_which_is_said_in_one_line(walk, cluster, tmp_path, capsys, caplog):
    study, folder, _ = walk
    results = shutil.copytree(folder, tmp_path / "results")
    shard = min((results / "shards").iterdir())
    runs = pq.read_table(shard).num_rows
    data = bytearray(shard.read_bytes())
    data[len(data) // 2] ^= 4
    shard.write_bytes(data)
    (results / "study.json").unlink()
    with pytest.raises(UsageError, match=r"study\.json: expected a JSON file that can be read"):
        read_runs(results)
    assert sweep(study, results, scheduler=cluster[0]).done == runs
    (line,) = [record.getMessage() for record in caplog.records if record.name.startswith("ndob_fmu")]
    assert re.search(r"results: 1 of \d+ shards are damaged .* in damaged now, and their runs are done again", line)
    assert (results / "damaged" / shard.name).read_bytes() == data
    columns = ["run", "u", "y", "step_size", "end", "least", "failed", "reason"]
    assert read_runs(results).select(columns) == read_runs(folder).select(columns)


def test_a_report_of_damaged_shards_ends_in_one_line(walk, tmp_path, capsys):
    results = shutil.copytree(walk[1], tmp_path / "results")
    shard = min((results / "shards").iterdir())
    shard.write_bytes(shard.read_bytes()[:-100])
    assert main(["report", str(results)]) == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert f"{shard.name}: expected a file whose bytes have the digest in its name" in err
    assert "`ndob-fmu sweep` does its runs again" in err


@pytest.mark.parametrize("text", ["", "[]", "null", "{}", "[" * 100_000, '{"digest": 1' + "0" * 5000 + "}"])
def test_a_plan_that_is_none_ends_a_report_in_one_line_and_a_study_writes_it_anew(walk, tmp_path, capsys, text):
    study, folder, _ = walk
    results = shutil.copytree(folder, tmp_path / "results")
    (results / "study.json").write_text(text)
    assert main(["report", str(results)]) == 2
    err = capsys.readouterr().err
    assert "study.json: expected" in err
    assert err.count("\n") == 1
    assert sweep(study, results, scheduler="tcp://127.0.0.1:1").done == 0
    assert (results / "study.json").read_bytes() == (folder / "study.json").read_bytes()


def test_a_changed_study_is_noticed_where_study_json_is_gone(walk, fmus, tmp_path):
    results = shutil.copytree(walk[1], tmp_path / "results")
    (results / "study.json").unlink()
    before = sorted(results.rglob("*.parquet"))
    other = read_study(write(tmp_path, "walk", WALK.replace("-3.0", "-4.0"), fmus))
    with pytest.raises(UsageError, match=r"received runs of another one, without a valid study\.json"):
        sweep(other, results, scheduler="tcp://127.0.0.1:1")
    assert sorted(results.rglob("*.parquet")) == before


def test_a_second_command_on_a_folder_says_who_holds_it_until_that_one_is_gone(walk, tmp_path):
    study, folder, _ = walk
    results = shutil.copytree(folder, tmp_path / "r")
    program = "import sys; from pathlib import Path; from ndob_fmu.study.lock import locked\n"
    program += "with locked(Path(sys.argv[1])): print('held', flush=True); sys.stdin.read()"
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    with subprocess.Popen([sys.executable, "-c", program, str(results)], **pipes) as holder:
        assert holder.stdout.readline() == b"held\n"
        with pytest.raises(UsageError, match=rf"r: expected .*one in use by process {holder.pid} on .*since 20"):
            sweep(study, results)
        holder.kill()
    assert sweep(study, results).done == 0


def test_an_unreachable_scheduler_is_named(walk, fmus, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(workers, "_PATIENCE", 0.5)
    path = write(tmp_path, "walk", WALK, fmus)
    assert main(["sweep", str(path), "--out", str(tmp_path / "r"), "--scheduler", "tcp://127.0.0.1:1"]) == 2
    err = capsys.readouterr().err
    assert "scheduler tcp://127.0.0.1:1: expected a scheduler of dask.distributed that answers" in err
    assert err.count("\n") == 1


def test_a_scheduler_without_a_worker_is_named(fmus, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(workers, "_FIRST_WORKER", 0.5)
    path = write(tmp_path, "walk", WALK, fmus)
    scheduler = {"dashboard_address": "127.0.0.1:0"}
    with LocalCluster(
        n_workers=0, processes=False, protocol="tcp://", dashboard_address=None, scheduler_kwargs=scheduler
    ) as started:
        words = ["sweep", str(path), "--out", str(tmp_path / "r"), "--scheduler", started.scheduler_address]
        assert main(words) == 1
    assert capsys.readouterr().err.endswith(": expected a worker, received none in 0.5 s\n")


@pytest.fixture(scope="module")
def secured(tmp_path_factory):
    """Start a cluster that speaks TLS; return its address and dask's configuration with a certificate for it."""
    security, folder = Security.temporary(), tmp_path_factory.mktemp("tls")
    files = {
        "ca-file": security.tls_ca_file,
        "client.cert": security.tls_client_cert,
        "client.key": security.tls_client_key,
    }
    for name, text in files.items():
        (folder / name).write_text(text)
    http = {"dashboard_address": "127.0.0.1:0"}
    with LocalCluster(
        processes=False, threads_per_worker=1, security=security, dashboard_address=None, scheduler_kwargs=http
    ) as started:
        yield started.scheduler_address, {f"distributed.comm.tls.{name}": str(folder / name) for name in files}


def test_a_study_runs_on_a_scheduler_that_speaks_tls_by_dasks_configuration(fmus, secured, tmp_path):
    address, configuration = secured
    assert address.startswith("tls://")
    study = read_study(write(tmp_path, "walk", WALK, fmus))
    with dask.config.set(configuration):
        assert sweep(study, tmp_path / "r", scheduler=address).done == 24


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (dict.fromkeys(("ca-file", "client.cert", "client.key")), "for TLS in dask's configuration, received none"),
        ({"ca-file": "absent"}, "No such file"),
        ({"client.key": __file__}, "PEM"),
        ({"ca-file": "other"}, "certificate"),
    ],
)
def test_tls_without_the_right_certificate_ends_in_one_line(walk, secured, tmp_path, capfd, change, words):
    address, configuration = secured
    (tmp_path / "other").write_text(Security.temporary().tls_ca_file)
    changed = {name: str(tmp_path / value) if value else None for name, value in change.items()}
    configuration = {**configuration, **{f"distributed.comm.tls.{name}": path for name, path in changed.items()}}
    with dask.config.set(configuration), pytest.raises(UsageError, match=words):
        sweep(walk[0], tmp_path / "r", scheduler=address)
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize(
    "address", ["foo://host:1", "tcp://", "", "tcp://127.0.0.1:x", "tcp://127.0.0.1:99999", "inproc://x"]
)
def test_an_address_that_is_none_is_refused_in_one_line(walk, tmp_path, capfd, address):
    with pytest.raises(UsageError, match=rf"scheduler {address}: expected a scheduler"):
        sweep(walk[0], tmp_path / "r", scheduler=address)
    assert capfd.readouterr().err == ""


def test_a_fault_inside_distributed_is_not_told_as_a_scheduler_that_does_not_answer(walk, tmp_path, monkeypatch):
    def fail(*_, **__):
        raise TypeError("of the library's own")

    monkeypatch.setattr(workers, "Client", fail)
    with pytest.raises(TypeError, match="of the library's own"):
        sweep(walk[0], tmp_path / "r", scheduler="tcp://127.0.0.1:1")


@pytest.mark.parametrize(
    ("status", "raised", "told"),
    [
        ("running", ZeroDivisionError, ZeroDivisionError),
        ("closed", ZeroDivisionError, SimulationError),  # such errors follow where the scheduler is gone
        ("running", CommClosedError, SimulationError),
        ("running", CancelledError, SimulationError),
    ],
)
def test_an_error_is_told_as_a_lost_scheduler_where_that_is_gone_only(status, raised, told):
    with pytest.raises(told), sweeping.while_connected(SimpleNamespace(status=status)):
        raise raised("words")


def test_what_no_worker_can_do_is_told_with_its_cause(fmus, cluster, tmp_path, monkeypatch):
    study = read_study(write(tmp_path, "walk", WALK, fmus))
    monkeypatch.setattr(sweeping, "run_batch", operator.truediv)
    with pytest.raises(
        SimulationError, match=r"expected workers that can do its runs, received TypeError: unsupported"
    ):
        sweep(study, tmp_path / "r", scheduler=cluster[0])


def test_a_cluster_of_this_machine_is_reached_from_this_machine_only_and_asks_for_a_certificate(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    here = psutil.Process()
    before, others = ports(here), workers_of(here)
    with workers.connected(1, None) as client:
        everyone = [here, *(process for process in workers_of(here) if process not in others)]
        listening = {place for process in everyone for place in ports(process)} - before
        address = client.scheduler.address
        assert len(everyone) >= 2
        assert len(listening) >= 3
        assert {place.ip for place in listening} == {"127.0.0.1"}
        with pytest.raises((OSError, TypeError)):
            connect(address, Security())
    assert list(tmp_path.iterdir()) == []


def ports(process):
    return {c.laddr for c in process.net_connections("inet") if c.status == psutil.CONN_LISTEN}


def connect(address, security):
    async def attempt():
        async with rpc(address, connection_args=security.get_connection_args("client")) as scheduler:
            await scheduler.identity()

    asyncio.run(asyncio.wait_for(attempt(), 5.0))


def test_an_input_file_goes_to_the_workers_and_recorded_signals_come_back(fmus, cluster, tmp_path):
    (tmp_path / "u.csv").write_text("time,u\n0,1\n0.5,-2\n")
    text = WALK.replace("[simulation]", 'record = ["y"]\n[simulation]\nstart_time = 0.0\ninput_file = "u.csv"')
    text = text.replace("u = [1.0, 2.0, -3.0]", "half = [1.0]").replace("half = [1.0]\n", "").replace("0.25]", "0.5]")
    study = read_study(write(tmp_path, "walk", text.split("[measures]")[0], fmus))
    sweep(study, tmp_path / "r", scheduler=cluster[0])
    for row in read_runs(tmp_path / "r", signals=True).to_pylist():
        assert row["time"] == [k * row["step_size"] for k in range(len(row["time"]))]
        expected = [row["y"] + (t if t <= 0.5 else 0.5 - 2 * (t - 0.5)) for t in row["time"]]
        assert row["Integrator.y(t)"] == pytest.approx(expected, rel=1e-12)
    assert "time" not in read_runs(tmp_path / "r").column_names


FAILING = SLOW.split("[fixed]")[0] + '[grid]\nhow = ["", "raise", "discard"]\nfails_at = [0.0, 0.5, 1.0]\nx = [1, 2]\n'


def test_a_failed_run_is_a_row_with_its_reason_and_can_be_done_again(fmus, cluster, tmp_path):
    study = read_study(write(tmp_path, "failing", FAILING.replace("\nx = [1, 2]", ""), fmus))
    tally = sweep(study, tmp_path / "r", scheduler=cluster[0])
    rows = read_runs(tmp_path / "r").to_pylist()
    assert tally.failed == 1
    for row in rows:
        assert row["failed"] == (row["how"] == "raise" and row["fails_at"] == 0.0)
        if row["failed"]:
            assert "the bearing has seized" in row["reason"]
            assert row["Fragile.x"] is None
        else:
            assert row["reason"] is None
            assert row["Fragile.x"] == 0.0
        # An FMU that ends the simulation makes a run that ended early.
        assert row["ended_at"] == (0.0 if row["how"] == "discard" and row["fails_at"] == 0.0 else None)
    summary = summarize(tmp_path / "r", tally)
    assert (summary["failed"], summary["ended_early"]) == (1, 1)
    assert "1 failed, 1 ended early" in as_text(summary)
    again = sweep(study, tmp_path / "r", scheduler=cluster[0], retry_failed=True)
    assert (again.done, again.failed) == (1, 1)
    assert read_runs(tmp_path / "r").num_rows == 9


def test_one_run_that_kills_its_worker_fails_and_takes_no_other_with_it(fmus, tmp_path):
    """On a cluster of this machine's, as by default."""
    text = SLOW.split("[fixed]")[0] + '[grid]\nhow = ["", "crash"]\nfails_at = [2.0, 3.0, 0.0]\n'
    study = read_study(write(tmp_path, "crash", text, fmus))
    before = workers_of(psutil.Process())
    tally = sweep(study, tmp_path / "r", workers=2)
    rows = read_runs(tmp_path / "r").to_pylist()
    assert [row["failed"] for row in rows] == [False] * 5 + [True]
    assert "the worker's process died" in rows[5]["reason"]
    assert (rows[5]["how"], rows[5]["fails_at"]) == ("crash", 0.0)
    assert (tally.done, tally.failed) == (6, 1)
    assert workers_of(psutil.Process()) == before


def test_a_study_survives_kill_9_of_a_worker_and_of_the_command_and_loses_no_finished_run(fmus, tmp_path, monkeypatch):
    temporary = tmp_path / "tmp"
    temporary.mkdir()
    monkeypatch.setenv("TMPDIR", str(temporary))
    path, results = write(tmp_path, "slow", SLOW, fmus), tmp_path / "r"

    def shards(count):
        return lambda: len(found := sorted((results / "shards").glob("runs_*"))) >= count and found

    process = start("sweep", path, "--out", results, "--workers", "2")
    wait_for(shards(2))
    wait_for(lambda: len(workers_of(process)) == 2)  # one may have done both
    crew = workers_of(process)
    crew[0].kill()  # SIGKILL
    seen = {shard: shard.read_bytes() for shard in wait_for(shards(5))}
    wait_for(lambda: len(workers_of(process)) == 2)  # another one has come
    crew = workers_of(process)
    process.kill()
    process.wait()
    process.stdout.close()
    process.stderr.close()
    assert psutil.wait_procs(crew, timeout=10)[1] == []  # the workers go when the command is gone
    finished = set(read_runs(results)["run"].to_pylist())
    assert 5 <= len(finished) < 60

    process = start("sweep", path, "--out", results, "--workers", "2")
    out, err = process.communicate(timeout=120)
    assert (process.returncode, err) == (0, "")
    assert f"60 of 60 runs, 0 failed; {60 - len(finished)} of them now" in out
    assert read_runs(results)["run"].to_pylist() == list(range(60))
    for shard, content in seen.items():
        assert shard.read_bytes() == content
    assert not [p for p in (results / "shards").iterdir() if not p.name.startswith("runs_")]
    assert (results / "heat_map.png").exists() is False  # one parameter makes no map
    assert json.loads((results / "summary.json").read_text("utf-8"))["finished"] == 60


def test_a_script_that_is_its_own_worker_is_told_so_in_one_line(fmus, tmp_path):
    path = write(tmp_path, "walk", WALK, fmus)
    program = f"from ndob_fmu.study import *; sweep(read_study({str(path)!r}), {str(tmp_path / 'r')!r}, workers=1)"
    (tmp_path / "script.py").write_text(program)
    done = subprocess.run([sys.executable, tmp_path / "script.py"], capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert "outside of `if __name__" in done.stderr.splitlines()[-1]


def test_ctrl_c_says_how_to_go_on(fmus, tmp_path):
    path, results = write(tmp_path, "slow", SLOW, fmus), tmp_path / "r"
    process = subprocess.Popen(
        [sys.executable, "-m", "ndob_fmu", "sweep", str(path), "--out", str(results), "--workers", "1"],
        stderr=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    wait_for(lambda: list((results / "shards").glob("runs_*")))
    crew = workers_of(process)
    os.killpg(process.pid, 2)  # as the terminal does: to the command and its workers
    out, err = process.communicate(timeout=30)
    assert process.returncode == 130, err
    assert err.strip() == f"ndob-fmu: interrupted; finished runs are in {results}, the same command goes on"
    assert out == ""
    assert psutil.wait_procs(crew, timeout=10)[1] == []


def test_a_scheduler_that_dies_ends_the_study_in_one_line_and_finished_runs_are_kept(
    fmus, cluster, tmp_path, monkeypatch
):
    """The last test here: it takes the cluster down."""
    monkeypatch.setattr(workers, "_PATIENCE", 3.0)
    address, (scheduler, *_) = cluster
    study = read_study(write(tmp_path, "slow", SLOW, fmus))

    def kill():
        wait_for(lambda: list((tmp_path / "r" / "shards").glob("runs_*")))
        scheduler.kill()

    thread = threading.Thread(target=kill)
    thread.start()
    with pytest.raises(SimulationError, match=r"expected workers that go on to the end.*finished runs are kept"):
        sweep(study, tmp_path / "r", scheduler=address)
    thread.join()
    assert 1 <= read_runs(tmp_path / "r").num_rows < 60
