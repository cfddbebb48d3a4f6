"""Run the reference experiments with `fmpy simulate` and compare them with the references in tolerance tubes.

    python fmus/tools/regression.py [FOLDER]

FOLDER, by default build/fmus, holds the FMUs. An experiment is a file `<Name>_ref.opt` or `<Name>_paper_ref.opt` in
fmus/<Name>/: how to run the FMU `<Name>`, with the inputs in `…_in.csv` if there is one, and how wide the tube around
`…_ref.csv` is. Exit code 1 if a signal leaves its tube. Needs fmpy and pyfunnel, not the package that built the FMUs.

The tube is as wide as RelTol times the span of the signal (its magnitude, where it is constant), to both sides; that of
`consistency` is ten times as wide. Times are not given any tolerance, for the communication points are those of the
reference.
"""

from __future__ import annotations

import csv
import shlex
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pyfunnel import compareAndReport

Array = NDArray[np.float64]

REFERENCES = Path(__file__).resolve().parents[1]
# The paper's experiments are run by the paper's method; the observer's start value is the other one.
START_VALUES = {"FlexibleJointObserver_paper": ("method", "1")}
# The samples of the references have no noise, so that the residuals are errors of rounding, which differ from processor
# to processor. `consistency` has their squares: on two processors it differed by 1.2 tubes of RelTol alone.
WIDER = {"consistency": 10.0}


@dataclass(frozen=True)
class ReferenceExperiment:
    """One run of an FMU and its reference; `stem` is what the names of its files begin with."""

    stem: str
    folder: Path

    @property
    def fmu(self) -> str:
        """The name of the FMU, which is also that of the folder."""
        return self.folder.name

    @property
    def options(self) -> dict[str, float]:
        """What the .opt file says."""
        with (self.folder / f"{self.stem}_ref.opt").open(encoding="utf-8") as file:
            return {name: float(value) for name, value in csv.reader(file)}

    @property
    def reference(self) -> dict[str, Array]:
        """The reference's columns by name, `time` among them."""
        return read_columns(self.folder / f"{self.stem}_ref.csv")

    def command(self, fmus: Path, result: Path) -> list[str]:
        """Return the command line; fmpy calls a co-simulation's communication step the output interval."""
        options, inputs = self.options, self.folder / f"{self.stem}_in.csv"
        words = ["fmpy", "simulate", str(fmus / f"{self.fmu}.fmu")]
        words += ["--start-time", f"{options['StartTime']:g}", "--stop-time", f"{options['StopTime']:g}"]
        words += ["--output-interval", f"{options['StepSize']:g}", "--output-file", str(result)]
        if inputs.exists():
            words += ["--input-file", str(inputs)]
        if self.stem in START_VALUES:
            words += ["--start-values", *START_VALUES[self.stem]]
        return words


def experiments() -> list[ReferenceExperiment]:
    """Return all experiments of fmus/."""
    paths = sorted(REFERENCES.glob("*/*_ref.opt"))
    return [ReferenceExperiment(path.name.removesuffix("_ref.opt"), path.parent) for path in paths]


def read_columns(path: Path) -> dict[str, Array]:
    """Return a CSV file's columns by name; fmpy writes Booleans as words, which it cannot read itself."""
    with path.open(encoding="utf-8", newline="") as file:
        names, *rows = csv.reader(file)
    words = {"True": 1.0, "False": 0.0}
    table = np.array([[words[cell] if cell in words else float(cell) for cell in row] for row in rows])
    return dict(zip(names, table.T, strict=True))


def excess(reference: dict[str, Array], result: dict[str, Array], tolerance: float) -> dict[str, float]:
    """Return by how much each signal of the reference leaves its tube, in widths of the tube; 0 inside.

    It is infinite where the result lacks the signal, a communication point of the reference, or finite values.
    """
    times = reference["time"]
    at = np.minimum(np.searchsorted(result["time"], times - 1e-9), len(result["time"]) - 1)
    complete = bool((np.abs(result["time"][at] - times) < 1e-9).all())
    found = {}
    for name in [name for name in reference if name != "time"]:
        expected, got = reference[name], result[name][at] if name in result else np.array([np.nan])
        if not (complete and np.isfinite(got).all()):
            found[name] = np.inf
            continue
        span = float(np.ptp(expected) or np.abs(expected).max() or 1.0)
        width = WIDER.get(name, 1.0) * tolerance * span
        with tempfile.TemporaryDirectory(prefix="funnel_") as folder:
            if compareAndReport(times, expected, times, got, outputDirectory=folder, atoly=width) != 0:
                raise RuntimeError(f"pyfunnel cannot compare {name}")
            outside = read_columns(Path(folder, "errors.csv"))["y"]
        found[name] = float(np.abs(outside).max()) / width
    return found


def run(experiment: ReferenceExperiment, fmus: Path) -> dict[str, float]:
    """Simulate and return by how much each signal leaves its tube. Raises RuntimeError, as fmpy says, if it fails."""
    with tempfile.TemporaryDirectory(prefix="regression_") as folder:
        words = experiment.command(fmus, Path(folder, "result.csv"))
        print(shlex.join(words), flush=True)
        done = subprocess.run([sys.executable, "-m", *words], capture_output=True, text=True, check=False)
        if done.returncode != 0:
            raise RuntimeError(f"fmpy ended with {done.returncode}: {done.stderr.strip() or done.stdout.strip()}")
        result = read_columns(Path(folder, "result.csv"))
    return excess(experiment.reference, result, experiment.options["RelTol"])


def main(fmus: Path) -> int:
    """Run all experiments, print one line for each signal, and return the exit code."""
    worst = 0.0
    for experiment in experiments():
        try:
            found = run(experiment, fmus)
        except RuntimeError as error:
            print(f"    FAILED: {error}")
            worst = np.inf
            continue
        for name, widths in found.items():
            verdict = "inside the tube" if widths == 0 else f"OUTSIDE the tube by {widths:.3g} times its width"
            print(f"    {name:24} {verdict}")
        worst = max(worst, *found.values())
    return 1 if worst > 0 else 0


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1] if len(sys.argv) > 1 else "build/fmus")))
