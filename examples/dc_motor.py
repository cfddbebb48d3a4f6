"""DC servo motor with friction and an unknown load torque; only the shaft angle is measured.

    shaft:      inertia · ω̇ = torque_constant · i − viscous_damping · ω − friction_torque · tanh(ω / friction_rate)
                              + load_torque,     φ̇ = ω
    armature:   inductance · i̇ = voltage − resistance · i − torque_constant · ω

The friction enters where the load torque does: the matched case, eq. (1), with n = 3, m = p = q = 1. The one zero is
the electrical pole, −resistance/inductance = −500 1/s. SI units; a small servo motor with its load.

γ = friction_torque / friction_rate = 0.4 N·m·s/rad: the slope of the friction at zero speed. Divided by the inertia it
is a rate of 200 1/s. The observer's rate (√pi_end / inertia)^½ = 1000 1/s is chosen well above it.
"""

import math

import sympy

from ndob_fmu import Experiment, Model, ObserverDefaults, SignalDefaults

J, b, K, R, L = sympy.symbols("inertia viscous_damping torque_constant resistance inductance")

model = Model(
    name="DcMotor",
    description="DC servo motor with friction and an unknown load torque",
    states=["shaft_angle", "shaft_rate", "current"],
    inputs=["voltage"],
    outputs=["shaft_angle"],
    disturbances=["load_torque"],
    A=[[0, 1, 0], [0, -b / J, K / J], [0, -K / L, -R / L]],
    B=[[0], [0], [1 / L]],
    C=[[1, 0, 0]],
    G_d=[[0], [1 / J], [0]],
    f=lambda x, u, p: [-p.friction_torque * sympy.tanh(x.shaft_rate / p.friction_rate)],
    parameters={
        "inertia": 2e-3,
        "viscous_damping": 1e-3,
        "torque_constant": 0.3,
        "resistance": 1.0,
        "inductance": 2e-3,
        "friction_torque": 0.2,
        "friction_rate": 0.5,
    },
    units={
        "shaft_angle": "rad",
        "shaft_rate": "rad/s",
        "current": "A",
        "voltage": "V",
        "load_torque": "N.m",
        "inertia": "kg.m2",
        "viscous_damping": "N.m.s/rad",
        "torque_constant": "N.m/A",
        "resistance": "Ohm",
        "inductance": "H",
        "friction_torque": "N.m",
        "friction_rate": "rad/s",
    },
    descriptions={
        "current": "armature current",
        "voltage": "armature voltage",
        "load_torque": "unknown torque on the shaft, driving where positive",
        "inertia": "inertia of rotor and load",
        "torque_constant": "torque per current, and back-EMF per rate",
        "friction_torque": "dry friction at speed",
        "friction_rate": "rate at which dry friction reaches 76 % of its value",
    },
    lipschitz=0.4,
    disturbance_bound=1.5,
    observer=ObserverDefaults(
        disturbance_rate=1.5 * (2 * math.pi) ** 2, alpha=20.0, pi_start=1e-2, pi_end=4e6, pi_ramp_time=1.0
    ),
    disturbance=SignalDefaults(kind="sine", amplitude=1.0, frequency=1.0),
    experiment=Experiment(stop_time=3.0, step_size=5e-4),
)
