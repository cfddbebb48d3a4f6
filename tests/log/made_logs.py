"""Logs with a known truth: the cart of `test_estimate_log`, driven by several frequencies."""

import numpy as np

from ndob_fmu.codegen.compile_model import compile_model
from tests.log.test_estimate_log import CART, write_log

EQUATIONS = compile_model(CART)
TRUE = [2.0, 0.1]


def wind(kind, time, seed):
    """Return a disturbance (K,) of one class."""
    random = np.random.default_rng(seed)
    if kind == "sine":
        return 2.0 * np.sin(2.0 * np.pi * random.uniform(0.5, 0.9) * time + random.uniform(0.0, 6.0))
    if kind == "steps":
        ends = np.cumsum(random.exponential(1.2, size=int(2.0 * time[-1]) + 4))
        return random.uniform(-2.5, 2.5, len(ends) + 1)[np.searchsorted(ends, time)]
    steps = np.cumsum(random.standard_normal(len(time)) * 0.05)
    return steps - steps.mean()


def made_log(path, kind, seed, rows=3000, noise=(2.0e-3, 3.0e-2)):
    """Write a log of the cart and return its true wind (K,)."""
    random, time = np.random.default_rng(seed + 1000), 0.01 * np.arange(rows)
    force = 2.0 * np.sin(1.5 * time) + 1.5 * np.sin(7.0 * time + 1.0) + np.sign(np.sin(4.1 * time))
    d, x, h, places = wind(kind, time, seed), np.zeros(2), 0.005, []

    def rate(x, k):
        return np.array(EQUATIONS.derivatives(x.tolist(), [force[k]], [d[k]], TRUE))

    for k in range(rows):
        places.append(x)
        for _ in range(2):
            k1 = rate(x, k)
            k2 = rate(x + h / 2 * k1, k)
            k3 = rate(x + h / 2 * k2, k)
            x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + rate(x + h * k3, k))
    outputs = np.array(places) + random.standard_normal((rows, 2)) * noise
    write_log(path, time, force[:, None], outputs)
    return d
