"""What the library in C finds is what NumPy finds, and without a compiler the results are the same."""

from math import inf

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from ndob_fmu.codegen.compile_model import compile_model
from ndob_fmu.codegen.row_functions import row_functions
from ndob_fmu.interface.told_observer import told_observer
from ndob_fmu.log.estimate_log import estimate_log
from ndob_fmu.log.smooth import c_library as module
from ndob_fmu.log.smooth.c_library import c_library
from ndob_fmu.log.smooth.event_effects import AlongRecord, Source
from ndob_fmu.log.smooth.events import Events, Jumps, with_events
from ndob_fmu.log.smooth.gains import explained_by
from ndob_fmu.log.smooth.pieces import CutRecord, parts_of, side_by_side
from ndob_fmu.log.smooth.row_model import RowModel
from ndob_fmu.log.smooth.row_steps import Motion
from ndob_fmu.log.smooth.row_transition import row_transition
from ndob_fmu.log.smooth.smoother import backward, forward, lower_factor
from ndob_fmu.log.smooth.whole_record import WholeRecord
from ndob_fmu.log.told_values import told_values
from ndob_fmu.log.tune.lagged import lagged_adjoint
from ndob_fmu.model.loading import load_model
from ndob_fmu.results.csv_files import csv_lines
from tests.helpers.needs import C_COMPILER
from tests.log.test_estimate_log import CART, NOISE, TUNED, gusts, simulated, write_log
from tests.log.test_smoother import random_record

pytestmark = C_COMPILER
ROWS = 1200
EDGES = [0.0, -0.0, 5e-324, 2.0**-1022, 1e-5, 1e-4, 0.1, 123456.5, 1e15, 1e16, 2.0**53, 9007199254740993.0, 1e22, 1e23]
EDGES += [1.7976931348623157e308, inf, -inf, float("nan")]


@pytest.fixture
def in_numpy(monkeypatch):
    """Return a function that calls another one as if there were no compiler."""

    def called(function, *arguments, **named):
        with monkeypatch.context() as patch:
            patch.setattr(module, "MANY_ROWS", inf)
            return function(*arguments, **named)

    return called


def found_in_c(function, *arguments, **named):
    assert c_library(ROWS) is not None
    return function(*arguments, **named)


def assert_close(found, expected, tolerance=1e-9):
    """Each array within a part of its largest entry; factors (…,N,·) by their products."""
    for name, values in expected.items():
        got = found[name]
        if name in ("factor", "noise"):
            got, values = (one @ np.swapaxes(one, -1, -2) for one in (got, values))
        size = np.where(np.isfinite(values), np.abs(values), 0.0).max()
        np.testing.assert_allclose(got, values, rtol=0, atol=tolerance * size, err_msg=name)


def stable_record(N, p, seed):
    """A record of many rows whose states do not grow without bounds."""
    record = random_record(N, p, ROWS, seed)
    record.Phi[:] *= 0.8
    return record


@pytest.mark.parametrize(("N", "p"), [(2, 1), (5, 2), (7, 3)])
def test_both_passes_find_the_same_with_jumps_that_have_different_columns(N, p, in_numpy):
    record, random = stable_record(N, p, seed=N), np.random.default_rng(1)
    jumps = {k: random.standard_normal((N, c)) for k, c in ((0, 1), (700, 9), (701, 2), (ROWS - 1, 3))}
    run, expected = found_in_c(forward, record, jumps), in_numpy(forward, record, jumps)
    assert_close(vars(run), vars(expected))
    assert_close(vars(found_in_c(backward, record, run)), vars(in_numpy(backward, record, expected)))


def test_records_side_by_side_are_filtered_each_with_its_own_start_and_jumps(in_numpy):
    record, random = stable_record(4, 3, seed=2), np.random.default_rng(3)
    pieces = side_by_side(ROWS, 150)
    parts = parts_of(record, pieces, np.full(4, 2.0))
    jumps = pieces.placed({k: random.standard_normal((4, c)) for k, c in ((10, 2), (160, 1), (900, 2))})
    run, expected = found_in_c(forward, parts, jumps), in_numpy(forward, parts, jumps)
    assert_close(vars(run), vars(expected))
    assert_close(vars(found_in_c(backward, parts, run)), vars(in_numpy(backward, parts, expected)))


def test_a_whole_record_with_noise_of_many_columns_is_filtered_as_in_pieces(in_numpy):
    record, random = stable_record(3, 2, seed=4), np.random.default_rng(5)
    several = [np.tril(0.3 * random.standard_normal((ROWS - 1, 3, 3))) for _ in range(4)]
    record = type(record)(**{**vars(record), "noise": np.concatenate(several, axis=2)})
    jumps = {500: np.ones((3, 1))}
    found, expected = (
        call(WholeRecord(record).passes, record.variance, jumps) for call in (found_in_c, in_numpy)
    )  # fmt: skip
    for mine, theirs in zip(found, expected, strict=True):
        assert_close(vars(mine), vars(theirs))


def test_factors_are_lower_triangles_of_the_same_covariance(in_numpy):
    rows = np.random.default_rng(6).standard_normal((ROWS, 5, 8))
    rows[::3, :, 2:] = 0.0  # fewer columns than rows
    rows[::5, 1] = 0.0
    found = found_in_c(lower_factor, rows)
    np.testing.assert_array_equal(found, np.tril(found))
    assert_close({"factor": found}, {"factor": in_numpy(lower_factor, rows)}, 1e-13)


@pytest.mark.parametrize("longest", [1e-3, 0.3, 3.0])
def test_steps_of_a_linear_system_are_the_same_however_long_they_are(longest, in_numpy):
    random = np.random.default_rng(7)
    F = random.standard_normal((ROWS, 5, 5)) * (random.random((5, 5)) < 0.5)
    H = random.uniform(0.2, 1.0, ROWS) * longest
    channel, held = random.standard_normal((5, 2)), random.standard_normal((5, 3))
    told = (F, channel, H, held, np.array([0.1, 0.5, 0.9]), np.array([1.0, 2.0, 0.1, 5.0, 1.0]))
    found, expected = found_in_c(row_transition, *told), in_numpy(row_transition, *told)
    for name in ("Phi", "responses"):
        values = getattr(expected, name)
        size = np.abs(values).max(axis=(1, 2), keepdims=True) if name == "Phi" else np.abs(values).max()
        np.testing.assert_allclose(getattr(found, name) / size, values / size, rtol=0, atol=1e-12)
    for one in range(2):
        got, values = ({"noise": each.noise[:, :, one]} for each in (found, expected))
        assert_close(got, values, 1e-12)


@pytest.mark.parametrize("apart", [True, False])
def test_the_steps_of_a_plant_with_several_disturbances_are_the_same(apart, in_numpy):
    model = load_model("examples/planar_quadrotor.py")
    eq = compile_model(model)
    found = told_observer(eq, told_values(eq, {}).__getitem__, print).tuned(5e-3).model
    random, rows = np.random.default_rng(8), RowModel(found, row_functions(model))
    xi = 0.3 * random.standard_normal((ROWS, found.layout.size))
    u, H = random.uniform(0.0, 15.0, (ROWS, 2)), random.uniform(1e-3, 0.5, ROWS)  # some of many parts
    directions = found.noise_directions
    sizes = random.uniform(0.5, 1.0, (ROWS, directions.shape[1]))
    motion = Motion(rows, xi, u, H)
    plan = motion.plan(xi)
    steps, expected = (
        call(motion.steps, plan, directions, sizes, apart=apart) for call in (found_in_c, in_numpy)
    )  # fmt: skip
    assert_close(vars(steps), vars(expected), 1e-11)


@pytest.mark.parametrize("c", [1, 3, 6])
def test_what_events_explain_is_the_same(c, in_numpy):
    random = np.random.default_rng(9)
    columns, scores = random.standard_normal((ROWS, 4, c)), random.standard_normal((ROWS, 4))
    half = random.standard_normal((ROWS, 4, 4))
    told = (columns, scores, half @ np.swapaxes(half, 1, 2))
    expected = in_numpy(explained_by, *told)
    np.testing.assert_allclose(found_in_c(explained_by, *told), expected, rtol=0, atol=1e-9 * np.abs(expected).max())
    score = (np.swapaxes(columns, 1, 2) @ scores[:, :, None])[7]
    whole = np.eye(c) + columns[7].T @ told[2][7] @ columns[7]
    by_definition = 0.5 * ((score.T @ np.linalg.solve(whole, score)).item() - np.linalg.slogdet(whole)[1])
    assert expected[7] == pytest.approx(by_definition, rel=1e-9)


def test_where_rounding_errors_leave_an_event_no_variance_both_say_so(in_numpy):
    variances = np.broadcast_to(np.eye(3), (ROWS, 3, 3)).copy()
    variances[900] *= -2.0
    told = (np.ones((ROWS, 3, 2)), np.ones((ROWS, 3)), variances)
    for call in (found_in_c, in_numpy):
        assert np.flatnonzero(np.isneginf(call(explained_by, *told))).tolist() == [900]


@given(st.data())
def test_numbers_are_written_as_python_writes_them(data):
    rows = data.draw(arrays(float, (3, 4), elements=st.floats()))
    rows[:, 2] = data.draw(arrays(int, 3, elements=st.integers(-(2**31), 2**31 - 1)))
    assert c_library(ROWS).lines(rows, [2]) == csv_lines(rows, [2])


def test_numbers_of_all_sizes_are_written_as_python_writes_them():
    random = np.random.default_rng(10)
    bits = random.integers(0, 2**64, 20_000, dtype=np.uint64).view(float)
    usual = random.normal(size=20_000) * 10.0 ** random.integers(-9, 9, 20_000)
    powers = [*(2.0 ** np.arange(-1074, 1024)), *(10.0 ** np.arange(-308, 309)), *np.arange(1000.0)]
    numbers = np.array([*EDGES, *bits, *usual, *np.round(usual, 3), *powers])[:, None]
    assert c_library(ROWS).lines(numbers, []).split() == csv_lines(numbers, []).split()


def test_a_log_is_estimated_alike_with_a_compiler_and_without_one(tmp_path, monkeypatch, in_numpy):
    monkeypatch.setattr("ndob_fmu.log.estimate_log.write_figures", lambda *_, **__: None)
    time = 0.01 * np.arange(ROWS) + np.random.default_rng(11).uniform(-0.002, 0.002, ROWS)
    inputs, outputs = simulated(time, gusts(time), [*NOISE.values()], 5)
    outputs[[300, 777], 0] += 0.5
    log = write_log(tmp_path / "log.csv", time, inputs, outputs)
    tables = []
    for call in (found_in_c, in_numpy):
        found = call(estimate_log, CART, log, tmp_path / "out", start_values=TUNED)
        assert found.outliers >= 2
        tables.append(np.loadtxt(tmp_path / "out" / "result.csv", delimiter=",", skiprows=1))
    size = np.abs(tables[1]).max(axis=0) + 1e-12
    np.testing.assert_allclose(tables[0] / size, tables[1] / size, rtol=0, atol=1e-9)


def test_few_rows_ask_for_no_compiler():
    assert c_library(100) is None


@pytest.mark.parametrize("rows", [1, 7, 300, 2 * ROWS])
def test_what_later_rows_up_to_a_lag_say_is_the_same(rows, in_numpy):
    record = stable_record(5, 2, seed=12)
    run = forward(record)
    found, expected = (call(lagged_adjoint, record, run, rows) for call in (found_in_c, in_numpy))
    assert_close(vars(found), vars(expected))


@pytest.mark.parametrize("cut", [False, True])
def test_what_events_do_to_the_scores_around_them_is_the_same(cut, in_numpy):
    record, random = stable_record(4, 3, seed=13), np.random.default_rng(14)
    jumps = Jumps(random.standard_normal((ROWS, 4, 1)), random.standard_normal((ROWS, 4, 3)))
    if cut:
        pieces = side_by_side(ROWS, 150)
        filtered = CutRecord(record, pieces, parts_of(record, pieces, np.full(4, 2.0)))
    else:
        filtered = WholeRecord(record)
    found = with_events(filtered, jumps, Events({300: True}))
    places = [(0, False), (151, True), (600, True), (ROWS - 1, False)]
    sources = [Source(k, jumps.of(k, in_step)) for k, in_step in places] + [Source(700, np.full((1, 1), 3.0), 1)]
    sizes = [one.columns.shape[1] for one in sources]
    told = sources, [np.ones(c) for c in sizes], [0.5 * np.eye(c) for c in sizes]
    both = zip(*(call(AlongRecord(found).effects, *told) for call in (found_in_c, in_numpy)), strict=True)
    for mine, theirs in both:
        assert mine.first == theirs.first
        assert_close(vars(mine), vars(theirs))
