"""Each study in each tool that can run it, always in a process of its own: how far it is from our master."""

from __future__ import annotations

import csv
import json
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterable
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from ndob_fmu.cosim import FmuComponent, System
from ndob_fmu.packages import build_ssp, fmu_with_start_values, write_ssp
from ndob_fmu.support.shipped import shipped_folder
from tests.helpers import fmi_instance
from tests.helpers.clean_process import ENVIRONMENT, run_clean
from tests.helpers.native_host import Native, unpack
from tests.importers.importer_environments import PINNED, python_with
from tests.importers.importer_studies import (
    as_one_block,
    coupled_twice,
    observer_alone,
    plant_alone,
    reference,
    run_again,
    shipped,
    shorter,
)
from tests.importers.importers import Rows, Study

TOLERANCE = 1e-9
HERE = Path(__file__).parent
SPECIAL = "ä # + [ ( , ' x"
PRINTED = 0.5e-6  # by what the six decimals of ecos's file may differ from the number

# Which tools run what; the others do not offer it, or run no more of it here.
PYTHON = ("fmpy", "libcosimpy", "ecospy")
RUNS = {
    "plant": (*PYTHON, "ecos", "C host"),
    "observer, recorded inputs": (*PYTHON, "C host"),
    "open_loop.ssp": ("libcosimpy", "ecospy", "ecos"),
    "open_loop_boundary.ssp": ("fmucontainer",),
    "two plants, two observers": ("libcosimpy", "ecospy", "ecos"),
    "run again": (*PYTHON, "C host"),
    "special folder": (*PYTHON, "ecos", "C host"),
    "state": ("fmpy", "C host"),
}
# What tools with an environment of their own run besides.
RUNS_IN_ENVIRONMENTS = {study: tuple(PINNED) for study in ("plant", "observer, recorded inputs")}


@dataclass
class Bench:
    """The FMUs, the package, the C host, and a folder to work in.

    against: the bench whose FMUs our master runs for comparison; none: its own
    at_most: steps of a run; the table of docs/tools.md is made of whole studies
    """

    plant: Path
    observer: Path
    package: Path
    host: Path
    folder: Path
    against: Bench | None = None
    at_most: int = 3000
    _prepared: dict[str, tuple[Study, Path, Rows]] = field(default_factory=dict)

    def difference(self, tool: str, name: str) -> float:
        """Run the study in the tool and return how far it is from our master."""
        study, folder, own = self._study(name)
        expected = self.against._study(name)[2] if self.against else own
        rows = self._run(tool, name, study, Path(tempfile.mkdtemp(dir=folder)))
        return difference(rows, expected, PRINTED if tool == "ecos" else 0.0)

    def _study(self, name: str) -> tuple[Study, Path, Rows]:
        if name not in self._prepared:
            self._prepared[name] = self._prepare(name)
        return self._prepared[name]

    def _prepare(self, name: str) -> tuple[Study, Path, Rows]:
        if name == "open_loop.ssp":
            study = shorter(shipped(self.package), self.at_most)
            return study, self.folder, reference(study)
        if name == "open_loop_boundary.ssp":
            study = as_one_block(
                build_ssp(shipped_folder("ssp") / "open_loop_boundary", self.plant.parent, self.folder), steps=1000
            )
            return study, self.folder, reference(study)
        if name == "special folder":
            folder = self.folder / SPECIAL
            folder.mkdir()
            plant = Path(shutil.copy(self.plant, folder))
            study = replace(plant_alone(plant, self.observer), steps=500)
            return study, folder, reference(study)
        make = {
            "plant": plant_alone,
            "observer, recorded inputs": observer_alone,
            "two plants, two observers": coupled_twice,
            "run again": run_again,
            "state": partial(observer_alone, steps=200),
        }[name]
        study = shorter(make(self.plant, self.observer), self.at_most)
        return study, self.folder, reference(study)

    def _run(self, tool: str, name: str, study: Study, folder: Path) -> Rows:
        if tool == "C host":
            ((_, path),) = study.instances.items()
            return in_c_host(study, unpack(Path(path), folder / "fmu", self.host), restore=name == "state")
        if tool == "ecos":
            return in_ecos(study, folder)
        if tool in PINNED:
            return in_environment(tool, study, folder)
        return with_states(study) if name == "state" else in_python(tool, study, folder)


def difference(rows: Rows, expected: Rows, rounding: float = 0.0) -> float:
    """Return the largest difference of a signal, in itself or by the signal's size, whichever is more.

    rounding: what the tool's own rounding of numbers may add to it. Infinite if the communication points are others;
    these may round differently.
    """
    if rows.shape != expected.shape or not np.allclose(rows[:, 0], expected[:, 0], rtol=0.0, atol=1e-9):
        return np.inf
    largest = np.abs(expected).max(axis=0)[1:]
    size = np.where(largest > 0.0, np.minimum(1.0, largest), 1.0)
    found = np.abs(rows - expected)[:, 1:].max(axis=0)
    return float((np.maximum(0.0, found - rounding) / size).max())


def in_python(tool: str, study: Study, folder: Path) -> Rows:
    """Return the rows of one of the tools of `importers`, which works in the folder."""
    described, rows = folder / "study.json", folder / "rows.npy"
    described.write_text(json.dumps(asdict(study)), "utf-8")
    program = f"import sys; sys.path.append({str(HERE)!r}); import importers; importers.main(*sys.argv[1:])"
    done = run_clean(program, tool, described, rows, cwd=folder)
    assert done.returncode == 0, done.stdout + done.stderr
    return np.load(rows)


def in_environment(tool: str, study: Study, folder: Path) -> Rows:
    """Return the rows of a tool that has an environment of its own."""
    ((name, path),) = study.instances.items()
    fmu = folder / Path(path).name
    if tool == "gemseo-fmu":  # which sets what it is given also after initialization, where parameters are fixed
        inputs = {v.name for v in FmuComponent(path).variables if v.causality == "input"}
        parameters = {port: v for port, v in study.starts.items() if port.removeprefix(f"{name}.") not in inputs}
        fmu.write_bytes(fmu_with_start_values(path, {p.removeprefix(f"{name}."): v for p, v in parameters.items()}))
        study = replace(study, starts={port: v for port, v in study.starts.items() if port not in parameters})
    else:  # which read every output as a Real
        command = shutil.which("fmutool", path=str(Path(sys.executable).parent))
        options = ["-input", path, "-remove-regexp", "^valid$", "-output", str(fmu)]
        subprocess.run([command, *options], check=True, capture_output=True)
    described, rows = folder / "study.json", folder / "rows.npy"
    described.write_text(json.dumps(asdict(replace(study, instances={name: str(fmu)}))), "utf-8")
    program = [python_with(tool), HERE / "importers.py", tool, described, rows]
    done = subprocess.run(program, cwd=folder, env=ENVIRONMENT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return np.load(rows)


def in_ecos(study: Study, folder: Path) -> Rows:
    """Return the rows of the program `ecos`, started with an empty environment; it prints six decimals."""
    package = Path(study.package) if study.package else _packed(study, folder)
    program = folder / "ecos"
    shutil.copy(Path(find_spec("ecospy").origin).parent / "binaries" / "ecos", program)
    program.chmod(0o755)
    result = folder / f"{package.stem}.csv"
    words = ["simulate", "--path", package, "--stepSize", f"{study.step_size:g}", "--parameterSet", study.parameter_set]
    words += ["--stopTime", f"{study.times[-1] + study.step_size / 2:.9g}", "--logLevel", "warn"]
    done = subprocess.run(
        [program, *words], cwd=folder, env={"TMPDIR": str(folder)}, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    with result.open(encoding="utf-8") as file:
        header, *lines = csv.reader(file, skipinitialspace=True)
    columns = [header.index("time"), *(header.index(f"{c.replace('.', '::', 1)}[REAL]") for c in study.shown)]
    return np.array([[float(line[column]) for column in columns] for line in lines])


def in_c_host(study: Study, native: Native, *, restore: bool = False) -> Rows:
    """Return the rows of the C host, started with an empty environment.

    restore: half way the state is saved, other steps follow, and the run goes on from the state.
    """
    ((name, _),) = study.instances.items()

    def refs(ports: Iterable[str]) -> str:
        return native.references(*(port.removeprefix(f"{name}.") for port in ports))

    def text(values: Iterable[float]) -> str:
        return ",".join(map(repr, map(float, values)))

    begin = ["setup 0", f"setR {refs(study.first)} {text(study.first.values())}", "enter", "exit"]
    read, detour = f"getR {refs(study.shown)}", f"run 10 {study.step_size!r} - {refs(study.shown)}"
    commands = ["new fmu", *begin]
    if study.again:
        commands += [detour, "reset", *begin]
    commands.append(read)
    for k, time in enumerate(study.times[:-1].tolist()):
        if restore and k == study.steps // 2:
            other = f"setR {refs(study.inputs)} {text([9.0] * len(study.inputs))}"
            commands += ["save", other, f"step {time!r} {study.step_size!r}", "restore", "drop"]
        if study.inputs:
            commands.append(f"setR {refs(study.inputs)} {text(values[k] for values in study.inputs.values())}")
        commands += [f"step {time!r} {study.step_size!r}", read]
    done = native.run(*commands, "terminate", "free")
    assert (done.code, done.log) == (0, [])
    assert {reply.rsplit(" ", 1)[-1] for reply in done.replies} == {"OK"}
    rows = [reply.split()[:-2] for reply in done.replies if reply.endswith("getR OK")]
    return np.column_stack([study.times, np.array(rows, dtype=np.float64)])


def with_states(study: Study) -> Rows:
    """Return the rows of fmpy's FMU2Slave where another instance goes on half way, from the serialised state."""
    ((name, path),) = study.instances.items()
    starts = {port.removeprefix(f"{name}."): value for port, value in study.first.items()}
    inputs = {port.removeprefix(f"{name}."): values for port, values in study.inputs.items()}
    with fmi_instance.unpacked(path) as instance:
        now, other = instance("first"), instance("second")
        now.begin(**starts)
        rows = [now.get()]
        for k, time in enumerate(study.times[:-1].tolist()):
            if k == study.steps // 2:
                status, state = other.from_bytes(now.bytes_of(now.state()))
                assert status == other.setFMUState(state) == fmi_instance.OK
                now = other
            rows.append(now.step(time, study.step_size, **{port: values[k] for port, values in inputs.items()}))
    shown = [column.removeprefix(f"{name}.") for column in study.shown]
    return np.column_stack([study.times, [[row[column] for column in shown] for row in rows]])


def _packed(study: Study, folder: Path) -> Path:
    """Write the study as an SSP package."""
    system = System()
    for name, path in study.instances.items():
        values = {p.removeprefix(f"{name}."): value for p, value in study.starts.items() if p.startswith(f"{name}.")}
        system = system.add(name, path, values)
    for source, target in study.connections:
        system = system.connect(source, target)
    return write_ssp(system, folder / "study.ssp", parameter_set=study.parameter_set)
