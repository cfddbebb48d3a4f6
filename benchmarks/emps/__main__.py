"""The measured record of the EMPS drive: fit to it, estimate with made pulses of force, and write the gallery's page.

    python -m benchmarks.emps DATA_EMPS.mat [--out DIR] [--seed N]

The data are not a part of this repository; the page says where they are. The same arguments write the same bytes.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmarks.emps.model import model
from benchmarks.emps.page import FREE, fitted_table, map_table, table, write
from benchmarks.emps.record import LAG, estimates, pulses, read, write_log
from ndob_fmu.log.estimate_log import estimate_log
from ndob_fmu.log.fit.fit_log import fit_log
from ndob_fmu.results.csv_files import read_csv
from ndob_fmu.results.run_files import RESULT


def main(arguments: Sequence[str] | None = None) -> int:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description=str(__doc__).partition("\n")[0], prog="python -m benchmarks.emps")
    parser.add_argument("data", type=Path, help="path of DATA_EMPS.mat")
    parser.add_argument("--out", type=Path, default=Path(__file__).parents[2] / "docs" / "gallery")
    parser.add_argument("--seed", type=int, default=5, help="of the pulses")
    given = parser.parse_args(arguments)
    measured = read(given.data)
    force = pulses(measured.t, given.seed)
    with TemporaryDirectory() as name:
        folder = Path(name)
        write_log(folder / "measured.csv", measured, 0.0 * force)
        write_log(folder / "pulses.csv", measured, force)
        told = {"lag": LAG}
        fitted = fit_log(model, folder / "measured.csv", folder / "fit", free=FREE, start_values=told, native=folder)
        print(fitted_table(fitted), map_table(fitted), sep="\n\n", end="\n\n")
        found = fitted.start_values
        estimate_log(model, folder / "pulses.csv", folder / "out", start_values=found, native=folder)
        made = estimates(read_csv(folder / "out" / RESULT), force)
    print(table(measured.t, made))
    given.out.mkdir(parents=True, exist_ok=True)
    for path in write(given.out, fitted, measured.t, made):
        print(path)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
