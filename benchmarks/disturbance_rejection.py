"""How much compensation of the estimate reduces the motion in the closed loops of ssp/.

`python -m benchmarks.disturbance_rejection` builds FMUs and systems in a temporary folder, runs each system with
compensation off and on, and writes the table of docs/systems.md.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

from ndob_fmu import build, load_model, simulate
from ndob_fmu.fmu.components import build_components
from ndob_fmu.fmu.controller import build_controller
from ndob_fmu.packages import build_ssp
from ndob_fmu.support.files import atomic_path
from ndob_fmu.support.shipped import shipped_folder

PAGE = Path(__file__).resolve().parents[1] / "docs" / "systems.md"
BEGIN, END = "<!-- written by benchmarks/disturbance_rejection.py: begin -->\n", "<!-- end -->\n"
CASES = (
    ("disturbance_rejection", None, "exact model, no encoder"),
    ("disturbance_rejection", "heavy_arm", "γ = 50, known to observer and controller"),
    ("disturbance_rejection", "detuned", "stiffness 20 % too large in observer and controller"),
    ("noisy_encoder", None, "encoders of 12 bits with noise of 5e-4 rad"),
    ("noisy_encoder", "detuned", "these encoders and that stiffness"),
)
BEGINS = 1.0  # s, where step and sine begin


def main() -> None:
    lines = [
        "| System | | RMS without, rad | RMS with, rad | Factor | Error of the estimate, N·m | Not valid |",
        "|---|---|---|---|---|---|---|",
    ]
    with tempfile.TemporaryDirectory(prefix="ndob_fmu_") as work:
        folder, model = Path(work), load_model("flexible_joint")
        build(model, folder)
        build_controller(model, folder)
        build_components(folder)
        for name, parameter_set, text in CASES:
            package = build_ssp(shipped_folder("ssp") / name, folder, folder, parameter_set=parameter_set)
            off, on = (simulate(package, start_values={"controller.compensation": c}) for c in (False, True))
            after = on.time >= BEGINS
            without, with_ = (_rms(run["plant.link_angle"][after]) for run in (off, on))
            error = _rms((on["observer.load_torque_hat"] - on["plant.load_torque_total"])[after])
            lost = 1.0 - np.mean(on["observer.valid"][after])
            cells = (f"`{package.stem}`", text, f"{without:.1e}", f"{with_:.1e}", f"{without / with_:.0f}")
            lines.append(f"| {' | '.join((*cells, f'{error:.2g}', f'{lost:.0%}'))} |")
            print(lines[-1])
    before, _, rest = PAGE.read_text("utf-8").partition(BEGIN)
    with atomic_path(PAGE) as temporary:
        temporary.write_text(before + BEGIN + "\n".join(lines) + "\n" + END + rest.partition(END)[2], "utf-8")


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


if __name__ == "__main__":
    main()
