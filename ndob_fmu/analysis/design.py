"""The design of a model's observer: the assumptions, the gain, and the accuracy that the gain gives."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ndob_fmu.analysis.assumptions import required
from ndob_fmu.analysis.paper_design import PaperDesign, sorted_poles
from ndob_fmu.analysis.sampled_data_design import SampledDataDesign, sampled_data_design
from ndob_fmu.codegen.compile_model import compile_model, linear_part
from ndob_fmu.errors import UsageError
from ndob_fmu.model.checks import by_name, require_bounds, require_not_negative
from ndob_fmu.model.model import Model, require_model
from ndob_fmu.runtime.design.gains import paper_gains
from ndob_fmu.runtime.design.lumping import lumped_bound, lumped_rate
from ndob_fmu.runtime.equations import Equations
from ndob_fmu.support.progress import begin


def design(
    model: Model,
    *,
    pi: float | None = None,
    alpha: float | None = None,
    step_size: float | None = None,
    disturbance_order: int | None = None,
    noise_std: float | Mapping[str, float] | None = None,
    disturbance_bound: float | Sequence[float] | None = None,
    disturbance_rate: float | Sequence[float] | None = None,
    parameters: Mapping[str, float] | None = None,
) -> PaperDesign | SampledDataDesign:
    """Design the paper's observer; with a `step_size`, the sampled-data observer for that step as well.

    pi, alpha: π > 0 and α > 0 (1/s) of the paper. A given π also sets the intensity of the sampled-data observer.
    step_size: H in s; None for the paper's observer alone. Where its assumptions do not hold, the model's own method
        is 2 and neither π nor α is given, None stands for the step of the default experiment.
    disturbance_order: r = 0 … 3.
    noise_std: σ of the noise in a sample of an output, {output: σ}, or one number for all.
    disturbance_bound: D₀, one number or one for each disturbance.
    disturbance_rate: the bound of |d^{(r)}| (of |ḋ| for r = 0), likewise.

    Values that are not given are the model's. For a disturbance with a channel the design is that of the lumped
    inputs n_j d.

    Raises UsageError for an invalid π, α or step, and for r, σ or bounds without a step_size; ModelError for an unknown
    output, and for a σ, a bound or a rate that the model could not have; AssumptionError if the model's method lacks
    what it needs, or if a given π or α without a step_size asks for the paper's observer and one of its assumptions
    fails; DesignError for an invalid r, or if a gain is not accurate enough.
    """
    require_model(model)
    if step_size is None:
        _require_none_given(
            disturbance_order=disturbance_order,
            noise_std=noise_std,
            disturbance_bound=disturbance_bound,
            disturbance_rate=disturbance_rate,
        )
    of_the_paper = step_size is None and not (pi is None and alpha is None)
    expert = pi
    pi = model.observer.pi_end if pi is None else pi
    alpha = model.observer.alpha if alpha is None else alpha
    if not (np.isfinite(pi) and pi > 0):
        raise UsageError.report("pi", expected="a finite number > 0", received=repr(pi))
    report = required(model, alpha=alpha, parameters=parameters)
    paper = None
    if of_the_paper or report.holds("method 1"):
        report.require("method 1")
        begin(f"designing the observer of {model.name} for pi = {pi:g}")
        paper = _continuous(model, pi, alpha, parameters)
        if step_size is None:
            return paper
    if step_size is None:
        step_size = model.experiment.step_size
    if not (np.isfinite(step_size) and step_size > 0):
        raise UsageError.report("step size", expected="a finite time > 0 s", received=repr(step_size))
    begin(f"designing the observer of {model.name} for steps of {step_size:g} s")
    order = model.observer.disturbance_order if disturbance_order is None else disturbance_order
    equations, q = compile_model(model), len(model.disturbances)
    bound, default = equations.disturbance_bound, equations.disturbance_rate
    if disturbance_bound is not None:
        bound = require_bounds("disturbance_bound", disturbance_bound, q, positive=True)
    if order != model.observer.disturbance_order or disturbance_bound is not None:
        default = tuple(
            value * omega ** max(order, 1) for value, omega in zip(bound, _paces(model, equations), strict=True)
        )
    rate = default if disturbance_rate is None else require_bounds("disturbance_rate", disturbance_rate, q)
    return sampled_data_design(
        model,
        paper=paper,
        pi=pi,
        alpha=alpha,
        step_size=step_size,
        order=order,
        noise_std=_noise(model, noise_std, equations.noise_std),
        disturbance_bound=tuple(lumped_bound(equations, bound)),
        disturbance_rate=tuple(lumped_rate(equations, bound, rate, order=order)),
        by_pi=expert is not None,
        parameters=parameters,
    )


def _paces(model: Model, equations: Equations) -> list[float]:
    """Return ω (q2,) of the sines that have the model's bounds of d and of its r-th derivative."""
    root = 1.0 / max(model.observer.disturbance_order, 1)
    bounds = zip(equations.disturbance_rate, equations.disturbance_bound, strict=True)
    return [float((rate / bound) ** root) for rate, bound in bounds]


def _require_none_given(**of_the_samples: object) -> None:
    for name, value in of_the_samples.items():
        if value is not None:
            raise UsageError.report(
                name,
                expected="a step size with it",
                received=f"{value!r} and no step size",
                likely="only the sampled-data observer uses it, which step_size (--step-size) asks for",
            )


def _noise(model: Model, value: float | Mapping[str, float] | None, default: Sequence[float]) -> tuple[float, ...]:
    found = by_name("noise_std", {} if value is None else value, model.outputs, default)
    for output, std in zip(model.outputs, found, strict=True):
        require_not_negative(f"noise_std, {output}", std)
    return tuple(map(float, found))


def _continuous(model: Model, pi: float, alpha: float, parameters: Mapping[str, float] | None) -> PaperDesign:
    linear = linear_part(model, parameters)
    gains = paper_gains(linear, pi=pi, alpha=alpha)
    poles = np.linalg.eigvals(linear.A - gains.L @ linear.C)
    estimate = np.sqrt(pi) * linear.selector @ gains.W
    constant = estimate @ linear.C @ np.linalg.solve(gains.L @ linear.C - linear.A, linear.G_d)
    return PaperDesign(
        model=model.name,
        disturbances=tuple(model.unknown_inputs),
        pi=float(pi),
        alpha=float(alpha),
        L=gains.L,
        W=gains.W,
        M=gains.M,
        Q=gains.riccati.Q,
        poles=sorted_poles(poles),
        riccati_residual=gains.riccati.residual,
        bandwidth=float(np.max(np.abs(poles))),
        dc_gain=np.diag(constant),
        noise_gain=np.linalg.norm(estimate, axis=1),
    )
