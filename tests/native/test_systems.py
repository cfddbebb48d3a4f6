"""The shipped FMUs and systems as native ones: what they carry, and the same trajectories in every tool."""

from __future__ import annotations

import sys
import zipfile
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from fmpy.ssp.simulation import simulate_ssp

from fmus.tools import regression
from ndob_fmu.cli import main
from ndob_fmu.cosim import check_ssp, simulate
from ndob_fmu.native.origin import ORIGIN
from ndob_fmu.study import read_study
from ndob_fmu.study.session import Session
from tests.cosim.test_shipped_systems import PORTABLE, real_outputs
from tests.helpers.needs import ECOS, FRONT
from tests.importers.importer_runs import TOLERANCE, difference, in_ecos, in_python
from tests.importers.importer_studies import reference
from tests.importers.importers import Study

pytestmark = FRONT
EQUAL, EQUAL_WITHOUT_NOISE = 1e-9, 1e-6  # of a signal's range: gains come from another linear algebra
RUNS = {"open_loop": (0.3, EQUAL), "noisy_encoder": (1.2, EQUAL), "two_joints_full": (0.2, EQUAL_WITHOUT_NOISE)}


@pytest.fixture(scope="module")
def native(tmp_path_factory):
    """Return the folder with all that `ndob-fmu build --target native --systems` makes."""
    folder = tmp_path_factory.mktemp("native")
    words = ["--target", "native", "--out", str(folder / "fmus"), "--systems", str(folder / "ssp")]
    assert main(["build", "flexible_joint", *words]) == 0
    return folder


def test_the_command_builds_the_systems_of_the_python_target_and_each_passes_all_checks(native, shipped):
    packages = sorted((native / "ssp").iterdir())
    assert [path.name for path in packages] == sorted(path.name for path in shipped.systems.iterdir())
    for path in packages:
        assert check_ssp(path).passed, path.name
        with zipfile.ZipFile(path) as package:
            fmus = [name for name in package.namelist() if name.endswith(".fmu")]
            for fmu in fmus:
                with package.open(fmu) as file, zipfile.ZipFile(file) as archive:
                    assert [name for name in archive.namelist() if name.endswith(".py")] == []
        assert fmus


def description(archive):
    """Return the model description as text, without what says which build it is."""
    root = ElementTree.fromstring(archive.read("modelDescription.xml"))
    for name in ("guid", "generationTool"):
        root.set(name, "")
    cosimulation = root.find("CoSimulation")
    for sources in cosimulation.findall("SourceFiles"):
        cosimulation.remove(sources)
    return ElementTree.canonicalize(ElementTree.tostring(root), strip_text=True)


def test_each_fmu_describes_itself_as_the_python_fmu_does_and_has_the_same_pages(native, shipped):
    fmus = sorted(path.name for path in shipped.fmus.glob("*.fmu"))
    assert sorted(path.name for path in (native / "fmus").iterdir()) == fmus
    for name in fmus:
        with zipfile.ZipFile(shipped.fmus / name) as python, zipfile.ZipFile(native / "fmus" / name) as own:
            assert description(own) == description(python), name
            pages = [{n for n in a.namelist() if n.startswith(("documentation/", "model"))} for a in (python, own)]
            assert pages[0] - pages[1] == {"documentation/licenses/pythonfmu.txt"}
            assert pages[1] - pages[0] == ({ORIGIN} if name.endswith(("Plant.fmu", "Observer.fmu")) else set())


@pytest.mark.parametrize("name", RUNS)
def test_a_system_has_the_trajectories_of_the_python_build(native, shipped, name):
    """`consistency` without noise is left out: it is a ratio of rounding errors."""
    stop_time, bound = RUNS[name]
    expected, found = (simulate(f / f"{name}.ssp", stop_time=stop_time) for f in (shipped.systems, native / "ssp"))
    assert found.names == expected.names
    wanted, had = (dict(zip(run.names, run.columns.T, strict=True)) for run in (expected, found))
    for signal, column in wanted.items():
        if signal.endswith("consistency") and bound == EQUAL_WITHOUT_NOISE:
            continue
        # A residual is known to the rounding of its output.
        of = signal.removesuffix("_residual").replace("observer", "plant") if signal.endswith("_residual") else signal
        scale = max(np.abs(column).max(), np.abs(wanted[of]).max(), 1e-12)
        assert np.abs(had[signal] - column).max() <= (0.0 if signal.endswith("valid") else bound) * scale, signal


@pytest.mark.parametrize("tool", ["libcosimpy", *(pytest.param(tool, marks=ECOS) for tool in ("ecospy", "ecos"))])
def test_a_system_has_the_trajectories_of_our_master_in_other_tools(native, tool, tmp_path):
    name = "noisy_encoder"
    package = native / "ssp" / f"{name}.ssp"
    step_size, steps = PORTABLE[name]
    study = Study(package=str(package), shown=real_outputs(package), step_size=step_size, steps=steps)
    expected = reference(study)
    found = in_ecos(study, tmp_path) if tool == "ecos" else in_python(tool, study, tmp_path)
    assert difference(found, expected, rounding=1e-6 if tool == "ecos" else 0.0) <= TOLERANCE


def test_a_system_starts_in_fmpys_own_simulation_with_the_values_that_its_fmus_have(native):
    """It reads no parameter sets, stamps rows one step early, and exchanges nothing at first."""
    package = native / "ssp" / "noisy_encoder_heavy_arm.ssp"
    result, ours = simulate_ssp(str(package), stop_time=0.02, step_size=1e-3), simulate(package, stop_time=0.02)
    shown = [column for column in result.dtype.names if column in ours.names]
    assert len(shown) > 10
    for column in shown:
        np.testing.assert_allclose(result[column][:20], ours[column][1:], rtol=0.0, atol=1e-12, err_msg=column)


def test_the_reference_experiments_are_inside_their_tubes(native, capsys):
    assert regression.main(native / "fmus") == 0
    assert "OUTSIDE" not in capsys.readouterr().out


def test_the_script_without_a_model_builds_all_that_is_shipped(monkeypatch, tmp_path):
    asked = []
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("ndob_fmu.cli.main", lambda words: asked.append(words) or 0)
    for words, folder in (([], "build"), (["--target", "native", "--platforms", "win64"], "build/native")):
        monkeypatch.setattr(sys, "argv", ["build_fmu.py", *words])
        script = (Path(__file__).parents[2] / "build_fmu.py").read_text("utf-8")
        with pytest.raises(SystemExit) as ended:
            exec(compile(script, "build_fmu.py", "exec"), {"__name__": "__main__"})
        assert ended.value.code == 0
        shipped = ["flexible_joint", "--out", f"{folder}/fmus", "--systems", f"{folder}/ssp"]
        assert asked.pop() == ["build", *shipped, *words]


def test_systems_are_refused_in_fmi_3_in_one_line(capsys, tmp_path):
    words = ["--target", "native", "--fmi", "3", "--systems", str(tmp_path / "ssp")]
    assert main(["build", "flexible_joint", *words]) == 2
    assert capsys.readouterr().err == (
        "ndob-fmu: build --systems: expected --fmi 2, whose FMUs are coupled, received --fmi 3\n"
    )


STUDY = """
system = "nowhere.ssp"
[simulation]
stop_time = 0.2
[fixed]
observer.method = 2
[grid]
plant.disturbance.amplitude = [1.0, 2.0]
[measures]
estimate = { of = "observer.load_torque_hat", take = "final" }
"""


def test_a_study_runs_on_the_system_that_is_given_and_its_plan_says_what_made_the_fmus(native, shipped, tmp_path):
    (tmp_path / "study.toml").write_text(STUDY, "utf-8")
    found = {}
    for name, folder in (("python", shipped.systems), ("native", native / "ssp")):
        study = read_study(tmp_path / "study.toml", folder / "open_loop.ssp")
        session = Session(study, {study.system: folder / "open_loop.ssp"})
        found[name] = study, [session.run(run)["estimate"] for run in range(2)]
        session.close()
    np.testing.assert_allclose(found["native"][1], found["python"][1], rtol=EQUAL_WITHOUT_NOISE)
    made = {name: study.to_dict()["fmus"] for name, (study, _) in found.items()}
    assert made["native"].keys() == made["python"].keys() == {"plant", "observer"}
    assert all("with PythonFMU" in tool for tool in made["python"].values())
    assert all("PythonFMU" not in tool and tool.startswith("ndob-fmu ") for tool in made["native"].values())
    assert found["native"][0].digest != found["python"][0].digest
