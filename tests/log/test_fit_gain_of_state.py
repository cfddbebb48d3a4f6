"""Parameters of a plant in which the effect of the disturbance depends on the state."""

from dataclasses import replace

import numpy as np
import pytest
import sympy

from ndob_fmu.codegen.compile_model import compile_model
from ndob_fmu.log.fit.class_fit import fit_class
from ndob_fmu.log.fit.parameter_step import most_likely
from ndob_fmu.log.fit.setup import Setup
from ndob_fmu.log.told_values import told_values
from ndob_fmu.model.model import Model

# A funnel: the wider it is at the level, the slower an inflow moves it.
FUNNEL = Model(
    name="Funnel",
    states=["level"],
    inputs=["pump"],
    outputs=["level"],
    disturbances=["inflow"],
    dynamics=lambda x, u, d, p: [(u.pump + d.inflow - p.valve * sympy.sqrt(x.level)) / (0.15 + 0.35 * x.level) ** 2],
    parameters={"valve": 1e-3},
    ranges={"level": (0.05, 1.5), "pump": (0.0, 3e-3)},
    noise_std={"level": 3e-3},
    disturbance_bound=1e-3,
    x0={"level": 0.8},
)
EQUATIONS, VALVE = compile_model(FUNNEL), 1e-3


def write_log(path, seed, rows=1500, H=2.0):
    """Write a log of the funnel, whose pump is switched and whose inflow wanders."""
    random, time = np.random.default_rng(seed), H * np.arange(rows)
    pump = VALVE * np.sqrt(0.8) * (1.0 + 0.25 * np.sign(np.sin(2.0 * np.pi * time / 500.0)))
    d, level, levels = np.cumsum(random.standard_normal(rows)) * 1e-6 * np.sqrt(H), np.array([0.8]), []
    for k in range(rows):
        levels.append(level[0])
        for _ in range(4):
            middle = level + H / 8.0 * np.array(EQUATIONS.derivatives(level.tolist(), [pump[k]], [d[k]], [VALVE]))
            level = level + H / 4.0 * np.array(EQUATIONS.derivatives(middle.tolist(), [pump[k]], [d[k]], [VALVE]))
    columns = np.column_stack([time, pump, np.array(levels) + 3e-3 * random.standard_normal(rows)])
    path.write_text("time,pump,level\n" + "\n".join(",".join(map(repr, row)) for row in columns.tolist()) + "\n")


@pytest.mark.parametrize("seed", range(4))
def test_its_step_leads_to_the_top_of_the_likelihood(tmp_path, seed):
    """The top of a parabola through fits that are told the valve, which take no slope by it."""
    write_log(tmp_path / "log.csv", seed)
    setup = Setup(FUNNEL, EQUATIONS, told_values(EQUATIONS, {}), ("valve",), 0.0, None)
    run = setup.online(tmp_path / "log.csv", None, None)
    problem = setup.problem(run, 1)

    def told(valve):
        one = replace(setup, free=()).with_values({"valve": valve}).problem(run, 1)
        return fit_class(one, setup.trajectory(run, one), most_likely)

    low, here, high = map(told, (0.9 * VALVE, VALVE, 1.1 * VALVE))
    less, value, more = low.noise.value, here.noise.value, high.noise.value
    top = 0.1 * VALVE * 0.5 * (more - less) / (2.0 * value - less - more)
    step, covariance, _ = most_likely(problem, here.trajectory, problem.told, here.noise)
    assert abs(step[0] - top) < 0.15 * np.sqrt(covariance[0, 0])
