"""(i) The cost of a cycle of native observers in a C host, beside a C FMU that does nothing and the Python FMUs."""

from __future__ import annotations

import os
import shlex
import subprocess
from dataclasses import dataclass, replace
from pathlib import Path

import fmpy
import numpy as np

from benchmarks.cycle import samples_of
from benchmarks.figures import Section, Time, compared
from ndob_fmu import build, load_model
from ndob_fmu.native.build import build_native
from ndob_fmu.native.sources import HEADERS

HERE = Path(__file__).parent / "native"
WARM_UP, COUNT, ROUNDS, INSTANCES = 500, 100, 40, 1000
IDLE, NATIVE, PYTHON = "C FMU that does nothing", "native observer", "Python observer"
CONVERGED, RUNNING = "converged gain", "covariance running"


@dataclass(frozen=True)
class Host:
    """The compiled C host with a file of samples, `inputs` numbers before each step."""

    program: Path
    samples: Path
    inputs: int

    def run(self, what: str, numbers: list[int], fmus: list[str]) -> list[list[float]]:
        """Return the numbers that the host prints, row by row."""
        command = [self.program, what, self.samples, str(self.inputs), *map(str, numbers), *fmus]
        done = subprocess.run(command, check=True, capture_output=True, text=True, timeout=600)
        return [[float(number) for number in line.split()] for line in done.stdout.splitlines()]


def compiled(source: str, folder: Path, *flags: str) -> Path:
    """Compile a C file of this benchmark."""
    target = folder / Path(source).stem
    compiler = shlex.split(os.environ.get("CC", "cc"))
    subprocess.run([*compiler, "-O2", *flags, "-I", HEADERS, HERE / source, "-o", target, "-ldl"], check=True)
    return target


def given(fmu: Path) -> str:
    """Return an FMU as the host takes it."""
    description, folder = fmpy.read_model_description(fmu), Path(fmpy.extract(fmu))
    library = next((folder / "binaries/linux64").glob(f"{description.coSimulation.modelIdentifier}.so"))
    outputs = [v.valueReference for v in description.modelVariables if (v.causality, v.type) == ("output", "Real")]
    return "|".join([str(library), description.guid, (folder / "resources").as_uri(), ",".join(map(str, outputs))])


def test_native(benchmark, section, tmp_path):
    joint = load_model("flexible_joint")
    # Of a state with noise no constant gain is right everywhere, so that the covariance goes on.
    models = {CONVERGED: joint, RUNNING: replace(joint, state_noise={"link_rate": 1e-6})}
    rows = np.array(samples_of(joint, WARM_UP + COUNT * ROUNDS))
    rows.tofile(tmp_path / "samples")
    host = Host(compiled("host.c", tmp_path), tmp_path / "samples", rows.shape[1])
    fmus = {f"{NATIVE}, {how}": given(build_native(m, tmp_path / how)[1]) for how, m in models.items()}
    *_, outputs = fmus[f"{NATIVE}, {CONVERGED}"].split("|")
    fmus |= {f"{PYTHON}, {how}": given(build(m, tmp_path / f"{how}, Python")[1]) for how, m in models.items()}
    fmus[IDLE] = f"{compiled('idle.c', tmp_path, '-shared', '-fPIC')}|||{outputs}"
    found = benchmark.pedantic(host.run, args=("cycles", [WARM_UP, COUNT, ROUNDS], list(fmus.values())), rounds=1)
    times = dict(zip(fmus, np.array(found).T / COUNT, strict=True))
    pairs = {how: (times[f"{NATIVE}, {how}"], times[f"{PYTHON}, {how}"]) for how in models}
    three = build_native(joint, tmp_path / "three", platforms=["linux64", "win64", "aarch64-linux"])[1]
    starts, (memory,) = host.run("instances", [INSTANCES], [fmus[f"{NATIVE}, {CONVERGED}"]])
    section(
        Section(
            rank=1,
            title="Native observers in a C host: n = 4, r = 2",
            text=(
                "One cycle is fmi2SetReal of all inputs, fmi2DoStep and fmi2GetReal of all Real outputs, called from C."
                " All FMUs have the same samples of the flexible joint at 1 ms, and take turns in one process,"
                f" {COUNT} cycles each, {ROUNDS} times. With the default settings the gain has converged; noise on a"
                " state (state_noise) keeps the covariance running. An instance is instantiated, initialized, and takes"
                " its first step, in which the first one is tuned; the others take that over."
                f" {INSTANCES} instances at once take"
                f" {memory / INSTANCES / 1000:.0f} kB of memory each, and {sum(starts):.1f} s together. The FMU with"
                f" binaries for linux64, win64 and aarch64-linux, and with its sources, has"
                f" {three.stat().st_size / 1000:.0f} kB."
            ),
            ratios=(
                *(compared(who, IDLE, times[who], times[IDLE]) for who in times if who.startswith(NATIVE)),
                *(compared(f"{NATIVE}, {how}", f"{PYTHON}, {how}", *pair) for how, pair in pairs.items()),
            ),
            times=(
                *(Time(f"{who}, a cycle", float(np.median(t))) for who, t in times.items()),
                Time("native observer, the first instance up to its first step", starts[0]),
                Time("native observer, each of the others", float(np.median(starts[1:]))),
            ),
        )
    )
