"""The time that a native host spends on setting all inputs and reading all outputs of the observer FMU, besides doStep.

    python -m benchmarks.native_calls [--steps N]

The FMU and the C host of the tests are built for it; the host runs with an empty environment. Prints the microseconds
of one step's three calls, setReal, getReal and getBoolean, the least of ten tries, and what part of the limit that is.
Exit code 1 above the limit.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

from ndob_fmu import build, load_model
from ndob_fmu.codegen.compile_model import compile_model
from ndob_fmu.interface.model_variables import observer_variables
from tests.helpers.native_host import compile_host, unpack

LIMIT = 10.0


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.native_calls", description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=int, default=20_000)
    steps = parser.parse_args().steps
    model = load_model("flexible_joint")
    variables = observer_variables(compile_model(model))
    names = {
        kind: [v.name for v in variables if (v.causality, v.type) == kind]
        for kind in (("input", "Real"), ("output", "Real"), ("output", "Boolean"))
    }
    with tempfile.TemporaryDirectory(prefix="ndob_fmu_") as work:
        folder = Path(work)
        native = unpack(build(model, folder)[1], folder / "unpacked", compile_host(folder))
        references = " ".join(native.references(*some) for some in names.values())
        done = native.run("new fmu", "setup 0 10", "enter", "exit", f"cost {steps} {references}")
    cost = float(done.replies[-1].split()[0])
    count = sum(map(len, names.values()))
    print(f"set and get of {count} variables: {cost:.1f} µs, {cost / LIMIT:.2f} of the limit of {LIMIT:g} µs")
    return int(cost > LIMIT)


if __name__ == "__main__":
    sys.exit(main())
