"""(h) The design of method 2 for a plant with 60 states, beside one Riccati equation of the same size in SciPy."""

from __future__ import annotations

from dataclasses import replace
from itertools import count

import numpy as np
import scipy.linalg

from benchmarks.figures import Section, Time, compared
from benchmarks.models import carts
from benchmarks.timing import take_turns
from ndob_fmu import check, design
from ndob_fmu.codegen.compile_model import linear_part
from ndob_fmu.runtime.design.augmented import augment
from ndob_fmu.runtime.design.stationary_design import design_for, stationary_design
from ndob_fmu.runtime.design.tuning import Knowledge, tuned_intensities

STEP, NOISE, ALPHA, ROUNDS = 1e-2, 1e-6, 0.05, 3


def test_design(benchmark, section):
    model = replace(carts(30), observer=replace(carts(30).observer, alpha=ALPHA))
    rate = model.disturbance_bound[0] * (2.0 * np.pi) ** 2
    known = Knowledge(NOISE * np.eye(2), np.array(model.disturbance_bound), np.array([rate]))
    system = augment(linear_part(model), 2)
    intensities = tuned_intensities(system, STEP, ALPHA, known)
    found = stationary_design(system, STEP, known.R_factor, intensities, ALPHA)
    # In the plant's own units SciPy refuses the equation. Ours has to find the units itself.
    size = np.linalg.norm(found.prior_factor, axis=1)
    noise = found.noise_factor / size[:, None]
    Phi, C = found.discrete.Phi * size / size[:, None], system.C * size / np.diag(found.sample_factor)[:, None]
    rounds = count(1)  # a result for other numbers is of no use

    def of_another(what):
        other = replace(model, disturbance_bound=model.disturbance_bound[0] * (1.0 + 1e-6 * next(rounds)))
        return lambda: what(other)

    actions = {
        "Riccati equation in SciPy": lambda: scipy.linalg.solve_discrete_are(Phi.T, C.T, noise @ noise.T, np.eye(2)),
        "gain": lambda: design_for(system, found.discrete, known.R_factor, intensities, ALPHA),
        "tuning": lambda: tuned_intensities(system, STEP, ALPHA, known),
        "check": lambda: of_another(check)(),
        "design": lambda: of_another(lambda other: design(other, step_size=STEP, noise_std=NOISE))(),
    }
    np.testing.assert_allclose(np.diag(actions["Riccati equation in SciPy"]()), 1.0, rtol=1e-8)
    benchmark.pedantic(actions["gain"], rounds=1)
    times = take_turns(actions, ROUNDS)
    peer = "`scipy.linalg.solve_discrete_are` for the same gain, in good units"
    section(
        Section(
            rank=8,
            title="The design for 60 states",
            text=(
                f"Thirty carts in a row, r = 2, H = {STEP:g} s. A tuning makes some twenty gains. The last two rows "
                "are what the commands do after the start of Python. `design` writes the equations, tunes, bounds the "
                f"errors and runs the observer until its error bars have settled. Medians of {ROUNDS} rounds."
            ),
            ratios=tuple(
                compared(f"{what} of method 2, n = 60", peer, times[what], times["Riccati equation in SciPy"])
                for what in ("gain", "tuning")
            ),
            times=tuple(Time(what, float(np.median(found))) for what, found in times.items()),
        )
    )
