"""Run FMUs in fmpy and keep their trajectories: run by a Windows Python under wine, and by Linux's for comparison.

python simulate.py JOBS.json RESULT.npz [RECORDED.npz]

JOBS: name → path of an FMU, or of the folder that it is unpacked in, start values, and where not STEPS how many steps.
RECORDED: a result with trajectories of the plant, which the inputs of those names get.
"""

import json
import sys
from pathlib import Path

import numpy as np
from fmpy import read_model_description, simulate_fmu

STEP, STEPS = 1e-3, 1500


def signals(names, recorded):
    """Inputs of all Real input variables: as recorded, else smooth and all different."""
    t = STEP * np.arange(STEPS + 1)
    smooth = {name: 0.3 * np.sin((2.0 + 0.7 * i) * t + 0.4 * i) for i, name in enumerate(names)}
    columns = [t, *(recorded.get(f"FlexibleJointPlant/{name}", smooth[name]) for name in names)]
    return np.array(list(zip(*columns, strict=True)), dtype=[(name, float) for name in ("time", *names)])


def trajectories(recorded, path, start_values, steps=STEPS):
    """Return name → column of every output."""
    description = read_model_description(path)
    inputs = [v.name for v in description.modelVariables if v.causality == "input" and v.type == "Real"]
    outputs = [v.name for v in description.modelVariables if v.causality == "output"]
    rows = simulate_fmu(
        path,
        stop_time=steps * STEP,
        output_interval=STEP,
        start_values=start_values,
        input=signals(inputs, recorded) if inputs else None,
        output=outputs,
    )
    return {name: rows[name].astype(float) for name in rows.dtype.names}


def main(jobs, result, recorded=None):
    columns = {}
    known = dict(np.load(recorded)) if recorded else {}
    for name, job in json.loads(Path(jobs).read_text("utf-8")).items():
        for variable, column in trajectories(known, *job).items():
            columns[f"{name}/{variable}"] = column
    np.savez(result, **columns)


if __name__ == "__main__":
    main(*sys.argv[1:])
