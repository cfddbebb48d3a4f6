"""`ndob-fmu estimate` by the native FMU of the model, where it was built: the same estimates, and never a stale FMU."""

import json
import zipfile
from dataclasses import fields, replace

import numpy as np
import pytest

from ndob_fmu.cli import main
from ndob_fmu.errors import NdobError
from ndob_fmu.interface.told_observer import told_observer
from ndob_fmu.log import first_block
from ndob_fmu.log.fit import tried_rates
from ndob_fmu.log.fit.setup import Setup
from ndob_fmu.log.log_columns import Signals
from ndob_fmu.log.native_run import native_run
from ndob_fmu.log.online import along
from ndob_fmu.log.read_log import read_log
from ndob_fmu.log.told_values import told_values
from ndob_fmu.native import origin
from ndob_fmu.native.build import build_native
from ndob_fmu.native.many_steps import native_observer
from ndob_fmu.runtime.base_errors import IntegrationError
from tests.helpers.needs import C_COMPILER
from tests.log.test_estimate_log import CART, EQUATIONS, NOISE, TUNED, gusts, simulated, write_log

pytestmark = C_COMPILER
X_HAT = [0.0, 0.0]


@pytest.fixture(scope="module")
def fmus(tmp_path_factory):
    """The folder of the cart's native FMUs, with start values of their own."""
    folder = tmp_path_factory.mktemp("fmus")
    build_native(CART, folder, start_values={"lag": 0.7, "mass": 3.0})
    return folder


@pytest.fixture(scope="module")
def rough(tmp_path_factory):
    """A log with jitter, gaps, a slow sensor, missing entries, outliers and jumps."""
    random = np.random.default_rng(4)
    time = 0.01 * np.arange(800) + random.uniform(-0.002, 0.002, 800)
    time = time[(time < 3.0) | (time > 3.4)]
    inputs, outputs = simulated(time, gusts(time), [*NOISE.values()], 5)
    outputs[np.arange(len(time)) % 5 > 0, 1] = np.nan
    outputs[random.random(len(time)) < 0.05, 0] = np.nan
    outputs[[100, 333], 0] += 0.5
    return write_log(tmp_path_factory.mktemp("rough") / "log.csv", time, inputs, outputs)


def blocks(log, block=300):
    return read_log(log, Signals(EQUATIONS.inputs, EQUATIONS.outputs, EQUATIONS.units, {}, {}), block)


def both(fmus, log, told):
    """Return what the observer says along a log by the native FMU and in Python, stretch by stretch."""
    values = told_values(EQUATIONS, told)
    observer = told_observer(EQUATIONS, values.__getitem__, print)
    with native_run(CART, fmus, values, observer, X_HAT, 700) as run:
        assert run is not None
        native = list(along(observer, X_HAT, blocks(log), run))
    return native, list(along(observer, X_HAT, blocks(log)))


@pytest.mark.parametrize(
    "told",
    [
        TUNED,
        {"disturbance_order": 2, "adapt_noise": "false", "mass_std": 0.1, "estimate_parameters": "true"},
        {"disturbance_order": 1, "disturbance_rate": 5.0, "place_delay": 0.02, "rate_bias_std": 0.02},
        {"disturbance_order": 0},
    ],
    ids=["lag", "parameters", "delay and offset", "order 0"],
)
def test_the_native_observer_says_of_a_rough_log_what_the_one_in_python_says(fmus, rough, told):
    for native, python in zip(*both(fmus, rough, told), strict=True):
        for one in fields(python.online):
            got, expected = (getattr(stretch.online, one.name) for stretch in (native, python))
            # Of each signal's range.
            size = np.maximum(np.nanmax(np.abs(expected), axis=0), 1e-12)
            np.testing.assert_allclose(got / size, expected / size, rtol=0.0, atol=1e-9, err_msg=one.name)
        np.testing.assert_array_equal(native.online.valid, python.online.valid)
        np.testing.assert_array_equal(native.online.refused, python.online.refused)


@pytest.mark.parametrize(
    "told", [TUNED, {"disturbance_order": 2, "disturbance_rate": 5.0}, {"disturbance_rate": 0.0}], ids=str
)
def test_the_smoother_takes_the_tuning_of_the_native_observer_and_makes_none(fmus, rough, told, monkeypatch):
    values = told_values(EQUATIONS, told)
    observer, python = (told_observer(EQUATIONS, values.__getitem__, print) for _ in range(2))
    with native_run(CART, fmus, values, observer, X_HAT, 700) as run:
        usual = next(along(observer, X_HAT, blocks(rough), run)).usual
    expected = python.tuned(usual)
    monkeypatch.setattr("ndob_fmu.runtime.step.sampled_observer.tune", None)
    found = observer.tuned(usual)
    assert (found.freezes, found.model.scale) == (expected.freezes, pytest.approx(expected.model.scale, rel=1e-9))
    assert found.model.jump_spacing == pytest.approx(expected.model.jump_spacing, rel=1e-9)
    for H, noise in ((usual, [1.0, 1.0]), (1.5 * usual, [1.0, 1.0]), (usual, [4.0, 9.0])):
        np.testing.assert_allclose(found.intensity(H, noise), expected.intensity(H, noise), rtol=1e-9)
    np.testing.assert_allclose(found.intensities.f, expected.intensities.f, rtol=1e-9)


def test_the_command_takes_the_native_observer_of_the_model_by_itself_and_says_so(tmp_path, monkeypatch, capsys, fmus):
    monkeypatch.setattr("ndob_fmu.log.estimate_log.write_figures", lambda *_, **__: None)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    (tmp_path / "model.py").write_text("from tests.log.test_estimate_log import CART as model\n")
    time = 0.01 * np.arange(200)
    write_log(tmp_path / "log.csv", time, *simulated(time, gusts(time), [*NOISE.values()], 7))
    said = {}
    for build in ("Python", "native"):
        if build == "native":
            (tmp_path / "build" / "native").mkdir(parents=True)
            (tmp_path / "build" / "native" / "fmus").symlink_to(fmus)
        assert main(["estimate", "model.py", "log.csv"]) == 0
        assert f"estimate of the {build} observer" in capsys.readouterr().out
        summary = json.loads((tmp_path / "results" / "log" / "summary.json").read_text())
        assert summary["estimate"]["build"] == build
        said[build] = np.loadtxt(tmp_path / "results" / "log" / "result.csv", delimiter=",", skiprows=1)
    size = np.abs(said["Python"]).max(axis=0) + 1e-12
    np.testing.assert_allclose(said["native"] / size, said["Python"] / size, rtol=0.0, atol=1e-8)


def test_fit_runs_the_native_observer_along_the_log(fmus, rough):
    told = told_values(EQUATIONS, {"lag": 0.1, "mass_std": 0.1})
    native, python = (
        Setup(CART, EQUATIONS, told, (), 0.3, folder).online(rough, None, None) for folder in (fmus, None)
    )
    assert (native.build, python.build) == ("native", "Python")
    got, expected = native.stretch.online.predicted, python.stretch.online.predicted
    np.testing.assert_allclose(got, expected, rtol=0.0, atol=1e-9 * np.abs(expected).max())


def test_a_fit_counts_the_rows_of_all_its_runs_where_it_decides_whether_to_build_the_observer(monkeypatch, rough):
    said = []

    def noted(model, folder, values, observer, x_hat, rows):
        said.append(rows)
        return native_run(model, None, values, observer, x_hat, rows)

    monkeypatch.setattr(first_block, "native_run", noted)
    told = Setup(CART, EQUATIONS, told_values(EQUATIONS, {}), (), 0.3, None)
    run = told.online(rough, None, None)
    told.along({}, run, 50)
    assert said == [run.rows * (1 + tried_rates.TRIED), 50]


def is_taken(model, folder, rows=700):
    values = told_values(EQUATIONS, {})
    with native_run(model, folder, values, told_observer(EQUATIONS, values.__getitem__, print), X_HAT, rows) as run:
        return run is not None


def test_an_fmu_of_another_model_or_of_another_version_of_the_package_is_not_taken(fmus, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert is_taken(CART, fmus)
    assert not is_taken(CART, tmp_path)
    drag = replace(CART, dynamics=lambda x, u, d, p: [x.rate, (u.force - p.drag * x.rate + d.wind) / p.mass])
    assert not is_taken(drag, fmus)
    assert not is_taken(replace(CART, ranges={"rate": (-4.0, 5.0)}), fmus)
    assert not is_taken(replace(CART, parameters={**CART.parameters, "mass": 2.0 + 1e-15}), fmus)
    monkeypatch.setattr(origin, "_writers", lambda: "another version")
    assert not is_taken(CART, fmus)


def test_a_long_log_builds_the_native_observer_once_and_then_short_ones_take_it_too(fmus, tmp_path, monkeypatch, rough):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    nowhere = tmp_path / "no folder"
    assert not is_taken(CART, nowhere, rows=9_999)
    assert is_taken(CART, nowhere, rows=10_000)
    monkeypatch.setenv("CC", "no compiler")
    assert is_taken(CART, nowhere)
    (kept, _), (built, _) = both(nowhere, rough, TUNED), both(fmus, rough, TUNED)
    for one, other in zip(kept, built, strict=True):
        np.testing.assert_array_equal(one.online.d_hat, other.online.d_hat)
    assert not is_taken(replace(CART, parameters={**CART.parameters, "mass": 2.5}), nowhere, rows=10_000)


def test_without_a_compiler_the_observer_runs_in_python(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setenv("CC", "no compiler")
    assert not is_taken(CART, tmp_path, rows=10_000)


def test_an_fmu_without_a_library_for_this_platform_or_with_a_broken_one_is_not_taken(fmus, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    for name, change in (("none", None), ("broken", b"no library")):
        folder = tmp_path / name
        folder.mkdir()
        with (
            zipfile.ZipFile(fmus / "CartObserver.fmu") as old,
            zipfile.ZipFile(folder / "CartObserver.fmu", "w") as new,
        ):
            for file in old.namelist():
                if not file.startswith("binaries/"):
                    new.writestr(file, old.read(file))
                elif change is not None:
                    new.writestr(file, change)
        assert not is_taken(CART, folder)


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_a_step_that_the_native_observer_refuses_is_the_error_of_the_one_in_python(fmus):
    values = told_values(EQUATIONS, {})
    observer = told_observer(EQUATIONS, values.__getitem__, print)
    state, _ = observer.step(observer.init(X_HAT), (0.0,), (0.0, 0.0), 0.01)
    with pytest.raises(NdobError) as expected:
        observer.step(state, (0.0,), (0.0, 0.0), 1e150)
    with native_observer(CART, fmus, values) as native, pytest.raises(IntegrationError) as error:
        native.steps(np.array([0.01, 1e150]), np.zeros((2, 3)), np.arange(2))
    assert str(error.value) == str(expected.value)
