"""Build the plant's and the observer's FMU of a model, or all shipped FMUs and systems.

    python build_fmu.py MODEL [--out DIR]
    python build_fmu.py

MODEL is a built-in name or a Python file that defines `model`. The arguments are those of `ndob-fmu build`. Without
arguments, all FMUs of the paper's example are built into build/fmus, and the systems of ssp/ into build/ssp.
"""

import sys

from ndob_fmu.cli import main

if __name__ == "__main__":
    shipped = ["flexible_joint", "--out", "build/fmus", "--systems", "build/ssp"]
    sys.exit(main(["build", *(sys.argv[1:] or shipped)]))
