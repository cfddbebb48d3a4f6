"""FMUs that are built with the start values of a file, as `fit` writes it."""

import json
import zipfile

import fmpy
import pytest

from ndob_fmu import simulate
from ndob_fmu.cli import main
from ndob_fmu.native.build import build_native
from tests.log.test_estimate_log import CART, EQUATIONS

FITTED = {
    "mass": 2.5,
    "mass_std": 0.1,
    "disturbance_order": 1,
    "disturbance_rate": 0.7,
    "lag": 0.1,
    "place_hat_start": 0.3,
}
MODEL = "from tests.log.test_estimate_log import CART as model\n"


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """Plant and observer of the cart, built by the command."""
    folder = tmp_path_factory.mktemp("started")
    (folder / "cart.py").write_text(MODEL)
    (folder / "fit.json").write_text(json.dumps(FITTED))
    words = ["build", str(folder / "cart.py"), "--out", str(folder), "--start-values-file", str(folder / "fit.json")]
    assert main(words) == 0
    return folder / "CartPlant.fmu", folder / "CartObserver.fmu"


def starts(fmu):
    return {v.name: v.start for v in fmpy.read_model_description(str(fmu)).modelVariables}


def test_each_fmu_has_those_of_its_own_parameters_in_its_description(built):
    plant, observer = map(starts, built)
    assert {name: float(observer[name]) for name in FITTED} == FITTED
    assert float(plant["mass"]) == 2.5
    assert set(FITTED) & set(plant) == {"mass"}


def last_row(fmu, **values):
    told = {"force": 1.0, "place": 0.2, "rate": 0.1}
    return simulate(fmu, stop_time=0.2, step_size=0.01, start_values=told | values).columns[-1].tolist()


def test_the_observer_computes_with_them(built):
    assert last_row(built[1]) == last_row(built[1], **FITTED)
    for name in ("mass", "disturbance_rate", "place_hat_start"):
        original = {"mass": 2.0, "disturbance_rate": EQUATIONS.observer.disturbance_rate or 3.0, "place_hat_start": 0.0}
        assert last_row(built[1], **{name: original[name]}) != last_row(built[1])


def test_the_plant_computes_with_them(built):
    recording = simulate(built[0], stop_time=1.0, step_size=0.1, start_values={"force": 1.0, "drag": 0.0, "wind": 0.0})
    assert recording["CartPlant.rate"][-1] == pytest.approx(1.0 / 2.5)


@pytest.mark.parametrize("fmi", [2, 3])
def test_native_fmus_have_them_in_description_and_sources(tmp_path, monkeypatch, fmi):
    monkeypatch.setattr("ndob_fmu.native.package.binary", lambda *_: b"")
    _, observer = build_native(CART, tmp_path, fmi=fmi, start_values={"disturbance_rate": 0.7})
    with zipfile.ZipFile(observer) as archive:
        assert 'start="0.7"' in archive.read("modelDescription.xml").decode()
        assert any(
            "0.7, /* disturbance_rate */" in archive.read(name).decode()
            for name in archive.namelist()
            if name.startswith("sources/") and name.endswith(".c")
        )


@pytest.mark.parametrize(
    ("text", "model", "expected"),
    [
        ('{"mas": 1.0}', "cart.py", "did you mean 'mass'"),
        ('{"mass": "heavy"}', "cart.py", "start value of mass"),
        ("[1]", "cart.py", "an object of names and values"),
        ('{"mass": 1.0}', None, "expected the MODEL that they are of"),
    ],
)
def test_values_that_no_fmu_can_have_are_refused_before_anything_is_built(tmp_path, capsys, text, model, expected):
    (tmp_path / "cart.py").write_text(MODEL)
    (tmp_path / "fit.json").write_text(text)
    words = [] if model is None else [str(tmp_path / model)]
    out = tmp_path / "out"
    assert main(["build", *words, "--out", str(out), "--start-values-file", str(tmp_path / "fit.json")]) == 2
    error = capsys.readouterr().err
    assert expected in error
    assert len(error) < 310
    assert not out.exists()
