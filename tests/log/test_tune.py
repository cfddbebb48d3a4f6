"""`ndob-fmu tune`: what the linearised filter says with other settings, and the page with its sliders."""

import json
import re
import shutil
import sys
from dataclasses import replace
from threading import Thread

import numpy as np
import pytest
from dash import dcc
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.support.ui import WebDriverWait

from ndob_fmu.cli import main
from ndob_fmu.codegen.row_functions import row_functions
from ndob_fmu.interface.told_observer import told_observer
from ndob_fmu.log.log_columns import Signals
from ndob_fmu.log.online import along
from ndob_fmu.log.read_log import read_log
from ndob_fmu.log.smooth.linear_record import Smoothed
from ndob_fmu.log.smooth.smooth_log import smooth
from ndob_fmu.log.smooth.smoother import backward, forward
from ndob_fmu.log.told_values import told_values
from ndob_fmu.log.tune.figures import disturbance_figure, residual_figure
from ndob_fmu.log.tune.lagged import lagged_adjoint
from ndob_fmu.log.tune.page import page
from ndob_fmu.log.tune.serve import HOST, address, page_server
from ndob_fmu.log.tune.workbench import Workbench
from ndob_fmu.results.shown_time import shown_time
from tests.helpers.browser import browser, requests
from tests.log.made_logs import EQUATIONS, made_log
from tests.log.test_estimate_log import CART
from tests.log.test_smoother import random_record

TOLD = {"disturbance_order": 1, "disturbance_rate": 5.0}
MODEL = "from tests.log.test_estimate_log import CART as model\n"


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    """A log whose noise of the place is twice as large as told."""
    path = tmp_path_factory.mktemp("tune") / "log.csv"
    made_log(path, "steps", 3, rows=1500)
    return path


@pytest.fixture(scope="module")
def workbench(log):
    return Workbench(CART, log, start_values=TOLD)


@pytest.mark.parametrize("more", [{}, {"drag_std": 0.03}], ids=["known", "uncertain drag"])
def test_with_the_settings_as_told_the_page_shows_the_smoothed_estimate_of_estimate(workbench, log, more):
    observer = told_observer(EQUATIONS, told_values(EQUATIONS, {**TOLD, **more}).__getitem__, print)
    blocks = read_log(log, Signals(EQUATIONS.inputs, EQUATIONS.outputs, EQUATIONS.units, {}, {}))
    stretches = along(observer, [0.0, 0.0], blocks)
    ((_, expected),) = smooth(observer, row_functions(CART), [0.0, 0.0], stretches)
    shown = (Workbench(CART, log, start_values={**TOLD, **more}) if more else workbench).shown(workbench.told)
    assert (shown.jumps, shown.outliers) == (expected.jumps, expected.outliers)
    np.testing.assert_allclose(shown.smoothed.d, expected.d, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(shown.smoothed.std, expected.d_std, rtol=1e-9)


def test_settings_count_as_if_they_had_been_told_once_the_jumps_are_found_anew(log):
    changes = {"disturbance_rate": 9.0, "place_noise_std": 2e-3, "adapt_noise": False, "disturbance_order": 2}
    workbench, other = (Workbench(CART, log, start_values={**TOLD, **more}) for more in ({}, changes))
    expected, before = other.shown(other.told), workbench.shown(other.told)
    workbench.find_jumps(other.told)
    shown, rows = workbench.shown(other.told), slice(100, None)
    assert before.jumps != shown.jumps
    # It is linear about another trajectory.
    assert np.median(shown.smoothed.std[rows]) == pytest.approx(np.median(expected.smoothed.std[rows]), rel=1e-2)
    assert np.median(shown.residual_std[rows]) == pytest.approx(np.median(expected.residual_std[rows]), rel=1e-2)
    close = np.abs(shown.smoothed.d - expected.smoothed.d) < expected.smoothed.std
    assert close[rows].mean() > 0.8


def test_each_later_sample_makes_the_band_narrower(workbench):
    shown = workbench.shown(replace(workbench.told, lag=0.05))
    assert np.all(shown.lagged.std <= shown.online.std * (1.0 + 1e-9))
    # The smoothed one also says of which rows it is not sure whether they are behind a jump.
    assert np.sum(shown.smoothed.std > shown.lagged.std * (1.0 + 1e-9)) <= shown.jumps
    assert shown.smoothed.std.mean() < 0.95 * shown.lagged.std.mean() < 0.9 * shown.online.std.mean()


@pytest.mark.parametrize("lag", [0, 1, 6, 40])
def test_a_lagged_estimate_is_the_smoothed_one_of_a_record_that_ends_a_lag_later(lag):
    record, K = random_record(3, 2, 30, seed=5), 30
    whole = forward(record)
    lagged = Smoothed(whole, lagged_adjoint(record, whole, lag))
    for k in (0, 11, 24, 29):
        part = record.some(slice(0, min(k + lag + 1, K)), record.start, record.start_factor)
        run = forward(part)
        expected = Smoothed(run, backward(part, run))
        np.testing.assert_allclose(lagged.xi[k], expected.xi[k], rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(lagged.covariance[k], expected.covariance[k], rtol=1e-9, atol=1e-9)


def test_the_verdict_on_the_noise_goes_away_when_its_advice_is_followed(workbench):
    told = workbench.told
    (line,) = workbench.shown(told).verdicts
    advised = re.fullmatch(r"noise_std of place is about .* × too small: the residuals show (.*) m", line)
    assert advised is not None
    noise_std = float(advised[1])
    # Some hundred samples show it to a tenth.
    assert noise_std == pytest.approx(2e-3, rel=0.15)
    assert workbench.shown(replace(told, noise_std=(noise_std, told.noise_std[1]))).verdicts == ()


def test_without_adaptation_the_noise_is_what_the_slider_says(workbench):
    told = workbench.told
    small, right = (
        workbench.shown(replace(told, noise_std=(place, told.noise_std[1]), adapt_noise=False)).diagnoses["place"].size
        for place in (1e-3, 2e-3)
    )
    assert small == pytest.approx(4.0, rel=0.15)
    assert right == pytest.approx(1.0, rel=0.15)


def test_the_axis_of_a_clock_that_starts_far_from_0_counts_from_the_first_row(workbench):
    time, shown = 1.7e9 + workbench.stretch.log.time, workbench.shown(workbench.told)
    for draw in (disturbance_figure, residual_figure):
        figure = draw(workbench.equations, time, shown, shown_time(1.7e9, 0.01))
        assert figure["layout"]["xaxis"]["title"]["text"] == "time [s] from the first row, at 1700000000 s"
        assert figure["layout"]["xaxis"]["range"] == pytest.approx([0.0, time[-1] - 1.7e9], abs=1e-3)
        assert max(figure["data"][0]["x"]) == pytest.approx(workbench.stretch.log.time[-1], abs=1e-3)


@pytest.fixture(scope="module")
def server(workbench, tmp_path_factory):
    folder = tmp_path_factory.mktemp("saved")
    made = page_server(workbench, "log.csv", folder)
    thread = Thread(target=made.serve_forever)
    thread.start()
    yield made, folder
    made.shutdown()
    thread.join()
    made.server_close()


def test_the_page_is_on_the_loopback_address_and_knows_no_other_name(server):
    made, _ = server
    assert made.socket.getsockname()[0] == HOST
    client = made.app.test_client()
    assert client.get("/", base_url=address(made)).status_code == 200
    assert client.get("/", base_url="http://elsewhere.example/").status_code == 400


def test_another_page_takes_another_port(server, workbench, tmp_path):
    other = page_server(workbench, "log.csv", tmp_path)
    assert other.server_port != server[0].server_port
    other.server_close()


def test_what_a_change_or_a_search_for_jumps_computes_shows_that_it_is_at_work(workbench, tmp_path):
    made = page(workbench, "log.csv", tmp_path)
    (working,) = [one for one in made.layout()._traverse() if isinstance(one, dcc.Loading)]
    inside = {getattr(one, "id", None) for one in working._traverse()}
    assert inside >= {"diagnoses", "disturbance", "residuals", "correlation", "found"}


BAND = """
const graph = document.querySelector("#disturbance .js-plotly-plot");
const band = graph && graph.data && graph.data.find(one => one.fill === "toself");
return band ? band.y.reduce((sum, y) => sum + Math.abs(y), 0) : null;
"""


def test_a_slider_moves_the_band_and_what_is_saved_is_what_estimate_takes(server, log, tmp_path):
    missing = [program for program in ("chromium", "chromedriver") if shutil.which(program) is None]
    if missing:
        pytest.skip(f"the page is tested in a browser, and {' and '.join(missing)} cannot be found on the PATH")
    made, folder = server
    with browser(tmp_path / "profile") as driver:
        driver.get(address(made))
        wait = WebDriverWait(driver, 20, poll_frequency=0.05)
        before = wait.until(lambda _: driver.execute_script(BAND))
        slider = driver.find_element(By.CSS_SELECTOR, "#rate-0 [role=slider]")
        for _ in range(8):
            slider.send_keys(Keys.ARROW_RIGHT)
        wait.until(lambda _: driver.find_element(By.ID, "rate-0-value").text.startswith("7.93 N/s"))
        wait.until(lambda _: driver.execute_script(BAND) > 1.01 * before)
        driver.find_element(By.ID, "save").click()
        wait.until(lambda _: driver.find_element(By.ID, "saved").text.endswith("fit.json"))
        assert {url for url in requests(driver) if url.startswith("http")} >= {address(made)}
        assert all(url.startswith(address(made)) for url in requests(driver) if url.startswith("http"))
        assert [entry for entry in driver.get_log("browser") if entry["level"] == "SEVERE"] == []
    saved = json.loads((folder / "fit.json").read_text("utf-8"))
    assert saved == {
        "place_noise_std": 1e-3,
        "rate_noise_std": 5e-2,
        "disturbance_order": 1,
        "disturbance_rate": pytest.approx(7.93, rel=1e-3),
        "lag": 0.0,
        "adapt_noise": True,
    }
    assert told_values(EQUATIONS, saved)["disturbance_rate"] == saved["disturbance_rate"]


def run(log, tmp_path, *words):
    model = tmp_path / "cart.py"
    model.write_text(MODEL)
    return main(["tune", str(model), str(log), "--no-browser", *words])


def test_the_command_prints_the_address(log, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("werkzeug.serving.BaseWSGIServer.serve_forever", lambda server: server.server_close())
    assert run(log, tmp_path, "--start-values", "disturbance_order", "1") == 0
    assert capsys.readouterr().out.startswith(f"http://{HOST}:")


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["disturbance_order", "0"], "disturbance_order 1 or more"),
        (["place_delay", "0.02"], "outputs without a delay"),
        (["rate_noise_std", "0"], "a number above 0"),
        (["lagg", "0.02"], "did you mean 'lag'"),
    ],
)
def test_what_cannot_be_tuned_is_one_line(words, expected, log, tmp_path, capsys):
    assert run(log, tmp_path, "--start-values", *words) == 2
    said = capsys.readouterr().err
    assert expected in said
    assert said.count("\n") == 1
    assert len(said) < 300


def test_without_the_extra_one_line_names_it(log, tmp_path, monkeypatch, capsys):
    for name in ("page", "serve"):
        monkeypatch.delitem(sys.modules, f"ndob_fmu.log.tune.{name}", raising=False)
    monkeypatch.setitem(sys.modules, "dash", None)
    monkeypatch.setattr("ndob_fmu.support.extras.find_spec", lambda name: None)
    assert run(log, tmp_path) == 2
    assert 'pip install "ndob-fmu[tune]"' in capsys.readouterr().err
