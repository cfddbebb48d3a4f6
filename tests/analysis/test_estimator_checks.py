"""What method 2 needs, and what the user is told where the plant lacks it."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
import sympy
from hypothesis import given, settings
from hypothesis import strategies as st

from ndob_fmu import Experiment, Model, ObserverDefaults, build, check, design
from ndob_fmu.cli import main
from ndob_fmu.command_line.options import as_json
from ndob_fmu.errors import AssumptionError
from ndob_fmu.runtime.base_errors import MESSAGE_LIMIT
from tests.helpers.general_plants import ARM
from tests.helpers.problems import MODELS


def plant(A, G_d, C, **fields):
    """A linear plant; a pace and a step that suit time constants of about a second."""
    n, q, p = len(A), np.shape(G_d)[1], len(C)
    standard = {
        "states": [f"x{i + 1}" for i in range(n)],
        "outputs": [f"y{i + 1}" for i in range(p)],
        "disturbances": [f"d{i + 1}" for i in range(q)],
        "experiment": Experiment(step_size=0.01),
    }
    return Model(name="Plant", A=A, G_d=G_d, C=C, **(standard | fields))


REACTOR = Model(
    name="Reactor",
    states=["concentration", "temperature"],
    inputs=["coolant", "feed"],
    outputs=["temperature"],
    disturbances=["feed_temperature"],
    dynamics=lambda x, u, d, p: [
        u.feed - x.concentration - sympy.exp(x.temperature / 50 - 7) * x.concentration,
        d.feed_temperature
        - 3 * x.temperature
        + 2 * u.coolant
        + 200 * sympy.exp(x.temperature / 50 - 7) * x.concentration,
    ],
    x0=[0.5, 350.0],
    xhat0=[0.5, 350.0],
    disturbance_bound=400.0,
    experiment=Experiment(step_size=0.01),
)


def test_an_f_of_a_state_that_is_not_measured_is_no_unknown_input():
    report = check(REACTOR)
    assert report.passed
    assert not report.holds("method 1")
    assert report["outputs_at_least_unknown_inputs"].failure == "1 outputs for 2 unknown inputs"
    text = str(report)
    assert text.startswith("Reactor: all 4 checks pass")
    assert "FAIL" not in text
    assert "method 1, the paper's assumptions, for information" in text
    with pytest.raises(AssumptionError, match="outputs_at_least_unknown_inputs"):
        check(replace(REACTOR, observer=ObserverDefaults(method=1))).require()


def test_a_mode_that_no_output_shows_but_that_decays_is_named_and_passes():
    report = check(plant([[-1, 0], [1, -2]], [[1], [0]], [[1, 0]]))
    assert report.passed
    assert report["detectable"].values["decaying"] == {"-2": "x2"}


LACKING = {
    "an integrator that no output shows": (
        plant([[-1, 0], [1, 0]], [[1], [0]], [[1, 0]]),
        ("detectable", "x2 in no output", "no output shows x2; measure it, or leave it out"),
    ),
    "a place of two bodies that no output shows": (
        plant(
            [[0, 1, 0, 0], [-2500, -1, 2500, 1], [0, 0, 0, 1], [50, 0.02, -50, -0.1]],
            [[0], [0], [0], [1]],
            [[0, 1, 0, 0]],
        ),
        (
            "detectable",
            "received x1, x3 in no output, mode 0 1/s; likely cause: no output shows x1, x3; measure it",
        ),
    ),
    "only a rate is measured": (
        plant([[0, 1], [-4, -1]], [[0], [1]], [[0, 1]]),
        ("detectable", "a constant d1 that leaves every output as it is", "measure a state that a constant d1 shifts"),
    ),
    "a zero on the right": (
        plant([[0, 1], [-2, -3]], [[0], [1]], [[-1, 1]]),
        ("disturbance_zeros", "zeros 1 1/s", "measure a state nearer to where it acts"),
    ),
    "zeros on the axis": (
        plant([[0, 1, 0], [0, 0, 1], [-6, -11, -6]], [[0], [0], [1]], [[4, 0, 1]]),
        ("disturbance_zeros", "2j 1/s", "no output moves"),
    ),
    "a disturbance without effect": (
        plant([[-1, 0], [1, -2]], [[0], [1]], [[1, 0]]),
        ("disturbance_zeros", "d1 without effect on any output", "measure a state that d1 moves, or leave d1 out"),
    ),
    "more disturbances than outputs": (
        plant([[0, 1], [-2, -3]], [[0, 1], [1, 0]], [[1, 0]]),
        ("disturbance_zeros", "1 outputs for 2 unknown inputs", "measure more states, or leave disturbances out"),
    ),
    "two disturbances that act alike": (
        plant([[0, 1], [-2, -3]], [[0, 0], [1, 2]], [[1, 0], [0, 1]]),
        ("disturbance_zeros", "d1, d2, which move the outputs", "make one disturbance of them"),
    ),
    "order 0 outside the paper's form": (
        replace(ARM, observer=replace(ARM.observer, disturbance_order=0), disturbance_nominal=None),
        ("disturbance_order", "received 0", "paper's design"),
    ),
}


@pytest.mark.parametrize("case", LACKING)
def test_what_cannot_work_is_refused_in_one_line_with_what_to_measure_or_leave_out(case, tmp_path):
    model, (row, *says) = LACKING[case]
    assert not check(model).passed
    messages = set()
    for refused in (
        lambda: check(model).require(),
        lambda: build(model, tmp_path),
        lambda: design(model, step_size=0.1),
    ):
        with pytest.raises(AssumptionError) as caught:
            refused()
        messages.add(str(caught.value))
    (message,) = messages
    assert message.startswith(f"{model.name}: {row}: expected ")
    assert "\n" not in message
    assert len(message) <= MESSAGE_LIMIT
    for words in says:
        assert words in message
    assert not list(tmp_path.iterdir())


def test_a_build_does_not_measure_what_only_the_other_method_needs(monkeypatch, tmp_path):
    def measured(*_):
        raise AssertionError("the slope of f was searched for")

    monkeypatch.setattr("ndob_fmu.analysis.paper_checks.largest_slope", measured)
    build(replace(MODELS["flexible_joint"], observer=ObserverDefaults(method=2)), tmp_path)
    with pytest.raises(AssertionError):
        build(replace(MODELS["flexible_joint"], observer=ObserverDefaults(method=1)), tmp_path)


def test_a_design_for_other_noise_and_another_step_does_not_tune_the_observer_for_the_models_own(monkeypatch):
    def tuned(*_):
        raise AssertionError("the observer was tuned")

    monkeypatch.setattr("ndob_fmu.analysis.estimator_checks.sampled_observer", tuned)
    assert design(MODELS["flexible_joint"], step_size=2e-3, noise_std=1e-5).step_size == 2e-3
    with pytest.raises(AssertionError):
        check(MODELS["flexible_joint"])


def test_what_is_hardly_seen_is_warned_of_and_not_refused():
    report = check(plant([[0, 1], [-2, -3]], [[0], [1]], [[1, 0]], noise_std=10.0))
    assert report.passed
    assert report["error_bars"].values["disturbances"]["d1"] > 0.5
    assert "; warning: d1 is hardly seen: error bar" in report["error_bars"].measured


def test_the_error_bar_is_relative_to_the_bound_and_the_states_to_their_error_at_the_start():
    values = check(MODELS["flexible_joint"])["error_bars"].values
    assert set(values["states"]) == set(MODELS["flexible_joint"].states)
    assert max(values["states"].values()) < 0.01


@pytest.mark.parametrize("name", MODELS)
def test_check_predicts_the_errors_that_design_predicts(name):
    model = MODELS[name]
    found = design(model, step_size=model.experiment.step_size)
    predicted = (found.predicted_bias + found.predicted_noise) / found.disturbance_bound
    shown = check(model)["error_bars"].values["disturbances"]
    np.testing.assert_allclose([*shown.values()], predicted, rtol=1e-12)


def cylinder(length=1.0, pressure=1.0, force=1.0):
    """A hydraulic cylinder at a closed valve, with its numbers multiplied by these: 1 for m, Pa and N."""
    area_a, area_b, mass, damping, stiffness, leakage = 2e-3, 1.2e-3, 500.0, 2000.0, 1.2e12, 2.0
    A = np.array(
        [
            [0.0, 1.0, 0.0, 0.0],
            [0.0, -damping / mass, area_a / mass, -area_b / mass],
            [0.0, -stiffness * area_a, -leakage, leakage],
            [0.0, stiffness * area_b, leakage, -leakage],
        ]
    )
    units = np.array([length, length, pressure, pressure])
    G_d = np.array([[0.0], [-1.0 / mass], [0.0], [0.0]])
    sigma = np.array([1e-5 * length, 2e4 * pressure, 2e4 * pressure])
    return plant(
        (A * units[:, None] / units).tolist(),
        (G_d * units[:, None] / force).tolist(),
        np.eye(4)[[0, 2, 3]].tolist(),
        noise_std={f"y{i + 1}": float(s) for i, s in enumerate(sigma)},
        disturbance_bound=1e4 * force,
        xhat0_std=(np.array([1e-3, 0.05, 1e6, 1e6]) * units).tolist(),
        experiment=Experiment(step_size=1e-3),
    )


@pytest.mark.parametrize("units", [(1e3, 1e-6, 1.0), (1e3, 1e-5, 1e-3), (1e6, 1.0, 1e9)], ids=["mm, MPa", "kN", "odd"])
def test_a_plant_in_other_units_is_accepted_with_the_same_prediction(units):
    one, two = cylinder(), cylinder(*units)
    first, second = check(one), check(two)
    assert first.passed
    assert second.passed
    shown = [report["error_bars"].values["disturbances"]["d1"] for report in (first, second)]
    assert shown[0] < 0.1
    assert shown[1] == pytest.approx(shown[0], rel=1e-9)
    designs = [design(model, step_size=1e-3) for model in (one, two)]
    np.testing.assert_allclose(designs[1].error_bar / units[2], designs[0].error_bar, rtol=1e-6)


def half_blind(low, high):
    """A mass whose position is shown only where it is positive."""
    return Model(
        name="HalfBlind",
        states=["position", "rate"],
        outputs={"shown": lambda x, u, p: x.position * (1 + sympy.tanh(2000 * x.position)) / 2},
        disturbances=["force"],
        dynamics=lambda x, u, d, p: [x.rate, d.force],
        ranges={"position": (low, high)},
        x0=[0.1, 0.0],
        xhat0=[0.1, 0.0],
        disturbance_bound=1.0,
        experiment=Experiment(step_size=0.01),
    )


def test_what_is_seen_at_the_start_must_be_seen_where_the_plant_works():
    blind = check(half_blind(-1.0, 0.2))["detectable"]
    assert not blind.passed
    assert "position in no output" in blind.failure.replace("position, rate", "position")
    assert "where the plant works, as at position = -" in blind.failure
    at_times = check(half_blind(-0.2, 1.0))["detectable"]
    assert at_times.passed
    assert "of 8 points of the ranges, as at position = -" in at_times.measured
    assert "warning" not in check(half_blind(0.05, 1.0))["detectable"].measured


@pytest.mark.parametrize("name", MODELS)
def test_the_shipped_plants_have_all_that_both_methods_need(name):
    report = check(MODELS[name])
    assert report.passed
    assert report.holds("method 1")


def test_json_says_which_part_a_row_belongs_to_and_which_decides(tmp_path, capsys):
    file = tmp_path / "rate.py"
    file.write_text(
        "from ndob_fmu import Model\n"
        "model = Model(name='Rate', states=['s', 'v'], outputs=['v'], disturbances=['d'],"
        " A=[[0, 1], [-4, -1]], G_d=[[0], [1]], C=[[0, 1]])\n"
    )
    assert main(["check", str(file), "--json"]) == 1
    data = json.loads(capsys.readouterr().out)
    assert (data["decides"], data["passed"]) == ("method 2", False)
    assert {row["part"] for row in data["rows"]} == {"method 1", "method 2"}


@st.composite
def random_plants(draw):
    """Random systems, half of them with a hidden or undriven mode or a zero on the right."""
    random = np.random.default_rng(draw(st.integers(0, 10**6)))
    n, p, q = draw(st.sampled_from([(3, 2, 1), (4, 3, 2), (2, 1, 1), (3, 1, 2)]))
    A = random.normal(size=(n, n))
    G, C = random.normal(size=(n, q)), random.normal(size=(p, n))
    if draw(st.booleans()):
        A[:-1, -1] = 0.0
        C[:, -1] = 0.0
    return A, G, C


@settings(max_examples=12)
@given(system=random_plants(), seed=st.integers(0, 10**6))
def test_other_units_of_states_and_outputs_change_no_verdict(system, seed):
    A, G, C = system
    random = np.random.default_rng(seed)
    x, y = (10.0 ** random.integers(-6, 7, size) for size in (len(A), len(C)))
    noise = 1e-3 * np.ones(len(C))
    fields = {"observer": ObserverDefaults(disturbance_rate=1.0)}

    def verdicts(A, G, C, noise, start):
        names = [f"y{i + 1}" for i in range(len(C))]
        report = check(plant(A, G, C, noise_std=dict(zip(names, noise, strict=True)), xhat0_std=list(start), **fields))
        return [(row.name, row.passed) for row in report.parts["method 2"]]

    ours = verdicts(A, G, C, noise, np.ones(len(A)))
    theirs = verdicts(A * x[:, None] / x, G * x[:, None], C * y[:, None] / x, noise * y, x)
    assert ours == theirs


def test_the_design_of_a_plant_without_a_papers_observer_is_that_of_method_2_alone():
    found, at_default = design(REACTOR, step_size=0.01), design(REACTOR)
    np.testing.assert_array_equal(found.K, at_default.K)
    assert found.paper is None
    assert found.L is None
    assert not found.certificate.exists
    assert "no bound: gamma, the largest slope of f, is not declared" in str(found)
    data = json.loads(as_json(found.to_dict()))
    assert data["certificate"]["disturbance_at_sample"] is None
    assert data["certificate"]["lacking"].startswith("gamma")
    assert (data["L"], data["riccati_residual"], len(data["K"])) == (None, None, 4)
    assert "no paper's observer" in str(found)
    with pytest.raises(AssumptionError, match="outputs_at_least_unknown_inputs"):
        design(REACTOR, pi=1e8)
