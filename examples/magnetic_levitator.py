"""Steel ball under an electromagnet, with an unknown push; gap and coil current are measured.

    ball:  mass · g̈ap = mass · gravity − magnet_constant · (current / gap)² + push
    coil:  inductance · i̇ = voltage − resistance · i

The gap is counted downwards from the magnet. Without control the ball falls or sticks: the pull grows as the gap
closes, and the unstable pole lies at √(2 · gravity / gap) = 44 1/s. The ranges say where the plant works: below 2 mm
the pull has no meaning. A laser measures the gap to 5 µm, a shunt the current to 2 mA. SI units.
"""

import math

from ndob_fmu import Experiment, Model, ObserverDefaults, SignalDefaults


def dynamics(x, u, d, p):
    """Return the ball's rate and acceleration, and the rate of the current."""
    pull = p.magnet_constant * (x.current / x.gap) ** 2
    return [
        x.rate,
        p.gravity - pull / p.mass + d.push / p.mass,
        (u.voltage - p.resistance * x.current) / p.inductance,
    ]


model = Model(
    name="MagneticLevitator",
    description="Steel ball under an electromagnet with an unknown push",
    states=["gap", "rate", "current"],
    inputs=["voltage"],
    outputs=["gap", "current"],
    disturbances=["push"],
    dynamics=dynamics,
    parameters={"mass": 0.05, "gravity": 9.81, "magnet_constant": 1e-4, "resistance": 2.0, "inductance": 0.02},
    units={
        "gap": "m",
        "rate": "m/s",
        "current": "A",
        "voltage": "V",
        "push": "N",
        "mass": "kg",
        "gravity": "m/s2",
        "magnet_constant": "N.m2/A2",
        "resistance": "Ohm",
        "inductance": "H",
    },
    descriptions={
        "gap": "distance of the ball from the magnet",
        "push": "unknown force on the ball, downwards",
        "magnet_constant": "pull times the square of the gap per square of the current",
    },
    ranges={"gap": (2e-3, 2e-2), "current": (0.0, 3.0), "voltage": (-12.0, 12.0)},
    noise_std={"gap": 5e-6, "current": 2e-3},
    disturbance_bound=0.2,
    x0=[0.010, 0.0, 0.70],
    xhat0=[0.011, 0.0, 0.70],
    xhat0_std=[1e-3, 0.05, 0.02],
    observer=ObserverDefaults(disturbance_rate=0.2 * (2 * math.pi * 2.0) ** 2),
    disturbance=SignalDefaults(kind="sine", amplitude=0.1, frequency=2.0),
    experiment=Experiment(stop_time=2.0, step_size=1e-3),
)
