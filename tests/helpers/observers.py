"""The sampled-data observer from what a test says of it, and a mass that an unknown force pushes."""

from __future__ import annotations

from ndob_fmu.model.model import Model
from ndob_fmu.runtime.step.sampled_observer import sampled_observer as observer_of_settings
from ndob_fmu.runtime.step.settings import observer_settings

MASS = Model(
    name="Mass",
    states=["position", "rate"],
    inputs=["force"],
    outputs=["position"],
    disturbances=["push"],
    parameters={},
    A=[[0, 1], [0, -0.5]],
    B=[[0], [1]],
    C=[[1, 0]],
    G_d=[[0], [1]],
)


def sampled_observer(equations, parameters, *, x_hat, **settings):
    """Return the observer with these settings; what is not given is the model's default."""
    return observer_of_settings(equations, parameters, observer_settings(equations, **settings), x_hat)
