"""Native FMUs with AddressSanitizer and UndefinedBehaviorSanitizer in them, under all attacks on FMUs.

python -m tests.attacks.native --calls 100000 --trials 5000 --seed 1
python -m tests.attacks.native --walks-only --calls 100000 --seed 1

The walk of random calls (tests.fuzz), crafted states, odd texts and odd steps, and random calls of FMI 3.0;
--walks-only: the random calls of FMI 2.0 and 3.0 alone. The first error of a sanitizer ends a process, which counts as
a crash. Needs gcc with its sanitizers.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Callable
from pathlib import Path

from ndob_fmu.model.loading import load_model
from ndob_fmu.native.build import build_native, build_native_components

FLAGS = (
    *("-std=c11", "-O1", "-g", "-shared", "-fPIC", "-fvisibility=hidden", "-ffp-contract=off"),
    *("-fsanitize=address,undefined,float-cast-overflow,bounds-strict", "-fno-sanitize-recover=all"),
)


def sanitized(fmu: Path, folder: Path, changed: Callable[[str], str] = str) -> Path:
    """Write the FMU with a binary for linux64 that its own sources give with sanitizers; return the path.

    changed: gives the source to compile, from that of the FMU
    """
    target = folder / fmu.name
    with tempfile.TemporaryDirectory(prefix="ndob_fmu_") as work, zipfile.ZipFile(fmu) as archive:
        archive.extractall(work)
        library = next(Path(work, "binaries").glob(f"*/{fmu.stem}.so"))
        source = Path(work, "sources", f"{fmu.stem}.c")
        source.write_text(changed(source.read_text("utf-8")), "utf-8")
        subprocess.run(["gcc", *FLAGS, source, "-o", library, "-lm"], cwd=work, check=True)
        with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as written:
            for path in sorted(path for path in Path(work).rglob("*") if path.is_file()):
                written.write(path, path.relative_to(work).as_posix())
    return target


def environment() -> dict[str, str]:
    """Return that of a process with the sanitizers, which must be loaded first; Python itself leaks at its end."""
    found = [
        subprocess.run(["gcc", f"-print-file-name={name}"], capture_output=True, text=True, check=True).stdout.strip()
        for name in ("libasan.so", "libubsan.so")
    ]
    return {
        **os.environ,
        "LD_PRELOAD": ":".join(found),
        "ASAN_OPTIONS": "detect_leaks=0:halt_on_error=1:detect_stack_use_after_return=1",
        "UBSAN_OPTIONS": "print_stacktrace=1:halt_on_error=1",
    }


def walk(calls: int, seed: int) -> list[str]:
    """Return the words of the walk of random calls of FMI 2.0, without the folder of FMUs."""
    return ["tests.fuzz", "--calls", str(calls), "--seed", str(seed)]


def attacks(calls: int, trials: int, seed: int) -> list[list[str]]:
    """Return the words of each attack on FMUs of FMI 2.0, as those of the walk."""
    of_trials = ("tests.attacks.native_states", "tests.attacks.texts", "tests.attacks.steps")
    return [walk(calls, seed), *([name, "--trials", str(trials), "--seed", str(seed)] for name in of_trials)]


def attack_of_fmi3(calls: int, seed: int) -> list[str]:
    """Return the words of the attack on FMUs of FMI 3.0."""
    return ["tests.attacks.fmi3", "--calls", str(calls), "--seed", str(seed)]


def attacked(words: list[str], folder: Path) -> int:
    """Run an attack on the FMUs in the folder, and return its exit code."""
    command = [sys.executable, "-m", *words, "--fmus", str(folder)]
    return subprocess.run(command, env=environment(), check=False).returncode


def main() -> int:
    """Run the attacks and return 1 if one of them found something."""
    parser = argparse.ArgumentParser(prog="python -m tests.attacks.native", description=__doc__.splitlines()[0])
    parser.add_argument("--calls", type=int, default=100_000)
    parser.add_argument("--trials", type=int, default=5000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--walks-only", action="store_true", help="only the random calls of FMI 2.0 and 3.0")
    options = parser.parse_args()
    of_fmi2 = attacks(options.calls, options.trials, options.seed)
    if options.walks_only:
        of_fmi2 = [walk(options.calls, options.seed)]
    with tempfile.TemporaryDirectory(prefix="ndob_fmu_") as work:
        joint, found = load_model("flexible_joint"), 0
        for fmi, every in ((2, of_fmi2), (3, [attack_of_fmi3(options.calls, options.seed)])):
            plain, folder = Path(work, f"plain{fmi}"), Path(work, f"sanitized{fmi}")
            folder.mkdir()
            for fmu in (*build_native(joint, plain, fmi=fmi), *build_native_components(plain, fmi=fmi)):
                sanitized(fmu, folder)
            for words in every:
                print("python -m", *words, flush=True)
                found += attacked(words, folder) != 0
    print(f"native FMUs with sanitizers: {found} of the attacks found something")
    return int(found > 0)


if __name__ == "__main__":
    sys.exit(main())
