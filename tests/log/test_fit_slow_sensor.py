"""A disturbance that only a noisy sensor shows, beside one that an exact sensor shows."""

import numpy as np
import pytest

from ndob_fmu.codegen.compile_model import compile_model
from ndob_fmu.log.estimate_log import estimate_log
from ndob_fmu.log.fit.fit_log import fit_log
from tests.helpers.general_plants import TROLLEY

EQUATIONS = compile_model(TROLLEY)


def write_log(path, seed, rows=1900, H=0.02, parts=2):
    """Write a log in which the rail changes smoothly, and the wind wanders; return the wind (K,)."""
    random, time, h = np.random.default_rng(seed), H * np.arange(rows), H / parts
    rail, wind = 0.5 * np.sin(3.0 * time + seed), np.zeros(rows)
    for k in range(1, rows):
        wind[k] = wind[k - 1] * (1.0 - 0.3 * H) + 0.25 * np.sqrt(0.6 * H) * random.standard_normal()
    force, x, lines = np.sign(np.sin(time)), np.zeros(3), ["time,force,speed,sway"]
    for k in range(rows):
        y = x[:2] + random.standard_normal(2) * [1e-3, 0.1]
        lines.append(",".join(map(repr, [float(one) for one in (time[k], force[k], *y)])))
        for _ in range(parts):
            d = [rail[k], wind[k]]
            middle = x + 0.5 * h * np.array(EQUATIONS.derivatives(x.tolist(), [force[k]], d, []))
            x = x + h * np.array(EQUATIONS.derivatives(middle.tolist(), [force[k]], d, []))
    path.write_text("\n".join(lines) + "\n")
    return wind


@pytest.mark.parametrize("seed", [1, 2])
def test_its_error_bar_holds_after_a_fit(tmp_path, seed):
    """Within 3 s such a wind is nearly a line, of any pace. With pieces of the log so short, it stood still."""
    wind = write_log(tmp_path / "log.csv", seed)
    found = fit_log(TROLLEY, tmp_path / "log.csv", tmp_path / "fit")
    assert found.intensity["wind"].std < found.intensity["wind"].value
    estimate_log(TROLLEY, tmp_path / "log.csv", tmp_path / "out", start_values=found.start_values)
    said = np.genfromtxt(tmp_path / "out" / "result.csv", delimiter=",", names=True, deletechars="")
    error = said["observer.wind_at_sample"][1:] - wind[:-1]
    assert np.mean(np.abs(error) < 2.0 * said["observer.wind_std"][1:]) > 0.8
