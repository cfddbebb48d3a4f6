"""(c) The cost of a step of the observer inside the FMU, over the size of a sparse model."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from benchmarks.figures import Section, Time, compared
from benchmarks.models import carts
from benchmarks.timing import take_turns
from ndob_fmu.codegen.compile_model import compile_model
from ndob_fmu.runtime.equations import HIGHEST_ORDER
from ndob_fmu.runtime.generated_steps import ConvergedGain
from ndob_fmu.runtime.step.converged_step import frozen_memory
from ndob_fmu.runtime.step.sampled_observer import sampled_observer
from ndob_fmu.runtime.step.settings import observer_settings

STEP = 1e-3
SIZES, DESIGNED = (4, 8, 16, 32, 64), (4, 8, 16)
COUNT, ROUNDS = 50, 100


def generated(model):
    """Return COUNT generated steps from x = 0, with a gain that has as many entries as a designed one."""
    eq = compile_model(model)
    n, p, q = len(eq.states), len(eq.outputs), len(eq.disturbances)
    constants = eq.steps.observer_constants(model.parameter_values())
    K = (1e-3,) * ((n + HIGHEST_ORDER * q) * p)
    xi_hat, inputs = (0.0,) * (n + HIGHEST_ORDER * q), [0.1] * (len(eq.inputs) + p)
    one, tenth = (1.0,) * p, (0.1,) * q
    gain = ConvergedGain(gate=one, weight=one, d_std=tenth, at_sample_std=tenth, residual_std=one, K=K)
    assert eq.steps.observer_step(xi_hat, inputs, one, constants, gain, STEP) is not None

    def steps():
        for _ in range(COUNT):
            eq.steps.observer_step(xi_hat, inputs, one, constants, gain, STEP)

    return steps


def by_definition(model):
    """Return COUNT steps with a converged covariance, in NumPy."""
    eq = compile_model(model)
    at_zero = [0.0] * len(eq.states)
    observer = sampled_observer(eq, model.parameter_values(), observer_settings(eq), at_zero)
    start, tuned = observer.init(at_zero), observer.tuned(STEP)
    memory = replace(start.memory, tuned_at=STEP, step=STEP, age=tuned.model.start_samples)
    design = observer.designs.at(STEP, STEP)
    start = replace(start, memory=frozen_memory(tuned.model, memory, design, memory.frozen_noise))
    u, y = [0.1] * len(eq.inputs), [0.0] * len(eq.outputs)

    def steps():
        for _ in range(COUNT):
            observer.step_by_definition(start, u, y, STEP)

    return steps


def entries(model):
    """Return how many entries of A, B, C, G_f and G_d are not zero."""
    linear = compile_model(model).linear_part(model.parameter_values())
    return sum(np.count_nonzero(matrix) for matrix in (linear.A, linear.B, linear.C, linear.G_f, linear.G_d))


def test_core(benchmark, section):
    models = {n: carts(n // 2) for n in SIZES}
    actions = {f"generated, n = {n}": generated(model) for n, model in models.items()}
    actions |= {f"NumPy, n = {n}": by_definition(models[n]) for n in DESIGNED}
    benchmark.pedantic(actions["generated, n = 4"], rounds=1)
    times = take_turns(actions, ROUNDS)
    counted = ", ".join(f"{entries(model)} for n = {n}" for n, model in models.items())
    section(
        Section(
            rank=3,
            title="A step in Python, over the size of the model",
            text=(
                "Carts in a row between springs and dampers, r = 2, p = 2; each cart is connected to its neighbours"
                " only. The step is what the FMU runs after the gain has been frozen: sample, correction and "
                "prediction. The step in NumPy is the definition of the generated step. The number of non-zero "
                f"entries in the model's matrices grows with n: {counted}."
            ),
            ratios=(
                *(
                    compared(
                        f"generated step, n = {n}",
                        f"the step in NumPy, n = {n}",
                        times[f"generated, n = {n}"],
                        times[f"NumPy, n = {n}"],
                    )
                    for n in DESIGNED
                ),
                *(
                    compared(
                        f"generated step, n = {n}",
                        "generated step, n = 4",
                        times[f"generated, n = {n}"],
                        times["generated, n = 4"],
                    )
                    for n in SIZES[1:]
                ),
            ),
            times=tuple(Time(f"{what}, a step", float(np.median(t)) / COUNT) for what, t in times.items()),
        )
    )
