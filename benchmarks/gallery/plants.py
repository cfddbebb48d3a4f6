"""The plants of the gallery: files of `examples/` with the controller that moves them in a record."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np

from benchmarks.estimator.plants import Array, Plant
from benchmarks.estimator.textbook import filtered_rate, textbook_plant

Memory = dict[str, Array]


def _integral(error: Array, gain: float, limit: float, memory: Memory, name: str, H: float) -> Array:
    """Return the integral of an error times a gain, within ±limit, for a controller."""
    memory[name] = np.clip(memory.get(name, 0.0) + gain * H * error, -limit, limit)
    return memory[name]


def _arm_control(t: float, y: Array, memory: Memory, H: float) -> Array:
    """Return the torques of a proportional and differential controller of each joint along sines."""
    wanted = np.array([1.2 + 0.8 * np.sin(2.5 * t), 0.6 * np.sin(1.5 * t)])  # elbow, shoulder
    rates = filtered_rate(y, memory, "angles", H, 5e-3)
    elbow, shoulder = ([8.0, 30.0] * (wanted - y) - [1.0, 5.0] * rates).T
    return np.column_stack([shoulder, elbow])


def _levitator_control(t: float, y: Array, memory: Memory, H: float) -> Array:
    """Return the voltage of a controller of the gap with a controller of the current inside."""
    gap, current = y.T
    error = gap - (0.010 + 0.002 * np.sin(3.0 * t))
    rate = filtered_rate(gap, memory, "gap", H, 3e-3)
    wanted = 0.70 + 300.0 * error + 5.0 * rate + _integral(error, 600.0, 0.5, memory, "integral", H)
    return np.clip(2.0 * wanted + 20.0 * (wanted - current), -12.0, 12.0)[:, None]


def _quadrotor_control(t: float, y: Array, memory: Memory, H: float) -> Array:
    """Return the thrusts of controllers of the height, of the way across, and of the pitch inside."""
    across, up, pitch, pitch_rate = y.T
    rate_across = filtered_rate(across, memory, "across", H, 0.03)
    rate_up = filtered_rate(up, memory, "up", H, 0.03)
    error_across, error_up = np.sin(0.8 * t) - across, 1.0 + 0.5 * np.sin(0.5 * t) - up
    integral_across = _integral(error_across, 1.5, 3.0, memory, "integral across", H)
    integral_up = _integral(error_up, 4.0, 4.0, memory, "integral up", H)
    tilt = np.clip(-(4.0 * error_across - 3.0 * rate_across + integral_across) / 9.81, -0.5, 0.5)
    thrust = 1.2 * (9.81 + 9.0 * error_up - 5.0 * rate_up + integral_up)
    turn = 0.02 / 0.2 * (80.0 * (tilt - pitch) - 14.0 * pitch_rate)
    return np.clip(0.5 * np.column_stack([thrust - turn, thrust + turn]), 0.0, 15.0)


def _cylinder_control(t: float, y: Array, memory: Memory, H: float) -> Array:
    """Return the opening of the valve of a proportional controller of the position."""
    wanted = 0.2 + 0.05 * (1.0 - np.cos(2.5 * t))
    return np.clip(20.0 * (wanted - y[:, :1]) + 0.15 * np.sin(2.5 * t), -1.0, 1.0)


def _motor_control(t: float, y: Array, memory: Memory, H: float) -> Array:
    """Return the voltages of a speed controller with current controllers inside."""
    angle, i_d, i_q = y.T
    rate = filtered_rate(angle, memory, "angle", H, 5e-3)
    error = 60.0 + 40.0 * np.sin(5.0 * t) - rate
    wanted = np.clip(0.15 * error + _integral(error, 2.0, 10.0, memory, "integral", H), -15.0, 15.0)
    electric = 4.0 * rate
    v_d = -0.3 * i_d - electric * 1e-3 * i_q
    v_q = 0.5 * wanted + 0.3 * (wanted - i_q) + electric * (0.05 + 1e-3 * i_d)
    return np.column_stack([v_d, v_q])


def _tank_control(t: float, y: Array, memory: Memory, H: float) -> Array:
    """Return the temperature of the coolant of a proportional and integral controller."""
    error = 350.0 + 3.0 * np.sin(2.0 * np.pi * t / 900.0) - y[:, 0]
    coolant = 300.0 + 8.0 * error + _integral(error, 0.04, 15.0, memory, "integral", H)
    return np.clip(coolant, 270.0, 330.0)[:, None]


def _two_link_arm() -> Plant:
    encoder = 2.0 * np.pi / 2**17
    return textbook_plant(
        "two_link_arm", _arm_control, pace=1.0, substep=1e-3, resolution={"shoulder": encoder, "elbow": encoder}
    )


def _magnetic_levitator() -> Plant:
    return textbook_plant("magnetic_levitator", _levitator_control, pace=2.0, substep=5e-4)


def _planar_quadrotor() -> Plant:
    return textbook_plant("planar_quadrotor", _quadrotor_control, pace=0.5, substep=2.5e-3)


def _hydraulic_cylinder() -> Plant:
    return textbook_plant("hydraulic_cylinder", _cylinder_control, pace=1.0, substep=5e-4)


def _pmsm() -> Plant:
    return textbook_plant("pmsm", _motor_control, pace=2.0, substep=2e-4, resolution={"angle": 2.0 * np.pi / 2**14})


def _stirred_tank() -> Plant:
    return textbook_plant("stirred_tank", _tank_control, pace=1.0 / 600.0, substep=0.5)


_MADE: tuple[Callable[[], Plant], ...] = (
    _two_link_arm,
    _magnetic_levitator,
    _planar_quadrotor,
    _hydraulic_cylinder,
    _pmsm,
    _stirred_tank,
)


@cache
def gallery_plants() -> tuple[Plant, ...]:
    """Return the plants of the gallery."""
    return tuple(make() for make in _MADE)
