"""A torsion spring: what couples two joints."""

from __future__ import annotations


def spring_torques(stiffness: float, angle_a: float, angle_b: float) -> tuple[float, float]:
    """Return the torques (N·m) with which a spring of that stiffness (N·m/rad) pulls two angles (rad) together."""
    torque = stiffness * (angle_b - angle_a)
    return torque, -torque
