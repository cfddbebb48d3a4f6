"""A log in other units, or with other columns, than the model's is named as such."""

from dataclasses import replace

import numpy as np
import pytest
import sympy

from ndob_fmu.codegen.compile_model import compile_model
from ndob_fmu.errors import UsageError
from ndob_fmu.log.diagnostics import OutputDiagnosis
from ndob_fmu.log.estimate_log import estimate_log
from ndob_fmu.log.fit.fit_log import fit_log
from ndob_fmu.log.tune.workbench import Workbench
from ndob_fmu.model.model import Model
from ndob_fmu.runtime.base_errors import IntegrationError
from ndob_fmu.runtime.blocks.disturbance import Generator
from ndob_fmu.runtime.blocks.plant import Plant
from ndob_fmu.runtime.equations import Experiment
from tests.log.test_estimate_log import CART, NOISE, TUNED, gusts, simulated, write_log

TIME = 0.01 * np.arange(520)
INPUTS, OUTPUTS = simulated(TIME, gusts(TIME), [*NOISE.values()], 1)


@pytest.fixture
def warnings(tmp_path, monkeypatch):
    """A function that returns the warnings about a log."""
    monkeypatch.setattr("ndob_fmu.log.estimate_log.write_figures", lambda *_, **__: None)

    def found(time=TIME, inputs=INPUTS, outputs=OUTPUTS, model=CART, **told):
        path = write_log(tmp_path / "log.csv", time, inputs, outputs)
        return estimate_log(model, path, tmp_path / "out", start_values={**TUNED, **told}).warnings

    return found


def test_a_log_in_the_units_of_the_model_is_not_suspected(warnings):
    assert warnings() == ()


def test_an_output_in_another_unit_leaves_its_range(warnings):
    (line, *_) = warnings(outputs=OUTPUTS * [1.0, 1000.0])
    assert line.startswith("rate goes from")
    assert "far outside its range, -5 to 5" in line
    assert "--unit" in line


def test_an_input_in_another_unit_leaves_its_range(warnings):
    (line, *_) = warnings(inputs=1000.0 * INPUTS, model=replace(CART, ranges={"force": (-3.0, 3.0)}))
    assert line.startswith("force goes from")


def test_a_first_sample_that_the_start_values_exclude_is_named(warnings):
    (line, *_) = warnings(outputs=np.add(OUTPUTS, [50.0, 0.0]))
    assert line.startswith("place is 50 m in the first row, where the start values say 0 ± 0.2 m")


def test_an_estimate_far_beyond_the_bound_is_named(warnings):
    assert any("the estimate of wind reaches" in line for line in warnings(inputs=30.0 * INPUTS))


def fit(model, path, folder, told):
    return fit_log(model, path, folder, start_values=told).warnings


def tune(model, path, folder, told):
    return Workbench(model, path, start_values=told).warnings


@pytest.mark.parametrize("command", [fit, tune])
def test_who_begins_with_fit_or_tune_is_warned_as_by_estimate(tmp_path, warnings, command):
    outputs = OUTPUTS * [1.0, 1000.0] + [50.0, 0.0]
    expected = warnings(outputs=outputs)
    path = write_log(tmp_path / "log.csv", TIME, INPUTS, outputs)
    if command is fit:  # it asks what the model can follow with other parameters
        expected = tuple(line for line in expected if "cannot follow it" not in line)
    assert command(CART, path, tmp_path / "other", TUNED)[: len(expected)] == expected


@pytest.mark.parametrize("command", [fit, tune])
def test_an_error_of_fit_or_tune_says_which_column_is_its_likely_cause(tmp_path, command):
    path = write_log(tmp_path / "log.csv", TIME, 1e200 * INPUTS, OUTPUTS)
    with pytest.raises(IntegrationError, match=r"; likely cause: force goes from"):
        command(replace(CART, ranges={"force": (-3.0, 3.0)}), path, tmp_path / "out", TUNED)


def test_times_in_another_unit_are_named(warnings):
    assert any("samples 10 s apart cannot follow" in line for line in warnings(time=1000.0 * TIME))


def test_an_error_says_which_column_is_its_likely_cause(warnings):
    with pytest.raises(IntegrationError, match=r"; likely cause: force goes from"):
        warnings(inputs=1e200 * INPUTS, model=replace(CART, ranges={"force": (-3.0, 3.0)}))


def test_times_with_too_few_digits_are_the_first_thing_named(warnings, tmp_path):
    (line, *_) = warnings(time=np.round(TIME, 1))
    assert line.startswith("467 of 520 rows have the time of the row before and other samples")
    with pytest.raises(UsageError, match=r"500 rows of different times .* received 53; likely cause: 467 of 520"):
        fit_log(CART, tmp_path / "log.csv", tmp_path / "out")


# A cell whose current shows in its voltage at once.
CELL = Model(
    name="Cell",
    states=["charge"],
    inputs=["current"],
    outputs={"voltage": lambda x, u, p: x.charge - p.resistance * u.current},
    disturbances=["leak"],
    dynamics=lambda x, u, d, p: [-(u.current + d.leak) / 100.0],
    parameters={"resistance": 0.1},
    noise_std=1e-3,
    disturbance_bound=0.5,
    experiment=Experiment(stop_time=300.0, step_size=1.0),
)


@pytest.mark.parametrize("resistance", [0.1, 0.13])
@pytest.mark.parametrize("rows_behind", [0, 1])
def test_an_output_that_follows_the_input_of_its_own_row_is_named(tmp_path, monkeypatch, resistance, rows_behind):
    """Whether or not its resistance is told right. Each input is held from its row on, so that it acts behind it."""
    monkeypatch.setattr("ndob_fmu.log.estimate_log.write_figures", lambda *_, **__: None)
    random, time = np.random.default_rng(1), np.arange(300.0)
    current = np.concatenate([[0.0], random.normal(size=len(time))])
    charge = 1.0 - np.concatenate([[0.0], np.cumsum(current[1:-1])]) / 100.0
    voltage = charge - 0.1 * current[1 - rows_behind :][: len(time)] + 1e-3 * random.normal(size=len(time))
    rows = np.column_stack([time, current[1:], voltage]).tolist()
    log = tmp_path / "log.csv"
    log.write_text("time,current,voltage\n" + "".join(f"{t},{u},{y}\n" for t, u, y in rows))
    model = replace(CELL, parameters={"resistance": resistance}, x0=[1.0], xhat0=[1.0])
    found = estimate_log(model, log, tmp_path / "out").warnings
    assert any(line.startswith("voltage follows the inputs of its own row") for line in found) == (rows_behind == 0)


@pytest.mark.parametrize(("push", "is_held"), [(12.0, True), (40.0, False)])
def test_a_mass_that_friction_holds_is_named(tmp_path, monkeypatch, push, is_held):
    """With 10 N of friction, a push of 12 N leaves it in its place for most of the time, a swing of 40 N does not."""
    monkeypatch.setattr("ndob_fmu.log.estimate_log.write_figures", lambda *_, **__: None)
    rough_table = Model(
        name="RoughTable",
        states=["x", "v"],
        inputs=["u"],
        outputs=["x"],
        disturbances=["d"],
        dynamics=lambda x, u, d, p: [x.v, u.u + d.d - x.v - 10.0 * sympy.sign(x.v)],
        noise_std=1e-5,
        disturbance_bound=8.0,
        experiment=Experiment(stop_time=2.0, step_size=5e-3),
    )
    plant = Plant(compile_model(rough_table), (), (Generator(),))
    mass, rows = plant.init((0.0, 0.0), 0.0), []
    for k in range(400):
        t = 5e-3 * k
        u = push * np.sin(6.0 * t) if is_held else push * np.sign(np.sin(6.0 * t))
        rows.append((t, u, mass.x[0]))
        mass = plant.step(mass, (u,), (1.0,), t + 5e-3)
    log = tmp_path / "log.csv"
    log.write_text("time,u,x\n" + "".join(f"{t},{u},{x}\n" for t, u, x in rows))
    found = estimate_log(rough_table, log, tmp_path / "out").warnings
    assert any(line.startswith("friction holds the plant in") for line in found) == is_held


def test_an_output_without_samples_is_named(warnings):
    without = OUTPUTS.copy()
    without[:, 1] = np.nan
    assert "rate was never measured: what only this output shows is not estimated" in warnings(outputs=without)


def diagnosis(**changed):
    values = {
        "samples": 1000, "size": 1.0, "size_band": 0.1, "correlation": np.zeros(20), "correlation_band": 0.06,
        "refused": 0.0, "noise_factor": 1.0,
    }  # fmt: skip
    return OutputDiagnosis(**{**values, **changed})


def test_residuals_that_follow_one_another_are_not_called_noise():
    """With the larger noise_std that they show, the observer would hide the model's error."""
    correlated = np.full(20, 0.9)
    (line,) = diagnosis(noise_factor=20.0, correlation=correlated).verdicts("place", 1e-3, "m")
    assert "follow one another (correlation 0.90)" in line
    (line,) = diagnosis(noise_factor=20.0).verdicts("place", 1e-3, "m")
    assert line == "noise_std of place is about 20.0 × too small: the residuals show 0.02 m"


@pytest.mark.parametrize(("factor", "size", "says"), [(0.8, "large", "1.2"), (1.25, "small", "1.2")])
def test_residuals_as_small_or_large_as_the_noise_makes_them_are_not_laid_on_the_disturbance(factor, size, says):
    (line,) = diagnosis(noise_factor=factor, size=factor**2.0 if factor < 1.0 else 1.5).verdicts("rate", 0.01, "rad/s")
    assert line == f"noise_std of rate is about {says} × too {size}: the residuals show {0.01 * factor:.2g} rad/s"


@pytest.mark.parametrize(("found", "says"), [(0.3, "slower than"), (2.0, "larger or faster than")])
def test_residuals_that_noise_alone_does_not_explain_are_laid_on_the_disturbance(found, says):
    (line,) = diagnosis(noise_factor=1.0, size=found).verdicts("rate", 0.01, "rad/s")
    assert says in line


def test_a_factor_without_meaning_is_not_shown():
    (line,) = diagnosis(noise_factor=2e6).verdicts("place", 1e-9, "m")
    assert line == "noise_std of place is far too small: the residuals show 0.002 m"
