"""Quadrotor in the vertical plane in gusty wind: two unknown forces and an unknown moment.

    across:  mass · ẍ = −(left_thrust + right_thrust) · sin θ + wind_across
    up:      mass · z̈ = (left_thrust + right_thrust) · cos θ − mass · gravity + wind_up
    pitch:   inertia · θ̈ = arm · (right_thrust − left_thrust) + wind_moment

The body's attitude turns the thrust, and the wind is what the thrust does not explain. Motion capture measures the
position to 1 mm, the inertial sensors the pitch to 2 mrad and its rate to 5 mrad/s, all every 5 ms. SI units.
"""

import math

import sympy

from ndob_fmu import Experiment, Model, ObserverDefaults, SignalDefaults


def dynamics(x, u, d, p):
    """Return the velocities and accelerations."""
    thrust = u.left_thrust + u.right_thrust
    return [
        x.velocity_across,
        x.velocity_up,
        x.pitch_rate,
        (-thrust * sympy.sin(x.pitch) + d.wind_across) / p.mass,
        (thrust * sympy.cos(x.pitch) + d.wind_up) / p.mass - p.gravity,
        (p.arm * (u.right_thrust - u.left_thrust) + d.wind_moment) / p.inertia,
    ]


model = Model(
    name="PlanarQuadrotor",
    description="Quadrotor in the vertical plane with two unknown forces and an unknown moment of the wind",
    states=["across", "up", "pitch", "velocity_across", "velocity_up", "pitch_rate"],
    inputs=["left_thrust", "right_thrust"],
    outputs=["across", "up", "pitch", "pitch_rate"],
    disturbances=["wind_across", "wind_up", "wind_moment"],
    dynamics=dynamics,
    parameters={"mass": 1.2, "inertia": 0.02, "arm": 0.2, "gravity": 9.81},
    units={
        "across": "m",
        "up": "m",
        "pitch": "rad",
        "velocity_across": "m/s",
        "velocity_up": "m/s",
        "pitch_rate": "rad/s",
        "left_thrust": "N",
        "right_thrust": "N",
        "wind_across": "N",
        "wind_up": "N",
        "wind_moment": "N.m",
        "mass": "kg",
        "inertia": "kg.m2",
        "arm": "m",
        "gravity": "m/s2",
    },
    descriptions={
        "pitch": "angle of the body, positive to the left",
        "wind_across": "unknown horizontal force of the wind",
        "wind_up": "unknown vertical force of the wind",
        "wind_moment": "unknown moment of the wind, to the left",
        "arm": "distance of the rotors from the centre of mass",
    },
    ranges={"pitch": (-1.0, 1.0), "left_thrust": (0.0, 15.0), "right_thrust": (0.0, 15.0)},
    noise_std={"across": 1e-3, "up": 1e-3, "pitch": 2e-3, "pitch_rate": 5e-3},
    disturbance_bound=[3.0, 1.5, 0.1],
    x0=[0.0, 1.0, 0.0, 0.0, 0.0, 0.0],
    xhat0=[0.0, 1.0, 0.0, 0.0, 0.0, 0.0],
    xhat0_std=[0.1, 0.1, 0.05, 0.5, 0.5, 0.2],
    observer=ObserverDefaults(disturbance_rate=[3.0 * math.pi**2, 1.5 * math.pi**2, 0.1 * math.pi**2]),
    disturbance=SignalDefaults(kind="sine", amplitude=0.05, frequency=0.5),
    experiment=Experiment(stop_time=8.0, step_size=5e-3),
)
