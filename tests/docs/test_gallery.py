"""The gallery in docs: a page with a picture of every plant, as its command writes them."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from benchmarks.estimator.kalman import ekf
from benchmarks.estimator.ours import ours_of
from benchmarks.estimator.records import simulate
from benchmarks.gallery.exhibits import EXHIBITS, exhibits
from benchmarks.gallery.page import NOMINAL, TOLD, UNTOLD, Shown, draw, table, write, write_index

ROOT = Path(__file__).parents[2]
GALLERY = ROOT / "docs" / "gallery"
PLANTS = {plant.name: plant for plant, _ in exhibits()}


@pytest.mark.parametrize("name", sorted(EXHIBITS))
def test_the_committed_page_has_its_figure(name):
    page = (GALLERY / f"{name}.md").read_text("utf-8")
    assert f"]({name}.png)" in page
    assert (GALLERY / f"{name}.png").stat().st_size < 150_000
    with Image.open(GALLERY / f"{name}.png") as image:
        assert image.width == 810  # a page's width
    assert f"examples/{name}.py" in page
    assert EXHIBITS[name].text in page
    assert EXHIBITS[name].title in (GALLERY / "index.md").read_text("utf-8")


@pytest.mark.parametrize("name", sorted(EXHIBITS))
def test_the_committed_page_has_a_row_for_each_case_and_disturbance(name):
    page = (GALLERY / f"{name}.md").read_text("utf-8")
    for text in (NOMINAL, UNTOLD, TOLD):
        rows = re.findall(rf"^\| {re.escape(text)} \| `(\w+)`", page, re.MULTILINE)
        assert rows == list(PLANTS[name].model().disturbances)


@pytest.mark.parametrize("name", sorted(EXHIBITS))
def test_the_uncertain_parameters_are_the_plants(name):
    assert set(EXHIBITS[name].uncertain) <= set(PLANTS[name].parameters)


@pytest.fixture(scope="module")
def short():
    """A short record of the tank, for all three cases."""
    plant = PLANTS["stirred_tank"]
    record = simulate(plant, 1.0, [1], stop_time=60.0)
    shown = Shown(record, ours_of(record), ekf(record, intensity=1.0))
    return plant, EXHIBITS["stirred_tank"], dict.fromkeys((NOMINAL, UNTOLD, TOLD), shown)


def test_the_table_has_the_errors_of_the_record(short):
    plant, _, cases = short
    record, found = cases[NOMINAL].record, cases[NOMINAL].ours
    rms = np.sqrt(np.mean((found["at"] - record.d)[0, 18:, 0] ** 2))
    row = next(line for line in table(plant, cases).splitlines() if line.startswith(f"| {NOMINAL} |"))
    assert float(row.split("|")[3].removesuffix("K ")) == pytest.approx(rms, rel=0.06)


def test_the_axes_show_truth_and_error_bar(short):
    drawing = draw(*short)
    value, error = drawing.axes[0], drawing.axes[2]
    record, found = short[2][NOMINAL].record, short[2][NOMINAL].ours
    low, high = value.get_ylim()
    assert low < record.d.min()
    assert record.d.max() < high
    assert error.get_ylim()[1] > 2.0 * np.median(found["std"])
    assert value.get_ylabel() == "feed_temperature [K]"
    assert drawing.axes[-1].get_xlabel() == "t [min]"


def test_page_and_picture_are_written_and_the_same_again(tmp_path, monkeypatch, short):
    plant, exhibit, cases = short
    monkeypatch.setattr("benchmarks.gallery.page.measured", lambda *arguments: cases)
    first = {path.name: path.read_bytes() for path in write(tmp_path, plant, exhibit, 1)}
    again = {path.name: path.read_bytes() for path in write(tmp_path, plant, exhibit, 1)}
    assert first == again
    assert sorted(first) == ["stirred_tank.md", "stirred_tank.png"]
    assert "(stirred_tank.md)" in write_index(tmp_path, [(plant, exhibit)]).read_text("utf-8")
