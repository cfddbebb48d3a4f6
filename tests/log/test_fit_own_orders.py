"""Disturbances of different kinds in one log: each has the order that it needs."""

import math
import re

import numpy as np
import pytest

from ndob_fmu.cli import main
from ndob_fmu.log.estimate_log import estimate_log
from ndob_fmu.log.fit.fit_log import fit_log
from ndob_fmu.log.made_log import Sensor, make_log, sines, walk
from ndob_fmu.model.model import Model
from tests.helpers.general_plants import TROLLEY

# Heat of the sun and vapour of the plants, which the temperature and the humidity of a greenhouse show.
GREENHOUSE = Model(
    name="Greenhouse",
    states=["temperature", "humidity"],
    inputs=["heater"],
    outputs=["temperature", "humidity"],
    disturbances=["sun", "vapour"],
    dynamics=lambda x, u, d, p: [
        (u.heater + d.sun - 0.8 * x.temperature) / 5.0,
        (d.vapour - 0.6 * x.humidity - 0.1 * x.temperature) / 3.0,
    ],
    parameters={},
    noise_std={"temperature": 0.1, "humidity": 0.3},
    disturbance_bound={"sun": 5.0, "vapour": 5.0},
    x0={},
)
# Of each plant: model, step (s), size and pace (Hz) of both disturbances.
PLANTS = {"trolley": (TROLLEY, 0.02, 0.5, (0.5, 0.3)), "greenhouse": (GREENHOUSE, 0.2, 3.0, (0.03, 0.03))}


def made(folder, plant, kinds, seed, rows=2000):
    """Write a log whose disturbances are smooth, "s", or wander, "w"; return the model, the log and the truth."""
    model, H, size, paces = PLANTS[plant]
    stop = H * (rows - 1)
    signals = {
        name: sines(size, pace, 10 * seed + i) if kind == "s" else walk(0.5 * size, pace, 10 * seed + i, stop)
        for i, (name, kind, pace) in enumerate(zip(model.disturbances, kinds, paces, strict=True))
    }
    log = folder / "log.csv"
    truth = make_log(
        model,
        log,
        lambda t, x: [math.copysign(size, math.sin(0.02 * t / H))],
        step=H,
        stop_time=stop,
        disturbances=signals,
        sensors={name: Sensor(noise_std=std) for name, std in model.noise_std.items()},
        seed=seed,
    )
    return model, log, np.genfromtxt(truth, delimiter=",", names=True)


@pytest.mark.parametrize(("plant", "kinds"), [("trolley", "sw"), ("greenhouse", "sw"), ("greenhouse", "ws")])
def test_a_disturbance_that_wanders_beside_a_smooth_one_has_error_bars_that_hold(tmp_path, plant, kinds):
    """With one order for all, both count as smooth, and half of the errors of the one that wanders are outside."""
    model, log, true = made(tmp_path, plant, kinds, seed=3)
    found = fit_log(model, log, tmp_path / "fit")
    assert found.orders == {name: {"s": 2, "w": 1}[kind] for name, kind in zip(model.disturbances, kinds, strict=True)}
    estimate_log(model, log, tmp_path / "out", start_values=found.start_values)
    said = np.genfromtxt(tmp_path / "out" / "result.csv", delimiter=",", names=True, deletechars="")
    for name in model.disturbances:
        error, std = np.abs(said[f"smoother.{name}"] - true[name]), said[f"smoother.{name}_std"]
        assert np.mean(error < 2.0 * std) > 0.88
        online = np.abs(said[f"observer.{name}_at_sample"][1:] - true[name][:-1])
        assert np.mean(online < 2.0 * said[f"observer.{name}_std"][1:]) > 0.88


@pytest.mark.parametrize(("kinds", "seed"), [("ws", 3), ("ws", 4), ("sw", 4), ("sw", 6)])
def test_a_short_log_tells_each_order_where_its_held_out_rows_alone_do_not(tmp_path, kinds, seed):
    """One disturbance of two moves less of a log than both; 300 rows do not tell its order for sure, 1000 do."""
    model, log, _ = made(tmp_path, "greenhouse", kinds, seed, rows=1000)
    found = fit_log(model, log, tmp_path / "fit")
    assert [*found.orders.values()] == [{"s": 2, "w": 1}[kind] for kind in kinds]


def test_fit_says_of_each_disturbance_how_it_moves(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    _, log, _ = made(tmp_path, "greenhouse", "sw", seed=4)
    file = tmp_path / "greenhouse.py"
    file.write_text("from tests.log.test_fit_own_orders import GREENHOUSE as model\n")
    assert main(["fit", str(file), str(log), "--out", "fit"]) == 0
    said = capsys.readouterr().out
    assert "sun is smooth, vapour wanders: disturbance_order 2; disturbance_own_order sun 2, vapour 1" in said
    of_all, of_these = (re.search(rf"{what} (-?[0-9.]+)", said) for what in ("held-out rows: order 1", "these orders"))
    assert float(of_these[1]) > float(of_all[1])
