"""The plants of the estimator's benchmark: their models for this package, their equations by hand, and their control.

    JOINT       flexible joint, the paper's example
    CYLINDER    hydraulic cylinder, position and chamber pressure measured
    MOTOR       synchronous motor with permanent magnets, angle and both currents measured
    ARM         two-joint arm with a force on its tool, the example with a state-dependent channel
    LAG         pendulum whose drive follows its input with a time constant of 1 µs; UNLAGGED follows it at once

The equations by hand serve the truth and the estimators that we compare with; only ours reads the model.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache
from math import pi
from pathlib import Path
from typing import Any

import numpy as np
import sympy
from numpy.typing import NDArray

from ndob_fmu import Model, load_model

Array = NDArray[np.float64]
Parameters = Mapping[str, Any]
Slope = Callable[[Any, Any, Any, Parameters], Any]
Control = Callable[[float, Array, dict[str, Array], float], Array]


@dataclass(frozen=True, eq=False)
class Plant:
    """A plant with all that its observers are told. Its disturbances are sines of amplitude D₀/2.

    model: returns the model, from which the FMU is made
    slope: ẋ(x (…,n), u (…,m), d (…,q), parameters) by hand, also for complex x
    control: u (B,m) from t (s), the samples y (B,p), a memory of its own and H (s)
    C: (p,n), the outputs
    x0, x_hat, x_std: (n,), the start, its estimate, and that estimate's standard deviation
    sigma: (p,), standard deviation of the noise in a sample
    bound: D₀, a number or (q,)
    substep: s, the longest step of the integration by Runge–Kutta
    stop_time: s, of a record
    pace: Hz, of the sines, and of the class in which a disturbance is declared: |d^{(r)}| ≤ D₀ (2π pace)^r
    nominal: value about which a disturbance is small, a number or (q,)
    resolution: (p,), to which samples are rounded, 0 for none; None for none at all. A rounded one has no other noise
    """

    name: str
    model: Callable[[], Model]
    parameters: Mapping[str, float]
    slope: Slope
    control: Control
    C: Array
    x0: Array
    x_hat: Array
    x_std: Array
    sigma: Array
    bound: float | Array
    substep: float
    stop_time: float
    pace: float = 1.0
    nominal: float | Array = 0.0
    resolution: Array | None = None

    @property
    def bounds(self) -> Array:
        """D₀ (q,)."""
        return np.atleast_1d(self.bound)

    def rates(self, order: int) -> Array:
        """Return the declared bounds of the r-th derivatives (q,), of the first ones for r = 0."""
        return np.asarray(self.bounds * (2.0 * pi * self.pace) ** max(order, 1))

    def rate(self, order: int) -> float:
        """Return that of the first disturbance."""
        return float(self.rates(order)[0])

    def sampled(self, y: Array, noise: Array) -> Array:
        """Return samples of the outputs y (…,p), with noise (…,p) where they are not rounded."""
        if self.resolution is None:
            return y + noise
        width = np.where(self.resolution > 0.0, self.resolution, 1.0)
        return np.where(self.resolution > 0.0, width * np.round(y / width), y + noise)


def _slope(*rows: Any) -> Any:
    return np.stack(np.broadcast_arrays(*rows), axis=-1)


def _rows_of_identity(n: int, *rows: int) -> Array:
    return np.eye(n)[list(rows)]


# -- flexible joint


def _joint_slope(x: Any, u: Any, d: Any, p: Parameters) -> Any:
    spring = p["joint_stiffness"] * (x[..., 0] - x[..., 2])
    return _slope(
        x[..., 1],
        -spring - p["gravity_torque"] * np.sin(x[..., 0]),
        x[..., 3],
        spring - p["motor_damping"] * x[..., 3] + u[..., 0] + d[..., 0],
    )


def _no_control(inputs: int) -> Control:
    return lambda t, y, memory, H: np.zeros((len(y), inputs))


JOINT = Plant(
    name="joint",
    model=cache(lambda: load_model("flexible_joint")),
    parameters={"gravity_torque": 10.0, "joint_stiffness": 1.0, "motor_damping": 1.0},
    slope=_joint_slope,
    control=_no_control(1),
    C=_rows_of_identity(4, 2, 0),
    x0=np.ones(4),
    x_hat=-np.ones(4),
    x_std=np.full(4, 2.0),
    sigma=np.full(2, 1e-4),
    bound=5.0,
    substep=1e-3,
    stop_time=3.0,
)


# -- hydraulic cylinder


@cache
def _cylinder_model() -> Model:
    mass, damping, stiffness, leakage = sympy.symbols("mass damping stiffness leakage")
    return Model(
        name="Cylinder",
        description="Hydraulic cylinder with a servo valve, in m, m/s and MPa",
        states=["position", "speed", "pressure"],
        inputs=["valve"],
        outputs=["position", "pressure"],
        disturbances=["load_force"],
        A=[[0, 1, 0], [0, -damping / mass, 1000 / mass], [0, -stiffness, -stiffness * leakage]],
        B=[[0], [0], [0]],
        C=[[1, 0, 0], [0, 0, 1]],
        G_d=[[0], [1 / mass], [0]],
        G_f=[[0], [0], [1]],
        f=lambda x, u, p: [
            p.stiffness
            * p.gain
            * u.valve
            * sympy.sqrt(sympy.sqrt((20 - x.pressure * sympy.tanh(10 * u.valve)) ** 2 + 1e-2))
        ],
        parameters={"mass": 50.0, "damping": 200.0, "stiffness": 200.0, "leakage": 0.01, "gain": 0.05},
        lipschitz=6.0,
        disturbance_bound=1000.0,
    )


def _cylinder_slope(x: Any, u: Any, d: Any, p: Parameters) -> Any:
    flow = np.sqrt(np.sqrt((20.0 - x[..., 2] * np.tanh(10.0 * u[..., 0])) ** 2 + 0.01))
    return _slope(
        x[..., 1],
        (1000.0 * x[..., 2] - p["damping"] * x[..., 1] + d[..., 0]) / p["mass"],
        p["stiffness"] * (-x[..., 1] - p["leakage"] * x[..., 2] + p["gain"] * u[..., 0] * flow),
    )


def _cylinder_control(t: float, y: Array, memory: dict[str, Array], H: float) -> Array:
    return np.asarray(np.clip(15.0 * (0.1 * np.sin(2.0 * t) - y[:, :1]), -1.0, 1.0))


CYLINDER = Plant(
    name="cylinder",
    model=_cylinder_model,
    parameters={"mass": 50.0, "damping": 200.0, "stiffness": 200.0, "leakage": 0.01, "gain": 0.05},
    slope=_cylinder_slope,
    control=_cylinder_control,
    C=_rows_of_identity(3, 0, 2),
    x0=np.zeros(3),
    x_hat=np.array([0.01, 0.05, 0.1]),
    x_std=np.array([0.01, 0.1, 0.2]),
    sigma=np.full(2, 1e-4),
    bound=1000.0,
    substep=2.5e-4,
    stop_time=2.0,
)


# -- synchronous motor

_POLE_PAIRS = 4


@cache
def _motor_model() -> Model:
    inertia, friction, resistance, inductance, flux = sympy.symbols("inertia friction resistance inductance flux")
    torque = sympy.Rational(3, 2) * _POLE_PAIRS * flux / inertia
    return Model(
        name="Motor",
        description="Synchronous motor with permanent magnets in the rotor's coordinates",
        states=["angle", "rate", "i_d", "i_q"],
        inputs=["v_d", "v_q"],
        outputs=["angle", "i_d", "i_q"],
        disturbances=["load_torque"],
        A=[
            [0, 1, 0, 0],
            [0, -friction / inertia, 0, torque],
            [0, 0, -resistance / inductance, 0],
            [0, -_POLE_PAIRS * flux / inductance, 0, -resistance / inductance],
        ],
        B=[[0, 0], [0, 0], [1 / inductance, 0], [0, 1 / inductance]],
        C=[[1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]],
        G_d=[[0], [-1 / inertia], [0], [0]],
        G_f=[[0, 0], [0, 0], [1, 0], [0, 1]],
        f=lambda x, u, p: [_POLE_PAIRS * x.rate * x.i_q, -_POLE_PAIRS * x.rate * x.i_d],
        parameters={"inertia": 1e-3, "friction": 1e-3, "resistance": 0.5, "inductance": 1e-3, "flux": 0.05},
        lipschitz=450.0,
        disturbance_bound=0.5,
    )


def _motor_slope(x: Any, u: Any, d: Any, p: Parameters) -> Any:
    rate, i_d, i_q = x[..., 1], x[..., 2], x[..., 3]
    electric = _POLE_PAIRS * rate
    return _slope(
        rate,
        (1.5 * _POLE_PAIRS * p["flux"] * i_q - p["friction"] * rate - d[..., 0]) / p["inertia"],
        (u[..., 0] - p["resistance"] * i_d) / p["inductance"] + electric * i_q,
        (u[..., 1] - p["resistance"] * i_q - electric * p["flux"]) / p["inductance"] - electric * i_d,
    )


def _motor_control(t: float, y: Array, memory: dict[str, Array], H: float) -> Array:
    """Return the voltages of a speed controller: proportional and integral, on the filtered difference of the angle."""
    angle, i_d, i_q = y.T
    zero = np.zeros(len(y))
    difference = (angle - memory.get("angle", angle)) / H
    before = memory.get("rate", zero)
    rate = before + min(1.0, H / 0.02) * (difference - before)
    error = 60.0 + 20.0 * np.sin(3.0 * t) - rate
    integral = np.clip(memory.get("integral", zero) + 0.5 * H * error, -8.0, 8.0)
    memory.update(angle=angle, rate=rate, integral=integral)
    wanted = np.clip(0.08 * error + integral, -10.0, 10.0)
    v_d = -0.2 * i_d - 0.5 * _POLE_PAIRS * 1e-3 * rate * i_q
    v_q = 0.5 * wanted + _POLE_PAIRS * 0.05 * rate + 0.2 * (wanted - i_q)
    return np.column_stack([v_d, v_q])


MOTOR = Plant(
    name="motor",
    model=_motor_model,
    parameters={"inertia": 1e-3, "friction": 1e-3, "resistance": 0.5, "inductance": 1e-3, "flux": 0.05},
    slope=_motor_slope,
    control=_motor_control,
    C=_rows_of_identity(4, 0, 2, 3),
    x0=np.array([0.0, 50.0, 0.0, 1.0]),
    x_hat=np.array([0.0, 45.0, 0.0, 0.5]),
    x_std=np.array([0.01, 5.0, 0.5, 0.5]),
    sigma=np.full(3, 1e-3),
    bound=0.5,
    substep=1e-4,
    stop_time=2.0,
)


# -- two-joint arm


@cache
def _arm_model() -> Model:
    return load_model(str(Path(__file__).parents[2] / "examples" / "tool_on_arm.py"))


def _arm_slope(x: Any, u: Any, d: Any, p: Parameters) -> Any:
    shoulder, elbow = x[..., 1], x[..., 3]
    lever = p["forearm"] + p["upper_arm"] * np.cos(x[..., 2])
    friction = p["shoulder_friction"] * np.tanh(shoulder / p["friction_rate"])
    elbow_friction = p["elbow_friction"] * np.tanh(elbow / p["friction_rate"])
    torque = u[..., 0] - p["shoulder_damping"] * shoulder - friction + lever * d[..., 0]
    elbow_torque = u[..., 1] - p["elbow_damping"] * elbow - elbow_friction + p["forearm"] * d[..., 0]
    return _slope(shoulder, torque / p["shoulder_inertia"], elbow, elbow_torque / p["elbow_inertia"])


ARM = Plant(
    name="arm",
    model=_arm_model,
    parameters=_arm_model().parameters,
    slope=_arm_slope,
    control=_no_control(2),
    C=_rows_of_identity(4, 2, 0),
    x0=np.array([0.3, 0.0, -0.5, 4.0]),
    x_hat=np.array([0.3, 0.0, -0.5, 0.0]),
    x_std=np.array([1e-2, 2.0, 1e-2, 4.0]),
    sigma=np.full(2, 6e-6),
    bound=20.0,
    substep=5e-4,
    stop_time=2.0,
)


# -- pendulum with a fast drive


@cache
def _lag_model() -> Model:
    time_constant, damping = sympy.symbols("time_constant damping")
    return Model(
        name="Lag",
        description="Pendulum with a fast drive",
        states=["angle", "rate", "torque"],
        inputs=["command"],
        outputs=["angle"],
        disturbances=["load"],
        A=[[0, 1, 0], [0, -damping, 1], [0, 0, -1 / time_constant]],
        B=[[0], [0], [1 / time_constant]],
        C=[[1, 0, 0]],
        G_d=[[0], [1], [0]],
        f=lambda x, u, p: [-p.gravity * sympy.sin(x.angle)],
        parameters={"time_constant": 1e-6, "damping": 1.0, "gravity": 10.0},
        lipschitz=10.0,
        disturbance_bound=5.0,
    )


def _lag_slope(x: Any, u: Any, d: Any, p: Parameters) -> Any:
    torque = (u[..., 0] - x[..., 2]) / p["time_constant"]
    return _slope(x[..., 1], x[..., 2] - _held_back(x, p) + d[..., 0], torque)


def _unlagged_slope(x: Any, u: Any, d: Any, p: Parameters) -> Any:
    return _slope(x[..., 1], u[..., 0] - _held_back(x, p) + d[..., 0], 0.0 * x[..., 2])


def _held_back(x: Any, p: Parameters) -> Any:
    return p["damping"] * x[..., 1] + p["gravity"] * np.sin(x[..., 0])


LAG = Plant(
    name="lag",
    model=_lag_model,
    parameters={"time_constant": 1e-6, "damping": 1.0, "gravity": 10.0},
    slope=_lag_slope,
    control=lambda t, y, memory, H: np.full((len(y), 1), np.sin(2.0 * pi * t)),
    C=_rows_of_identity(3, 0),
    x0=np.array([0.5, 0.0, 0.0]),
    x_hat=np.zeros(3),
    x_std=np.ones(3),
    sigma=np.full(1, 1e-4),
    bound=5.0,
    substep=1e-3,
    stop_time=2.0,
)
UNLAGGED = replace(LAG, name="unlagged", slope=_unlagged_slope)

PLANTS = (JOINT, CYLINDER, MOTOR, ARM)
