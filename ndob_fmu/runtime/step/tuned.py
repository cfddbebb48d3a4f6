"""What an observer is tuned to at its first step, which tells H, and when its gain is frozen."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.base_errors import DesignError
from ndob_fmu.runtime.design.intensity_law import IntensityLaw
from ndob_fmu.runtime.design.start_up import start_up
from ndob_fmu.runtime.design.stationary_design import Intensities
from ndob_fmu.runtime.design.step_designs import StepDesign, StepDesigns
from ndob_fmu.runtime.design.tuning import Search, each_bandwidth, squared_errors
from ndob_fmu.runtime.generated_steps import Numbers
from ndob_fmu.runtime.step.adaptive_noise import LEAST_RATIO, for_a_frozen_gain, is_settled, weight_of
from ndob_fmu.runtime.step.converged_step import STEADY, frozen_memory, has_converged, is_near, is_quiet, least_squares
from ndob_fmu.runtime.step.filter_model import FilterModel
from ndob_fmu.runtime.step.filter_state import FilterMemory, SampledObserverState
from ndob_fmu.runtime.step.measurement_update import Measured
from ndob_fmu.runtime.step.preparation import PreparedObserver

# A frozen gain that takes f for noise is as good as one that follows f's slopes up to this ratio of predicted errors.
_AS_GOOD = 1.01
# The most that f may move a state over a step, in natural units, while a frozen gain takes it for noise.
_SLOW_F = 0.5


@dataclass(frozen=True)
class Tuned:
    """The observer tuned for steps about H (s).

    model: its constants
    intensities: of the noise at H
    law: of the intensities for other steps and noises
    to_own_order (q2,): factors on the intensities where disturbances have orders of their own
    freezes: whether a frozen gain is as good as the running covariance
    """

    H: float
    model: FilterModel
    intensities: Intensities
    law: IntensityLaw | None
    to_own_order: Array
    freezes: bool

    def intensity(self, H: float, noise: Sequence[float]) -> Array:
        """Return the intensity (q2,) behind each d's r-th derivative at a step H (s), for factors (p,) on σ²."""
        at_tuned = self.intensities.disturbance * self.intensities.scale**2 * self.to_own_order
        if self.law is None or (self.H == H and all(ratio == 1.0 for ratio in noise)):
            return np.asarray(at_tuned)
        return self.law.scaled(at_tuned, self.H, H, noise)


def tune(observer: PreparedObserver, H: float) -> Tuned:
    """Return what is tuned for steps about H (s). Raises DesignError where there is no tuning."""
    if observer.layout.order == 0:
        intensities = observer.designs.intensities(H)
        return Tuned(
            H,
            filter_model(observer, intensities.scale, 0.0),
            intensities,
            None,
            np.ones(observer.layout.q),
            freezes=_may_freeze(observer),
        )
    slopes, may_freeze = _judged(observer.tracking, H), _may_freeze(observer) and _f_is_slow(observer, H)
    f_as_noise = _judged(observer.designs, H) if slopes is None or may_freeze else None
    designs = observer.designs if slopes is None and f_as_noise is not None else observer.tracking
    judged = f_as_noise if slopes is None else slopes
    if judged is not None:
        intensities, error, searched = judged.intensities, judged.error, judged.searched
        if slopes is None:
            error = np.inf
    else:
        intensities, error, searched = designs.intensities(H), np.inf, None  # says why there is no tuning
    freezes = False
    if f_as_noise is not None and may_freeze:
        freezes = f_as_noise.error <= _AS_GOOD**2 * error and f_as_noise.error < np.inf
        if freezes:
            intensities = f_as_noise.intensities
    return tuned_to(observer, H, intensities, designs.law(H, searched), freezes=freezes)


def tuned_to(
    observer: PreparedObserver, H: float, intensities: Intensities, law: IntensityLaw, *, freezes: bool
) -> Tuned:
    """Return what is tuned for steps about H (s) where the intensities and their law are known; for r ≥ 1."""
    bandwidths = each_bandwidth(observer.tracking.system, H, intensities.disturbance, observer.known)
    # White noise behind fewer derivatives has the same spectrum at the disturbance's bandwidth.
    fewer = np.array([observer.layout.order - own for own in observer.layout.own], dtype=float)
    model = filter_model(observer, intensities.scale, 0.25 / float(bandwidths[0]))
    return Tuned(H, model, intensities, law, bandwidths ** (-2.0 * fewer), freezes=freezes)


class _Judged(NamedTuple):
    """The intensities for a step, J with them, and the search for them, None with π."""

    intensities: Intensities
    error: float
    searched: Search | None


def _judged(designs: StepDesigns, H: float) -> _Judged | None:
    """Return the intensities for steps H (s) and how good they are; None where there is no design."""
    try:
        searched = designs.searched(H)
        intensities = designs.intensities(H, searched)
        stationary = designs.at(H, tuned=intensities).stationary
    except DesignError:
        return None
    return _Judged(intensities, sum(squared_errors(stationary, designs.known)), searched)


def _f_is_slow(observer: PreparedObserver, H: float) -> bool:
    """Return whether the slopes of f at x̂₀ move the states little over a step H (s), so that f can pass for noise."""
    n, units = observer.layout.n, observer.tracking.system.units[: observer.layout.n]
    slopes = observer.tracking.system.A[:n, :n] - observer.designs.system.A[:n, :n]
    return bool(np.max(np.sum(np.abs(slopes * units / units[:, None]), axis=0)) * H <= _SLOW_F)


def _may_freeze(observer: PreparedObserver) -> bool:
    """Return whether a constant gain can do all that the observer was asked for."""
    settings, layout = observer.settings, observer.layout
    plain = not (
        layout.biased
        or layout.uncertain
        or any(settings.sensors.delay)
        or any(settings.state_noise)
        or any(observer.undriven)
        or layout.is_mixed
    )
    # Outside the paper's form no constant matrices hold wherever the plant is.
    return plain and settings.lag == 0.0 and observer.equations.matrices is not None


def filter_model(observer: PreparedObserver, scale: float, jump_spacing: float) -> FilterModel:
    """Return the observer's constants, for a factor on the standard deviations of all noises and a spacing (s)."""
    settings = observer.settings
    start = start_up(observer.system, observer.known, np.array(settings.x_std, dtype=float))
    return FilterModel(
        equations=observer.equations,
        parameters=observer.parameters,
        settings=settings,
        layout=observer.layout,
        noise_variance=(observer.noise_std * scale) ** 2,
        scale=scale,
        start_std=np.concatenate(
            [
                np.diag(start.factor) * np.concatenate([np.ones(observer.layout.n), observer.layout.carried]),
                [settings.sensors.bias_std[i] for i in observer.layout.biased],
                [settings.parameter_std[i] for i in observer.layout.uncertain],
            ]
        ),
        undriven=observer.undriven,
        doubtful=observer.doubtful,
        like_disturbance=observer.like_disturbance,
        natural_units=observer.tracking.system.units,
        least_noise=np.ones(len(observer.noise_std))
        if scale > 1.0
        else np.maximum((observer.rounding / observer.noise_std) ** 2, LEAST_RATIO),
        jump_spacing=jump_spacing,
    )


def frozen(
    tuned: Tuned,
    design_at: Callable[[float, float, Numbers], StepDesign],
    after: SampledObserverState,
    measured: Measured,
    H: float,
    before: float,
) -> SampledObserverState:
    """Return the state after a step H (s) with a frozen gain, where that is as good from now on.

    before: the step before (s)
    design_at: design_at(H, tuned_at, noise) returns the design for a step H (s), as `StepDesigns.at`
    """
    memory, model = after.memory, tuned.model
    started = memory.age >= model.start_samples and memory.steady >= STEADY
    if not (tuned.freezes and started) or memory.lost or memory.model_error > 0.0:
        return after
    # What holds the plant hides the disturbance, and the covariance must say how long.
    if model.is_on_a_surface(np.array(after.xi_hat), after.u):
        return after
    if measured.suspicious or (model.adapts and not _noise_is_settled(model, memory, measured)):
        return after
    noise = for_a_frozen_gain(model.noise_ratios(memory.sensors), model.least_noise.tolist())
    # Where steps jitter, the gain is that of the usual one.
    step = H if before == H or not is_near(tuned.H, H) else tuned.H
    try:
        design = design_at(step, tuned.H, noise)
    except DesignError:
        return after
    if not (is_quiet(measured, least_squares(model, noise, design)) and has_converged(memory, design)):
        return after
    return replace(after, memory=frozen_memory(model, memory, design, noise))


def _noise_is_settled(model: FilterModel, memory: FilterMemory, measured: Measured) -> bool:
    """Return whether the noise in use will stay."""
    used = model.noise_used(memory.sensors)
    return all(
        is_settled(sensor.noise_ratio, sensor.counted, weight_of(noise, std**2))
        for sensor, noise, std in zip(memory.sensors, used, measured.prediction.std, strict=True)
    )
