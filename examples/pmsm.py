"""Synchronous motor with permanent magnets (PMSM) in the rotor's coordinates, with an unknown load torque.

    rotor:  inertia · ω̇ = 3/2 · pole_pairs · flux · i_q − friction · ω − load_torque,       φ̇ = ω
    d axis: inductance · i̇_d = v_d − resistance · i_d + pole_pairs · ω · inductance · i_q
    q axis: inductance · i̇_q = v_q − resistance · i_q − pole_pairs · ω · (inductance · i_d + flux)

A 14-bit encoder measures the angle, which is counted on over the turns: its rounding to 0.38 mrad counts as noise of
0.38/√12 = 0.11 mrad. The currents are measured to 20 mA and transformed with that angle. SI units.
"""

import math

import sympy

from ndob_fmu import Experiment, Model, ObserverDefaults, SignalDefaults


def dynamics(x, u, d, p):
    """Return the rates of angle, speed and both currents."""
    electric = p.pole_pairs * x.rate
    torque = sympy.Rational(3, 2) * p.pole_pairs * p.flux * x.i_q
    return [
        x.rate,
        (torque - p.friction * x.rate - d.load_torque) / p.inertia,
        (u.v_d - p.resistance * x.i_d) / p.inductance + electric * x.i_q,
        (u.v_q - p.resistance * x.i_q - electric * p.flux) / p.inductance - electric * x.i_d,
    ]


model = Model(
    name="Pmsm",
    description="Synchronous motor with permanent magnets and an unknown load torque",
    states=["angle", "rate", "i_d", "i_q"],
    inputs=["v_d", "v_q"],
    outputs=["angle", "i_d", "i_q"],
    disturbances=["load_torque"],
    dynamics=dynamics,
    parameters={
        "inertia": 5e-4,
        "friction": 1e-3,
        "resistance": 0.5,
        "inductance": 1e-3,
        "flux": 0.05,
        "pole_pairs": 4.0,
    },
    units={
        "angle": "rad",
        "rate": "rad/s",
        "i_d": "A",
        "i_q": "A",
        "v_d": "V",
        "v_q": "V",
        "load_torque": "N.m",
        "inertia": "kg.m2",
        "friction": "N.m.s/rad",
        "resistance": "Ohm",
        "inductance": "H",
        "flux": "Wb",
        "pole_pairs": "1",
    },
    descriptions={
        "i_d": "current along the magnets' field",
        "i_q": "current across it, which makes the torque",
        "load_torque": "unknown torque against the rotor",
        "flux": "flux linkage of the magnets",
    },
    ranges={
        "rate": (-500.0, 500.0),
        "i_d": (-20.0, 20.0),
        "i_q": (-20.0, 20.0),
        "v_d": (-50.0, 50.0),
        "v_q": (-150.0, 150.0),
    },
    noise_std={"angle": 1.1e-4, "i_d": 0.02, "i_q": 0.02},
    disturbance_bound=2.0,
    x0=[0.0, 50.0, 0.0, 0.2],
    xhat0=[0.0, 45.0, 0.0, 0.0],
    xhat0_std=[1e-3, 5.0, 0.5, 0.5],
    observer=ObserverDefaults(disturbance_rate=2.0 * (2 * math.pi * 2.0) ** 2),
    disturbance=SignalDefaults(kind="sine", amplitude=1.0, frequency=2.0),
    experiment=Experiment(stop_time=1.5, step_size=1e-3),
)
