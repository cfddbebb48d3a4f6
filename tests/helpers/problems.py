"""One list of problems for all tests: the models of the package, random systems with known zeros, and bad ones.

Import it as `from problems import …`. The random systems are built from a normal form, so that zeros and relative
degrees are known exactly, and then hidden behind dense, well-conditioned changes of all coordinates:

    channel j of q, a chain of r_j integrators:  ξ̇_j1 = ξ_j2, …,  ξ̇_jr = a_jᵀ ξ + b_jᵀ η + w_j,   seen by y_j = ξ_j1
    zero dynamics:                               η̇ = Z η + K [ξ_11 … ξ_q1],   eig Z = the zeros

where a_j takes of the other chains only the ends that are seen. Further outputs (p > q) see other ξ, never η, and
therefore keep the zeros.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import scipy.linalg
import sympy
from hypothesis import strategies as st
from numpy.typing import NDArray

from ndob_fmu.model.loading import BUILT_IN, load_model
from ndob_fmu.model.model import Model
from ndob_fmu.runtime.linear_part import LinearPart

Array = NDArray[np.float64]

EXAMPLES = sorted((Path(__file__).parents[2] / "examples").glob("*.py"))
MODELS: dict[str, Model] = {source: load_model(source) for source in BUILT_IN}
_LOADED = {path: load_model(path) for path in EXAMPLES}
# Those written as a textbook has them are for method 2. The others have the paper's form.
TEXTBOOK: dict[Path, Model] = {path: model for path, model in _LOADED.items() if model.dynamics is not None}
EXAMPLES = [path for path in EXAMPLES if path not in TEXTBOOK]
MODELS |= {path.stem: _LOADED[path] for path in EXAMPLES}


@dataclass(frozen=True)
class Problem:
    """A linear part of which the zeros (real first, then conjugate pairs) and the relative degrees r (q,) are known."""

    name: str
    linear: LinearPart
    zeros: tuple[complex, ...]
    relative_degrees: tuple[int, ...]

    @property
    def shape(self) -> tuple[int, int, int, int]:
        """Return n, m, p, q."""
        return len(self.linear.A), self.linear.B.shape[1], len(self.linear.C), self.linear.G.shape[1]


def system_with_zeros(
    *,
    relative_degrees: Sequence[int],
    zeros: Sequence[complex] = (),
    extra_outputs: int = 0,
    inputs: int = 1,
    matched: bool = True,
    seed: int = 0,
    name: str = "",
) -> Problem:
    """Return a random system of n = Σr + (number of zeros), m = `inputs`, p = q + `extra_outputs`, q = len(r).

    r_j is the length of channel j's chain; an extra output may see it from nearer, and there may be Σr − q of them.
    `zeros` holds one of each conjugate pair; without `matched`, f takes the first channel and d the others (q ≥ 2).
    """
    random = np.random.default_rng(seed)
    Z = _modal(zeros)
    r, q, n_z = sum(relative_degrees), len(relative_degrees), len(Z)
    ends = np.cumsum(relative_degrees)
    firsts, lasts = ends - np.array(relative_degrees), ends - 1
    A = np.zeros((r + n_z, r + n_z))
    A[:r, :r] = np.diag([0.0 if k in lasts else 1.0 for k in range(r - 1)], 1)
    A[np.ix_(lasts, firsts)] = random.uniform(-1.0, 1.0, (q, q))
    for first, last in zip(firsts, lasts, strict=True):
        A[last, first : last + 1] = random.uniform(-1.0, 1.0, last + 1 - first)
    A[r:, r:] = Z
    A[r:, firsts] = _away_from_zero(random, (n_z, q))
    A[np.ix_(lasts, range(r, r + n_z))] = _away_from_zero(random, (q, n_z))
    G = np.zeros((r + n_z, q))
    G[lasts, range(q)] = 1.0
    others = np.setdiff1d(np.arange(r), firsts)
    seen = np.concatenate([firsts, random.permutation(others)[:extra_outputs]])
    C = np.eye(r + n_z)[seen]

    T = _rotation(random, r + n_z) * random.uniform(0.5, 2.0, r + n_z)
    A, G, C = np.linalg.solve(T, A @ T), np.linalg.solve(T, G * random.uniform(0.5, 2.0, q)), C @ T
    C = (_rotation(random, len(C)) * random.uniform(0.5, 2.0, len(C))) @ C
    B = random.uniform(-1.0, 1.0, (len(A), inputs))
    G_f, G_d = (G, G) if matched else (G[:, :1], G[:, 1:])
    linear = LinearPart(A=A, B=B, C=C, G_f=G_f, G_d=G_d, matched=matched)
    degrees = tuple(_relative_degree(k, firsts, seen, lasts) for k in range(q))
    return Problem(name, linear, tuple(map(complex, np.linalg.eigvals(Z))) if n_z else (), degrees)


def _relative_degree(channel: int, firsts: Array, seen: Array, lasts: Array) -> int:
    """Return the number of integrations from the channel to the nearest of its own states in an output."""
    own = [k for k in seen if firsts[channel] <= k <= lasts[channel]]
    return int(lasts[channel] - max(own) + 1)


def _modal(zeros: Sequence[complex]) -> Array:
    blocks = [
        np.array([[z.real, z.imag], [-z.imag, z.real]]) if z.imag else np.array([[z.real]]) for z in map(complex, zeros)
    ]
    return np.asarray(scipy.linalg.block_diag(*blocks)) if blocks else np.zeros((0, 0))


def _rotation(random: np.random.Generator, size: int) -> Array:
    return np.asarray(np.linalg.qr(random.normal(size=(size, size)))[0])


def _away_from_zero(random: np.random.Generator, shape: tuple[int, int]) -> Array:
    return np.asarray(random.choice([-1.0, 1.0], shape) * random.uniform(0.5, 1.5, shape))


def to_model(linear: LinearPart, name: str = "Random", **fields: object) -> Model:
    """Return a model with that linear part, f_i = sin(first state + i) (γ ≤ √q1), and plain names x1, u1, y1, d1, …."""
    columns = linear.G_f.shape[1]
    n, m, p, q2 = len(linear.A), linear.B.shape[1], len(linear.C), linear.G_d.shape[1]
    standard: dict[str, object] = {
        "states": [f"x{i + 1}" for i in range(n)],
        "inputs": [f"u{i + 1}" for i in range(m)],
        "outputs": [f"y{i + 1}" for i in range(p)],
        "disturbances": [f"d{i + 1}" for i in range(q2)],
        "A": linear.A,
        "B": linear.B,
        "C": linear.C,
        "G_d": linear.G_d,
        "G_f": None if linear.matched else linear.G_f,
        "f": (lambda x, u, p: [sympy.sin(x.x1 + i) for i in range(columns)]) if columns else None,
        "lipschitz": float(np.sqrt(columns)) if columns else None,
        "disturbance_bound": 2.0,
    }
    return Model(name=name, **(standard | fields))  # type: ignore[arg-type]


# n, m, p, q of each are pairwise different, save p = q where the system is square.
RANDOM = [
    system_with_zeros(name="square, degree 1, two zeros", relative_degrees=[1], zeros=[-2.0, -0.5], inputs=2, seed=1),
    system_with_zeros(name="square, degree 2, a pair", relative_degrees=[2], zeros=[-1.5 + 4j], inputs=3, seed=2),
    system_with_zeros(name="square, degree 3, no zeros", relative_degrees=[3], inputs=2, seed=3),
    system_with_zeros(name="square, degree 3, one zero", relative_degrees=[3], zeros=[-3.0], inputs=2, seed=4),
    system_with_zeros(
        name="square, degrees 1 and 3", relative_degrees=[1, 3], zeros=[-1.0], inputs=1, matched=False, seed=5
    ),
    system_with_zeros(
        name="tall, degree 2", relative_degrees=[3], zeros=[-1.0 + 1j], extra_outputs=1, inputs=3, seed=6
    ),
    system_with_zeros(
        name="tall, degrees 2 and 1, unmatched",
        relative_degrees=[2, 2],
        zeros=[-0.7],
        extra_outputs=1,
        inputs=1,
        matched=False,
        seed=7,
    ),
    system_with_zeros(
        name="tall, degrees 1 and 1, two more outputs",
        relative_degrees=[3, 1],
        zeros=[-5.0, -2.0],
        extra_outputs=2,
        inputs=1,
        seed=8,
    ),
    system_with_zeros(
        name="tall, three channels, unmatched",
        relative_degrees=[2, 1, 2],
        zeros=[-6.0],
        extra_outputs=1,
        inputs=2,
        matched=False,
        seed=9,
    ),
]


@dataclass(frozen=True)
class BadProblem:
    """A linear part that violates assumptions: the rows that fail, and what the first of them must name."""

    name: str
    linear: LinearPart
    fails: tuple[str, ...]
    says: str


def _with_mode(linear: LinearPart, mode: float, *, driven: bool, seen: bool) -> LinearPart:
    """Add a state, the last, that the unknown inputs drive or not and that the outputs contain or not."""
    n, q = len(linear.A), linear.G.shape[1]
    A = np.block([[linear.A, np.zeros((n, 1))], [np.zeros((1, n)), np.array([[mode]])]])
    G = np.vstack([linear.G, np.full((1, q), float(driven))])
    C = np.hstack([linear.C, np.full((len(linear.C), 1), float(seen))])
    B = np.vstack([linear.B, np.ones((1, linear.B.shape[1]))])
    return LinearPart(A=A, B=B, C=C, G_f=G, G_d=G, matched=True)


_TALL = RANDOM[7].linear
_NONMINIMUM = system_with_zeros(relative_degrees=[2], zeros=[-1.0, 0.25], extra_outputs=1, inputs=3, seed=10).linear
_TWICE = _TALL.G @ [[1.0, 2.0], [1.0, 2.0]]
BAD = [
    BadProblem(
        "an unobservable mode", _with_mode(_TALL, -7.5, driven=True, seen=False), ("observable",), "mode -7.5 1/s (x7)"
    ),
    BadProblem(
        "an uncontrollable mode",
        _with_mode(_TALL, -7.5, driven=False, seen=True),
        ("controllable",),
        "mode -7.5 1/s (x7)",
    ),
    BadProblem("a zero on the right", _NONMINIMUM, ("minimum_phase", "alpha_below_zeros"), "zeros 0.25 1/s"),
    BadProblem(
        "fewer outputs than unknown inputs",
        replace(_TALL, C=_TALL.C[:1]),
        ("outputs_at_least_unknown_inputs", "minimum_phase", "alpha_below_zeros"),
        "1 outputs for 2 unknown inputs",
    ),
    BadProblem(
        "an output that is twice another",
        replace(_TALL, C=np.vstack([_TALL.C, 2.0 * _TALL.C[1]])),
        ("rank_C",),
        "rank 4, with y2, y5 dependent",
    ),
    BadProblem(
        "an unknown input that is twice another",
        replace(_TALL, G_f=_TWICE, G_d=_TWICE),
        ("rank_G", "minimum_phase", "alpha_below_zeros"),
        "rank 1, with d1, d2 dependent",
    ),
]


@st.composite
def minimum_phase_systems(draw: st.DrawFn, *, margin: float = 1.5, square: bool | None = None) -> Problem:
    """Draw a system whose zeros all lie left of −`margin` (1/s), so that any α up to it may be used.

    q is 1 or 2, the relative degrees 1 to 3, n at most 9; m differs from n, p and q, and p from q where it is tall.
    """
    degrees = draw(st.lists(st.integers(1, 3), min_size=1, max_size=2))
    zeros: list[complex] = []
    # Distinct real parts: two equal zeros behind one channel would be an unobservable mode.
    for step in draw(st.lists(st.integers(0, 15), max_size=3, unique=True)):
        pair = draw(st.booleans()) and len(_modal(zeros)) < 2
        zeros.append(complex(-margin - 0.1 - 0.4 * step, draw(st.floats(0.5, 6.0)) if pair else 0.0))
    most = min(2, sum(degrees) - len(degrees))
    extra = 0 if square or not most else draw(st.integers(1 if square is False else 0, most))
    n, q = sum(degrees) + len(_modal(zeros)), len(degrees)
    inputs = draw(st.sampled_from([m for m in range(1, 5) if m not in (n, q, q + extra)]))
    matched = q == 1 or draw(st.booleans())
    return system_with_zeros(
        relative_degrees=degrees,
        zeros=zeros,
        extra_outputs=extra,
        inputs=inputs,
        matched=matched,
        seed=draw(st.integers(0, 2**32 - 1)),
        name="drawn",
    )
