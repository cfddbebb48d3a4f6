"""The report in a real browser without a network: it opens, logs no error, asks for nothing, and draws every plot."""

from __future__ import annotations

import base64
import re

import numpy as np
import pytest
from browser import browser, requests, screenshot
from selenium.webdriver.support.ui import WebDriverWait

from ndob_fmu.cli import main
from ndob_fmu.errors import UsageError
from ndob_fmu.report import write_report
from ndob_fmu.report.signals import estimates, thinned
from ndob_fmu.study.figures import Axis, cell_medians

STUDY = """
system = "{system}"
[simulation]
stop_time = 0.1
step_size = 5e-3
[fixed]
observer.method = 2
[grid]
observer.disturbance_order = [1, 2]
plant.disturbance.kind = ["sine", "constant"]
[list]
plant.joint_stiffness = [0.9, 1.0, 1.1]
[measures]
"error <b>" = {{ of = "observer.load_torque_hat", minus = "plant.load_torque_total", take = "rms" }}
"""


@pytest.fixture(scope="module")
def driver(tmp_path_factory):
    with browser(tmp_path_factory.mktemp("profile")) as started:
        yield started


@pytest.fixture(scope="module")
def run(flexible_joint, tmp_path_factory):
    folder = tmp_path_factory.mktemp("run")
    words = ["simulate", str(flexible_joint.system), "--stop-time", "2.5", "--results", str(folder)]
    assert main([*words, "--start-values", "plant.disturbance.kind", "sine"]) == 0
    return folder


@pytest.fixture(scope="module")
def study(flexible_joint, tmp_path_factory):
    folder = tmp_path_factory.mktemp("study")
    (folder / "s.toml").write_text(STUDY.format(system=flexible_joint.system))
    assert main(["sweep", str(folder / "s.toml"), "--out", str(folder / "r"), "--workers", "1"]) == 0
    return folder / "r"


def opened(driver, page):
    """Open a page, wait until every plot is drawn, and return what a person sees of it as text."""
    driver.get(page.as_uri())
    plots = "document.querySelectorAll('.plotly-graph-div')"
    WebDriverWait(driver, 30).until(
        lambda d: d.execute_script(f"return [...{plots}].every(p => p._fullLayout && p.querySelector('.main-svg'))")
    )
    errors = [entry for entry in driver.get_log("browser") if entry["level"] == "SEVERE"]
    assert errors == []
    assert {url for url in requests(driver) if not url.startswith("chrome")} == {page.as_uri()}
    return driver.find_element("tag name", "body").text


def lines(driver, plot):
    """Return the number of points of each line that is drawn in a plot."""
    paths = "document.getElementById(arguments[0]).querySelectorAll('path.js-line')"
    script = f"return [...{paths}].map(path => path.getAttribute('d'))"
    return [len(re.findall("[ML,]", path)) for path in driver.execute_script(script, plot)]


def test_the_report_of_a_run_shows_estimates_signals_parameters_and_versions(driver, run, capsys, tmp_path):
    assert main(["report", str(run)]) == 0
    assert capsys.readouterr().out == f"{run / 'report.html'}\n"
    text = opened(driver, run / "report.html")
    assert "Simulation of open_loop.ssp" in text
    assert "observer.load_torque_hat and plant.load_torque_total over time" in text
    assert driver.execute_script("return document.querySelectorAll('.plotly-graph-div').length") == 5 + 7
    for plot in range(12):
        drawn = lines(driver, f"plot-{plot}")
        assert drawn, plot
        assert min(drawn) >= 2
    for words in ("pythonfmu", "numpy", "wall time [s]", "load_torque_total [N·m]"):
        assert words in driver.page_source
    assert re.search(r"plant\.disturbance\.kind</th><td>sine</td>", driver.page_source)
    titles = driver.execute_script("return [...document.querySelectorAll('.modebar-btn')].map(b => b.dataset.title)")
    assert "Download plot" in titles
    assert [title for title in titles if re.search("share|cloud|edit", title, re.IGNORECASE)] == []
    picture = driver.find_element("css selector", "img[alt*=system]")
    assert driver.execute_script("return arguments[0].complete && arguments[0].naturalWidth", picture) > 100
    drawing = base64.b64decode(picture.get_attribute("src").partition(",")[2])
    assert drawing == (run / "system.svg").read_bytes()
    assert b"observer" in drawing
    screenshot(driver, tmp_path / "run.png")
    assert (tmp_path / "run.png").stat().st_size > 100_000


def test_a_plot_can_be_zoomed_and_a_signal_hidden(driver, run):
    write_report(run)
    opened(driver, run / "report.html")
    before = lines(driver, "plot-0")
    driver.execute_async_script("Plotly.relayout('plot-0', {'xaxis2.range': [1.0, 1.1]}).then(arguments[0])")
    assert driver.execute_script("return document.getElementById('plot-0').layout.xaxis2.range") == [1.0, 1.1]
    driver.find_element("css selector", "#plot-0 .legendtoggle").click()
    WebDriverWait(driver, 10).until(lambda d: len(lines(d, "plot-0")) == len(before) - 1)


def test_the_report_of_a_study_shows_its_figures_and_escapes_names(driver, study, tmp_path):
    page = write_report(study, tmp_path / "there" / "page.html")
    text = opened(driver, page)
    assert "12 of 12 runs finished, 0 of them failed" in text
    assert "error <b>" in text
    assert len(driver.find_elements("css selector", "img[alt*=system]")) == 1
    kinds = driver.execute_script(
        "return [...document.querySelectorAll('.plotly-graph-div')].map(p => p._fullData[0].type)"
    )
    assert kinds == ["parcoords", "heatmap", "scatter"]
    assert driver.execute_script("return document.querySelectorAll('.no-webgl').length") == 0
    assert len(driver.find_elements("css selector", "#plot-0 .y-axis")) == 4
    assert len(driver.find_elements("css selector", "#plot-2 .point")) == 12
    shown = driver.execute_script("return document.querySelectorAll('#plot-1 .hm image').length")
    assert shown == 1
    driver.execute_async_script(
        "const menu = document.getElementById('plot-1').layout.updatemenus[0].buttons[1].args;"
        "Plotly.update('plot-1', menu[0], menu[1]).then(arguments[0])"
    )
    assert "plant.joint_stiffness" in driver.find_element("css selector", "#plot-1 .ytitle").text
    screenshot(driver, tmp_path / "study.png")


def test_a_run_without_a_value_lies_above_the_others_and_is_not_left_out():
    axis = Axis("settling", np.array([1.0, 100.0, np.inf, 10.0, np.nan]))
    values, ticks, labels = axis.drawable()
    assert values[[0, 3, 1]] == pytest.approx([0.0, 1.0, 2.0])  # decades
    assert values[2] == values[4] == ticks[-1] > 2.0
    assert labels[-1] == "none"
    words = Axis("kind", np.array([0.0, 1.0, 0.0]), ("sine", "step")).drawable()
    assert (words[1], words[2]) == ([0.0, 1.0], ["sine", "step"])


def test_a_cell_of_the_heat_map_is_the_median_of_its_runs():
    x, y = Axis("x", np.array([1.0, 1, 2, 2, 2])), Axis("y", np.array([5.0, 5, 5, 7, 7]))
    cells, columns, rows = cell_medians(x, y, Axis("z", np.array([1.0, 3.0, 4.0, np.nan, np.inf])))
    np.testing.assert_array_equal(cells, [[2.0, 4.0], [np.nan, np.nan]])
    assert (columns, rows) == (["1", "2"], ["5", "7"])
    many = Axis("m", np.linspace(0.0, 12.0, 49))
    cells, columns, _ = cell_medians(many, Axis("y", np.zeros(49)), many)
    assert len(columns) == 12
    assert cells[0].tolist() == sorted(cells[0])


def test_the_figures_of_a_study_are_images_with_units(study):
    for name in ("heat_map", "parallel_coordinates"):
        assert (study / f"{name}.png").read_bytes().startswith(b"\x89PNG")
        assert "[N·m]" in (study / f"{name}.svg").read_text("utf-8")


def test_the_same_results_give_the_same_page(run, tmp_path):
    one, other = (write_report(run, tmp_path / name).read_bytes() for name in ("one.html", "other.html"))
    assert one == other


def test_a_result_from_elsewhere_is_reported_with_what_there_is(driver, tmp_path):
    (tmp_path / "result.csv").write_text('"time","tank.level"\n0,1\n1,nan\n2,3\n3,4\n')
    text = opened(driver, write_report(tmp_path))
    assert "1 signals in 4 rows from 0 to 3 s" in text
    assert len(lines(driver, "plot-0")) >= 1


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda folder: None, r"result\.csv \(a run\) or study\.json \(a study\), received neither"),
        (lambda folder: (folder / "result.csv").write_text("a,b\n1,2\n"), r"expected a header of different names"),
        (lambda folder: (folder / "study.json").write_text("{"), r"study\.json: expected a JSON file that can be read"),
    ],
)
def test_a_folder_without_results_is_refused_in_one_line(tmp_path, make, words):
    make(tmp_path)
    with pytest.raises(UsageError, match=words):
        write_report(tmp_path)
    assert not (tmp_path / "report.html").exists()


def test_a_long_signal_is_thinned_without_losing_its_peaks():
    values = np.sin(np.arange(100_000) / 500.0)
    values[12_345], values[54_321] = 7.0, -8.0
    values[99_000] = np.nan
    rows = thinned(values, 1000)
    assert len(rows) <= 1002
    assert {0, 12_345, 54_321, 99_999} <= set(rows.tolist())
    assert list(rows) == sorted(set(rows.tolist()))
    assert thinned(values[:10], 1000).tolist() == list(range(10))


def test_an_estimate_is_shown_with_what_it_estimates():
    names = ["plant.x", "plant.d", "plant.d_total", "observer.x_hat", "observer.d_hat", "observer.z_hat", "observer.x"]
    assert estimates(names) == [("plant.x", "observer.x_hat"), ("plant.d_total", "observer.d_hat")]
