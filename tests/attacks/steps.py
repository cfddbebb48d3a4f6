"""Random masters that add their steps up: the observer's estimate stays finite and its error bar honest.

python -m tests.attacks.steps [--trials N] [--seed S] [--fmus FOLDER]

Each trial couples the plant and the observer of the paper's example, sampled with noise, under random step sizes, start
and stop times, with steps of 1e-16 s to 1e-6 s among them and a last step clipped at the stop time. Ends with 1 if a
step is refused, a value is not finite, or an error is larger than six error bars.
"""

from __future__ import annotations

import argparse
import sys
from contextlib import ExitStack
from math import isfinite
from pathlib import Path
from random import Random

from tests.helpers.fmi_instance import OK, opened

NOISE = 1e-5
SETTLED = 40
LARGEST_ERROR = 6.0


def adding_up(start, stop, H):
    """The steps of a master that adds them up and clips the last one at the stop time: (t, h)."""
    t = start
    while t < stop:
        h = min(H, stop - t)
        yield t, h
        t += h


def with_odd_steps(start, stop, H, random, share=0.02):
    """The same with steps of 1e-16 s to 1e-6 s among them, as far as they move the time."""
    t = start
    while t < stop:
        odd = 10.0 ** random.uniform(-16.0, -6.0)
        h = odd if random.random() < share and t + odd > t else H
        h = min(h, stop - t)
        yield t, h
        t += h


def coupled(plant, observer, steps, *, noise=0.0, random=None, start=0.0, stop=None, **parameters):
    """Step plant and observer side by side; a row (t, h, error of the estimate, outputs) for each step."""
    plant.begin(start_time=start, stop_time=stop, **{"disturbance.kind": 3, "disturbance.start_time": start})
    observer.begin(start_time=start, stop_time=stop, **parameters)
    references = [observer.variables[name].valueReference for name in ("motor_angle", "link_angle")]
    shown, rows = plant.get(), []
    for t, h in steps:
        y = [shown[name] + (random.gauss(0.0, noise) if noise else 0.0) for name in ("motor_angle", "link_angle")]
        assert observer.setReal(references, y) == OK
        assert (plant.doStep(t, h), observer.doStep(t, h)) == (OK, OK), (t, h, plant.said, observer.said)
        shown, estimate = plant.get(), observer.get()
        rows.append((t, h, estimate["load_torque_hat"] - shown["load_torque_total"], estimate))
    return rows


def fault(rows):
    """What is wrong with the rows of a run, or nothing."""
    full_steps = 0
    for t, h, error, estimate in rows:
        full_steps += h > 1e-6
        if not all(map(isfinite, map(float, estimate.values()))):
            return f"a value that is not finite at {t!r} s after a step of {h!r} s"
        if full_steps > SETTLED and not abs(error) <= LARGEST_ERROR * estimate["load_torque_std"]:
            return f"an error of {error:.2g} N·m, std {estimate['load_torque_std']:.2g}, at {t!r} s, step {h!r} s"
    return ""


def trial(plant, observer, random):
    """One random run; what is wrong with it, or nothing."""
    start = random.choice([0.0, 0.0, 0.1, -3.0, 1e3, 1e6, 1.7e9])
    H = random.choice([1e-3, 1e-3, 1e-3, 1 / 300, 5e-3, 7e-3])
    stop = start + H * random.uniform(60.0, 200.0)
    if random.random() < 0.5:  # a round time, which the sum of the steps misses by rounding
        stop = start + H * random.randint(60, 200)
    steps = with_odd_steps(start, stop, H, random) if random.random() < 0.7 else adding_up(start, stop, H)
    order = random.choice([1, 2, 3])
    rows = coupled(
        plant,
        observer,
        steps,
        noise=NOISE,
        random=random,
        start=start,
        stop=stop,
        **{f"{angle}_noise_std": NOISE for angle in ("motor_angle", "link_angle")},
        disturbance_order=order,
        disturbance_rate=2.0 * 6.2832**order,
    )
    found = fault(rows)
    assert plant.reset() == OK
    assert observer.reset() == OK
    return found and f"start {start!r}, stop {stop!r}, H {H!r}, order {order}: {found}"


def run(trials, seed, fmus):
    """Run the trials and return what was wrong, one text each."""
    with ExitStack() as stack:
        parts = [stack.enter_context(opened(Path(fmus, f"FlexibleJoint{part}.fmu"))) for part in ("Plant", "Observer")]
        return [found for i in range(trials) if (found := trial(*parts, Random(f"{seed} {i}")))]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trials", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--fmus", default="build/fmus")
    chosen = parser.parse_args()
    found = run(chosen.trials, chosen.seed, chosen.fmus)
    print(f"steps: {chosen.trials} masters, seed {chosen.seed}: {len(found)} with a wrong estimate")
    for text in found[:10]:
        print(f"  {text}")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
