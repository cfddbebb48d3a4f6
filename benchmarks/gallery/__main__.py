"""The gallery of plants: a page and a picture of each, measured through the observer FMU's code.

    python -m benchmarks.gallery [--out DIR] [--seed N] [--only NAME …]

The same arguments write the same bytes.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from benchmarks.gallery.exhibits import EXHIBITS, exhibits
from benchmarks.gallery.page import write, write_index


def main(arguments: Sequence[str] | None = None) -> int:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description=str(__doc__).partition("\n")[0], prog="python -m benchmarks.gallery")
    parser.add_argument("--out", type=Path, default=Path(__file__).parents[2] / "docs" / "gallery")
    parser.add_argument("--seed", type=int, default=1, help="of the noise and of the true parameters")
    parser.add_argument("--only", nargs="+", choices=sorted(EXHIBITS), help="only these plants, without the index")
    given = parser.parse_args(arguments)
    given.out.mkdir(parents=True, exist_ok=True)
    for plant, exhibit in exhibits():
        if given.only is None or plant.name in given.only:
            for path in write(given.out, plant, exhibit, given.seed):
                print(path)
    if given.only is None:
        print(write_index(given.out, exhibits()))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
