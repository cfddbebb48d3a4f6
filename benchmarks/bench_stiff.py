"""(g) The cost of a step of 10 ms where a state of the plant is far faster than that."""

from __future__ import annotations

from math import sin

import numpy as np

from benchmarks.figures import Section, Time, compared
from benchmarks.models import lagged_motor
from benchmarks.timing import take_turns
from ndob_fmu.codegen.compile_model import compile_model
from ndob_fmu.runtime.blocks.disturbance import KINDS, Generator
from ndob_fmu.runtime.blocks.plant import Plant
from ndob_fmu.runtime.step.layout import Layout
from ndob_fmu.runtime.step.time_update import predict_plant

STEP = 1e-2
TIME_CONSTANTS = (1.0, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7)
COUNT, ROUNDS = 10, 20
START = (0.3, -0.2, 0.7)


def plant_steps(time_constant):
    """Return COUNT steps of the plant from START, the command and the load being sines."""
    model = lagged_motor(time_constant)
    plant = Plant(compile_model(model), model.parameter_values(), (Generator(KINDS["sine"], 2.0, 1.0, 0.0),))

    def steps():
        state = plant.init(START, 0.0)
        for k in range(COUNT):
            state = plant.step(state, (sin(6.0 * k * STEP),), (0.5,), (k + 1) * STEP)

    return steps


def predictions(time_constant):
    """Return COUNT predictions from START, where the lag has yet to settle, with d and its rate estimated."""
    model = lagged_motor(time_constant)
    eq, p = compile_model(model), model.parameter_values()
    xi_hat = np.array([*START, 0.5, 3.0])
    layout = Layout(n=3, q=1, order=2, own=(2,), biased=(), uncertain=())

    def steps():
        for _ in range(COUNT):
            predict_plant(eq, layout, p, xi_hat, (0.2,), STEP, None)

    return steps


def test_stiff(benchmark, section):
    kinds = {"plant": plant_steps, "prediction": predictions}
    actions = {f"{kind}, {tau:g} s": steps(tau) for tau in TIME_CONSTANTS for kind, steps in kinds.items()}
    benchmark.pedantic(actions["plant, 1 s"], rounds=1)
    times = take_turns(actions, ROUNDS)
    section(
        Section(
            rank=7,
            title="A step of 10 ms of a plant with a fast state",
            text=(
                "A motor with dry friction behind a drive that lags by the given time constant, n = 3. The lag has not "
                "settled when the steps begin. A step of the plant runs generated code where its explicit method is "
                "used. The prediction of the observer's start-up is in NumPy and begins unsettled at every step."
            ),
            ratios=tuple(
                compared(
                    f"{kind}, lag {tau:g} s", f"{kind}, lag 1 s", times[f"{kind}, {tau:g} s"], times[f"{kind}, 1 s"]
                )
                for kind in kinds
                for tau in TIME_CONSTANTS[1:]
            ),
            times=tuple(Time(f"{what}, a step", float(np.median(t)) / COUNT) for what, t in times.items()),
        )
    )
