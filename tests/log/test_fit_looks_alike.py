"""A parameter whose effect looks like the disturbance, beside one that another output tells."""

import numpy as np
import pytest

from ndob_fmu.codegen.compile_model import compile_model
from ndob_fmu.log.fit.fit_log import fit_log
from ndob_fmu.model.model import Model

# Hours and kelvins. The sun heats by day, when it is warm outside, too.
HOUSE = Model(
    name="House",
    states=["air", "vapour"],
    inputs=["heater", "fan", "outside"],
    outputs=["air", "vapour"],
    disturbances=["sun"],
    dynamics=lambda x, u, d, p: [
        u.heater + d.sun - (p.cover + p.vent * u.fan) * (x.air - u.outside),
        1.0 - (0.1 + p.vent * u.fan) * x.vapour,
    ],
    parameters={"cover": 0.6, "vent": 1.0},
    noise_std={"air": 0.1, "vapour": 0.02},
    disturbance_bound=20.0,
    x0={"air": 18.0, "vapour": 3.0},
    xhat0_std={"air": 3.0, "vapour": 3.0},
)
EQUATIONS, VENT = compile_model(HOUSE), 0.85


def write_log(path, seed, rows=1440, H=0.05, parts=4):
    """Write a log of three days, in which cover and vent are 15 % off and clouds pass."""
    random, time, h = np.random.default_rng(seed), H * np.arange(rows), H / parts
    day = 2.0 * np.pi * time / 24.0
    clouds = np.clip(1.0 + 0.03 * np.repeat(random.standard_normal(rows // 10), 10), 0.2, 1.5)
    sun, outside = 25.0 * np.maximum(0.0, np.sin(day - 1.9)) * clouds, 6.0 + 6.0 * np.sin(day - 1.9)
    x, lines = np.array([18.0, 3.0]), ["time,heater,fan,outside,air,vapour"]
    for k in range(rows):
        u = [max(0.0, 3.0 * (18.0 - x[0]) + 8.0), float(np.clip(0.15 * (x[0] - 17.5), 0.0, 1.0)), outside[k]]
        y = x + random.standard_normal(2) * [0.1, 0.02]
        lines.append(",".join(map(repr, [float(one) for one in (time[k], *u, *y)])))
        for _ in range(parts):
            slope = EQUATIONS.derivatives(x.tolist(), u, [sun[k]], [0.69, VENT])
            middle = x + 0.5 * h * np.array(slope)
            x = x + h * np.array(EQUATIONS.derivatives(middle.tolist(), u, [sun[k]], [0.69, VENT]))
    path.write_text("\n".join(lines) + "\n")


@pytest.mark.parametrize("seed", range(2))
def test_a_parameter_that_looks_like_the_disturbance_stays_and_does_not_spoil_the_other(tmp_path, seed):
    """The sun is like a cover that lets the warmth of the day in. The vapour tells how much the fan moves."""
    write_log(tmp_path / "log.csv", seed)
    found = fit_log(HOUSE, tmp_path / "log.csv", tmp_path / "out", free=["cover", "vent"], hold=0.0)
    assert list(found.parameters) == ["vent"]
    vent = found.parameters["vent"]
    assert abs(vent.value - VENT) < min(3.0 * vent.std, 0.01)
    assert found.noise_std["vapour"].value == pytest.approx(0.02, rel=0.05)
    said = [line for line in found.warnings if line.startswith("cover: ")]
    assert len(said) == 1
    assert said[0].endswith("the error bars take it for known until cover_std says how far off it may be")
