"""Continuous stirred tank reactor: only the temperature is measured, the temperature of the feed is unknown.

    substance:  ċ = dilution · (feed_concentration − c) − k(T) · c,         k(T) = k0 · exp(−activation / T)
    heat:       Ṫ = dilution · (feed_temperature − T) + heat · k(T) · c + cooling · (coolant_temperature − T)

The reaction heats the tank and runs the faster, the hotter the tank is: at 350 K the reactor is unstable without
control. The feed has about 350 K, and the disturbance is counted from there (`disturbance_nominal`). The
concentration is not measured; it follows from the temperature. A thermometer with 0.1 K of noise, a sample every
second. SI units, and mol/l.
"""

import math

import sympy

from ndob_fmu import Experiment, Model, ObserverDefaults, SignalDefaults


def dynamics(x, u, d, p):
    """Return the rates of concentration and temperature."""
    reaction = p.k0 * sympy.exp(-p.activation / x.temperature) * x.concentration
    return [
        p.dilution * (p.feed_concentration - x.concentration) - reaction,
        p.dilution * (d.feed_temperature - x.temperature)
        + p.heat * reaction
        + p.cooling * (u.coolant_temperature - x.temperature),
    ]


model = Model(
    name="StirredTank",
    description="Stirred tank reactor with an unknown feed temperature",
    states=["concentration", "temperature"],
    inputs=["coolant_temperature"],
    outputs=["temperature"],
    disturbances=["feed_temperature"],
    dynamics=dynamics,
    parameters={
        "dilution": 1 / 60,
        "feed_concentration": 1.0,
        "k0": 1.2e9,
        "activation": 8750.0,
        "heat": 209.2,
        "cooling": 2.092 / 60,
    },
    units={
        "concentration": "mol/l",
        "temperature": "K",
        "coolant_temperature": "K",
        "feed_temperature": "K",
        "dilution": "1/s",
        "feed_concentration": "mol/l",
        "k0": "1/s",
        "activation": "K",
        "heat": "K.l/mol",
        "cooling": "1/s",
    },
    descriptions={
        "feed_temperature": "unknown temperature of the feed",
        "dilution": "flow of the feed per volume of the tank",
        "activation": "activation energy over the gas constant",
        "heat": "rise of the temperature per concentration that has reacted",
        "cooling": "heat transfer to the coolant per heat capacity",
    },
    ranges={"concentration": (0.0, 1.0), "temperature": (300.0, 420.0), "coolant_temperature": (270.0, 330.0)},
    noise_std=0.1,
    disturbance_bound=30.0,
    disturbance_nominal=350.0,
    x0=[0.5, 350.0],
    xhat0=[0.45, 350.0],
    xhat0_std=[0.05, 0.5],
    observer=ObserverDefaults(disturbance_rate=30.0 * (2 * math.pi / 600.0) ** 2),
    disturbance=SignalDefaults(kind="sine", amplitude=15.0, frequency=1 / 600),
    experiment=Experiment(stop_time=1800.0, step_size=1.0),
)
