"""The positioning system EMPS of Janot, Gautier and Brunot: a motor drives a load along a guide by a spindle.

    mass · v̇ = gain · voltage − viscous · v − coulomb · sign(v) − offset + force,   ẋ = v

tanh(v / 1 mm/s) stands for sign(v). The parameters are theirs. SI units; the voltage is the one of the current loop.
What friction and the place do beyond that is a map, which `fit` learns.
"""

import sympy

from ndob_fmu import Experiment, Model


def dynamics(x, u, d, p):
    """Return rate and acceleration of the load."""
    friction = p.viscous * x.velocity + p.coulomb * sympy.tanh(x.velocity / 1e-3) + p.offset
    return [x.velocity, (p.gain * u.voltage - friction + d.force) / p.mass]


model = Model(
    name="Emps",
    description="Electro-mechanical positioning system with an unknown force on the load",
    states=["position", "velocity"],
    inputs=["voltage"],
    outputs=["position"],
    disturbances=["force"],
    dynamics=dynamics,
    parameters={"mass": 95.1089, "viscous": 203.5034, "coulomb": 20.3935, "offset": -3.1648, "gain": 35.15},
    units={
        "position": "m",
        "velocity": "m/s",
        "voltage": "V",
        "force": "N",
        "mass": "kg",
        "viscous": "N.s/m",
        "coulomb": "N",
        "offset": "N",
        "gain": "N/V",
    },
    ranges={"velocity": (-1.0, 1.0), "voltage": (-10.0, 10.0)},
    noise_std={"position": 1e-6},
    disturbance_bound=300.0,
    disturbance_map={"force": {"velocity": "friction", "position": "place"}},
    x0=[0.0, 0.0],
    xhat0=[0.0, 0.0],
    xhat0_std=[0.01, 0.01],
    experiment=Experiment(stop_time=24.84, step_size=1e-3),
)
