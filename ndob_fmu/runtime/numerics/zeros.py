"""Transmission zeros and hidden modes, found so that the units of the plant do not decide.

A zero of (A, G, C) is a z at which the pencil [[A − zI, G], [C, 0]] loses column rank: an unknown input that moves the
states as e^{zt} and leaves every output at zero. Without G these are the unobservable modes. The infinite part
of the pencil is removed by orthogonal transformations (Emami-Naeini and Van Dooren, Automatica 1982): its eigenvalues,
perturbed by rounding, would otherwise pass for finite zeros. Tall systems (p > q) need no squaring down for that.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ndob_fmu.runtime.arrays import Array
from ndob_fmu.runtime.numerics.units import nearest_to_one

ComplexArray = NDArray[np.complex128]

RANK_TOLERANCE = 1e-10
AXIS_TOLERANCE = 1e-9  # of the larger of |z| and the plant's own rate: a zero this close to the axis is on it


@dataclass(frozen=True)
class Balanced:
    """A system in units in which its entries are as near to one as diagonal scaling allows.

    A (n,n), G (n,q), C (p,n): its matrices.
    states (n,): S of x = S z.
    rate (1/s): the unit of time: λ of the plant is rate · λ of `A`.
    """

    A: Array
    G: Array
    C: Array
    states: Array
    rate: float


def balance(A: Array, G: Array, C: Array) -> Balanced:
    """Return the system in the units of states, unknown inputs, outputs and time that bring its entries nearest to one.

    The logarithms of the non-zero entries are fitted by least squares, so that the result is the same whatever units
    the plant was written in, up to the rounding of each scale to a power of two, which keeps the scaling exact.
    """
    n, q, p = len(A), G.shape[1], len(C)
    entries, rows = [], []
    for matrix, row_scale, column_scale, timed in (
        (A, (-1.0, 0), (1.0, 0), True),
        (G, (-1.0, 0), (1.0, n), False),
        (C, (1.0, n + q), (1.0, 0), False),
    ):
        for i, j in np.argwhere(matrix != 0):
            row = np.zeros(n + q + p + 1)
            row[row_scale[1] + i] += row_scale[0]
            row[column_scale[1] + j] += column_scale[0]
            row[-1] = -1.0 if timed else 0.0
            rows.append(row)
            entries.append(np.log2(abs(matrix[i, j])))
    exponents = nearest_to_one(np.array(rows).reshape(-1, n + q + p + 1), np.array(entries))
    scales = np.exp2(np.round(exponents))
    states, inputs, outputs, rate = scales[:n], scales[n : n + q], scales[n + q : -1], float(scales[-1])
    return Balanced(
        A=A * states / states[:, None] / rate,
        G=G * inputs / states[:, None],
        C=C * states * outputs[:, None],
        states=states,
        rate=rate,
    )


def pencil_zeros(A: Array, G: Array, C: Array) -> tuple[ComplexArray, int]:
    """Return the finite zeros of a balanced system and the normal rank of C (sI − A)⁻¹ G.

    Where that rank is below q, every z is a zero and the array is empty.
    """
    q = G.shape[1]
    D = np.zeros((len(C), q))
    tolerance = RANK_TOLERANCE * float(np.linalg.norm(np.block([[A, G], [C, D]])))
    A, B, C, D = _remove_infinite_part(A, G, C, D, tolerance)
    n, rank = len(A), len(D)
    if rank < q or n == 0:
        return np.zeros(0, dtype=complex), rank
    # D is square and invertible: the zeros are the eigenvalues of A − B D⁻¹ C, found without inverting D itself.
    kernel = np.linalg.svd(np.hstack([C, D]))[2][q:].T
    zeros = np.linalg.eigvals(np.hstack([A, B]) @ kernel @ np.linalg.inv(kernel[:n])).astype(complex)
    return zeros[np.lexsort((zeros.imag, -zeros.real))], rank


def _remove_infinite_part(
    A: Array, B: Array, C: Array, D: Array, tolerance: float
) -> tuple[Array, Array, Array, Array]:
    """Return a smaller system (A, B, C, D) with the same finite zeros and a D of full row rank."""
    while True:
        U, sigma, _ = np.linalg.svd(D)
        rank = int(np.sum(sigma > tolerance))
        C, D = U.T @ C, (U.T @ D)[:rank]
        blind = C[rank:]  # these outputs do not depend on the input, so the states that they depend on must be zero
        _, sigma, Vt = np.linalg.svd(blind)
        seen = int(np.sum(sigma > tolerance))
        if seen == 0:
            return A, B, C[:rank], D
        zero, free = Vt[:seen].T, Vt[seen:].T
        C, D = np.vstack([C[:rank] @ free, zero.T @ A @ free]), np.vstack([D, zero.T @ B])
        A, B = free.T @ A @ free, free.T @ B
