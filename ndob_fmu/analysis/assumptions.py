"""The paper's assumptions (eqs. 2–4 and 21), checked before any design, each with its measured value.

Modes, ranks and zeros are judged in the balanced units of `ndob_fmu.runtime.numerics.zeros`; rates are reported in 1/s.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from ndob_fmu.analysis.check_report import CheckReport, CheckRow
from ndob_fmu.analysis.direction import shortest_direction
from ndob_fmu.analysis.lipschitz import largest_slope
from ndob_fmu.analysis.separable import separability_rows
from ndob_fmu.codegen.compile_model import compile_model, working_part
from ndob_fmu.errors import UsageError
from ndob_fmu.model.model import Model, require_model
from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.design.pace import pace_of, pace_warnings
from ndob_fmu.runtime.linear_part import LinearPart
from ndob_fmu.runtime.numerics.zeros import RANK_TOLERANCE, Balanced, ComplexArray, balance, pencil_zeros
from ndob_fmu.runtime.step.channel_observer import VANISHING
from ndob_fmu.support.progress import begin

MODE_TOLERANCE = 1e-8
LIPSCHITZ_TOLERANCE = 1e-6
_AXIS_TOLERANCE = 1e-9  # of the larger of |z| and the plant's own rate: a zero this close to the axis is on it


def check(model: Model, *, alpha: float | None = None, parameters: Mapping[str, float] | None = None) -> CheckReport:
    """Check the paper's assumptions for a model.

    alpha: α in 1/s; None for the model's own.
    parameters: values that replace the model's.

    An assumption that fails is a row of the report, not an exception. Raises UsageError if α is not a positive number
    or `model` is no Model, and ModelError for a parameter that the model does not have.
    """
    require_model(model)
    chosen = model.observer.alpha if alpha is None else alpha
    if not (isinstance(chosen, (int, float)) and math.isfinite(chosen) and chosen > 0):
        raise UsageError.report(f"alpha of {model.name}", expected="a finite number > 0 (1/s)", received=repr(chosen))
    linear = working_part(model, parameters)
    begin(f"measuring modes, ranks and zeros of {model.name}")
    system = balance(linear.A, linear.G, linear.C)
    channels = [*([] if linear.matched else [f"f[{i}]" for i in range(linear.G_f.shape[1])]), *model.unknown_inputs]
    rows = _general_rows(model, parameters, system, channels) or (
        _enough_outputs(linear),
        _full_rank("rank_C", "rank C = p", system.C, model.outputs, "two outputs measure the same thing"),
        _full_rank("rank_G", "rank G = q", system.G.T, channels, "two unknown inputs act on the plant in the same way"),
        _modes_reached("observable", "(A, C) observable", system, system.A, system.C, model.states),
        _modes_reached("controllable", "(A, G) controllable", system, system.A.T, system.G.T, model.states),
        _relative_degrees(system, channels),
        *_zero_rows(system, float(chosen)),
        _lipschitz(model, parameters),
        *_direction(model, parameters),
        *separability_rows(model, parameters),
        _pace(model, parameters),
    )
    return CheckReport(model=model.name, alpha=float(chosen), rows=rows)


def _general_rows(
    model: Model, parameters: Mapping[str, float] | None, system: Balanced, channels: Sequence[str]
) -> tuple[CheckRow, ...]:
    """Return the rows of a plant outside the paper's form, linearised where it starts; none for a plant in it."""
    field = model.vector_field
    if field.has_paper_form:
        return ()
    lacking = [
        *([] if field.outputs_are_linear else ["outputs that are nonlinear or depend on an input"]),
        *([] if field.directions_are_constant else ["directions of d that depend on the state"]),
    ]
    return (
        CheckRow("paper_form", True, "y = C x, constant G_d: method 1 only", f"method 2 only: {' and '.join(lacking)}"),
        _modes_reached("observable", "(A, C) observable", system, system.A, system.C, model.states),
        _relative_degrees(system, channels),
        next(_zero_rows(system, 1.0)),
        *separability_rows(model, parameters),
        _pace(model, parameters),
    )


def _pace(model: Model, parameters: Mapping[str, float] | None) -> CheckRow:
    """Return how fast plant and disturbance are, and whether rate or step are absurd; for information."""
    eq, order = compile_model(model), model.observer.disturbance_order
    pace = pace_of(
        eq,
        model.parameter_values(parameters),
        eq.xhat0,
        bound=eq.disturbance_bound,
        rate=eq.disturbance_rate,
        order=order,
    )
    warnings = pace_warnings(pace, model.disturbances, model.experiment.step_size)
    modes = dict.fromkeys(f"{mode:.3g}" for mode in (pace.slowest, pace.fastest))
    plant = f"plant {' to '.join(modes)} 1/s" if pace.fastest else "plant of integrators"
    disturbance = ", ".join(f"{omega:.3g}" for omega in pace.disturbance)
    values = {"slowest": pace.slowest, "fastest": pace.fastest, "disturbance": pace.disturbance, "warnings": warnings}
    measured = f"{plant}, disturbance {disturbance} rad/s, step {model.experiment.step_size:g} s"
    return CheckRow("pace", True, "for information", "; warning: ".join([measured, *warnings]), values=values)


def _row(
    name: str, passed: bool, requirement: str, measured: str, *, failure: str, likely: str, values: Mapping[str, Any]
) -> CheckRow:
    if passed:
        failure = likely = ""
    return CheckRow(name, passed, requirement, measured, failure, likely, values)


def _enough_outputs(linear: LinearPart) -> CheckRow:
    p, q = len(linear.C), linear.G.shape[1]
    return _row(
        "outputs_at_least_unknown_inputs",
        p >= q,
        f"p >= q (eq. {4 if linear.matched else 21})",
        f"p = {p}, q = {q}",
        failure=f"{p} outputs for {q} unknown inputs",
        likely="an output is missing" + ("" if linear.matched else ", or f could enter where d does (G_f = G_d)"),
        values={"p": p, "q": q},
    )


def _full_rank(name: str, requirement: str, rows: Array, labels: Sequence[str], likely: str) -> CheckRow:
    U, sigma, _ = np.linalg.svd(rows)
    sigma = np.concatenate([sigma, np.zeros(len(rows) - len(sigma))])
    rank = int(np.sum(sigma > RANK_TOLERANCE * max(sigma[0], np.finfo(float).tiny)))
    return _row(
        name,
        rank == len(rows),
        f"{requirement} = {len(rows)}",
        f"{rank}; singular values {_numbers(sigma, 3)} (> {RANK_TOLERANCE:g} of the largest)",
        failure=f"rank {rank}, with {_dominant(U[:, -1], labels)} dependent",
        likely=likely,
        values={"rank": rank, "singular_values": sigma},
    )


def _modes_reached(
    name: str, requirement: str, system: Balanced, A: Array, C: Array, states: Sequence[str]
) -> CheckRow:
    """Apply the PBH test to (A, C): [A − λI; C] has full column rank at every eigenvalue λ.

    The test also covers the modes that the structure of (A, C) shows to be unobservable. A multiple eigenvalue of A is
    known only to a root of the rounding error, and the test at it could miss the mode.
    """
    candidates = np.concatenate([np.linalg.eigvals(A), pencil_zeros(A, np.zeros((len(A), 0)), C)[0]])
    limit = MODE_TOLERANCE * max(1.0, float(np.linalg.norm(A, 2)))
    smallest, hidden = math.inf, {}
    for mode in candidates:
        _, sigma, Vh = np.linalg.svd(np.vstack([A - mode * np.eye(len(A)), C]))
        smallest = min(smallest, float(sigma[-1]))
        if sigma[-1] <= limit and mode.imag >= -limit:
            hidden[_number(system.rate * mode)] = _dominant(Vh[-1], states)
    return _row(
        name,
        smallest > limit,
        f"{requirement} (PBH test)",
        f"smallest singular value {smallest:.2g} (> {limit:.2g})",
        failure=", ".join(f"hidden mode {mode} 1/s ({where})" for mode, where in hidden.items()),
        likely="an output is missing, or a state acts on nothing that is measured"
        if name == "observable"
        else "no unknown input drives that state; leave it out of the model or give it an unknown input",
        values={"smallest_singular_value": smallest, "hidden_modes": hidden},
    )


def _relative_degrees(system: Balanced, channels: Sequence[str]) -> CheckRow:
    """Yield the smallest k with C A^{k−1} G_j ≠ 0 for each unknown input j; None if no output depends on it."""
    degrees: dict[str, int | None] = dict.fromkeys(channels)
    reached = system.G
    norm_A = max(1.0, float(np.linalg.norm(system.A, 2)))
    for k in range(1, len(system.A) + 1):
        for j, channel in enumerate(channels):
            size = np.linalg.norm(system.G[:, j]) * np.linalg.norm(system.C) * norm_A ** (k - 1)
            if degrees[channel] is None and np.linalg.norm(system.C @ reached[:, j]) > RANK_TOLERANCE * size:
                degrees[channel] = k
        reached = system.A @ reached
    measured = ", ".join(f"{channel}: {k or 'never seen'}" for channel, k in degrees.items())
    return CheckRow("relative_degree", True, "for information", measured, values=degrees)


def _zero_rows(system: Balanced, alpha: float) -> Iterator[CheckRow]:
    """Yield minimum_phase and alpha_below_zeros: Re z < 0 for every transmission zero, 0 < α < min(−Re z)."""
    names = ("minimum_phase", "alpha_below_zeros")
    requirements = ("Re z < 0 for every zero z of (A, G, C)", "0 < alpha < min(-Re z)")
    scaled, rank = pencil_zeros(system.A, system.G, system.C)
    p, q = len(system.C), system.G.shape[1]
    if rank < q:
        for name, requirement in zip(names, requirements, strict=True):
            yield _row(
                name,
                False,
                requirement,
                f"degenerate, normal rank {rank} < {q}: every z is a zero",
                failure=f"a transfer matrix from unknown inputs to outputs of normal rank {rank} where {q} is needed",
                likely="too few outputs"
                if p < q
                else "an unknown input reaches no output, or two reach the outputs in the same way",
                values={"normal_rank": rank},
            )
        return
    zeros = system.rate * scaled
    margins = -zeros.real - _AXIS_TOLERANCE * np.maximum(abs(zeros), system.rate)
    yield _row(
        names[0],
        bool(np.all(margins > 0)),
        requirements[0],
        f"zeros {_numbers(zeros)} 1/s (margin {_AXIS_TOLERANCE:g})" if len(zeros) else "no finite zeros",
        failure=f"zeros {_numbers(zeros[margins <= 0])} 1/s",
        likely="the outputs are far from where the unknown input acts; measure nearer to it",
        values={"zeros": zeros, "normal_rank": rank},
    )
    largest = float(np.min(margins, initial=math.inf))
    nearest = f"zero at {_number(zeros[int(np.argmin(margins))])} 1/s" if len(zeros) else "no finite zeros"
    yield _row(
        names[1],
        alpha < largest,
        requirements[1],
        f"alpha = {alpha:g} 1/s, {nearest}",
        failure=f"alpha = {alpha:g} 1/s, {nearest}; "
        + (f"at most {largest:.6g} 1/s is allowed" if largest > 0 else "no alpha is allowed"),
        likely="alpha chosen without regard to the zeros" if largest > 0 else "the plant is not minimum phase",
        values={"alpha": alpha, "largest_allowed": largest},
    )


def _lipschitz(model: Model, parameters: Mapping[str, float] | None) -> CheckRow:
    name, requirement = "lipschitz", "slope of f in x <= gamma (eq. 3)"
    if not model.f_expressions:
        return CheckRow(name, True, requirement, "no nonlinearity")
    slope = largest_slope(model, parameters)
    where = ", ".join(f"{name} = {value:.4g}" for name, value in slope.at.items())
    searched = f"; {slope.searched}"
    values = {"gamma": slope.value, "declared": model.lipschitz, "at": slope.at}
    if not math.isfinite(slope.value):
        return _row(
            name,
            False,
            requirement,
            f"unbounded slope{searched}",
            failure="an f that jumps or cannot be evaluated" + (f" at {where}" if where else ""),
            likely="a root, a division or a switch in f; smooth it wherever the estimate may pass",
            values=values,
        )
    found = f"largest slope {slope.value:.6g}" + (f" at {where}" if where else "")
    if model.lipschitz is None:
        return CheckRow(name, True, requirement, f"{found}; none declared{searched}", values=values)
    return _row(
        name,
        slope.value <= model.lipschitz * (1.0 + LIPSCHITZ_TOLERANCE),
        requirement,
        f"{found}; declared {model.lipschitz:g} (tolerance {LIPSCHITZ_TOLERANCE:g}){searched}",
        failure=f"{found} where gamma = {model.lipschitz:g} is declared",
        likely="gamma was declared for other parameters, or a steep part of f was overlooked",
        values=values,
    )


def _direction(model: Model, parameters: Mapping[str, float] | None) -> Iterator[CheckRow]:
    """Yield how short n(x, u) becomes, relative to the bounds of its entries; nothing without a channel."""
    if not model.channel_expressions:
        return
    shortest = shortest_direction(model, parameters)
    where = ", ".join(f"{name} = {value:.4g}" for name, value in shortest.at.items())
    yield CheckRow(
        "direction",
        True,
        "for information",
        f"shortest n, in its bounds, {shortest.length:.3g}"
        + (f" at {where}" if where else "")
        + f"; the estimate is held below {VANISHING:g}; largest entry {shortest.largest_entry:.3g} times its bound",
        values={"shortest": shortest.length, "at": shortest.at, "largest_entry": shortest.largest_entry},
    )


def _dominant(vector: Any, labels: Sequence[str]) -> str:
    """Return the labels of the entries that are at least half as large as the largest."""
    sizes = np.abs(vector)
    return ", ".join(label for label, size in zip(labels, sizes, strict=True) if size >= 0.5 * np.max(sizes))


def _numbers(values: ComplexArray | Array, digits: int = 6) -> str:
    return ", ".join(_number(value, digits) for value in values)


def _number(value: complex, digits: int = 6) -> str:
    if abs(value.imag) <= 1e-9 * abs(value):
        return f"{value.real:.{digits}g}"
    return f"{value.real:.{digits}g}{value.imag:+.{digits}g}j"
