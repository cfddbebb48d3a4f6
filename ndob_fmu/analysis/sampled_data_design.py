"""The design of the sampled-data observer at one step, for people: gains, predicted errors, bounds, warnings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ndob_fmu.analysis.certificate import Certificate, certify, no_certificate
from ndob_fmu.analysis.error_bars import settled_error_bars, stationary_at
from ndob_fmu.analysis.paper_design import PaperDesign, sorted_poles, table
from ndob_fmu.codegen.compile_model import compile_model
from ndob_fmu.errors import UsageError
from ndob_fmu.model.model import Model
from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.design.lumping import lumped
from ndob_fmu.runtime.design.pace import pace_of, pace_warnings
from ndob_fmu.runtime.design.ranges import continued
from ndob_fmu.runtime.design.tuning import bandwidth_of, predicted_error
from ndob_fmu.runtime.step.sampled_observer import SampledObserver, sampled_observer
from ndob_fmu.runtime.step.settings import observer_settings

# Below this ratio of noise to bias in the predicted error, the step limits the accuracy and not the noise.
_STEP_LIMITS = 0.1


# Keys of `PaperDesign.to_dict`, null where there is no paper's design.
_OF_THE_PAPER = ("L", "W", "M", "Q", "poles", "riccati_residual", "bandwidth", "dc_gain", "noise_gain")


@dataclass(frozen=True)
class SampledDataDesign:
    """The sampled-data design at `step_size` H, and the paper's where its assumptions hold. N = n + r q2.

    model, disturbances: their names.
    paper: the paper's design; its L, W, M, poles and bandwidth are attributes here too. None where it does not exist.
    pi, alpha: π and α (1/s).
    step_size, disturbance_order: H (s) and r.
    noise_std: σ of a sample by the name of its output.
    disturbance_bound, disturbance_rate (q2,): bounds of |d| and |d^{(r)}|.
    K (N,p): gain of the update.
    M_H (q2,p): d̂ = M_H e for r = 0, None for r ≥ 1.
    filter_poles (N,): of (I − K C) Φ.
    equivalent_pi: π = s/(σ²H) of the intensity s on the first disturbance.
    sampled_bandwidth: up to which disturbances are followed, rad/s.
    predicted_bias (q2,): error of d̂ at the sample for a constant r-th derivative at its bound.
    predicted_noise (q2,): standard deviation of d̂ at the sample.
    error_bar, lagged_error_bar (q2,): `<disturbance>_std` and `_lagged_std` once they have settled.
    lag: of the lagged estimate (s).
    certificate: bounds of the errors of the frozen gain, without noise.
    warnings: what to change, one sentence each.
    """

    model: str
    disturbances: tuple[str, ...]
    paper: PaperDesign | None
    pi: float
    alpha: float
    step_size: float
    disturbance_order: int
    noise_std: Mapping[str, float]
    disturbance_bound: tuple[float, ...]
    disturbance_rate: tuple[float, ...]
    K: Array
    M_H: Array | None
    filter_poles: NDArray[np.complex128]
    equivalent_pi: float
    sampled_bandwidth: float
    predicted_bias: Array
    predicted_noise: Array
    error_bar: Array
    lagged_error_bar: Array
    lag: float
    certificate: Certificate
    warnings: tuple[str, ...]

    def __getattr__(self, name: str) -> Any:
        """Return what the paper's design has of that name, None where there is no such design."""
        if name not in _OF_THE_PAPER:
            raise AttributeError(name)
        return None if self.paper is None else getattr(self.paper, name)

    def to_dict(self) -> dict[str, Any]:
        """Return the design in JSON's types; a pole is a pair [real, imaginary], the paper's part null without one."""
        none = {"model": self.model, "pi": self.pi, "alpha": self.alpha, **dict.fromkeys(_OF_THE_PAPER)}
        return {
            **(none if self.paper is None else self.paper.to_dict()),
            "step_size": self.step_size,
            "disturbance_order": self.disturbance_order,
            "noise_std": dict(self.noise_std),
            "disturbance_bound": list(self.disturbance_bound),
            "disturbance_rate": list(self.disturbance_rate),
            "K": self.K.tolist(),
            "M_H": None if self.M_H is None else self.M_H.tolist(),
            "filter_poles": [[pole.real, pole.imag] for pole in self.filter_poles.tolist()],
            "equivalent_pi": self.equivalent_pi,
            "sampled_bandwidth": self.sampled_bandwidth,
            "predicted_bias": self.predicted_bias.tolist(),
            "predicted_noise": self.predicted_noise.tolist(),
            "error_bar": self.error_bar.tolist(),
            "lagged_error_bar": self.lagged_error_bar.tolist(),
            "lag": self.lag,
            "certificate": self.certificate.to_dict(),
            "warnings": list(self.warnings),
        }

    def __str__(self) -> str:
        lines = [
            f"{self.model}: no paper's observer, as its assumptions do not hold"
            if self.paper is None
            else str(self.paper),
            "",
            f"Sampled-data observer at H = {self.step_size:g} s, disturbance order r = {self.disturbance_order}, "
            f"noise {', '.join(f'{sigma:g} in {output}' for output, sigma in self.noise_std.items())}",
            "",
            table("K", self.K),
            *([table("M_H", self.M_H)] if self.M_H is not None else []),
            "",
            f"filter poles      {', '.join(f'{pole:.4g}' for pole in self.filter_poles)}",
            f"bandwidth         {self.sampled_bandwidth:.4g} rad/s, as pi = {self.equivalent_pi:.3g}",
        ]
        for i, name in enumerate(self.disturbances):
            lines.append(
                f"{name}: predicted bias {self.predicted_bias[i]:.3g}, noise {self.predicted_noise[i]:.3g}, "
                f"error bar {self.error_bar[i]:.3g} (one sigma), {self.lagged_error_bar[i]:.3g} "
                + (f"{self.lag:g} s before the sample" if self.lag else "at the sample")
            )
        bounds = self.certificate
        if bounds.exists:
            of_d = ", ".join(
                f"{name} {value:.3g}" for name, value in zip(self.disturbances, bounds.at_sample, strict=True)
            )
            of_x = ", ".join(f"{value:.2g}" for value in bounds.states)
            lines.append(
                f"frozen gain without noise, never more than: {of_d}; states {of_x} (loop gain {bounds.loop_gain:.2g})"
            )
        else:
            why = bounds.lacking or f"the loop gain through f is {bounds.loop_gain:.3g}, not below 1"
            lines.append(f"no bound: {why}")
        return "\n".join([*lines, *(f"warning: {text}" for text in self.warnings)])


def sampled_data_design(
    model: Model,
    *,
    paper: PaperDesign | None,
    pi: float,
    alpha: float,
    step_size: float,
    order: int,
    noise_std: tuple[float, ...],
    disturbance_bound: tuple[float, ...],
    disturbance_rate: tuple[float, ...],
    by_pi: bool,
    parameters: Mapping[str, float] | None,
) -> SampledDataDesign:
    """Design the sampled-data observer of the model for a step H > 0 s; `by_pi`: π sets the intensity, not the rate.

    Raises UsageError for a step over which the plant cannot be predicted, DesignError for values outside their range or
    where no stationary gain can be found.
    """
    equations = continued(lumped(compile_model(model)))

    def observer_for(rate: tuple[float, ...]) -> SampledObserver:
        return sampled_observer(
            equations,
            model.parameter_values(parameters),
            observer_settings(
                equations,
                order=order,
                noise_std=noise_std,
                disturbance_bound=disturbance_bound,
                disturbance_rate=rate,
                adapt_noise=False,
                alpha=alpha,
                pi=pi,
            ),
            equations.xhat0,
        )

    observer = observer_for(disturbance_rate)
    if not observer.longest >= step_size:
        raise UsageError.report(
            "step size", expected=f"at most {observer.longest:.3g} s for {model.name}", received=f"{step_size:g} s"
        )
    known = observer.known
    if by_pi:
        observer = observer_for((0.0,) * len(disturbance_rate))
    found, of_constants = stationary_at(observer, step_size)
    intensity = float(found.intensities.disturbance[-len(known.disturbance_bound)])
    bias, noise = predicted_error(found, known.disturbance_rate)
    error_bar, lagged_error_bar = settled_error_bars(observer, np.array(equations.xhat0), step_size)
    pace = pace_of(
        equations,
        observer.parameters,
        equations.xhat0,
        bound=disturbance_bound,
        rate=disturbance_rate,
        order=order,
    )
    bandwidth = bandwidth_of(observer.tracking.system, step_size, intensity, known)
    lacking = _lacking_for_a_bound(model, of_constants=of_constants)
    return SampledDataDesign(
        model=model.name,
        disturbances=tuple(model.unknown_inputs),
        paper=paper,
        pi=float(pi),
        alpha=float(alpha),
        step_size=step_size,
        disturbance_order=order,
        noise_std=dict(zip(model.outputs, noise_std, strict=True)),
        disturbance_bound=disturbance_bound,
        disturbance_rate=disturbance_rate,
        K=found.K,
        M_H=found.M_H,
        filter_poles=sorted_poles(found.poles),
        equivalent_pi=intensity / (float(np.min(np.diag(known.R_factor))) ** 2 * step_size),
        sampled_bandwidth=min(bandwidth, 1.0 / step_size),
        predicted_bias=bias,
        predicted_noise=noise,
        error_bar=error_bar,
        lagged_error_bar=lagged_error_bar,
        lag=observer.settings.lag,
        certificate=no_certificate(found, lacking)
        if lacking
        else certify(
            found,
            disturbance_rate=known.disturbance_rate,
            disturbance_bound=known.disturbance_bound,
            lipschitz=equations.lipschitz,
            f_states=equations.f_states,
        ),
        warnings=(
            *_warnings(known.disturbance_bound, step_size, bandwidth, bias, noise, by_pi=by_pi),
            *([] if by_pi else pace_warnings(pace, model.unknown_inputs, step_size)),
        ),
    )


def _lacking_for_a_bound(model: Model, *, of_constants: bool) -> str:
    """Return what the proof of a bound lacks; of_constants: whether there is a gain for the constant matrices."""
    if not model.vector_field.has_paper_form:
        return "no constant matrices describe the plant"
    if not of_constants:
        return "there is no gain that takes f for noise"
    if model.f_expressions and model.lipschitz is None:
        return "gamma, the largest slope of f, is not declared (lipschitz)"
    return ""


def _warnings(bound: Array, H: float, bandwidth: float, bias: Array, noise: Array, *, by_pi: bool) -> list[str]:
    found = []
    if by_pi:
        if bandwidth * H > 1.0:
            found.append(
                f"pi asks for a bandwidth of {bandwidth:.3g} rad/s, H ω₀ = {bandwidth * H:.2g}: "
                f"the step is too coarse, the samples carry nothing beyond {1.0 / H:.3g} rad/s"
            )
    elif np.all(noise < _STEP_LIMITS * bias):
        found.append(
            f"the step of {H:g} s limits the accuracy, not the noise: the observer is as fast as the samples allow"
        )
    for i, total in enumerate(bias + noise):
        if total > bound[i]:
            found.append(
                f"the predicted error {total:.3g} of disturbance {i + 1} exceeds its bound {bound[i]:g}: the estimate "
                "tells little; a lower noise, a slower disturbance or another order r is needed"
            )
    return found
