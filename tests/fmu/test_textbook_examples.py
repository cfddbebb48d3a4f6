"""The examples that are written as in a textbook: they build, and their observers find the disturbances."""

from __future__ import annotations

import runpy

import fmpy
import numpy as np
import pytest

from benchmarks.estimator.ours import ours_of
from benchmarks.estimator.records import simulate
from benchmarks.gallery.plants import gallery_plants
from ndob_fmu import build, check
from tests.helpers.problems import TEXTBOOK

STEPS = 150
PLANTS = {plant.name: plant for plant in gallery_plants()}
every_plant = pytest.mark.parametrize("name", sorted(PLANTS))


def short_record(plant):
    step = plant.model().experiment.step_size
    return simulate(plant, step, [1], stop_time=STEPS * step)


def test_every_example_as_in_a_textbook_is_in_the_gallery():
    assert sorted(path.stem for path in TEXTBOOK) == sorted(PLANTS)


@pytest.mark.parametrize("path", TEXTBOOK, ids=lambda path: path.stem)
def test_its_file_says_what_it_is_and_gives_units(path):
    text, model = runpy.run_path(str(path))["__doc__"], TEXTBOOK[path]
    assert "·" in text
    named = {*model.states, *model.inputs, *model.outputs, *model.disturbances, *model.parameters}
    assert set(model.units) == named
    assert model.description
    assert 0.0 < model.disturbance.amplitude <= min(model.disturbance_bound)


@every_plant
def test_its_error_is_within_its_error_bar_after_some_samples(name):
    plant = PLANTS[name]
    record = short_record(plant)
    found = ours_of(record)
    late = slice(STEPS // 2, None)
    error = np.abs(found["ahead"] - record.d_end)[:, late]
    assert np.mean(error < 2.0 * found["std"][:, late]) > 0.9
    assert np.all(found["std"][:, -1] < 0.5 * plant.bounds)
    assert np.all(found["valid"])


@every_plant
def test_its_built_observer_gives_the_estimates_of_the_gallery(name, tmp_path):
    """Both are the same code; the FMU's host holds inputs and samples as the benchmark does."""
    plant = PLANTS[name]
    model = plant.model()
    assert check(model).passed
    _, observer = build(model, tmp_path)
    record = short_record(plant)
    names = [*model.inputs, *model.outputs]
    signals = np.zeros(STEPS, dtype=[(column, float) for column in ("time", *names)])
    signals["time"] = record.t
    for column, values in zip(names, np.hstack([record.U[0], record.Y[0]]).T, strict=True):
        signals[column] = values
    wanted = [f"{d}_at_sample" for d in model.disturbances]
    step = record.H
    run = fmpy.simulate_fmu(
        str(observer),
        stop_time=(STEPS - 1) * step,
        step_size=step,
        output_interval=step,
        input=signals,
        output=wanted,
        use_event_mode=False,
        start_values=dict(zip(names, [signals[column][0] for column in names], strict=True)),
    )
    expected = ours_of(record)["at"][0]
    # The host's first row is from before the first step.
    np.testing.assert_allclose(
        np.column_stack([run[column] for column in wanted])[1:], expected[: STEPS - 1], rtol=0, atol=1e-6
    )
