"""The gallery's page of a measured record: its figures, its errors, and the script that writes it."""

import re
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy.io import savemat

from benchmarks.emps.__main__ import main
from benchmarks.emps.model import model
from benchmarks.emps.page import EDGE, FREE, PAGE, TITLE, WHOLE
from benchmarks.emps.record import FORCE, Estimate, known_online, pulses, read, score
from ndob_fmu.errors import UsageError
from ndob_fmu.log.fit.fit_log import Fitted
from ndob_fmu.log.fit.map_step import LearnedMap
from ndob_fmu.log.made_log import Sensor, make_log
from ndob_fmu.log.told import Told
from tests.log.test_made_log import columns

GALLERY = Path(__file__).parents[2] / "docs" / "gallery"


def test_the_committed_page_has_its_figures_and_its_source():
    page = (GALLERY / PAGE).read_text("utf-8")
    assert page.startswith(f"# {TITLE}")
    for name in (WHOLE, EDGE):
        assert f"]({name})" in page
        assert (GALLERY / name).stat().st_size < 150_000
        with Image.open(GALLERY / name) as image:
            assert image.width == 810  # a page's width
    assert "Janot" in page
    assert f"[{TITLE}]({PAGE})" in (GALLERY / "index.md").read_text("utf-8")


def test_later_samples_make_the_committed_errors_smaller():
    rows = re.findall(
        r"^\| [a-z].* \| (\S+) N \| (\S+) N \| (\d+)% \|$", (GALLERY / PAGE).read_text("utf-8"), re.MULTILINE
    )
    at_sample, predicted, lagged, smoothed = ((float(rms), float(away)) for rms, away, _ in rows)
    assert predicted[0] > at_sample[0] > lagged[0] > smoothed[0]
    assert max(away for _, away in (predicted, at_sample, lagged, smoothed)) < 0.05 * FORCE


def test_an_error_at_an_edge_counts_in_the_whole_only():
    t = 1e-3 * np.arange(2000)
    true = np.where(t >= 1.0, FORCE, 0.0)
    error = np.where((t >= 1.0) & (t < 1.01), 100.0, 1.0)
    found = score(t, Estimate("", true + error, np.full(2000, 2.0), true))
    assert found.rms == pytest.approx(np.sqrt((1790 + 10 * 100.0**2) / 1800), rel=1e-9)
    assert found.away == pytest.approx(1.0)
    assert found.covered == pytest.approx(1790 / 1800)


def test_the_least_online_error_is_that_of_the_rows_before_samples_show_an_edge():
    t = 1e-3 * np.arange(2000)
    true = np.where(t >= 1.0, FORCE, 0.0)
    for rows in (1, 2):
        least = score(t, known_online(Estimate("", true, np.zeros(2000), true), rows))
        assert least.rms == pytest.approx(FORCE * np.sqrt(rows / 1800), rel=1e-9)
        assert least.away == 0.0


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A short record of the drive's model, in the form of the measured one."""
    folder = tmp_path_factory.mktemp("emps")
    sensors = {"position": Sensor(noise_std=1e-7)}
    make_log(model, folder / "log.csv", lambda t, _: [2.0 * np.sin(6.0 * t)], step=1e-3, stop_time=0.8, sensors=sensors)
    log = columns(folder / "log.csv")
    savemat(folder / "made.mat", {"t": log["time"], "qm": log["position"], "vir": log["voltage"]})
    return folder / "made.mat"


def test_the_script_finds_the_pulses_of_a_made_record_and_writes_its_page(made, tmp_path, monkeypatch, capsys):
    """`fit` takes seconds and has tests of its own."""
    values = {"position_noise_std": 1e-7, "disturbance_order": 1, "disturbance_rate": 1e3, "lag": 0.02}
    told, noise = dict.fromkeys(FREE, Told(1.0, 0.1)), {"position": Told(1e-7, 1e-9)}
    maps = {"force": LearnedMap(("friction of velocity",), 4.0, 1.0)}
    fitted = Fitted(
        build="Python",
        rows=560,
        held_out=240,
        order=1,
        orders={"force": 1},
        is_jumping=True,
        jumps=0,
        outliers=0,
        noise_std=noise,
        intensity={},
        parameters=told,
        maps=maps,
        held_out_values={},
        held_out_value=None,
        warnings=("a line",),
        start_values=values,
    )
    monkeypatch.setattr("benchmarks.emps.__main__.fit_log", lambda *_, **__: fitted)
    assert main([str(made), "--out", str(tmp_path)]) == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted((PAGE, WHOLE, EDGE))
    rows = re.findall(r"^\| .* \| (\S+) N \| (\S+) N \| \d+% \|$", capsys.readouterr().out, re.MULTILINE)
    at_sample, predicted, lagged, smoothed = (float(rms) for rms, _ in rows)
    assert at_sample < predicted
    assert max(lagged, smoothed) < 0.05 * FORCE
    page = (tmp_path / PAGE).read_text("utf-8")
    assert "\n> a line\n" in page
    assert "friction of velocity | 94% |" in page
    assert all(f"| `{name}` | " in page for name in FREE)
    assert np.count_nonzero(np.diff(pulses(read(made).t, 5))) >= 1


def test_another_file_is_refused_in_one_line(tmp_path):
    (tmp_path / "other.mat").write_text("no data")
    for name in ("other.mat", "none.mat"):
        with pytest.raises(UsageError, match=r"expected DATA_EMPS\.mat with t, qm and vir") as error:
            read(tmp_path / name)
        assert len(str(error.value)) < 300
