"""The report in a real browser without a network: it opens, logs no error, asks for nothing, and draws every plot."""

from __future__ import annotations

import base64
import re
import shutil

import numpy as np
import pytest
from selenium.webdriver.support.ui import WebDriverWait

from ndob_fmu.cli import main
from ndob_fmu.errors import UsageError
from ndob_fmu.report import write_report
from ndob_fmu.report.observers import disturbance_figures, input_figures, output_figures
from ndob_fmu.report.recorded_run import RecordedRun, read_recorded_run
from ndob_fmu.report.run_page import run_content
from ndob_fmu.report.signals import estimates, spans, usual_range
from ndob_fmu.results.csv_files import read_csv, write_csv
from ndob_fmu.results.plots import decades
from ndob_fmu.results.recording import Recording
from ndob_fmu.results.thinning import thinned
from ndob_fmu.study.axes import Axis, cell_medians, pairs_of, point_medians
from tests.helpers.browser import browser, requests, screenshot

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
[latin_hypercube]
runs = 3
plant.joint_stiffness = {{ from = 0.9, to = 1.1 }}
observer.link_angle_noise_std = {{ from = 1e-6, to = 1e-3, scale = "log" }}
[measures]
"error <b>" = {{ of = "observer.load_torque_hat", minus = "plant.load_torque_total", take = "rms" }}
"""


@pytest.fixture(scope="module")
def driver(tmp_path_factory):
    missing = [program for program in ("chromium", "chromedriver") if shutil.which(program) is None]
    if missing:
        pytest.skip(f"the report is tested in a browser, and {' and '.join(missing)} cannot be found on the PATH")
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
    assert text.index("its error bar of ±2 standard deviations") < text.index("Summary") < text.index("residual")
    assert driver.execute_script("return document.querySelectorAll('.plotly-graph-div').length") == 1 + 2 + 4 + 7
    assert driver.execute_script("return document.querySelectorAll('#plot-0 .scatterlayer .js-fill').length") == 1
    for plot in range(14):
        drawn = lines(driver, f"plot-{plot}")
        assert drawn, plot
        assert min(drawn) >= 2
    for words in ("pythonfmu", "numpy", "wall time [s]", "load_torque [N·m]"):
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
    assert kinds == ["parcoords", "scatter", "scatter"]
    assert driver.execute_script("return document.querySelectorAll('.no-webgl').length") == 0
    assert len(driver.find_elements("css selector", "#plot-0 .y-axis")) == 5
    assert len(driver.find_elements("css selector", "#plot-2 .point")) == 12
    # Three drawn points, each with the median of its four runs; the levels of the grid make a heat map.
    assert len(driver.find_elements("css selector", "#plot-1 .point")) == 3
    assert driver.find_element("css selector", "#plot-1 .xtitle").text == "plant.joint_stiffness [N·m/rad]"
    assert driver.find_element("css selector", "#plot-1 .ytitle").text == "observer.link_angle_noise_std [rad]"
    driver.execute_async_script(
        "const buttons = document.getElementById('plot-1').layout.updatemenus[0].buttons;"
        "const menu = buttons[buttons.length - 1].args;"
        "Plotly.update('plot-1', menu[0], menu[1]).then(arguments[0])"
    )
    assert driver.execute_script("return document.querySelectorAll('#plot-1 .hm image').length") == 1
    assert "plant.disturbance.kind" in driver.find_element("css selector", "#plot-1 .ytitle").text
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
    for name in ("scatter", "parallel_coordinates"):
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


def test_a_gap_in_a_long_signal_stays_a_gap():
    values = np.sin(np.arange(50_000) / 500.0)
    values[20_000:20_500] = np.nan
    drawn = values[rows := thinned(values)]
    assert np.isnan(drawn[(rows >= 20_000) & (rows < 20_500)]).any()
    assert np.isfinite(drawn[(rows < 20_000) | (rows >= 20_500)]).all()


def test_a_logarithmic_axis_is_scaled_by_the_typical_value_and_not_by_the_first_row():
    error = np.full(1000, 3e-3)
    assert decades(error) == (-3, -2)
    for first in (0.0, 1e-16, np.nan):
        error[0] = first
        low, high = decades(error)
        assert (low >= -7, high) == (True, -2)
    error[0] = 5.0
    assert decades(error) == (-3, 1)
    error[0] = 1e300
    assert decades(error)[1] <= 6
    assert decades(np.zeros(3)) is None


def test_a_peak_at_the_start_does_not_set_the_scale_of_an_axis():
    estimate = np.sin(np.arange(10_000) / 300.0)
    assert usual_range(estimate) is None  # all of it
    estimate[3] = 2e6
    low, high = usual_range(estimate)
    assert -2.0 < low < -1.0 < 1.0 < high < 2.0
    usual = np.arange(10_000) >= 5000
    estimate[:5000] = 100.0 * estimate[:5000]
    assert usual_range(estimate, usual=usual)[1] < 2.0
    assert usual_range(np.full(3, np.nan)) is None


def test_the_shaded_steps_are_those_after_which_valid_is_false_and_at_most_200():
    time = np.arange(10.0)
    holds = np.isin(np.arange(10), (2, 3, 7))
    assert spans(time, holds) == [(1.0, 3.0), (6.0, 7.0)]
    found = spans(np.arange(10_000.0), np.arange(10_000) % 10 == 5)
    assert len(found) == 200
    assert (found[0][0], found[-1][1]) == (4.0, 9995.0)


def caption_and_lines(figures):
    """Return the caption of the first figure and its lines by name, as (x, y)."""
    caption, figure = next(figures)
    return caption, {trace.name: (np.array(trace.x, float), np.array(trace.y, float)) for trace in figure.data}


def test_the_band_of_an_estimate_is_two_standard_deviations_and_the_caption_counts_what_lies_in_it(run):
    record = read_recorded_run(run)
    signal = record.recording
    estimate, std = signal["observer.load_torque_hat"], signal["observer.load_torque_std"]
    caption, lines = caption_and_lines(disturbance_figures(record))
    x, y = lines["estimate ± 2 std"]
    for time, value in zip(x[::50], y[::50], strict=True):
        row = round(time / 1e-3)
        assert abs(value - estimate[row]) == pytest.approx(2.0 * std[row], rel=1e-5)
    late = signal.time >= 1.25
    within = np.mean(np.abs(estimate - signal["plant.load_torque_total"])[late] <= 2.0 * std[late])
    assert f"{100 * within:.3g} % of the rows lie in the band" in caption


def test_the_prediction_of_an_output_is_the_sample_minus_its_residual_one_step_later(run):
    """The outputs of the example are states, whose predictions are recorded too: the two must be the same."""
    _, lines = caption_and_lines(output_figures(read_recorded_run(run)))
    signal = read_csv(run / "result.csv")
    x, y = lines["predicted motor_angle"]
    rows = np.round(x / 1e-3).astype(int)
    np.testing.assert_allclose(y[1:], signal["observer.motor_angle_hat"][rows][1:], rtol=0, atol=1e-6)
    assert np.abs(np.interp(x, *lines["measured motor_angle"]) - y).max() > 0.1  # at the start they differ


@pytest.mark.parametrize(
    ("summary", "driver_first", "reason"),
    [({}, False, ""), ({"output_interval": 0.5}, False, "rows were recorded less often"), ({}, True, "")],
)
def test_a_sample_belongs_to_the_start_of_a_step_unless_its_driver_has_stepped_before(summary, driver_first, reason):
    time, predicted = np.arange(6) * 0.1, np.array([0.0, 1.0, 3.0, 2.0, 5.0, 4.0])
    y = predicted + np.array([0.5, -0.5, 0.25, np.nan, 1.0, 2.0])
    residual = np.nan_to_num(y - predicted)  # an observer gives 0 where it got no sample
    recorded = residual if driver_first else np.concatenate([residual[:1], residual[:-1]])
    columns = np.column_stack([y, np.zeros(6), np.ones(6), recorded, ~np.isnan(y)])
    names = ("plant.y", "observer.d_hat", "observer.d_std", "observer.angle_residual", "observer.valid")
    summary = {**summary, "connections": {"observer.angle": ["plant.y", 2.0, 0.0]}}
    summary["order"] = ["plant", "observer"] if driver_first else []
    columns[:, [3]] *= 2.0
    caption, lines = caption_and_lines(output_figures(RecordedRun(Recording(time, names, columns), {}, summary)))
    np.testing.assert_allclose(lines["measured angle"][1], 2.0 * y)
    if reason:
        assert reason in caption
        assert "predicted angle" not in lines
        return
    when = slice(1, None) if driver_first else slice(None, -1)
    known = np.where(np.isnan(y), np.nan, 2.0 * predicted)
    np.testing.assert_allclose(lines["predicted angle"][1], known[when])
    np.testing.assert_allclose(lines["predicted angle"][0], time[when], rtol=1e-6)
    assert np.isnan(lines["residual of angle"][1]).sum() == 1  # a gap where there was no sample


@pytest.mark.parametrize(
    ("std", "words"),
    [
        (0.2, "75 % of the residuals"),
        (0.0, "No band: y_residual_std is 0, for method 1"),
        (None, "No band: the recording has no y_residual_std"),
    ],
)
def test_residuals_have_a_band_where_the_observer_says_what_to_expect_and_a_reason_where_it_does_not(std, words):
    names = ["observer.d_hat", "observer.d_std", "observer.y_residual"] + ["observer.y_residual_std"] * (
        std is not None
    )
    columns = np.column_stack([np.zeros(4), np.ones(4), [0.1, -0.1, 0.5, 0.0], np.full(4, std or 0.0)])
    recording = Recording(np.arange(4.0), tuple(names), columns[:, : len(names)])
    caption, lines = caption_and_lines(output_figures(RecordedRun(recording)))
    assert words in caption
    assert ("± 2 std expected" in lines) == bool(std)
    if std:
        assert set(np.abs(lines["± 2 std expected"][1])) == {0.4}


def test_the_inputs_of_a_replayed_log_are_kept_and_shown(flexible_joint, tmp_path, capsys):
    rows = [f"{k / 100:.2f},{k % 7},{'nan' if 20 <= k < 30 else 0.1},0.1" for k in range(101)]
    (tmp_path / "log.csv").write_text("\n".join(['"time","motor_torque","motor_angle","link_angle"', *rows]) + "\n")
    words = ["--stop-time", "1", "--step-size", "0.01", "--input-file", str(tmp_path / "log.csv")]
    assert main(["simulate", str(flexible_joint.observer), *words, "--results", str(tmp_path / "run")]) == 0
    kept = read_csv(tmp_path / "run" / "inputs.csv")
    np.testing.assert_array_equal(kept["FlexibleJointObserver.motor_torque"], np.arange(101) % 7)
    record = read_recorded_run(tmp_path / "run")
    _, lines = caption_and_lines(input_figures(record))
    np.testing.assert_allclose(lines["FlexibleJointObserver.motor_torque"][1], np.arange(101) % 7)
    caption, lines = caption_and_lines(output_figures(record))
    assert np.isnan(lines["measured motor_angle"][1]).sum() == 10
    assert "Shaded: valid is false" in caption
    assert record.summary["step_size"] == 0.01
    assert record.units["FlexibleJointObserver.motor_torque"] == "N·m"


def test_a_drawn_parameter_makes_points_with_the_median_of_their_runs():
    x = Axis("x", np.array([1.0, 2.0, 1.0, 2.0, 3.0]), drawn=True)
    y = Axis("y", np.array([5.0, 6.0, 5.0, 6.0, 7.0]), drawn=True)
    across, up, medians = point_medians(x, y, Axis("z", np.array([1.0, 2.0, 3.0, np.nan, np.inf])))
    np.testing.assert_array_equal(np.column_stack([across, up, medians]), [[1, 5, 2], [2, 6, 2], [3, 7, np.nan]])
    level = Axis("level", np.array([0.0, 1.0, 0.0, 1.0, 0.0]))
    assert pairs_of([level, x, y])[0] == (x, y)


def test_an_estimate_is_shown_with_what_it_estimates():
    names = ["plant.x", "plant.d", "plant.d_total", "observer.x_hat", "observer.d_hat", "observer.z_hat", "observer.x"]
    assert estimates(names) == [("plant.x", "observer.x_hat"), ("plant.d_total", "observer.d_hat")]


def test_times_of_a_clock_that_starts_far_from_0_are_shown_from_the_first_row(tmp_path):
    time = 1.7e9 + 0.01 * np.arange(50)
    write_csv(tmp_path / "result.csv", Recording(time, ("plant.angle",), np.sin(time)[:, None]))
    assert "from 0 to 0.49 s (times from the first row, at 1700000000 s)" in run_content(tmp_path).lead
    assert read_recorded_run(tmp_path).time[-1] == pytest.approx(0.49, abs=1e-6)
