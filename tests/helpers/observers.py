"""The sampled-data observer from what a test says of it."""

from __future__ import annotations

from ndob_fmu.runtime.step.sampled_observer import sampled_observer as observer_of_settings
from ndob_fmu.runtime.step.settings import observer_settings


def sampled_observer(equations, parameters, *, x_hat, **settings):
    """Return the observer with these settings; what is not given is the model's default."""
    return observer_of_settings(equations, parameters, observer_settings(equations, **settings), x_hat)
