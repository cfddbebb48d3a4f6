"""The form in which a plant's equations reach the runtime: plain functions on tuples of floats, and their names.

A module of this form is written from the symbolic model by `codegen.emit`; it is all that an FMU knows of its plant.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import InitVar, dataclass, field

import numpy as np

from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.base_errors import DesignError, NdobError
from ndob_fmu.runtime.generated_steps import Steps
from ndob_fmu.runtime.linear_part import LinearPart

Vector = Sequence[float]

# Of the disturbance's derivatives that the sampled-data observer can carry along.
HIGHEST_ORDER = 3


@dataclass(frozen=True)
class ObserverDefaults:
    """Start values of the observer FMU's tuning.

    method: 1 for the paper's observer, 2 for the sampled-data design
    disturbance_order: r = 0 … 3
    adapt_noise: whether the variance of each output's noise follows the innovations
    estimate_parameters: whether uncertain parameters are estimated too
    lag: how long before the sample the lagged estimate is (s)
    disturbance_rate: bound of |d^{(r)}|, in units of d per s^r, one number or (q2,). None: that of a sine at the
        disturbance's bound, as fast as the plant (`codegen.default_rate`). 0: the pace follows from pi_end
    alpha: α in 1/s
    pi_start, pi_end: π at the start and after the ramp
    pi_ramp_time: in s
    noise_std: refused, with a line that names what replaces it

    Raises NdobError where noise_std is given.
    """

    method: int = 2
    disturbance_order: int = 2
    adapt_noise: bool = True
    estimate_parameters: bool = False
    lag: float = 0.0
    disturbance_rate: float | Sequence[float] | None = None
    alpha: float = 1.0
    pi_start: float = 1.0
    pi_end: float = 1e8
    pi_ramp_time: float = 1.0
    noise_std: InitVar[object] = None

    def __post_init__(self, noise_std: object) -> None:
        if noise_std is not None:
            raise NdobError.report(
                "ObserverDefaults.noise_std",
                expected="the noise of each sensor in Model(noise_std={output: number}), or one number there for all",
                received=repr(noise_std),
            )


@dataclass(frozen=True)
class SignalDefaults:
    """Start values of the plant FMU's built-in disturbance generator.

    kind: a name in `runtime.blocks.disturbance.KINDS`
    amplitude: in the unit of the disturbance
    frequency: in Hz
    start_time: in s
    """

    kind: str = "none"
    amplitude: float = 0.0
    frequency: float = 1.0
    start_time: float = 0.0


@dataclass(frozen=True)
class Experiment:
    """The default experiment of the FMUs, in seconds."""

    stop_time: float = 10.0
    step_size: float = 1e-3


@dataclass(frozen=True)
class Channel:
    """The direction n (k,) in which one disturbance acts: ẋ = … + G_d w with the lumped inputs w = n(x, u) d.

    bound (k,): of each |n_j|
    rate: Ω (rad/s); the i-th derivative of n_j in time is at most Ω^i times its bound
    direction: direction(x, u, p) returns n, a tuple of k numbers
    derivatives, linearisation, input_slopes, sensitivity: those of `Equations`, with the w (k,) in place of d
    """

    bound: tuple[float, ...]
    rate: float
    direction: Callable[[Vector, Vector, Vector], tuple[float, ...]] = field(repr=False)
    derivatives: Callable[[Vector, Vector, Vector, Vector], tuple[float, ...]] = field(repr=False)
    linearisation: Callable[[Vector, Vector, Vector, Vector], tuple[float, ...]] = field(repr=False)
    input_slopes: Callable[[Vector, Vector, Vector, Vector], tuple[float, ...]] = field(repr=False)
    sensitivity: Callable[[Vector, Vector, Vector, Vector], tuple[float, ...]] = field(repr=False)


def lumped_names(disturbance: str, k: int) -> tuple[str, ...]:
    """Return names for w = n(x, u) d in reports."""
    return tuple(f"n[{j}]*{disturbance}" for j in range(k))


@dataclass(frozen=True)
class Equations:
    """ẋ = F(x, u) + G_d(x, u) d, y = h(x, u), with everything a component needs to name and start it.

    In the paper's form F = A x + B u + G_f f(x, u), G_d is constant and h = C x.

    Names, units, descriptions and start values are those of `model.Model`. Functions take the parameters p in the order
    of `parameters`. They raise ArithmeticError or ValueError where they have no value, as a root has no slope at 0.

    noise_std (p,): standard deviation of the noise in a sample of each output, in its unit; 0 for no noise
    delay (p,): age (s) of a sample of each output when it arrives
    bias_std (p,): standard deviation of a constant offset of each output, in its unit; 0 for none
    parameter_std: one-sigma uncertainty of each parameter, in its unit; 0 where it is known
    state_noise (n,): intensity of white noise on ẋ, as a standard deviation per √s; 0 for none
    disturbance_nominal (q2,): value about which d is small; the bound is that of |d − nominal|
    lipschitz: γ of eq. (3)
    f_states: indices of the states that f depends on; outside the paper's form also what G_d or h depend on
    ranges: where the plant works, for states and inputs by name; elsewhere they are not limited
    feedthrough (p,): for each output the indices of the inputs that it depends on directly
    matched: whether f and d enter through the same channel (eq. 1)
    matrices: matrices(p) returns A, B, C, G_f, G_d as nested tuples; None outside the paper's form
    nonlinearity: nonlinearity(x, u, p) returns f, a tuple of q1 numbers
    derivatives: derivatives(x, u, d, p) returns ẋ, a tuple of n numbers
    output: output(x, u, p) returns y, a tuple of p numbers
    linearisation: linearisation(x, u, d, p) returns [[∂ẋ/∂x, ∂ẋ/∂d], [∂y/∂x, 0]], a tuple of (n + p)(n + q2) numbers
        row by row. A jump has the slope 0, a kink that of one side
    input_slopes: input_slopes(x, u, d, p) returns [[∂ẋ/∂u], [∂y/∂u]], a tuple of (n + p) m numbers row by row
    sensitivity: sensitivity(x, u, d, p) returns [[∂ẋ/∂p], [∂y/∂p]], a tuple of (n + p) n_p numbers row by row
    steps: the steps of plant and observer as generated code
    surfaces: surfaces(x, u, p) returns [g, ∂g/∂x], a tuple of k (1 + n) numbers row by row, for the surfaces g = 0 at
        which ẋ jumps; None without such
    channel: the direction n in which the one disturbance acts: n(x, u) d in place of d; None without a channel
    """

    name: str
    description: str
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    disturbances: tuple[str, ...]
    parameters: Mapping[str, float]
    units: Mapping[str, str]
    descriptions: Mapping[str, str]
    x0: tuple[float, ...]
    xhat0: tuple[float, ...]
    xhat0_std: tuple[float, ...]
    disturbance_bound: tuple[float, ...]
    disturbance_rate: tuple[float, ...]
    disturbance_nominal: tuple[float, ...]
    noise_std: tuple[float, ...]
    delay: tuple[float, ...]
    bias_std: tuple[float, ...]
    parameter_std: tuple[float, ...]
    state_noise: tuple[float, ...]
    lipschitz: float
    f_states: tuple[int, ...]
    ranges: Mapping[str, tuple[float, float]]
    feedthrough: tuple[tuple[int, ...], ...]
    matched: bool
    observer: ObserverDefaults
    disturbance: SignalDefaults
    experiment: Experiment
    matrices: Callable[[Vector], tuple[tuple[tuple[float, ...], ...], ...]] | None = field(repr=False)
    nonlinearity: Callable[[Vector, Vector, Vector], tuple[float, ...]] = field(repr=False)
    derivatives: Callable[[Vector, Vector, Vector, Vector], tuple[float, ...]] = field(repr=False)
    output: Callable[[Vector, Vector, Vector], tuple[float, ...]] = field(repr=False)
    linearisation: Callable[[Vector, Vector, Vector, Vector], tuple[float, ...]] = field(repr=False)
    input_slopes: Callable[[Vector, Vector, Vector, Vector], tuple[float, ...]] = field(repr=False)
    sensitivity: Callable[[Vector, Vector, Vector, Vector], tuple[float, ...]] = field(repr=False)
    steps: Steps
    surfaces: Callable[[Vector, Vector, Vector], tuple[float, ...]] | None = field(default=None, repr=False)
    channel: Channel | None = None

    def linear_part(self, parameters: Vector) -> LinearPart:
        """Return the constant matrices at the given parameter values.

        Raises DesignError outside the paper's form.
        """
        if self.matrices is None:
            raise DesignError.report(
                f"the paper's form of {self.name}, for method 1",
                expected="y = C x and constant directions of the disturbances",
                received="nonlinear outputs, inputs fed through to outputs, or directions that turn",
                likely="this plant is for method 2, with disturbance_order 1 to 3",
            )
        n, m = len(self.states), len(self.inputs)
        A, B, C, G_f, G_d = (np.array(M, dtype=float) for M in self.matrices(parameters))
        return LinearPart(
            A=A,
            B=B.reshape(n, m),
            C=C,
            G_f=G_f.reshape(n, -1),
            G_d=G_d,
            matched=self.matched,
        )

    def slopes(self, x: Vector, u: Vector, d: Vector, d_rate: Array, parameters: Vector) -> tuple[Array, Array]:
        """Return ∂ẋ/∂x (n,n) and ∂ẋ/∂t (n,) where d changes at d_rate (q2,)."""
        n, q = len(self.states), len(d_rate)
        entries = self.linearisation(x, u, d, parameters)
        rows = np.array(entries[: n * (n + q)], dtype=float).reshape(n, n + q)
        return rows[:, :n], rows[:, n:] @ d_rate

    def surfaces_at(self, x: Vector, u: Vector, parameters: Vector) -> Array:
        """Return [g, ∂g/∂x] (k,1 + n) of the surfaces at which ẋ jumps."""
        rows = () if self.surfaces is None else self.surfaces(x, u, parameters)
        return np.array(rows, dtype=float).reshape(-1, 1 + len(self.states))
