"""Long runs of native FMUs in the C host: how its memory grows, and how many blocks of memory it asks for in them.

python -m tests.native_soak [--steps N] [--fmus FOLDER]

N steps (10000000) of a plant, an observer and each component, and a tenth of it where a step takes longer: with a
sensor that is off, which needs the covariance in every step, and by method 1. Ends with 1 if a run grows by 100 kB or
more, or asks for memory at all.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

from fmpy import read_model_description

from ndob_fmu.fmu.components import records
from ndob_fmu.model.loading import load_model
from ndob_fmu.native.build import build_native, build_native_components
from tests.helpers.component_settings import moved
from tests.helpers.native_experiments import Experiment
from tests.helpers.played import Loaded, memory_counter, this_machine
from tests.soak import resident

H = 1e-3
WARM_UP = 2000
LIMIT = 100_000
SLOW = {"motor_angle_bias_std", "method"}  # settings with which a step takes longer
NOISE = {"motor_angle_noise_std": 0.1, "link_angle_noise_std": 0.1}
SETTINGS = {
    "FlexibleJointPlant": [{}],
    "FlexibleJointObserver": [
        NOISE,
        {**NOISE, "motor_angle_bias_std": 0.1},
        {"method": 1, "pi_end": 1e4, "pi_ramp_time": 1.0},
    ],
    **{record.name: [moved(record.variables)] for record in records()},
}


def grown(fmu: Loaded, start_values: dict[str, float], steps: int) -> tuple[int, int]:
    """Return by how many bytes the host grows in this many steps, and how many blocks of memory it asks for."""
    variables = read_model_description(str(fmu.folder)).modelVariables
    inputs, outputs = (
        ",".join(str(v.valueReference) for v in variables if v.causality == kind and v.type == "Real") or "-"
        for kind in ("input", "output")
    )
    with subprocess.Popen(
        fmu.command(), stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=dict(fmu.machine.env)
    ) as host:

        def say(words: str) -> str:
            host.stdin.write(words + "\n")
            host.stdin.flush()
            reply = host.stdout.readline()
            assert reply.endswith(" OK\n"), (words, reply)
            return reply

        for words in fmu.begin(Experiment(fmu.folder.name, H, steps, start_values=start_values)):
            say(words)
        say(f"run {WARM_UP} {H} {inputs} {outputs}")
        say("memory")
        before = resident(host.pid)
        say(f"run {steps} {H} {inputs} {outputs}")
        blocks = int(say("memory").split()[0])
        growth = resident(host.pid) - before
        host.stdin.close()
    return growth, blocks


def main() -> int:
    """Print growth and blocks of each run."""
    parser = argparse.ArgumentParser(prog="python -m tests.native_soak", description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=int, default=10_000_000)
    parser.add_argument("--fmus", type=Path, help="folder with the native FMUs; built if it is not given")
    options = parser.parse_args()
    failed = 0
    with tempfile.TemporaryDirectory(prefix="ndob_fmu_") as work:
        folder = Path(work)
        fmus = options.fmus or folder
        if not options.fmus:
            build_native(load_model("flexible_joint"), folder)
            list(build_native_components(folder))
        machine = replace(this_machine(folder), env=memory_counter(folder))
        for name, choices in SETTINGS.items():
            fmu = Loaded.unpacked(machine, fmus / f"{name}.fmu", folder / name)
            for start_values in choices:
                began = time.monotonic()
                steps = options.steps // 10 if SLOW & start_values.keys() else options.steps
                growth, blocks = grown(fmu, start_values, steps)
                passed = time.monotonic() - began
                print(f"{name:24}{steps:9} grown={growth} blocks={blocks} in {passed:.0f} s", flush=True)
                failed += growth >= LIMIT or blocks > 0
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
