"""Plants of any size with sparse equations, for benchmarks over the size of a model."""

from __future__ import annotations

import sympy

from ndob_fmu import Model


def carts(count: int) -> Model:
    """Return carts in a row between springs and dampers, n = 2 `count`: each is connected to its neighbours only.

    The first one hangs on a spring that is no straight line and is pushed by the motor and by the unknown force; its
    place and that of the last one are measured (m = 1, p = 2, q1 = q2 = 1).
    """
    spring, damper = sympy.symbols("spring damper")
    places, speeds = [f"place{i}" for i in range(count)], [f"speed{i}" for i in range(count)]
    A = sympy.zeros(2 * count)
    for i in range(count):
        A[i, count + i] = 1
        for neighbour in {i - 1, i + 1} & set(range(count)):
            A[count + i, neighbour] += spring
            A[count + i, i] -= spring
            A[count + i, count + neighbour] += damper
            A[count + i, count + i] -= damper
    on_first = [[float(i == count)] for i in range(2 * count)]
    return Model(
        name=f"Carts{count}",
        states=places + speeds,
        inputs=["push"],
        outputs=list(dict.fromkeys([places[0], places[-1]])),
        disturbances=["wind"],
        parameters={"spring": 40.0, "damper": 0.5, "soft": 5.0},
        A=A,
        B=on_first,
        C=[
            [float(name == measured) for name in places + speeds] for measured in dict.fromkeys((places[0], places[-1]))
        ],
        G_d=on_first,
        f=lambda x, u, p: [-p.soft * sympy.sin(x.place0)],
        lipschitz=5.0,
        disturbance_bound=5.0,
    )


def lagged_motor(time_constant: float) -> Model:
    """Return a motor with dry friction behind a drive that lags by the given time constant (s), m = p = 1, n = 3."""
    return Model(
        name="LaggedMotor",
        states=["angle", "rate", "torque"],
        inputs=["command"],
        outputs=["angle"],
        disturbances=["load"],
        parameters={"drive_lag": time_constant, "friction": 2.0},
        A=[[0, 1, 0], [-20, 0, 1], [0, 0, -1 / sympy.Symbol("drive_lag")]],
        B=[[0], [0], [1 / sympy.Symbol("drive_lag")]],
        C=[[1, 0, 0]],
        G_d=[[0], [1], [0]],
        f=lambda x, u, p: [-p.friction * sympy.tanh(x.rate)],
        lipschitz=2.0,
        disturbance_bound=5.0,
    )
