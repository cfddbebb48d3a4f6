"""Build the plant's and the observer's FMU of a model, and the shipped systems of the built-in ones.

    python build_fmu.py [MODEL ...] [--out DIR]

MODEL is a built-in name or a Python file that defines `model`; the same as `ndob-fmu build`.
"""

import sys

from ndob_fmu.cli import main

if __name__ == "__main__":
    sys.exit(main(["build", *sys.argv[1:]]))
