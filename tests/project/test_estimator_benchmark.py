"""The benchmark of the estimator is right: plants, truth, faults, the other estimators, scores and rows."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import sympy
from scipy.integrate import solve_ivp
from scipy.linalg import solve_discrete_are

from benchmarks.estimator import faults, figures, must_show
from benchmarks.estimator.alternatives import MASSES, extended_state_observer, robust_differentiator
from benchmarks.estimator.clean_rows import together
from benchmarks.estimator.comparison import cells
from benchmarks.estimator.figures import Figure
from benchmarks.estimator.kalman import ExtendedKalmanFilter, UnscentedKalmanFilter, ekf, out_of_sequence, smoothed
from benchmarks.estimator.model_files import beside_the_filter, plant_of_file
from benchmarks.estimator.ours import NotAvailableError, RefusedError, ours, ours_of, parameters_of, plant_run
from benchmarks.estimator.page import ESTIMATORS, Results, sections
from benchmarks.estimator.plants import CYLINDER, JOINT, LAG, MOTOR, PLANTS
from benchmarks.estimator.records import Record, jump, simulate
from benchmarks.estimator.scores import Score, score, settling_time
from benchmarks.estimator.tasks import Task
from ndob_fmu.cosim import FmuComponent
from ndob_fmu.errors import ModelError
from ndob_fmu.fmu import build

H = 5e-3
STILL = {"gravity_torque": 0.0}  # the joint without gravity is linear


def short_record(plant=JOINT, stop_time=0.5, seeds=(1, 2), step=H, **more):
    return simulate(plant, step, seeds, stop_time=stop_time, **more)


# -- plants and truth


@pytest.mark.parametrize("plant", [*PLANTS, LAG], ids=lambda plant: plant.name)
def test_the_equations_by_hand_are_those_of_the_model(plant):
    model, field = plant.model(), plant.model().vector_field
    assert dict(model.parameters) == dict(plant.parameters)
    symbols = [model.symbols[name] for name in (*model.states, *model.inputs, *model.disturbances, *model.parameters)]
    slope = field.derivatives(field.driven_by(field.d))
    in_symbols = sympy.lambdify(symbols, list(slope), "numpy")
    random = np.random.default_rng(3)
    for _ in range(5):
        x, u, d = random.normal(size=len(model.states)), random.normal(size=len(model.inputs)), random.normal(size=1)
        values = {name: value * random.uniform(0.5, 2.0) for name, value in plant.parameters.items()}
        expected = np.array(in_symbols(*x, *u, *d, *values.values()), dtype=float)
        np.testing.assert_allclose(plant.slope(x, u, d, values), expected, rtol=1e-12, atol=1e-9)
    np.testing.assert_array_equal(np.array(model.C, dtype=float), plant.C)


@pytest.mark.parametrize("plant", PLANTS, ids=lambda plant: plant.name)
def test_the_truth_is_that_of_an_integrator_with_error_control(plant):
    record = short_record(plant, 0.1, seeds=(1,), sigma=0.0 * plant.sigma)
    x = plant.x0
    for k, t in enumerate(record.t):
        np.testing.assert_allclose(record.Y[0, k], plant.C @ x, rtol=0, atol=1e-7 * max(1.0, np.max(np.abs(x))))
        u = record.U[0, k]
        found = solve_ivp(
            lambda t, x, u=u: plant.slope(x, u, np.array([record.disturbance(t)]), plant.parameters),
            (t, t + H),
            x,
            method="DOP853",
            rtol=1e-11,
            atol=1e-12,
        )
        x = found.y[:, -1]


def test_the_controllers_read_the_noisy_samples_and_the_batch_does_not_mix_seeds():
    both = short_record(MOTOR, 0.1)
    alone = short_record(MOTOR, 0.1, seeds=(2,))
    np.testing.assert_array_equal(both.Y[1], alone.Y[0])
    np.testing.assert_array_equal(both.U[1], alone.U[0])
    assert np.max(np.abs(both.U[0] - both.U[1])) > 1e-3


def test_a_late_sample_is_the_one_from_before():
    now = short_record(sigma=0.0 * JOINT.sigma)
    late = short_record(sigma=0.0 * JOINT.sigma, delays=[3 * H, 0.0])
    np.testing.assert_array_equal(late.Y[:, 3:, 0], now.Y[:, :-3, 0])
    np.testing.assert_array_equal(late.Y[:, :, 1], now.Y[:, :, 1])
    assert np.all(np.isnan(late.Y[:, :3, 0]))
    half = short_record(sigma=0.0 * JOINT.sigma, delays=[0.5 * H, 0.0])
    between = 0.5 * (now.Y[:, 1:, 0] + now.Y[:, :-1, 0])
    np.testing.assert_allclose(half.Y[:, 1:, 0], between, rtol=0, atol=10.0 * H**2)


# -- faults


def test_each_fault_changes_what_it_says():
    good = short_record(stop_time=10.0, seeds=(1, 2, 3))
    moved = (faults.outliers(good, 50.0).Y - good.Y) / JOINT.sigma
    hit = moved[:, :, 0] != 0.0
    assert np.mean(hit) == pytest.approx(0.02, abs=0.006)
    np.testing.assert_allclose(np.abs(moved[:, :, 0][hit]), 50.0, rtol=1e-6)
    assert not np.any(moved[:, :, 1])
    same = np.all(faults.repeated(good).Y[:, 1:] == faults.repeated(good).Y[:, :-1], axis=2)
    assert np.mean(same) == pytest.approx(0.05, abs=0.01)
    stuck = faults.stuck(good).Y
    assert np.all(np.sum(np.all(stuck[:, 1:] == stuck[:, :-1], axis=2), axis=1) == 11)
    width = 20.0 * JOINT.sigma
    rounded = faults.quantised(good).Y
    np.testing.assert_allclose(rounded / width, np.round(rounded / width), atol=1e-9)
    assert np.max(np.abs(rounded - good.Y)) <= 0.5 * width[0] * (1.0 + 1e-9)
    assert np.mean(np.isnan(faults.lost(good, 0.2).Y)) == pytest.approx(0.2, abs=0.02)
    slow = np.isfinite(faults.every_tenth(good, 1).Y)
    assert np.mean(slow[:, :, 1]) == pytest.approx(0.1)
    assert np.all(slow[:, :, 0])
    steps = faults.jittering(H, 10.0, 1)
    assert 0.7 * H <= steps.min() < 0.75 * H < 1.25 * H < steps.max() <= 1.3 * H


# -- the Kalman filters


@pytest.mark.parametrize("plant", PLANTS, ids=lambda plant: plant.name)
def test_the_filters_jacobian_is_that_of_central_differences(plant):
    filter_ = ExtendedKalmanFilter(plant, 2, order=2, intensity=1.0)
    filter_.xi = filter_.xi + 0.3 * filter_.scale * np.random.default_rng(1).normal(size=filter_.xi.shape)
    u, n = np.full((2, plant.model().B.shape[1]), 0.4), len(plant.x0)
    found = filter_.jacobian(u)
    for i in range(n + 1):
        step = 1e-5 * filter_.scale[i] * np.eye(filter_.N)[i]
        sides = [
            plant.slope(xi[:, :n], u, xi[:, n : n + 1], plant.parameters)
            for xi in (filter_.xi + step, filter_.xi - step)
        ]
        expected = (sides[0] - sides[1]) / (2.0 * step[i])
        np.testing.assert_allclose(found[:, :n, i], expected, rtol=1e-5, atol=1e-6 * np.max(np.abs(expected)) + 1e-9)


def test_on_a_linear_plant_the_filters_covariance_is_that_of_the_riccati_equation():
    filter_ = ExtendedKalmanFilter(JOINT, 1, order=2, intensity=40.0, parameters=STILL)
    u = np.zeros((1, 1))
    for _ in range(1500):
        filter_.update(np.zeros((1, 2)))
        filter_.predict(u, H)
    Phi, Q = filter_._discretised(u, H)
    scale = filter_.scale
    P = solve_discrete_are(
        (Phi[0] * scale / scale[:, None]).T,
        (filter_.C * scale).T,
        Q[0] / scale / scale[:, None],
        np.diag(filter_.R),
    )
    np.testing.assert_allclose(filter_.P[0] / scale / scale[:, None], P, rtol=1e-5, atol=1e-12)


def test_an_output_that_is_nan_counts_as_one_of_boundless_noise():
    record = faults.every_tenth(short_record(), 1)
    filter_, deaf = (ExtendedKalmanFilter(JOINT, 2, order=2, intensity=30.0) for _ in range(2))
    for y in np.swapaxes(record.Y, 0, 1):
        filter_.update(y)
        deaf.R = np.where(np.isfinite(y[0]), JOINT.sigma**2, 1e30)
        deaf.update(np.nan_to_num(y))
        np.testing.assert_allclose(filter_.xi, deaf.xi, rtol=1e-9, atol=1e-12)
        for either in (filter_, deaf):
            either.predict(np.zeros((2, 1)), H)


def test_a_filter_of_late_samples_predicts_from_their_times():
    record = short_record()
    late = record.with_samples(np.concatenate([np.full((2, 1, 2), np.nan), record.Y[:, :-1]], axis=1))
    now, delayed = (ekf(r, intensity=30.0, delay=delay) for r, delay in ((record, 0.0), (late, H)))
    np.testing.assert_allclose(delayed["at"][:, 1:], now["ahead"][:, :-1], rtol=1e-9, atol=1e-9)


def test_a_filter_that_goes_over_late_samples_again_equals_the_others_where_they_apply():
    record = short_record()
    now = ekf(record, intensity=30.0)
    np.testing.assert_allclose(out_of_sequence(record, [0, 0], intensity=30.0), now["at"], rtol=0, atol=1e-12)
    blank = np.full((2, 3, 2), np.nan)
    both_late = record.with_samples(np.concatenate([blank, record.Y[:, :-3]], axis=1))
    found = out_of_sequence(both_late, [3, 3], intensity=30.0)
    expected = ekf(both_late, intensity=30.0, delay=3 * H)["at"]
    np.testing.assert_allclose(found[:, 3:], expected[:, 3:], rtol=1e-9, atol=1e-9)
    one_late = record.with_samples(np.stack([record.Y[:, :, 0], both_late.Y[:, :, 1]], axis=2))
    between = [
        np.mean((a - record.d)[:, 40:] ** 2)
        for a in (now["at"], out_of_sequence(one_late, [0, 3], intensity=30.0), found)
    ]
    assert between == sorted(between)


def test_on_a_linear_plant_the_unscented_filter_is_the_extended_one():
    record = short_record(parameters=STILL)
    found = [
        ekf(record, intensity=30.0, parameters=STILL, kind=kind)["at"]
        for kind in (ExtendedKalmanFilter, UnscentedKalmanFilter)
    ]
    np.testing.assert_allclose(found[1], found[0], rtol=0, atol=1e-7 * JOINT.bound)


def test_the_smoother_is_exact_for_a_constant_and_better_than_the_filter_in_noise():
    quiet = short_record(stop_time=1.0, disturbance=lambda t: 1.5, sigma=1e-9 * np.ones(2))
    np.testing.assert_allclose(smoothed(quiet, 5, intensity=30.0)["at"][:, 60:-5], 1.5, rtol=0, atol=0.01)
    record = short_record(stop_time=2.0)
    late, now = smoothed(record, 10, intensity=30.0)["at"][:, 100:-10], ekf(record, intensity=30.0)["at"][:, 100:-10]
    truth = record.d[100:-10]
    assert np.mean((late - truth) ** 2) < 0.2 * np.mean((now - truth) ** 2)


def test_a_filter_that_diverges_says_so_and_leaves_the_others_alone():
    record = short_record()
    wild = record.with_samples(record.Y.copy())
    wild.Y[0, 20] = 1e300
    found, alone = ekf(wild, intensity=30.0), ekf(record, intensity=30.0)
    assert np.all(np.isnan(found["at"][0, 40:]))
    np.testing.assert_allclose(found["at"][1], alone["at"][1], rtol=1e-9, atol=1e-12)


# -- the alternatives


@pytest.mark.parametrize("plant", MASSES, ids=lambda plant: plant.name)
def test_the_equation_of_the_mass_is_a_row_of_the_plants(plant):
    random, n = np.random.default_rng(2), len(plant.x0)
    x, d = random.normal(size=(3, n)), random.normal(size=(3, 1))
    u = random.normal(size=(3, plant.model().B.shape[1]))
    y = x @ plant.C.T
    row = 1 + int(np.argmax(plant.C[0]))
    mass = MASSES[plant]
    expected = plant.slope(x, u, d, plant.parameters)[:, row]
    found = mass.acceleration(y[:, 0], x[:, row], y, u) + mass.gain * d[:, 0]
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12)


def free_mass(d, acceleration=0.0, count=800):
    """Return a record of the joint's first output alone, as if it moved by d only."""
    t = H * np.arange(count)
    Y = np.zeros((1, count, 2))
    Y[0, :, 0] = 0.5 * d * t**2
    Y[0, :, 1] = Y[0, :, 0]
    still = np.full((count, 1), d)
    return Record(JOINT, (1,), t, np.full(count, H), np.zeros((1, count, 1)), Y, still, still, lambda t: d)


def test_both_alternatives_find_a_constant(monkeypatch):
    monkeypatch.setitem(MASSES, JOINT, replace(MASSES[JOINT], acceleration=lambda s, v, y, u: np.zeros(len(s))))
    record = free_mass(1.5)
    np.testing.assert_allclose(extended_state_observer(record, 40.0)[0, 200:, 0], 1.5, rtol=0, atol=1e-8)
    assert abs(extended_state_observer(record, 40.0)[0, 5, 0] - 1.5) > 0.1
    np.testing.assert_allclose(robust_differentiator(record, 20.0)[0, 400:, 0], 1.5, rtol=0, atol=1.1 * 20.0 * 4 * H)


# -- ours


def test_ours_in_this_process_is_the_built_fmu(tmp_path):
    record = short_record(seeds=(1,), stop_time=0.3)
    found = ours_of(record)
    model = JOINT.model()
    component = FmuComponent(build(model, tmp_path)[1])
    names = [variable.name for variable in component.variables if variable.causality == "output"]
    values = np.empty(len(names))
    inputs = [*model.inputs, *model.outputs]
    try:
        component.setup(0.0, 1.0, parameters_of(JOINT), inputs)
        component.set_inputs(np.append(record.U[0, 0], record.Y[0, 0]))
        component.initialize()
        for k in range(len(record.t)):
            component.set_inputs(np.append(record.U[0, k], record.Y[0, k]))
            component.step(k * H, H)
            component.get_outputs(values)
            assert values[names.index("load_torque_hat")] == found["ahead"][0, k, 0]
            assert values[names.index("load_torque_std")] == found["std"][0, k, 0]
    finally:
        component.close()


def test_a_parameter_that_the_fmu_has_not_is_named():
    with pytest.raises(NotAvailableError, match="no_such_name"):
        ours(JOINT, H, np.zeros((2, 1)), np.zeros((2, 2)), no_such_name=1.0)
    with pytest.raises(RefusedError, match="disturbance_bound"):
        ours(JOINT, H, np.zeros((2, 1)), np.zeros((2, 2)), disturbance_bound=-1.0)


def test_the_plant_fmu_takes_the_inputs_step_by_step():
    record = short_record(CYLINDER, seeds=(1,), sigma=0.0 * CYLINDER.sigma, disturbance=lambda t: 0.0)
    path, seconds = plant_run(CYLINDER, H, record.U[0])
    assert seconds.shape == record.t.shape
    np.testing.assert_allclose((path @ CYLINDER.C.T)[:-1], record.Y[0, 1:], rtol=0, atol=1e-8)


# -- scores and rows


def hand_made(at, std, valid):
    count = len(at)
    zero = np.zeros((count, 1))
    t = 0.1 * np.arange(count)
    record = Record(JOINT, (1,), t, np.full(count, 0.1), zero[None], np.zeros((1, count, 2)), zero, zero, lambda t: 0.0)
    column = np.array(at)[None, :, None]
    return record, {"at": column, "ahead": column, "std": np.array(std)[None, :, None], "valid": np.array([valid])}


def test_the_score_counts_from_its_begin_on():
    record, found = hand_made([9.0, 5.0, 1.0, -7.0], [9.0, 2.0, 1.0, 1.0], [False, True, False, True])
    result = score(record, found, begin=0.25)
    assert result.rms == pytest.approx(math.sqrt(75.0 / 3.0) / 5.0)
    assert (result.peak, result.covered, result.largest_std) == (pytest.approx(1.4), pytest.approx(1 / 3), 1.8)
    assert (result.valid, result.toggles) == (pytest.approx(2 / 3), 2.0)


def test_settling_is_counted_to_the_last_sample_outside():
    record, found = hand_made([9.0, 9.0, 0.1, 1.0, 0.1, 0.1], [1.0] * 6, [True] * 6)
    assert settling_time(record, found["at"], 0.1, 0.1) == pytest.approx(0.3)
    assert settling_time(record, found["at"][:, ::-1], 0.1, 0.1) == math.inf
    assert settling_time(record, 0.0 * found["at"], 0.1, 0.1) == 0.0


def test_a_jump_comes_at_its_time():
    d = jump(JOINT, -1.0, 1.0, 0.5)
    assert [d(t) for t in (0.0, 0.5 - 1e-9, 0.5, 0.6)] == [-5.0, -5.0, 5.0, 5.0]


def test_a_figure_that_is_missing_or_beyond_its_limit_is_short():
    table = figures.as_text(
        [
            Figure("a", 1.0, 0.9),
            Figure("b", 1.0, 1.1),
            Figure("c", 0.9, 0.95, at_least=True),
            Figure("d", 0.9, 0.85, at_least=True),
            Figure("e", 1.0, math.nan),
            Figure("f", 1.0, None, note="not available: lag"),
        ]
    )
    verdicts = [line.rsplit("|", 2)[1].strip() for line in table.splitlines()[2:]]
    assert verdicts == ["ok", "**short**", "ok", "**short**", "**short**", "**short**"]
    assert "not available: lag" in table


def test_a_task_that_needs_what_the_fmu_lacks_is_one_short_figure():
    def needs_more(seeds, name):
        raise NotAvailableError(name)

    (figure,) = Task("row", needs_more, ("lag",)).run((1,))
    assert (figure.text, figure.short, figure.note) == ("row", True, "not available: lag")


def test_the_coverage_of_all_cells_is_their_mean():
    text = "joint, good samples: share within 2·std"
    found = together([Figure(text, 0.9, 0.9, at_least=True), Figure("rms", 1.0, 0.5), Figure(text, 0.9, 1.0)])
    assert [(figure.limit, figure.measured) for figure in found] == [(0.90, 0.95), (0.99, 0.95)]
    assert together([Figure("other", 1.0, 1.0)]) == []


def test_tasks_and_cells_have_names_of_their_own():
    names = [task.name for task in must_show.tasks()]
    assert len(set(names)) == len(names) > 40
    assert {task.name for task in must_show.tasks("^lag")} == {"lag 25 ms", "lag 50 ms"}
    keys = [(cell.group, cell.plant.name, cell.text) for cell in cells()]
    assert len(set(keys)) == len(keys)


# -- model files of users

VALVE = """
import sympy
from ndob_fmu import Experiment, Model, ObserverDefaults

m = sympy.Symbol("mass")
model = Model(
    name="Valve", states=["position", "speed"], inputs=["opening"], outputs=OUTPUTS, disturbances=["force"],
    A=[[0, 1], [0, -2 / m]], B=[[0], [0]], G_d=[[0], [1 / m]], G_f=[[0], [1]], C=C,
    f=lambda x, u, p: [u.opening * sympy.sqrt(sympy.Max(2 - x.speed, 1)) * sympy.Min(x.position, 3, p.mass)],
    parameters={"mass": 2.0}, noise_std=1e-3, disturbance_bound=4.0, xhat0_std=[0.1, 0.1],
    observer=ObserverDefaults(disturbance_rate=4.0 * 36.0), experiment=Experiment(stop_time=2.0, step_size=0.01),
)

def control(t, y):
    return [-5.0 * y[0]]
"""


def valve(tmp_path, outputs='["position"]', C="[[1, 0]]"):
    path = tmp_path / "valve.py"
    path.write_text(VALVE.replace("OUTPUTS", outputs).replace("C=C", f"C={C}"), "utf-8")
    return str(path)


def test_the_equations_of_a_model_file_are_taken_as_they_stand(tmp_path):
    plant, disturbance = plant_of_file(valve(tmp_path))
    x, u, d = np.array([[0.5, -1.0], [4.0, 1.5]]), np.array([[0.3], [-0.2]]), np.array([[1.0], [2.0]])
    flow = u[:, 0] * np.sqrt(np.maximum(2.0 - x[:, 1], 1.0)) * np.minimum(x[:, 0], 2.0)
    expected = np.column_stack([x[:, 1], -x[:, 1] + 0.5 * d[:, 0] + flow])
    np.testing.assert_allclose(plant.slope(x, u, d, plant.parameters), expected, rtol=1e-13)
    assert disturbance is None
    assert plant.pace == pytest.approx(3.0 / math.pi)
    assert plant.substep < 0.01 / 4
    np.testing.assert_array_equal(plant.control(0.0, np.array([[0.1], [0.2]]), {}, 0.01), [[-0.5], [-1.0]])


def test_a_model_file_gets_rows_beside_the_filter(tmp_path):
    tuned, same, covered, valid = beside_the_filter((1,), valve(tmp_path))
    assert same.measured == pytest.approx(same.limit / 1.15, rel=0.03)
    assert tuned.measured == same.measured
    assert [figure.short for figure in (tuned, covered, valid)] == [False] * 3


def test_a_model_file_whose_outputs_are_not_linear_is_refused(tmp_path):
    model = valve(tmp_path).replace("valve.py", "curved.py")
    text = VALVE.replace("OUTPUTS", '{"angle": lambda x, u, p: sympy.sin(x.position)}')
    start, end = text.index("    A="), text.index("    parameters=")
    dynamics = "    dynamics=lambda x, u, d, p: [x.speed, u.opening + d.force],\n"
    (tmp_path / "curved.py").write_text(text[:start] + dynamics + text[end:], "utf-8")
    with pytest.raises(ModelError, match="states, or sums of them"):
        plant_of_file(model)


def test_the_page_shows_every_estimator_and_says_what_is_missing():
    good = next(cell for cell in cells() if cell.group == "good")
    later = next(cell for cell in cells() if cell.group == "later")
    scores = [{name: Score(0.01 * i, 1.0) for i, name in enumerate(ESTIMATORS, 1)}, {"ours": "not available: lag"}]
    results = Results([good, later], scores, [Figure("a", 1.0, 0.5), Figure("b", 1.0, 0.7, timed=True)], (1,))
    text = "\n".join(sections(results))
    assert "| joint | 1 ms | 0.0100 | 0.0200 | 0.0300 | 0.0400 | 0.0500 | 0.0600 | – | – | nan% |" in text
    assert "| joint | 5 ms | not available: lag | – | – |" in text
    assert "| a | – | ≤ 1 | 0.5 | ok |" in text
    assert "| b |" not in text
