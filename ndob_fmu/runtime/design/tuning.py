"""The noise intensities of the design, from what users know: the noise of the samples and the rate of the disturbance.

Users know the noise σ of a sample and a bound D of the disturbance's r-th derivative (of the first, for r = 0). A fast
observer follows the disturbance but passes the noise, a slow one the reverse. The design minimises the mean square,

    J(s) = Σ_i (|E_i(s)|² D²/3 + std_i(s)²) / D₀ᵢ²,

where |E| D is the error that a constant r-th derivative causes, whose square is a third of that on average where the
derivative may be anything within its bounds, and std the noise of d̂. Experts may set instead
π = s / (σ² H), the ratio of the intensities of disturbance and measurement noise in continuous time, eq. (8).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.base_errors import DesignError
from ndob_fmu.runtime.design.augmented import Augmented, Discrete, discretise
from ndob_fmu.runtime.design.stationary_design import Intensities, StationaryDesign, design_for

# The range of the search: the least bandwidth over 1/H, and the largest ratio of the disturbance's spectrum at 1/H to
# that of the noise, beyond which only rounding changes the gain.
_SLOWEST = 1e-4
_FASTEST = 1e6
SCAN = 10
# Where the logarithm of the cost is nearly flat, a bandwidth lower by a factor e may cost this part more.
_SLOWER = 1e-2
_PARABOLAS = 3
# Of what a channel could do in the outputs: less is rounding.
_NO_RESPONSE = 1e-12
_DIGITS = 3  # of the logarithm of the bandwidth times H
_CLOSER = 0.4  # the distance of the costs for a parabola, over that of those before


@dataclass(frozen=True)
class Knowledge:
    """What the user knows, in the units of outputs and disturbances.

    R_factor (p,p): diagonal, standard deviation of each output's sample.
    disturbance_bound (q2,): D₀, the bound of |d|.
    disturbance_rate (q2,): the bound of |d^{(r)}|, of |ḋ| for r = 0.
    """

    R_factor: Array
    disturbance_bound: Array
    disturbance_rate: Array


class Tried(NamedTuple):
    """A bandwidth of which J is known.

    log_bandwidth: its logarithm
    bias, noise: Σ |E|² D²/3 / D₀² and Σ std² / D₀², infinite where there is no design
    prior_factor (N,N): of the design; None without one
    """

    log_bandwidth: float
    bias: float
    noise: float
    prior_factor: Array | None


class Search(NamedTuple):
    """The bandwidth (rad/s) of the least J for the noise that was told, and all that were tried for it."""

    bandwidth: float
    tried: list[Tried]


def search(system: Augmented, H: float, alpha: float, known: Knowledge) -> Search:
    """Return the bandwidth of the least J at the step H (s). Raises DesignError where no bandwidth has a design."""
    bandwidth, tried = predicted_errors(system, H, alpha, known).best_bandwidth(1.0, ())
    return Search(bandwidth, tried)


def tuned_intensities(
    system: Augmented, H: float, alpha: float, known: Knowledge, found: Search | None = None
) -> Intensities:
    """Return the intensities that minimise J at the step H, on the scale of the disturbance.

    found: what `search` returns, where the caller has it

    Where samples have hardly any noise, only the ratio of the intensities counts, and a large ratio no longer does. The
    scale makes the white noise on w_d over a step as large as D (for r = 0, that on G as large as D₀).
    """
    best = search(system, H, alpha, known) if found is None else found
    tuned = at_bandwidth(system, H, best.bandwidth, known)
    pace = known.disturbance_rate if system.order else known.disturbance_bound
    scale = float(np.max(np.sqrt(H) * pace / np.sqrt(tuned.disturbance[-len(pace) :])))
    return replace(tuned, scale=max(1.0, scale))


@dataclass(frozen=True)
class PredictedErrors:
    """The two parts of J over the bandwidth, for a system and a step.

    ν times the noise and ν² times the intensities leave a gain as it is. So J for any noise follows from the same two
    parts, bias² + ν² noise², at the same bandwidths.
    """

    system: Augmented
    discrete: Discrete
    alpha: float
    known: Knowledge

    def best_bandwidth(self, noise_scale: float, tried: Sequence[Tried]) -> tuple[float, list[Tried]]:
        """Return the bandwidth (rad/s) of the least J for `noise_scale` times the noise that was told.

        tried: bandwidths that need no new design. Those that were tried now are behind them in the result.
        """

        def cost(log_bandwidth: float, tried: list[Tried]) -> tuple[float, list[Tried]]:
            found, tried = self.at(log_bandwidth, tried)
            total = found.bias + noise_scale**2 * found.noise
            return float(np.log(total)) if np.isfinite(total) else np.inf, tried

        H = self.discrete.H
        fastest = fastest_bandwidth(self.system, H, self.known)
        place, all_tried = _minimise(cost, float(np.log(_SLOWEST / H)), float(np.log(fastest)), list(tried))
        if all(one.prior_factor is None for one in all_tried):
            raise DesignError.report(
                "tuning of the observer",
                expected=f"a stationary gain at steps of {H:g} s",
                received="none from the slowest to the fastest observer",
                likely="a mode that samples hardly show; measure a state nearer to it, or leave it out of the model",
            )
        # The minimum is flat: its last digits are those of the processor's arithmetic, and say nothing.
        return float(np.exp(round(place + float(np.log(H)), _DIGITS)) / H), all_tried

    def at(self, log_bandwidth: float, tried: list[Tried]) -> tuple[Tried, list[Tried]]:
        """Return the two parts of J, and all that was tried with it."""
        for one in tried:
            if one.log_bandwidth == log_bandwidth:
                return one, tried
        found = self._predicted(log_bandwidth, tried)
        return found, [*tried, found]

    def _predicted(self, log_bandwidth: float, tried: Sequence[Tried]) -> Tried:
        known, discrete = self.known, self.discrete
        similar, distance = None, np.inf
        for one in tried:
            if one.prior_factor is not None and abs(one.log_bandwidth - log_bandwidth) < distance:
                similar, distance = one.prior_factor, abs(one.log_bandwidth - log_bandwidth)
        try:
            intensities = at_bandwidth(self.system, discrete.H, float(np.exp(log_bandwidth)), known)
            design = design_for(self.system, discrete, known.R_factor, intensities, self.alpha, similar)
        except DesignError:  # at the far ends of the range
            return Tried(log_bandwidth, np.inf, np.inf, None)
        bias, noise = squared_errors(design, known)
        return Tried(log_bandwidth, bias, noise, design.prior_factor)


def predicted_errors(system: Augmented, H: float, alpha: float, known: Knowledge) -> PredictedErrors:
    """Return the two parts of J at the step H (s)."""
    return PredictedErrors(system, discretise(system, H, alpha), alpha, known)


def at_bandwidth(system: Augmented, H: float, bandwidth: float, known: Knowledge) -> Intensities:
    """Return the intensities at which d is followed up to `bandwidth` (rad/s): where its spectrum meets the noise's.

    A disturbance of intensity s behind r integrations and a channel of relative degree ρ with gain g has the spectrum
    s g² / ω^{2(r+ρ)} in an output, the noise σ² H.
    """
    rates = known.disturbance_rate
    degree, gain = response_to_d(system, known.R_factor)
    common = H * bandwidth ** (2 * (system.order + degree)) / gain**2 / rates[0] ** 2
    return _complete(system, H, common * rates**2, bandwidth, known)


def fastest_bandwidth(system: Augmented, H: float, known: Knowledge) -> float:
    """Return the bandwidth (rad/s) beyond which no intensity changes the gain at the step H (s)."""
    degree, _ = response_to_d(system, known.R_factor)
    return float(_FASTEST ** (0.5 / (system.order + degree)) / H)


def from_pi(system: Augmented, H: float, pi: float, known: Knowledge) -> Intensities:
    """Return the intensities of π = s / (σ² H), σ being the smallest noise of an output."""
    s = pi * float(np.min(np.diag(known.R_factor))) ** 2 * H
    if system.order == 0:  # the paper's design, in which all unknown inputs have one π
        return Intensities(disturbance=np.full(system.linear.G.shape[1], s), f=np.zeros(0))
    bandwidth = bandwidth_of(system, H, s, known)
    return _complete(system, H, np.full(system.linear.G_d.shape[1], s), bandwidth, known)


def bandwidth_of(system: Augmented, H: float, intensity: float, known: Knowledge) -> float:
    """Return the bandwidth (rad/s) that an intensity on the first disturbance asks for; see `at_bandwidth`."""
    degree, gain = response_to_d(system, known.R_factor)
    return _asked_for(system, H, intensity, degree, gain)


def _asked_for(system: Augmented, H: float, intensity: float, degree: int, gain: float) -> float:
    """Return the bandwidth (rad/s) for an intensity behind a channel of relative degree ρ with gain g."""
    return float((intensity * gain**2 / H) ** (0.5 / (system.order + degree)))


def each_bandwidth(system: Augmented, H: float, intensities: Array, known: Knowledge) -> Array:
    """Return the bandwidth (q2,) that the intensity of each disturbance asks for, as `bandwidth_of`; for r ≥ 1."""
    found = np.full(len(intensities), bandwidth_of(system, H, float(intensities[0]), known))
    for j in range(1, len(found)):
        degree, gain = first_response(system, known.R_factor, system.linear.G_d[:, j])
        if degree:
            found[j] = _asked_for(system, H, float(intensities[j]), degree, gain)
    return found


def f_intensities(system: Augmented, H: float, bandwidth: float, known: Knowledge) -> Array:
    """Return the intensities (q_f,) on the channels of f where they are apart from the disturbance's.

    f is trusted like a disturbance up to the bandwidth (rad/s): each channel's spectrum meets the noise's there, in the
    outputs. So its unit does not matter. A channel that no output shows has none. Idle modes drift as slowly as the
    slowest observer follows.
    """
    linear = system.linear
    q_f = 0 if linear.matched else linear.G_f.shape[1]
    channels = linear.G_f if system.order == 0 else system.f_noise[: len(linear.A)]
    intensities = np.zeros(channels.shape[1] if system.order else q_f)
    for i in range(len(intensities)):
        degree, gain = first_response(system, known.R_factor, channels[:, i])
        if degree:
            followed = bandwidth if i < q_f else _SLOWEST / H
            intensities[i] = H * followed ** (2 * degree) / gain**2
    return intensities


def _complete(system: Augmented, H: float, disturbance: Array, bandwidth: float, known: Knowledge) -> Intensities:
    """Add the intensities of f's channels; for r = 0 these are some of the disturbance's."""
    if system.order == 0:
        of_f = f_intensities(system, H, bandwidth, known)
        return Intensities(disturbance=np.concatenate([of_f, disturbance]), f=np.zeros(0))
    return Intensities(disturbance=disturbance, f=f_intensities(system, H, min(bandwidth, 1.0 / H), known))


def steady_std(design: StationaryDesign, rate: Array) -> Array:
    """Return the one-sigma error bar (q2,) of d̂ a step ahead, for disturbances of at most the rate (q2,).

    The bias counts as a number that may lie anywhere within its bounds: its variance is a third of their square.
    """
    bias, noise = design.bias_gain(ahead=True) @ rate, design.noise_std(ahead=True)
    return np.asarray(np.sqrt(noise * noise + bias * bias / 3.0))


def steady_residual_std(design: StationaryDesign, source_bound: Array) -> Array:
    """Return the standard deviation (p,) of residuals once the gain is frozen; `source_bound` (q2,) as in `StepDesign`.

    What the disturbance leaves in the residuals counts like the bias of `steady_std`.
    """
    bias, noise = design.steady_innovation @ source_bound, design.innovation_noise_std()
    return np.asarray(np.sqrt(noise * noise + bias * bias / 3.0))


def squared_errors(design: StationaryDesign, known: Knowledge) -> tuple[float, float]:
    """Return the two parts of J, from the bias and from the noise."""
    with np.errstate(all="ignore"):
        bias, noise = (part / known.disturbance_bound for part in predicted_error(design, known.disturbance_rate))
        return float(np.sum(bias**2)) / 3.0, float(np.sum(noise**2))


def predicted_error(design: StationaryDesign, rate: Array) -> tuple[Array, Array]:
    """Return bias and noise (q2,) of d̂ at the sample, for disturbances of at most the rate (q2,)."""
    return design.bias_gain() @ rate, design.noise_std()


def first_response(system: Augmented, R_factor: Array, channel: Array) -> tuple[int, float]:
    """Return the relative degree ρ of a channel (n,) and ‖R^{-1/2} C A^{ρ−1} g‖, its gain over the noise.

    Both are 0 where no output depends on it. That is judged in the plant's natural units.
    """
    n, units = len(channel), system.units[: len(channel)]
    A = system.linear.A * units / units[:, None]
    C = np.linalg.solve(R_factor, system.linear.C) * units
    reached = channel / units
    least = _NO_RESPONSE * float(np.linalg.norm(C, 2) * np.linalg.norm(reached))
    for degree in range(1, n + 1):
        gain = float(np.linalg.norm(C @ reached))
        if gain > least:
            return degree, gain
        reached, least = A @ reached, least * max(float(np.linalg.norm(A, 2)), 1e-300)
    return 0, 0.0


def response_to_d(system: Augmented, R_factor: Array) -> tuple[int, float]:
    """Return `first_response` to the first disturbance.

    Raises DesignError where no output depends on it, or where parameters are so far out of proportion that rounding
    hides it.
    """
    found = first_response(system, R_factor, system.linear.G_d[:, 0])
    if not found[0]:
        raise DesignError.report(
            "unknown inputs",
            expected="each to show in an output",
            received="one that shows in none",
            likely="parameters of sizes that are out of proportion",
        )
    return found


def _minimise(
    cost: Callable[[float, list[Tried]], tuple[float, list[Tried]]], low: float, high: float, tried: list[Tried]
) -> tuple[float, list[Tried]]:
    """Return the place of the least cost on [low, high], and all that was tried.

    cost(place, tried) returns the cost at a place, and all that was tried with that.

    A scan finds the neighbourhood. Each parabola through three costs brings the place nearer. Their number is fixed and
    the costs stay well apart, so that rounding errors of the costs move the place in proportion only.
    """
    places: list[float] = np.linspace(low, high, SCAN).tolist()
    scanned, tried = _costs(cost, places, tried)
    middle = min(max(int(np.argmin(scanned)), 1), SCAN - 2)
    reach = places[1] - places[0]
    place = places[middle] + reach * _vertex(*scanned[middle - 1 : middle + 2])
    for _ in range(_PARABOLAS):
        reach *= _CLOSER
        place = min(max(place, low + reach), high - reach)
        around, tried = _costs(cost, [place - reach, place, place + reach], tried)
        place += reach * _vertex(*around)
    return place, tried


def _costs(
    cost: Callable[[float, list[Tried]], tuple[float, list[Tried]]], places: Sequence[float], tried: list[Tried]
) -> tuple[list[float], list[Tried]]:
    """Return the costs at some places, lower ones for lower places, and all that was tried."""
    found: list[float] = []
    for place in places:
        own, tried = cost(place, tried)
        found.append(own + _SLOWER * place)
    return found, tried


def _vertex(below: float, here: float, above: float) -> float:
    """Return where the parabola through three costs at −1, 0 and 1 is least; at most 1 from the middle."""
    if np.isfinite(below) and np.isfinite(above) and below + above > 2.0 * here:
        vertex = 0.5 * (below - above) / (below - 2.0 * here + above)
        return float(min(max(vertex, -1.0), 1.0))
    return float(np.argmin((below, here, above))) - 1.0
