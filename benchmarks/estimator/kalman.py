"""Our own extended Kalman filter over any record: time-varying, one output at a time, over B records at once.

It shares no code with the package. ξ = [x; d; ḋ; …] with r integrated disturbances, N = n + r q, and white noise behind
each d^{(r)}. Its intensity is in proportion to D₀².

    update     for each output that has a sample:  K = P hᵀ/(h P hᵀ + σ²),  ξ̂ += K (y − h ξ̂),  P by Joseph's form
    predict    ξ̂ by Runge–Kutta;  P⁻ = Φ P Φᵀ + Q,  Φ and Q by Van Loan from ∂F/∂ξ at ξ̂
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from math import ceil, factorial, log2, pi
from typing import Any

import numpy as np

from benchmarks.baselines import exponential
from benchmarks.estimator.plants import Array, Plant
from benchmarks.estimator.records import Record, simulate, sine

_COMPLEX_STEP = 1e-30
_FASTEST = 8.0  # of ∂F/∂ξ times the step of Van Loan's exponential
_DIVERGED = 1e6  # standard deviations of the prior
_COARSER = 4  # than the truth's substep: its error stays far below the noise


class ExtendedKalmanFilter:
    """The filter of a plant for B records.

    order: r ≥ 1
    intensity: of the white noise behind d^{(r)} of the first disturbance, a number or one for each record (B,)
    sigma: (p,), by default the plant's
    """

    def __init__(
        self,
        plant: Plant,
        batch: int,
        *,
        order: int,
        intensity: float | Array,
        sigma: Array | None = None,
        parameters: Mapping[str, Any] | None = None,
    ) -> None:
        self.plant, self.order, self.n = plant, order, len(plant.x0)
        self.q = q = len(plant.bounds)
        self.N = N = self.n + order * q
        self.parameters = {**plant.parameters, **(parameters or {})}
        self.C = np.hstack([plant.C, np.zeros((len(plant.C), order * q))])
        self.R = (plant.sigma if sigma is None else sigma) ** 2
        self.intensity = np.broadcast_to(np.asarray(intensity, dtype=float), (batch,))
        # The prior of d and its derivatives: a sine at the bound and the declared pace.
        derivatives = [plant.bounds * (2.0 * pi * plant.pace) ** i for i in range(order)]
        self.scale = np.concatenate([plant.x_std, *derivatives])
        nominal = np.broadcast_to(plant.nominal, q)
        self.xi = np.tile(np.concatenate([plant.x_hat, nominal, np.zeros((order - 1) * q)]), (batch, 1))
        self.P = np.tile(np.diag(self.scale**2), (batch, 1, 1))
        self.Phi = self.P
        self.lost = np.zeros(batch, dtype=bool)
        self._start = self.xi[0].copy()
        self._identity = np.eye(N)

    @property
    def d(self) -> Array:
        """d̂ (B,q), NaN where the filter has diverged."""
        return np.where(self.lost[:, None], np.nan, self.xi[:, self.n : self.n + self.q])

    @property
    def d_std(self) -> Array:
        """The standard deviation of d̂ (B,q)."""
        return np.asarray(np.sqrt(np.diagonal(self.P, axis1=1, axis2=2)[:, self.n : self.n + self.q]))

    def update(self, y: Array) -> None:
        """Take in samples (B,p); entries that are NaN were not measured."""
        for i, h in enumerate(self.C):
            measured = np.isfinite(y[:, i])
            if not measured.any():
                continue
            Ph = self.P @ h
            K = np.where(measured[:, None], Ph / (Ph @ h + self.R[i])[:, None], 0.0)
            error = np.where(measured, y[:, i] - self.xi @ h, 0.0)
            self.xi = self.xi + K * error[:, None]
            J = self._identity - K[:, :, None] * h
            self.P = J @ self.P @ np.swapaxes(J, 1, 2) + self.R[i] * K[:, :, None] * K[:, None, :]

    def predict(self, u: Array, h: float) -> None:
        """Go on by h (s) with the input u (B,m); a record of which the filter diverges is `lost`."""
        with np.errstate(over="ignore", invalid="ignore"):
            self.Phi, Q = self._discretised(u, h)
            self.xi, P = self._moved(u, h)
            P = P + Q
        self.P = 0.5 * (P + np.swapaxes(P, 1, 2))
        lost = ~np.all(np.abs(self.xi / self.scale) < _DIVERGED, axis=1) | ~np.all(np.isfinite(self.P), axis=(1, 2))
        if lost.any():
            # It goes on from the start, so that the other records of the batch can go on too.
            self.lost = self.lost | lost
            self.xi = np.where(lost[:, None], self._start, self.xi)
            self.P = np.where(lost[:, None, None], np.diag(self.scale**2), self.P)

    def _moved(self, u: Array, h: float) -> tuple[Array, Array]:
        """Return ξ̂ and P after h (s), without the noise."""
        return self.motion(self.xi, u, h), self.Phi @ self.P @ np.swapaxes(self.Phi, 1, 2)

    def motion(self, xi: Array, u: Array, h: float) -> Array:
        """Return what becomes of ξ (…,N) in h (s) with the input u (…,m), the disturbance a polynomial."""
        n, plant = self.n, self.plant
        x, derivatives = xi[:, :n], xi[:, n:].reshape(len(xi), self.order, self.q)
        substeps = ceil(h / (_COARSER * plant.substep) - 1e-9)
        step = h / substeps

        def d(t: float) -> Array:
            return np.asarray(sum(derivatives[:, i] * t**i / factorial(i) for i in range(self.order)))

        for i in range(substeps):
            begin, middle, end = d(i * step), d((i + 0.5) * step), d((i + 1) * step)
            k1 = plant.slope(x, u, begin, self.parameters)
            k2 = plant.slope(x + 0.5 * step * k1, u, middle, self.parameters)
            k3 = plant.slope(x + 0.5 * step * k2, u, middle, self.parameters)
            x = x + step / 6.0 * (k1 + 2.0 * (k2 + k3) + plant.slope(x + step * k3, u, end, self.parameters))
        moved = [
            sum(derivatives[:, j] * h ** (j - i) / factorial(j - i) for j in range(i, self.order))
            for i in range(self.order)
        ]
        return np.column_stack([x, *moved])

    def jacobian(self, u: Array) -> Array:
        """Return ∂F/∂ξ (B,N,N) at ξ̂, by complex steps, which are exact to rounding."""
        n, m, batch = self.n, self.n + self.q, len(self.xi)
        points = self.xi[:, None, :m] + _COMPLEX_STEP * 1j * np.eye(m)
        slopes = self.plant.slope(points[..., :n], u[:, None, :], points[..., n:], self.parameters)
        F = np.zeros((batch, self.N, self.N))
        F[:, :n, :m] = np.swapaxes(np.imag(slopes) / _COMPLEX_STEP, 1, 2)
        F[:, n:, n:] = np.eye(self.order * self.q, k=self.q)
        return F

    def _discretised(self, u: Array, h: float) -> tuple[Array, Array]:
        """Return Φ and Q (B,N,N), Van Loan (1978), in states of size one.

        His exponential grows as fast as a stiff plant decays, so that it is made for a part of the step and doubled.
        """
        N, q, scale = self.N, self.q, self.scale
        F = self.jacobian(u) * scale / scale[:, None]
        doublings = max(0, ceil(log2(max(h * float(np.max(np.abs(F).sum(axis=2))), 1.0) / _FASTEST)))
        part = h / 2**doublings
        block = np.zeros((len(F), 2 * N, 2 * N))
        block[:, :N, :N] = -part * F
        block[:, N - q : N, 2 * N - q :] = np.eye(q)  # D₀² is in the scales
        block[:, N:, N:] = part * np.swapaxes(F, 1, 2)
        whole = exponential(block)
        Phi = np.swapaxes(whole[:, N:, N:], 1, 2)
        Q = Phi @ whole[:, :N, N:] / 2**doublings
        for _ in range(doublings):
            Q = Q + Phi @ Q @ np.swapaxes(Phi, 1, 2)
            Phi = Phi @ Phi
        size = self.intensity * h / scale[-q] ** 2
        return Phi * scale[:, None] / scale, size[:, None, None] * Q * scale[:, None] * scale


class UnscentedKalmanFilter(ExtendedKalmanFilter):
    """The same with 2 N sigma points in place of the linearisation of the mean and its covariance.

    The points lie √N standard deviations away along the principal axes of P and weigh the same. Q is the EKF's.
    """

    def _moved(self, u: Array, h: float) -> tuple[Array, Array]:
        batch, N = self.xi.shape
        values, axes = np.linalg.eigh(self.P / self.scale[:, None] / self.scale)
        spread = self.scale * np.swapaxes(axes * np.sqrt(N * np.maximum(values, 0.0))[:, None, :], 1, 2)
        points = self.xi[:, None, :] + np.concatenate([spread, -spread], axis=1)
        moved = self.motion(points.reshape(-1, N), np.repeat(u, 2 * N, axis=0), h).reshape(batch, 2 * N, N)
        mean = moved.mean(axis=1)
        difference = moved - mean[:, None, :]
        return mean, np.swapaxes(difference, 1, 2) @ difference / (2 * N)


def ekf(
    record: Record,
    *,
    order: int = 2,
    intensity: float | Array | None = None,
    sigma: Array | None = None,
    parameters: Mapping[str, Any] | None = None,
    delay: float = 0.0,
    kind: type[ExtendedKalmanFilter] = ExtendedKalmanFilter,
) -> dict[str, Array]:
    """Run a filter of this kind over a record; its intensity is by default `tuned_intensity`.

    delay: s, by which every sample of the record is late; the filter knows it and is the best there is: it lives at the
    times of the samples and predicts from there.

    Returns at, ahead, std (B,K,q) as `ours_of` does.
    """
    plant = record.plant
    if intensity is None:
        intensity = tuned_intensity(plant, record.H, order)
    batch, count = record.Y.shape[:2]
    filter_ = kind(plant, batch, order=order, intensity=intensity, sigma=sigma, parameters=parameters)
    at, ahead, std = np.full((3, batch, count, len(plant.bounds)), np.nan)
    edges = np.concatenate([record.t, [record.t[-1] + record.steps[-1]]])
    now = 0.0
    for k in range(count):
        sampled = max(0.0, float(edges[k]) - delay)
        _go_on(filter_, record, edges, now, sampled)
        now = sampled
        if edges[k] - delay > -1e-12:
            filter_.update(record.Y[:, k])
        # Without delay the filter itself goes on to the next sample.
        published = _copy(filter_) if delay > 0.0 else filter_
        _go_on(published, record, edges, now, float(edges[k]))
        at[:, k] = published.d
        _go_on(published, record, edges, float(edges[k]), float(edges[k + 1]))
        ahead[:, k], std[:, k] = published.d, published.d_std
        if delay == 0.0:
            now = float(edges[k + 1])
    return {"at": at, "ahead": ahead, "std": std}


def out_of_sequence(record: Record, late: Sequence[int], *, order: int = 2, intensity: float) -> Array:
    """Return d̂ at the samples (B,K,1) where output i comes late[i] steps after it was measured.

    The filter keeps its estimate from before the latest sample that can still come, and goes over the steps since then
    with all that has come: the best that can be done, at max(late) + 1 times the cost.
    """
    batch, count, p = record.Y.shape
    longest = max(late)
    filter_ = ExtendedKalmanFilter(record.plant, batch, order=order, intensity=intensity)
    found = np.empty((batch, count, 1))
    for k in range(count):
        # `filter_` is the prediction for the step `begin`, all samples of which have come.
        begin = max(0, k - longest)
        twin = _copy(filter_)
        for j in range(begin, k + 1):
            y = np.full((batch, p), np.nan)
            for i, steps in enumerate(late):
                if j + steps <= k:
                    y[:, i] = record.Y[:, j + steps, i]
            twin.update(y)
            if j == k:
                found[:, k] = twin.d
            twin.predict(record.U[:, j], float(record.steps[j]))
            if j == k - longest:
                filter_ = _copy(twin)
    return found


def smoothed(record: Record, lag: int, *, order: int = 2, intensity: float | None = None) -> dict[str, Array]:
    """Return `at` (B,K,1): d̂ at each sample from the `lag` later ones too, NaN where there are not so many.

    Rauch, Tung and Striebel's recursion over windows of `lag` steps.
    """
    plant, (batch, count) = record.plant, record.Y.shape[:2]
    if intensity is None:
        intensity = tuned_intensity(plant, record.H, order)
    filter_ = ExtendedKalmanFilter(plant, batch, order=order, intensity=intensity)
    filtered, predicted, gains = [], [], []
    for k in range(count):
        filter_.update(record.Y[:, k])
        filtered.append(filter_.xi)
        P = filter_.P
        filter_.predict(record.U[:, k], float(record.steps[k]))
        predicted.append(filter_.xi)
        # P Φᵀ (P⁻)⁻¹ in states of size one.
        size = np.sqrt(np.diagonal(filter_.P, axis1=1, axis2=2))
        crossed = filter_.Phi @ P / size[:, :, None]
        normed = filter_.P / size[:, :, None] / size[:, None, :]
        gains.append(np.swapaxes(np.linalg.solve(normed, crossed), 1, 2) / size[:, None, :])
    xi_f, xi_p, G = np.stack(filtered), np.stack(predicted), np.stack(gains)
    xi = xi_f[lag:]
    for back in range(1, lag + 1):
        part = slice(lag - back, count - back)
        xi = xi_f[part] + (G[part] @ (xi - xi_p[part])[..., None])[..., 0]
    at = np.full((batch, count, 1), np.nan)
    at[:, : count - lag, 0] = xi[:, :, filter_.n].T
    return {"at": at}


def _go_on(filter_: ExtendedKalmanFilter, record: Record, edges: Array, begin: float, end: float) -> None:
    """Predict from `begin` to `end` (s), with the input of each step in its part."""
    rounding = 1e-9 * record.H
    k = max(0, int(np.searchsorted(edges, begin + rounding, side="right")) - 1)
    while end - begin > rounding:
        stop = min(end, float(edges[k + 1]))
        filter_.predict(record.U[:, k], stop - begin)
        begin, k = stop, k + 1


def _copy(filter_: ExtendedKalmanFilter) -> ExtendedKalmanFilter:
    twin = object.__new__(type(filter_))
    twin.__dict__.update(filter_.__dict__)
    return twin


@cache
def tuned_intensity(plant: Plant, H: float, order: int, sigma: tuple[float, ...] | None = None) -> float:
    """Return the intensity with the least error for sines at the declared bound and pace, over records of its own.

    That is the least favourable signal of the class that ours is told too; the records of the scores have half of it.
    """
    seeds: Sequence[int] = (1001, 1002)
    noise = None if sigma is None else np.array(sigma)
    record = simulate(plant, H, seeds, sine(plant, 1.0), sigma=noise, stop_time=min(plant.stop_time, 600 * H + 0.5))
    pace = 2.0 * pi * plant.pace
    grid = plant.rate(order) ** 2 / pace * np.geomspace(1e-4, 1e4, 17)
    U, Y = (np.repeat(values, len(grid), axis=0) for values in (record.U, record.Y))
    wide = Record(plant, record.seeds, record.t, record.steps, U, Y, record.d, record.d_end, record.disturbance)
    at = ekf(wide, order=order, intensity=np.tile(grid, len(seeds)), sigma=noise)["at"]
    begin = int(0.3 * len(record.t))
    squared = np.mean(((at - record.d) / plant.bounds)[:, begin:] ** 2, axis=(1, 2))
    squared = squared.reshape(len(seeds), -1).mean(axis=0)
    squared = np.where(np.isfinite(squared), squared, np.inf)
    best = int(np.clip(np.argmin(squared), 1, len(grid) - 2))
    three = np.log(squared[best - 1 : best + 2])
    if not np.all(np.isfinite(three)):
        return float(grid[np.argmin(squared)])
    # The vertex of the parabola through the three best in logarithms.
    shift = 0.5 * (three[0] - three[2]) / (three[0] - 2.0 * three[1] + three[2])
    return float(grid[best] * (grid[1] / grid[0]) ** np.clip(shift, -1.0, 1.0))
