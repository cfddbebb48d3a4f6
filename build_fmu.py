"""Build the plant's and the observer's FMU of a model, or all shipped FMUs and systems.

    python build_fmu.py MODEL [--out DIR]
    python build_fmu.py [--target native]

MODEL is a built-in name or a Python file that defines `model`. The arguments are those of `ndob-fmu build`. Without
arguments, all FMUs of the paper's example are built into build/fmus, and the systems of ssp/ into build/ssp. With
`--target native` as the first, these are native FMUs, in build/native/fmus and build/native/ssp.
"""

import sys

from ndob_fmu.cli import main

if __name__ == "__main__":
    given = sys.argv[1:]
    native = given[:2] == ["--target", "native"]
    folder = "build/native" if native else "build"
    shipped = ["flexible_joint", "--out", f"{folder}/fmus", "--systems", f"{folder}/ssp"]
    sys.exit(main(["build", *(shipped if native or not given else []), *given]))
