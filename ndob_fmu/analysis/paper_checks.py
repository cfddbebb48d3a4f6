"""The paper's assumptions (eqs. 2–4 and 21), which method 1 needs, each with its measured value.

Modes, ranks and zeros are judged in the balanced units of `ndob_fmu.runtime.numerics.zeros`; rates are reported in 1/s.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from ndob_fmu.analysis.check_report import CheckRow
from ndob_fmu.analysis.lipschitz import largest_slope
from ndob_fmu.analysis.row_parts import dominant, modes_reached, number, numbers, outcome, relative_degrees
from ndob_fmu.codegen.compile_model import linear_part
from ndob_fmu.model.model import Model
from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.design.minimum_phase import margins_of
from ndob_fmu.runtime.linear_part import LinearPart
from ndob_fmu.runtime.numerics.zeros import AXIS_TOLERANCE, RANK_TOLERANCE, Balanced, balance, pencil_zeros

LIPSCHITZ_TOLERANCE = 1e-6


def paper_rows(model: Model, alpha: float, parameters: Mapping[str, float] | None) -> tuple[CheckRow, ...]:
    """Return a row for each assumption of the paper at α (1/s); one alone for a plant outside the paper's form."""
    field = model.vector_field
    if not field.has_paper_form:
        lacking = [
            *([] if field.outputs_are_linear else ["outputs that are nonlinear or depend on an input"]),
            *([] if field.directions_are_constant else ["directions of d that depend on the state"]),
        ]
        return (
            outcome(
                "paper_form",
                False,
                "y = C x, constant G_d",
                " and ".join(lacking),
                failure=" and ".join(lacking),
                likely="the plant is not of the paper's form; method 2 does not need it",
                values={},
            ),
        )
    linear = linear_part(model, parameters)
    system = balance(linear.A, linear.G, linear.C)
    channels = [*([] if linear.matched else [f"f[{i}]" for i in range(linear.G_f.shape[1])]), *model.unknown_inputs]
    return (
        _enough_outputs(linear),
        _full_rank("rank_C", "rank C = p", system.C, model.outputs, "two outputs measure the same thing"),
        _full_rank("rank_G", "rank G = q", system.G.T, channels, "two unknown inputs act on the plant in the same way"),
        modes_reached("observable", "(A, C) observable", system, system.A, system.C, model.states),
        modes_reached("controllable", "(A, G) controllable", system, system.A.T, system.G.T, model.states),
        relative_degrees(system, channels),
        *_zero_rows(system, alpha),
        _lipschitz(model, parameters),
    )


def _enough_outputs(linear: LinearPart) -> CheckRow:
    p, q = len(linear.C), linear.G.shape[1]
    return outcome(
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
    return outcome(
        name,
        rank == len(rows),
        f"{requirement} = {len(rows)}",
        f"{rank}; singular values {numbers(sigma, 3)} (> {RANK_TOLERANCE:g} of the largest)",
        failure=f"rank {rank}, with {dominant(U[:, -1], labels)} dependent",
        likely=likely,
        values={"rank": rank, "singular_values": sigma},
    )


def _zero_rows(system: Balanced, alpha: float) -> Iterator[CheckRow]:
    """Yield minimum_phase and alpha_below_zeros: Re z < 0 for every transmission zero, 0 < α < min(−Re z)."""
    names = ("minimum_phase", "alpha_below_zeros")
    requirements = ("Re z < 0 for every zero z of (A, G, C)", "0 < alpha < min(-Re z)")
    scaled, rank = pencil_zeros(system.A, system.G, system.C)
    p, q = len(system.C), system.G.shape[1]
    if rank < q:
        for name, requirement in zip(names, requirements, strict=True):
            yield outcome(
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
    margins = margins_of(zeros, system.rate)
    yield outcome(
        names[0],
        bool(np.all(margins > 0)),
        requirements[0],
        f"zeros {numbers(zeros)} 1/s (margin {AXIS_TOLERANCE:g})" if len(zeros) else "no finite zeros",
        failure=f"zeros {numbers(zeros[margins <= 0])} 1/s",
        likely="the outputs are far from where the unknown input acts; measure nearer to it",
        values={"zeros": zeros, "normal_rank": rank},
    )
    largest = float(np.min(margins, initial=math.inf))
    nearest = f"zero at {number(zeros[int(np.argmin(margins))])} 1/s" if len(zeros) else "no finite zeros"
    yield outcome(
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
        return outcome(
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
    return outcome(
        name,
        slope.value <= model.lipschitz * (1.0 + LIPSCHITZ_TOLERANCE),
        requirement,
        f"{found}; declared {model.lipschitz:g} (tolerance {LIPSCHITZ_TOLERANCE:g}){searched}",
        failure=f"{found} where gamma = {model.lipschitz:g} is declared",
        likely="gamma was declared for other parameters, or a steep part of f was overlooked",
        values=values,
    )
