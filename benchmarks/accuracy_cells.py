"""Every estimator in every cell of step size, disturbance and noise: how it is run, and the numbers that judge it."""

from __future__ import annotations

import multiprocessing
import os
import tempfile
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from benchmarks.baselines import Array, System, extended_kalman_filter, extended_state_observer, second_difference
from ndob_fmu import build, load_model
from ndob_fmu.codegen.compile_model import compile_model
from ndob_fmu.cosim import Connection, FmuComponent, Port, simulate
from ndob_fmu.cosim import System as Coupled
from ndob_fmu.cosim.component import recordable
from ndob_fmu.runtime.blocks.disturbance import KINDS
from ndob_fmu.runtime.design.augmented import augment
from ndob_fmu.runtime.design.schedule import PiSchedule
from ndob_fmu.runtime.design.tuning import Knowledge, at_bandwidth, tuned_intensities
from ndob_fmu.runtime.linear_part import LinearPart
from ndob_fmu.runtime.step.paper_observer import paper_observer

MODEL = "flexible_joint"
OUTPUTS = ("motor_angle", "link_angle")
SHOWN = ("load_torque_at_sample", "load_torque_hat")
D0 = 5.0
PAPER_PI, PAPER_RAMP = 1e12, 1.0
STEADY_FROM, AFTER_STEP = 2.0, 0.2
SLOWEST, FASTEST = 4.0, 4.0  # of a scan over bandwidths: rad/s, and rad per step


@dataclass(frozen=True)
class Signal:
    """A disturbance of the plant FMU's generator, and the class a user would declare it in.

    The class is that of sines of amplitude 1 and `pace` Hz: |d^{(r)}| ≤ (2π pace)^r.
    """

    name: str
    kind: str
    amplitude: float
    pace: float
    frequency: float = 1.0
    start: float = 0.0

    def rate(self, order: int) -> float:
        """Return the bound D_r of the r-th derivative."""
        return float((2.0 * np.pi * self.pace) ** order)


# The chirp's frequency rises in 10 s; the runs end where it has reached 4.8 Hz.
SIGNALS = (
    Signal("constant 2", "constant", 2.0, 1.0),
    Signal("ramp 1/s", "ramp", 1.0, 1.0),
    Signal("step 2 at 1 s", "step", 2.0, 1.0, start=1.0),
    Signal("sine 1 Hz", "sine", 1.0, 1.0, frequency=1.0),
    Signal("sine 5 Hz", "sine", 1.0, 5.0, frequency=5.0),
    Signal("chirp to 4.8 Hz", "chirp", 1.0, 5.0, frequency=12.0),
)


@dataclass(frozen=True)
class Plan:
    """What is run: step sizes (s), disturbances, noise σ, disturbance orders r of ours and of the EKF, records per
    noisy cell, tunings per scan and around its best.

    stop_time (s) of a cell's records, long_stop_time of the noisy ones for the required figures.
    """

    steps: tuple[float, ...] = (1e-3, 5e-3, 1e-2)
    signals: tuple[Signal, ...] = SIGNALS
    noises: tuple[float, ...] = (0.0, 1e-6, 1e-4)
    orders: tuple[int, ...] = (2, 3)
    records: int = 4
    scan: int = 14
    refinement: int = 6
    stop_time: float = 4.0
    long_stop_time: float = 9.0
    seed: int = 1


QUICK = Plan(
    steps=(1e-2,),
    signals=(SIGNALS[0], SIGNALS[3]),
    noises=(0.0, 1e-4),
    orders=(3,),
    records=1,
    scan=4,
    refinement=1,
    stop_time=3.0,
    long_stop_time=3.0,
)


@dataclass(frozen=True)
class Record:
    """What a run of the plant FMU gave: samples y_k (K,2) and d (K+1,) at t_k, and the estimates of ours without noise.

    `ours` maps r to d̂(t_k | y_k) and d̂(t_k + H | y_k), (2,K).
    """

    H: float
    signal: Signal
    samples: Array = field(repr=False)
    d: Array = field(repr=False)
    ours: dict[int, Array] = field(repr=False)

    def noisy(self, sigma: float, plan: Plan) -> Array:
        """Return the samples (records,K,2) with noise of standard deviation σ, always the same for the same seed."""
        if sigma == 0.0:
            return self.samples[None]
        index = [signal.name for signal in SIGNALS].index(self.signal.name)
        random = np.random.default_rng([plan.seed, round(self.H * 1e6), index])
        return np.asarray(self.samples + sigma * random.normal(size=(plan.records, *self.samples.shape)))


@dataclass(frozen=True)
class Score:
    """How well an estimator did in a cell.

    error at the sample and for the end of the step (ahead): without noise the largest; with noise |bias| + standard
    deviation, or the root mean square of a chirp. each: error of every record alone. Without noise also the samples to
    2 % from the start, the steps to 2 % after a step, None where it never stays there, and the largest |d̂|.
    tuned: bandwidth (rad/s) that a scan found best.
    """

    error: float
    ahead: float
    each: tuple[float, ...] = ()
    samples_to_2_percent: int | None = None
    steps_after_step: int | None = None
    peak: float = 0.0
    tuned: float | None = None


Key = tuple[float, str, float, str]  # H, signal, σ, estimator
Scores = dict[Key, Score]


# -- what is measured


def score(record: Record, sigma: float, at_sample: Array, ahead: Array, tuned: float | None = None) -> Score:
    """Return the score of estimates (records,K)."""
    errors = at_sample - record.d[:-1], ahead - record.d[1:]
    time = np.array([record.H * k for k in range(len(record.d))])
    signal, rounding = record.signal, 1e-9
    begin = signal.start + AFTER_STEP if signal.kind == "step" else STEADY_FROM
    kept = time >= begin - rounding
    windows = kept[:-1], kept[1:]
    times = time[:-1], time[1:]
    values = [magnitude(t[w], e[:, w], signal, sigma) for t, e, w in zip(times, errors, windows, strict=True)]
    each = [magnitude(times[0][windows[0]], e[None, windows[0]], signal, sigma) for e in errors[0]]
    to_start = to_step = None
    if sigma == 0.0 and signal.kind == "constant":
        to_start = _settled(errors[0][0], signal.amplitude)
    if sigma == 0.0 and signal.kind == "step":
        to_step = _settled(errors[0][0][time[:-1] >= signal.start - rounding], signal.amplitude, first=0)
    peak = float(np.max(np.abs([at_sample, ahead])))
    return Score(values[0], values[1], tuple(each), to_start, to_step, peak, tuned)


def magnitude(t: Array, errors: Array, signal: Signal, sigma: float) -> float:
    """Return the one number that stands for errors (records,K) at times t (K,)."""
    if sigma == 0.0:
        return float(np.max(np.abs(errors)))
    if signal.kind == "chirp":
        return float(np.sqrt(np.mean(errors**2)))
    columns = [np.ones_like(t)]
    if signal.kind == "sine":
        angle = 2.0 * np.pi * signal.frequency * t
        columns += [np.cos(angle), np.sin(angle)]
    basis = np.column_stack(columns)
    # The bias is the same in every record, so that its coefficients are averaged before their size is taken.
    coefficients = np.linalg.lstsq(basis, np.mean(errors, axis=0), rcond=None)[0]
    rest = errors - basis @ coefficients
    bias = abs(coefficients[0]) + float(np.linalg.norm(coefficients[1:]))
    return float(bias + np.sqrt(np.mean(rest**2)))


def _settled(error: Array, amplitude: float, first: int = 1) -> int | None:
    """Return the number of samples after which the error stays within 2 %, None if it does not; `first` counts y₀."""
    outside = np.flatnonzero(~(np.abs(error) <= 0.02 * abs(amplitude)))
    if len(outside) == 0:
        return first
    return int(outside[-1]) + 1 + first if outside[-1] + 1 < len(error) else None


# -- ours, through the FMUs


def record(fmus: tuple[Path, Path], H: float, signal: Signal, plan: Plan, orders: Sequence[int] = ()) -> Record:
    """Co-simulate plant and observer without noise, both stepping at once, for each order, by default the plan's."""
    ours: dict[int, Array] = {}
    for order in orders or plan.orders:
        parts = {"plant": FmuComponent(fmus[0]), "observer": FmuComponent(fmus[1])}
        wires = tuple(Connection(Port("plant", y), Port("observer", y)) for y in OUTPUTS)
        still = {Port("plant", "motor_torque"): 0.0, Port("plant", "load_torque"): 0.0}
        starts = {
            "plant.disturbance.kind": KINDS[signal.kind],
            "plant.disturbance.amplitude": signal.amplitude,
            "plant.disturbance.frequency": signal.frequency,
            "plant.disturbance.start_time": signal.start,
            **{f"observer.{name}": value for name, value in _tuning(order, 0.0, signal).items()},
        }
        coupled = Coupled(parts, wires, {**still, Port("observer", "motor_torque"): 0.0})
        run = simulate(coupled, stop_time=plan.stop_time, step_size=H, start_values=starts, progress=False)
        ours[order] = np.array([run[f"observer.{name}"][1:] for name in SHOWN])
    samples = np.column_stack([run[f"plant.{y}"] for y in OUTPUTS])
    return Record(H, signal, samples[:-1], run["plant.load_torque_total"], ours)


def observed(fmus: tuple[Path, Path], data: Record, samples: Array, sigma: float, order: int) -> Array:
    """Drive the observer FMU with samples (K,2) and return what a Record has of ours, (2,K)."""
    H, fmu = data.H, FmuComponent(fmus[1])
    outputs = [variable.name for variable in recordable(fmu.variables)]
    values = np.empty((len(samples), len(outputs)))
    try:
        fmu.setup(0.0, H * len(samples), _tuning(order, sigma, data.signal), OUTPUTS)
        fmu.set_inputs(samples[0])
        fmu.initialize()
        for k, y in enumerate(samples):
            fmu.set_inputs(y)
            fmu.step(k * H, H)
            fmu.get_outputs(values[k])
    finally:
        fmu.close()
    return np.array([values[:, outputs.index(name)] for name in SHOWN])


def _tuning(order: int, sigma: float, signal: Signal) -> dict[str, float]:
    return {
        "method": 2,
        "disturbance_order": order,
        **{f"{output}_noise_std": sigma for output in OUTPUTS},
        "disturbance_bound": D0,
        "disturbance_rate": signal.rate(order),
    }


def ours_scores(fmus: tuple[Path, Path], data: Record, order: int, plan: Plan) -> Scores:
    """Score the observer FMU of a disturbance order in all noises."""
    scores = {}
    for sigma in plan.noises:
        runs = [data.ours[order]]
        if sigma > 0.0:
            runs = [observed(fmus, data, samples, sigma, order) for samples in data.noisy(sigma, plan)]
        at_sample, ahead = np.swapaxes(np.array(runs), 0, 1)
        scores[_key(data, sigma, f"ours r={order}")] = score(data, sigma, at_sample, ahead)
    return scores


# -- the others


@dataclass(frozen=True)
class Setting:
    """The flexible joint in the baselines' form, its linear part, and what the observers are told of it.

    tuning: the joint linearised where it hangs down, for the intensity of the Kalman filter
    """

    system: System
    linear: LinearPart
    tuning: LinearPart
    x_hat: Array
    x_std: Array

    def known(self, order: int, sigma: float, signal: Signal) -> Knowledge:
        """Return what the observers are told: σ, at least the rounding of a sample, D₀ and D_r."""
        C, rounding = np.abs(self.system.C), 4.0 * np.finfo(float).eps
        size = C @ np.abs(self.x_hat) + C @ self.x_std
        return Knowledge(
            R_factor=np.diag(np.maximum(sigma, rounding * size)),
            disturbance_bound=np.array([D0]),
            disturbance_rate=np.array([signal.rate(order)]),
        )


@cache
def setting() -> Setting:
    equations = compile_model(load_model(MODEL))
    gravity = equations.parameters["gravity_torque"]
    linear = equations.linear_part(list(equations.parameters.values()))

    def jacobian(x: Array) -> Array:
        value = np.zeros((len(x), 1, 4))
        value[:, 0, 0] = -gravity * np.cos(x[:, 0])
        return value

    system = System(linear.A, linear.C, linear.G_f, linear.G_d, lambda x: -gravity * np.sin(x[:, :1]), jacobian)
    hanging = linear.A + linear.G_f @ jacobian(np.zeros((1, 4)))[0]
    tuning = LinearPart(A=hanging, B=linear.B, C=linear.C, G_f=np.zeros((4, 0)), G_d=linear.G_d, matched=False)
    start = np.array(equations.xhat0), np.array(equations.xhat0_std)
    return Setting(system, linear, tuning, *start)


def ekf_scores(data: Record, order: int, plan: Plan) -> Scores:
    """Score the extended Kalman filter: tuned as ours is, and at the best of a scan over its intensity in each cell."""
    case, augmented = setting(), augment(setting().tuning, order)
    pace = (data.signal.rate(order) / D0) ** (1.0 / order)
    prior = np.concatenate([case.x_std, D0 * pace ** np.arange(order)])
    scores: Scores = {}
    for sigma in plan.noises:
        known = case.known(order, sigma, data.signal)

        def intensity(bandwidth: float, known: Any = known) -> float:
            return float(at_bandwidth(augmented, data.H, bandwidth, known).disturbance[0])

        def run(samples: Array, intensities: Array, known: Any = known) -> tuple[Array, Array]:
            estimates = extended_kalman_filter(
                case.system,
                order,
                data.H,
                samples,
                noise_std=np.broadcast_to(np.diag(known.R_factor), (len(samples), 2)),
                intensity=intensities[:, None],
                x_hat=case.x_hat,
                prior_std=prior,
            )
            return estimates.at_sample[:, :, 0], estimates.ahead[:, :, 0]

        principle = float(tuned_intensities(augmented, data.H, 1.0, known).disturbance[0])
        first, best = scanned(data, sigma, plan, run, intensity, principle)
        assert first is not None
        scores[_key(data, sigma, f"EKF r={order}")] = first
        scores[_key(data, sigma, f"EKF r={order}, scan")] = best
    return scores


def eso_scores(data: Record, order: int, plan: Plan) -> Scores:
    """Score the linear extended state observer at the best bandwidth of a scan in each cell."""
    parameters, x_hat = load_model(MODEL).parameters, setting().x_hat

    def run(samples: Array, bandwidth: Array) -> tuple[Array, Array]:
        estimates = extended_state_observer(
            order,
            data.H,
            samples,
            bandwidth=bandwidth,
            stiffness=parameters["joint_stiffness"],
            damping=parameters["motor_damping"],
            start=(x_hat[2], x_hat[3]),
        )
        return estimates.at_sample[:, :, 0], estimates.ahead[:, :, 0]

    return {
        _key(data, sigma, f"ESO r={order}, scan"): scanned(data, sigma, plan, run, lambda bandwidth: bandwidth)[1]
        for sigma in plan.noises
    }


def scanned(
    data: Record,
    sigma: float,
    plan: Plan,
    run: Callable[[Array, Array], tuple[Array, Array]],
    knob: Callable[[float], float],
    given: float | None = None,
) -> tuple[Score | None, Score]:
    """Return the score at the knob's `given` value and the best over bandwidths: a scan and a finer one around it."""
    samples = data.noisy(sigma, plan)

    def scores_at(bandwidths: Array, knobs: Array) -> list[Score]:
        at_sample, ahead = run(np.tile(samples, (len(knobs), 1, 1)), np.repeat(knobs, len(samples)))
        groups = [values.reshape(len(knobs), len(samples), -1) for values in (at_sample, ahead)]
        return [score(data, sigma, a, b, w) for a, b, w in zip(*groups, bandwidths.tolist(), strict=True)]

    coarse = np.geomspace(SLOWEST, FASTEST / data.H, plan.scan)
    knobs = np.array([knob(bandwidth) for bandwidth in coarse])
    first = None
    if given is not None:
        first, *results = scores_at(np.append(0.0, coarse), np.append(given, knobs))
    else:
        results = scores_at(coarse, knobs)
    best = int(np.argmin([result.error for result in results]))
    ends = coarse[max(best - 1, 0)], coarse[min(best + 1, plan.scan - 1)]
    fine = np.geomspace(*ends, plan.refinement + 2)[1:-1]
    results += scores_at(fine, np.array([knob(bandwidth) for bandwidth in fine]))
    return first, min(results, key=lambda result: result.error)


def paper_scores(data: Record, plan: Plan) -> Scores:
    """Score the paper's method, y held and y a polynomial; with noise also at the π that fits σ and a bound of ḋ.

    Its estimate for the end of a step is taken for the sample there where that is the better of its two.
    """
    scores: Scores = {}
    for sigma in plan.noises:
        ends = {"paper": PAPER_PI}
        if sigma > 0.0:
            ends["paper π*"] = fitting_pi(sigma, data.signal)
        for name, pi_end in ends.items():
            for degree, hold in ((0, "held"), (2, "polynomial")):
                runs = [_paper_run(data, samples, pi_end, degree) for samples in data.noisy(sigma, plan)]
                at_sample, ahead = np.swapaxes(np.array(runs), 0, 1)
                shown = score(data, sigma, at_sample, ahead)
                predicted = np.concatenate([np.zeros((len(ahead), 1)), ahead[:, :-1]], axis=1)
                shifted = score(data, sigma, predicted, ahead)
                scores[_key(data, sigma, f"{name}, {hold}")] = min(shown, shifted, key=lambda result: result.error)
    return scores


def fitting_pi(sigma: float, signal: Signal) -> float:
    """Return π* = (D₁/(√2 σ))^{4/3}, at which bias and noise of the paper's method balance."""
    return float((signal.rate(1) / (np.sqrt(2.0) * sigma)) ** (4.0 / 3.0))


def _paper_run(data: Record, samples: Array, pi_end: float, degree: int) -> Array:
    equations = compile_model(load_model(MODEL))
    schedule = PiSchedule(1.0, pi_end, PAPER_RAMP)
    observer = paper_observer(equations, list(equations.parameters.values()), schedule, alpha=1.0, hold_degree=degree)
    state = observer.init(equations.xhat0)
    estimates = []
    for y in samples:
        state, estimate = observer.step(state, [0.0], y, data.H)
        estimates.append((estimate.d_at_sample[0], estimate.d_hat[0]))
    return np.asarray(np.array(estimates).T)


def inverse_scores(data: Record, plan: Plan) -> Scores:
    """Score the second-difference inverse."""
    parameters = load_model(MODEL).parameters
    scores = {}
    for sigma in plan.noises:
        estimates = second_difference(
            data.H,
            data.noisy(sigma, plan),
            stiffness=parameters["joint_stiffness"],
            damping=parameters["motor_damping"],
        )
        scores[_key(data, sigma, "inverse")] = score(
            data, sigma, estimates.at_sample[:, :, 0], estimates.ahead[:, :, 0]
        )
    return scores


def _key(data: Record, sigma: float, estimator: str) -> Key:
    return data.H, data.signal.name, sigma, estimator


# -- all of it


def run_all(plan: Plan, workers: int) -> Scores:
    """Run every estimator in every cell."""
    with tempfile.TemporaryDirectory(prefix="ndob_accuracy_") as folder:
        fmus = build(load_model(MODEL), folder)
        cells = [(H, signal) for H in plan.steps for signal in plan.signals]
        records = in_parallel("plant", [(record, fmus, H, signal, plan) for H, signal in cells], workers)
        jobs: list[tuple[Any, ...]] = []
        for data in records:
            jobs += [(ekf_scores, data, order, plan) for order in plan.orders]
            jobs += [(ours_scores, fmus, data, order, plan) for order in plan.orders]
            jobs += [(paper_scores, data, plan)]
            jobs += [(eso_scores, data, order, plan) for order in (1, 3)]
            jobs += [(inverse_scores, data, plan)]
        return {key: value for scores in in_parallel("estimators", jobs, workers) for key, value in scores.items()}


def in_parallel(title: str, jobs: Sequence[tuple[Any, ...]], workers: int) -> list[Any]:
    """Return the results of jobs (function, *arguments), in their order."""
    if workers == 1:
        return [function(*arguments) for function, *arguments in tqdm(jobs, desc=title, disable=None)]
    # A fresh interpreter each: loaded FMUs do not survive a fork. Small matrices gain nothing from BLAS's own threads.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    results: dict[int, Any] = {}
    with ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn")) as pool:
        futures = {pool.submit(*job): index for index, job in enumerate(jobs)}
        try:
            for future in tqdm(as_completed(futures), desc=title, total=len(jobs), disable=None):
                results[futures[future]] = future.result()
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise
    return [results[index] for index in range(len(jobs))]
