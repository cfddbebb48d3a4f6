"""Single link with a flexible joint, the paper's example (§3).

    link:   θ̈ = −joint_stiffness (θ − φ) − gravity_torque sin θ
    motor:  φ̈ =  joint_stiffness (θ − φ) − motor_damping φ̇ + motor_torque + load_torque

Both inertias are 1 kg·m², so torques and accelerations share their numbers. Both angles are measured.
"""

import math

import sympy

from ndob_fmu.model.model import Model
from ndob_fmu.runtime.equations import Experiment, ObserverDefaults, SignalDefaults

k, c = sympy.symbols("joint_stiffness motor_damping")

model = Model(
    name="FlexibleJoint",
    description="Single link with a flexible joint, from Tseng, Lin and Chen",
    states=["link_angle", "link_rate", "motor_angle", "motor_rate"],
    inputs=["motor_torque"],
    outputs=["motor_angle", "link_angle"],
    disturbances=["load_torque"],
    A=[[0, 1, 0, 0], [-k, 0, k, 0], [0, 0, 0, 1], [k, 0, -k, -c]],
    B=[[0], [0], [0], [1]],
    C=[[0, 0, 1, 0], [1, 0, 0, 0]],
    G_f=[[0], [1], [0], [0]],
    G_d=[[0], [0], [0], [1]],
    f=lambda x, u, p: [-p.gravity_torque * sympy.sin(x.link_angle)],
    parameters={"gravity_torque": 10.0, "joint_stiffness": 1.0, "motor_damping": 1.0},
    units={
        "link_angle": "rad",
        "link_rate": "rad/s",
        "motor_angle": "rad",
        "motor_rate": "rad/s",
        "motor_torque": "N.m",
        "load_torque": "N.m",
        "gravity_torque": "N.m",
        "joint_stiffness": "N.m/rad",
        "motor_damping": "N.m.s/rad",
    },
    descriptions={
        "link_angle": "angle of the link from the vertical",
        "motor_angle": "angle of the motor",
        "load_torque": "unknown torque on the motor",
        "gravity_torque": "largest torque of gravity on the link",
        "joint_stiffness": "stiffness of the joint",
        "motor_damping": "viscous damping of the motor",
    },
    lipschitz=10.0,
    disturbance_bound=5.0,
    noise_std=0.0,
    x0=[1.0, 1.0, 1.0, 1.0],
    xhat0=[-1.0, -1.0, -1.0, -1.0],
    observer=ObserverDefaults(
        disturbance_rate=5.0 * (2 * math.pi) ** 2, alpha=1.0, pi_start=1.0, pi_end=1e12, pi_ramp_time=10.0
    ),
    disturbance=SignalDefaults(kind="constant", amplitude=2.0),
    experiment=Experiment(stop_time=20.0, step_size=1e-3),
)
