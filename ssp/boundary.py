"""Names at the boundary of the shipped systems: inputs and outputs for use as one block of another system.

They stand in packages of their own, ``<system>_boundary``: libcosim and ecos refuse a connection that has an end at the
boundary, other tools make the inputs and outputs of the whole from nothing else.
"""

from __future__ import annotations

from collections.abc import Mapping

from ndob_fmu.cosim import System

# What is shown of a plant and of its observer, by component; a suffix of the component follows the name.
_SEEN = {
    "plant": ("link_angle", "link_rate", "motor_angle", "motor_rate", "load_torque_total"),
    "observer": (
        *("link_angle_hat", "link_rate_hat", "motor_angle_hat", "motor_rate_hat"),
        *("load_torque_hat", "load_torque_std", "valid"),
    ),
}


def with_boundary(system: System, inputs: Mapping[str, tuple[str, ...]], outputs: Mapping[str, str]) -> System:
    """Return the system with these names at its boundary, and names for the outputs of all plants and observers.

    inputs: name → the inputs of components that it drives. outputs: name → the output of a component.
    """
    for name, ports in inputs.items():
        system = system.expose(name, *ports)
    for component in system.components:
        kind, _, suffix = component.partition("_")
        for variable in _SEEN.get(kind, ()):
            system = system.expose(f"{variable}_{suffix}" if suffix else variable, f"{component}.{variable}")
    for name, port in outputs.items():
        system = system.expose(name, port)
    return system
