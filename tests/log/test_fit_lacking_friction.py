"""A disturbance that jumps, on a machine whose friction the model lacks a part of."""

from dataclasses import replace

import numpy as np
import pytest
import sympy

from ndob_fmu.log.estimate_log import estimate_log
from ndob_fmu.log.fit.fit_log import fit_log
from ndob_fmu.model.model import Model
from ndob_fmu.results.csv_files import read_csv
from ndob_fmu.results.run_files import RESULT

SLIDE = Model(
    name="Slide",
    states=["place", "speed"],
    inputs=["drive"],
    outputs=["place"],
    disturbances=["load"],
    dynamics=lambda x, u, d, p: [x.speed, (u.drive - p.damper * x.speed + d.load) / p.mass],
    parameters={"mass": 20.0, "damper": 50.0},
    noise_std={"place": 1e-6},
    disturbance_bound=100.0,
    x0=[0.0, 0.0],
)
H, PITCH = 2e-3, 0.05


def write_log(path, seed, rows=2500, parts=4):
    """Write a log whose load is 0 or ± 60 N, and return the load (K,). A spindle adds a ripple of 2 N and harmonics."""
    random, x, load, lines = np.random.default_rng(seed), np.zeros(2), np.zeros(rows), ["time,drive,place"]
    edge, level = 200, 0.0
    for k in range(rows):
        if k == edge:
            level = random.choice([one for one in (-60.0, 0.0, 60.0) if one != level])
            edge = k + random.integers(120, 500)
        load[k], drive = level, 40.0 * np.sin(2.0 * H * k) - level
        lines.append(f"{H * k!r},{float(drive)!r},{float(x[0] + 1e-6 * random.standard_normal())!r}")
        for _ in range(parts):
            turn = 2.0 * np.pi * x[0] / PITCH
            ripple = 1.5 * np.sin(turn) + 0.8 * np.sin(3.0 * turn + 1.0)
            x = x + H / parts * np.array([x[1], (drive - 50.0 * x[1] + level + ripple) / 20.0])
    path.write_text("\n".join(lines) + "\n")
    return load


def test_later_estimates_hold_the_ripple_that_the_model_lacks_too(tmp_path):
    """The load is what acts from outside; the ripple is found with it, and is an error of the model."""
    load = write_log(tmp_path / "log.csv", seed=2)
    found = fit_log(SLIDE, tmp_path / "log.csv", tmp_path / "fit", start_values={"lag": 0.04})
    assert found.is_jumping
    estimate_log(SLIDE, tmp_path / "log.csv", tmp_path / "out", start_values=found.start_values)
    said, late = read_csv(tmp_path / "out" / RESULT), 21
    lagged = said["observer.load_lagged"][late:] - load[:-late]
    smoothed = said["smoother.load"] - load
    held = {
        "lagged": np.mean(np.abs(lagged) <= 2.0 * said["observer.load_lagged_std"][late:]),
        "smoothed": np.mean(np.abs(smoothed) <= 2.0 * said["smoother.load_std"]),
    }
    assert 0.9 < min(held.values()) < 0.99


RUBBING = replace(
    SLIDE,
    dynamics=lambda x, u, d, p: [
        x.speed,
        (u.drive - p.damper * x.speed - p.coulomb * sympy.tanh(x.speed / 1e-3) + d.load) / p.mass,
    ],
    parameters={"mass": 20.0, "damper": 50.0, "coulomb": 8.5},
)


def write_rubbing_log(path, seed, rows=3000, parts=10):
    """Write a log of a slide whose friction of 10 N turns over within some 0.2 mm, as Dahl's, and whose load pulses."""
    random, x, stretch, h, lines = np.random.default_rng(seed), np.zeros(2), 0.0, H / parts, ["time,drive,place"]
    edge, level = 200, 0.0
    for k in range(rows):
        if k == edge:
            level = 0.0 if level else random.choice([-60.0, 60.0])
            edge = k + (random.integers(50, 150) if level else random.integers(200, 400))
        drive = 40.0 * np.sin(3.0 * H * k) - level
        lines.append(f"{H * k!r},{float(drive)!r},{float(x[0] + 1e-6 * random.standard_normal())!r}")
        for _ in range(parts):
            stretch += h * x[1] * (1.0 - np.sign(x[1]) * stretch / 2e-4)
            friction = 50.0 * x[1] + 10.0 * stretch / 2e-4
            x = x + h * np.array([x[1], (drive - friction + level) / 20.0])
    path.write_text("\n".join(lines) + "\n")


def test_friction_is_found_from_all_rows_beside_a_load_of_pulses(tmp_path):
    """How it turns over is the fast part of it, by which the likelihood goes; the model lacks that."""
    write_rubbing_log(tmp_path / "log.csv", seed=3)
    found = fit_log(RUBBING, tmp_path / "log.csv", tmp_path / "fit", free=["damper", "coulomb"])
    assert found.parameters["coulomb"].value == pytest.approx(10.0, rel=0.02)
    assert found.parameters["damper"].value == pytest.approx(50.0, rel=0.01)
    assert any("outside of pulses" in line for line in found.warnings)
