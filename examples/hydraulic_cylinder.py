"""Hydraulic cylinder with a servo valve in SI units: an unknown load; position and both pressures are measured.

    piston:    mass · v̇ = area_a · p_a − area_b · p_b − damping · v − load_force,         ẋ = v
    chambers:  (dead_volume + area_a · x) / bulk · ṗ_a = Q_a − area_a · v
               (dead_volume + area_b · (stroke − x)) / bulk · ṗ_b = Q_b + area_b · v
    valve:     Q_a =  valve · s · (√(supply − p_a) for s > 0, √p_a for s < 0)
               Q_b = −valve · s · (√p_b for s > 0, √(supply − p_b) for s < 0)

A position of 0.1 m stands beside pressures of 1e7 Pa, as they do in a data sheet. √Δp is smoothed below 1 bar, so that
it has a slope at 0, and so is the change between the valve's two sides. The position sensor has 10 µm of noise, the
pressure sensors 0.1 % of the supply.
"""

import math

import sympy

from ndob_fmu import Experiment, Model, ObserverDefaults, SignalDefaults


def root(difference, p):
    """Return the root of a pressure difference with its sign, √Pa."""
    return difference / sympy.root(difference**2 + p.smoothing**2, 4)


def dynamics(x, u, d, p):
    """Return the rates of position, velocity and both pressures."""
    opens_a = (1 + sympy.tanh(u.spool / p.overlap)) / 2
    flow_a = root(p.supply - x.pressure_a, p) * opens_a + root(x.pressure_a, p) * (1 - opens_a)
    flow_b = root(x.pressure_b, p) * opens_a + root(p.supply - x.pressure_b, p) * (1 - opens_a)
    volume_a = p.dead_volume + p.area_a * x.position
    volume_b = p.dead_volume + p.area_b * (p.stroke - x.position)
    force = p.area_a * x.pressure_a - p.area_b * x.pressure_b
    return [
        x.velocity,
        (force - p.damping * x.velocity - d.load_force) / p.mass,
        p.bulk / volume_a * (p.valve * u.spool * flow_a - p.area_a * x.velocity),
        p.bulk / volume_b * (-p.valve * u.spool * flow_b + p.area_b * x.velocity),
    ]


model = Model(
    name="HydraulicCylinder",
    description="Hydraulic cylinder with a servo valve and an unknown load",
    states=["position", "velocity", "pressure_a", "pressure_b"],
    inputs=["spool"],
    outputs=["position", "pressure_a", "pressure_b"],
    disturbances=["load_force"],
    dynamics=dynamics,
    parameters={
        "mass": 500.0,
        "damping": 2000.0,
        "area_a": 2e-3,
        "area_b": 1.2e-3,
        "dead_volume": 2e-4,
        "stroke": 0.5,
        "bulk": 1.2e9,
        "valve": 1.2e-7,
        "supply": 2e7,
        "smoothing": 1e5,
        "overlap": 0.01,
    },
    units={
        "position": "m",
        "velocity": "m/s",
        "pressure_a": "Pa",
        "pressure_b": "Pa",
        "spool": "1",
        "load_force": "N",
        "mass": "kg",
        "damping": "N.s/m",
        "area_a": "m2",
        "area_b": "m2",
        "dead_volume": "m3",
        "stroke": "m",
        "bulk": "Pa",
        "valve": "m3.5/kg0.5",
        "supply": "Pa",
        "smoothing": "Pa",
        "overlap": "1",
    },
    descriptions={
        "spool": "opening of the valve, -1 to 1",
        "load_force": "unknown force against the piston",
        "area_a": "area of the piston",
        "area_b": "area of the piston on the rod's side",
        "dead_volume": "of each chamber with its pipes",
        "bulk": "bulk modulus of the oil",
        "valve": "flow of the open valve per root of the pressure difference",
        "smoothing": "pressure difference below which the flow is nearly linear",
        "overlap": "opening below which the valve connects both sides",
    },
    ranges={
        "position": (0.0, 0.5),
        "velocity": (-0.5, 0.5),
        "pressure_a": (0.0, 2e7),
        "pressure_b": (0.0, 2e7),
        "spool": (-1.0, 1.0),
    },
    noise_std={"position": 1e-5, "pressure_a": 2e4, "pressure_b": 2e4},
    disturbance_bound=1e4,
    x0=[0.2, 0.0, 6e6, 1e7],
    xhat0=[0.2, 0.0, 6e6, 1e7],
    xhat0_std=[1e-3, 0.05, 1e6, 1e6],
    observer=ObserverDefaults(disturbance_rate=1e4 * (2 * math.pi) ** 2),
    disturbance=SignalDefaults(kind="sine", amplitude=5e3, frequency=1.0),
    experiment=Experiment(stop_time=2.0, step_size=1e-3),
)
