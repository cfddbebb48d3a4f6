"""The command line: what it prints, its exit codes, and one line for whatever cannot be used."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest
from fmpy.util import read_csv

import ndob_fmu
from ndob_fmu import load_model
from ndob_fmu.analysis.design import design
from ndob_fmu.cli import main
from ndob_fmu.fmu.components import records
from tests.helpers.clean_process import ENVIRONMENT
from tests.helpers.problems import EXAMPLES

ROOT = Path(__file__).parents[2]

UNSTABLE_ZERO = """
from ndob_fmu import Model
model = Model(
    name="Backwards", states=["a", "b"], outputs=["y"], disturbances=["d"],
    A=[[0, 1], [-2, -3]], C=[[-1, 1]], G_d=[[0], [1]],
)
"""
FILES = {
    "no_model.py": "x = 1",
    "wrong_type.py": "model = 3",
    "syntax.py": "model = (",
    "raises.py": "import math\nmath.sqrt(-1)\n",
    "leaves.py": "import sys\nsys.exit(0)\n",
    "shape.py": UNSTABLE_ZERO.replace("C=[[-1, 1]]", "C=[[-1, 1, 0]]"),
    "unit.py": UNSTABLE_ZERO.replace("C=[[-1, 1]]", "C=[[1, 0]], units={'a': 'bananas'}"),
    "zero.py": UNSTABLE_ZERO,
}


@pytest.fixture(autouse=True)
def elsewhere(tmp_path, monkeypatch):
    """Run each test in an empty folder of its own, so that what is left behind can be seen."""
    folder = tmp_path / "here"
    folder.mkdir()
    monkeypatch.chdir(folder)
    return folder


@pytest.fixture
def files(tmp_path):
    folder = tmp_path / "models"
    folder.mkdir()
    for name, text in FILES.items():
        (folder / name).write_text(text)
    return folder


def assert_one_line(capsys, *words):
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("ndob-fmu: ")
    assert err.count("\n") == 1
    for word in words:
        assert word in err
    assert "Traceback" not in err
    assert list(Path.cwd().iterdir()) == []


# -- check


def test_check_prints_one_row_per_assumption_and_returns_0(capsys):
    assert main(["check", "flexible_joint"]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    assert "observable" in out


def test_check_gives_json(capsys):
    assert main(["check", "flexible_joint", "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["passed"] is True


def test_check_returns_1_and_still_prints_its_rows_where_an_assumption_fails(files, capsys):
    assert main(["check", str(files / "zero.py")]) == 1
    out, err = capsys.readouterr()
    assert "zero" in out
    assert err == ""
    assert main(["check", str(files / "zero.py"), "--json"]) == 1
    assert json.loads(capsys.readouterr().out)["passed"] is False


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_check_passes_every_example(path, capsys):
    assert main(["check", str(path)]) == 0, capsys.readouterr().out


# -- design


def test_design_prints_the_papers_gain(capsys):
    assert main(["design", "flexible_joint"]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    assert "1.4162e+03" in out


def test_design_gives_json_with_the_keys_of_the_contract(capsys):
    assert main(["design", "flexible_joint", "--pi", "1e8", "--alpha", "0.5", "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    expected = design(load_model("flexible_joint"), pi=1e8, alpha=0.5)
    for key in ("L", "W", "M"):
        np.testing.assert_array_equal(np.array(result[key]), getattr(expected, key))
    poles = [complex(*pole) for pole in result["poles"]]
    np.testing.assert_array_equal(poles, expected.poles)
    assert result["riccati_residual"] == expected.riccati_residual <= 1e-8


# -- build

COMPONENTS = [f"{record.name}.fmu" for record in records()]


def test_build_writes_both_fmus_and_names_them(capsys, flexible_joint):
    assert main(["build", "flexible_joint"]) == 0
    assert capsys.readouterr().out.split() == [
        str(Path("build", "fmus", f"FlexibleJoint{part}.fmu")) for part in ("Plant", "Observer")
    ]
    assert Path("build/fmus/FlexibleJointPlant.fmu").read_bytes() == flexible_joint.plant.read_bytes()


def test_build_also_writes_the_other_components_and_packs_the_shipped_systems(capsys, flexible_joint, shipped):
    others = [*COMPONENTS, "FlexibleJointController.fmu"]
    assert main(["build", "flexible_joint", "--out", "f", "--components"]) == 0
    assert capsys.readouterr().out.split()[2:] == [str(Path("f", name)) for name in others]
    assert main(["build", "flexible_joint", "--out", "f", "--systems", "s"]) == 0
    packages = sorted(path.name for path in shipped.systems.iterdir())
    assert sorted(capsys.readouterr().out.split()[2 + len(others) :]) == [str(Path("s", name)) for name in packages]
    for name in packages:
        assert Path("s", name).read_bytes() == (shipped.systems / name).read_bytes()


ADRIFT = """
from ndob_fmu import Model
model = Model(name="Adrift", states=["v"], outputs=["v"], disturbances=["d"], A=[[-1]], C=[[1]], G_d=[[1]])
"""


def test_build_without_a_model_writes_the_components_that_fit_any_plant(capsys, shipped):
    assert main(["build", "--out", "f"]) == 0
    assert capsys.readouterr().out.split() == [str(Path("f", name)) for name in COMPONENTS]
    assert Path("f", "Encoder.fmu").read_bytes() == (shipped.fmus / "Encoder.fmu").read_bytes()
    assert main(["build", "--out", "g", "--systems", "s"]) == 2
    assert capsys.readouterr().err == (
        "ndob-fmu: build --systems: expected the MODEL that the systems contain, received none\n"
    )
    assert not Path("g").exists()


def test_a_plant_that_no_controller_fits_still_gets_the_other_components(capsys, tmp_path):
    (tmp_path / "adrift.py").write_text(ADRIFT)
    assert main(["build", str(tmp_path / "adrift.py"), "--out", "f", "--components"]) == 2
    out, err = capsys.readouterr()
    built = ["AdriftPlant.fmu", "AdriftObserver.fmu", *COMPONENTS]
    assert out.split() == [str(Path("f", name)) for name in built]
    assert sorted(path.name for path in Path("f").iterdir()) == sorted(built)
    assert err == "ndob-fmu: the controller of Adrift: expected a plant with inputs, received none\n"


def test_the_script_build_fmu_does_the_same(flexible_joint):
    """tests/native/test_systems.py shows what it asks for where it is given no model."""
    command = [sys.executable, ROOT / "build_fmu.py", "flexible_joint", "--out", "fmus"]
    subprocess.run(command, check=True, env=ENVIRONMENT | {"PYTHONPATH": str(ROOT)}, capture_output=True)
    for fmu in (flexible_joint.plant, flexible_joint.observer):
        assert Path("fmus", fmu.name).read_bytes() == fmu.read_bytes()


# -- simulate


def test_simulate_says_what_it_recorded(flexible_joint, capsys):
    assert main(["simulate", str(flexible_joint.system), "--stop-time", "0.02"]) == 0
    out, err = capsys.readouterr()
    assert re.match(r"21 rows of \d+ signals, 0 to 0\.02 s", out)
    assert err == ""


def test_simulate_takes_the_options_of_fmpy_and_writes_its_form_of_csv(flexible_joint, capsys):
    Path("in.csv").write_text('"time","plant.load_torque"\n1.0,0.0\n1.5,3.0\n')
    words = ["--start-time", "1", "--stop-time", "2", "--step-size", "0.01", "--output-interval", "0.1"]
    words += ["--start-values", "plant.disturbance.kind", "0", "observer.pi_end", "1e4", "--input-file", "in.csv"]
    assert main(["simulate", str(flexible_joint.system), *words, "--output-file", "out.csv"]) == 0
    assert capsys.readouterr().out.startswith("out.csv: 11 rows")
    table = read_csv("out.csv")
    assert table.dtype.names[0] == "time"
    np.testing.assert_allclose(table["time"], np.linspace(1.0, 2.0, 11))
    # A row of the file holds from its time on, so that the step that ends there still has the one before.
    np.testing.assert_array_equal(table["plant.load_torque_total"], [0.0] * 6 + [3.0] * 5)


def test_simulate_gives_the_values_of_a_file_to_each_component_that_has_the_parameter(flexible_joint):
    Path("fit.json").write_text('{"gravity_torque": 3.0, "lag": 0.02, "plant.link_angle_start": 0.5}')
    command = ["simulate", str(flexible_joint.system), "--stop-time", "0.1", "--results", "r"]
    assert main([*command, "--start-values-file", "fit.json", "--start-values", "observer.lag", "0.04"]) == 0
    told = json.loads(Path("r/summary.json").read_text())["parameters"]
    wanted = {"plant.gravity_torque": 3.0, "observer.gravity_torque": 3.0, "observer.lag": 0.04}
    assert {name: float(told[name]) for name in wanted} == wanted
    assert "plant.lag" not in told
    assert read_csv("r/result.csv")["plant.link_angle"][0] == 0.5


def test_simulate_runs_a_single_fmu_with_bare_names(flexible_joint, capsys):
    words = ["--stop-time", "0.1", "--step-size", "0.05", "--start-values", "link_angle_start", "0.5"]
    assert main(["simulate", str(flexible_joint.plant), *words, "--output-file", "out.csv"]) == 0
    assert read_csv("out.csv")["FlexibleJointPlant.link_angle"][0] == 0.5
    assert capsys.readouterr().err == ""


def test_simulate_couples_in_the_order_that_is_asked_for(flexible_joint, capsys):
    for scheme in ("jacobi", "gauss-seidel"):
        words = ["--stop-time", "0.1", "--scheme", scheme, "--output-file", f"{scheme}.csv"]
        assert main(["simulate", str(flexible_joint.system), *words]) == 0
    jacobi, gauss_seidel = (read_csv(f"{scheme}.csv") for scheme in ("jacobi", "gauss-seidel"))
    # The plant comes first: its new sample then reaches the observer a step earlier.
    residual = "observer.link_angle_residual"
    assert abs(gauss_seidel[residual][1] - jacobi[residual][2]) < 2e-2
    assert gauss_seidel[residual][1] != jacobi[residual][1]
    capsys.readouterr()


def test_simulate_writes_a_folder_with_figures_and_how_it_came_about(flexible_joint, capsys):
    words = ["--stop-time", "0.1", "--start-values", "observer.method", "sampled_data", "--results", "r"]
    assert main(["simulate", str(flexible_joint.system), *words]) == 0
    assert "r: 101 rows of" in capsys.readouterr().out
    found = sorted(path.name for path in Path("r").iterdir())
    assert found == ["result.csv", "signals.png", "signals.svg", "summary.json", "system.svg"]
    summary = json.loads(Path("r/summary.json").read_text("utf-8"))
    assert summary["parameters"]["observer.method"] == "sampled_data"
    assert summary["parameters"]["plant.gravity_torque"] == 10.0
    assert summary["units"]["plant.link_rate"] == "rad/s"
    assert (summary["step_size"], summary["stop_time"], summary["scheme"]) == (1e-3, 0.1, "jacobi")
    assert "plant [rad/s]" in Path("r/signals.svg").read_text("utf-8")


def test_simulate_opens_a_window_with_units_and_legends(flexible_joint, capsys, monkeypatch):
    from matplotlib import pyplot as plt

    def show():
        shown.update({axes.get_ylabel(): axes.get_legend_handles_labels()[1] for axes in plt.gcf().axes})
        plt.close()

    shown = {}
    monkeypatch.setattr(plt, "get_backend", lambda: "tkagg")  # as where there is a screen
    monkeypatch.setattr(plt, "show", show)
    assert main(["simulate", str(flexible_joint.system), "--stop-time", "0.1", "--show-plot"]) == 0
    capsys.readouterr()
    assert shown["plant [rad/s]"] == ["link_rate", "motor_rate"]
    assert shown["observer [N·m]"] == [
        f"load_torque_{suffix}" for suffix in ("hat", "at_sample", "std", "lagged", "lagged_std")
    ]


def test_a_window_where_there_is_no_screen_ends_in_one_line(flexible_joint, monkeypatch, capsys):
    from matplotlib import pyplot as plt

    monkeypatch.setattr(plt, "get_backend", lambda: "agg")
    assert main(["simulate", str(flexible_joint.system), "--stop-time", "0.1", "--show-plot"]) == 2
    err = capsys.readouterr().err
    assert "--show-plot: expected a screen, received none" in err
    assert err.count("\n") == 1


# -- usage


@pytest.mark.parametrize("command", ["check", "design", "build"])
@pytest.mark.parametrize(
    ("model", "code", "words"),
    [
        ("flexible_joints", 2, ["flexible_joints", "built-in name (flexible_joint"]),
        ("missing.py", 2, ["missing.py", "another working directory"]),
        ("no_model.py", 2, ["no_model.py", "no `model`"]),
        ("wrong_type.py", 2, ["wrong_type.py", "`model` of type int"]),
        ("syntax.py", 2, ["syntax.py", "SyntaxError", "line 1"]),
        ("raises.py", 2, ["raises.py", "ValueError", "line 2"]),
        ("leaves.py", 2, ["leaves.py", "SystemExit"]),
        ("shape.py", 2, ["shape.py", "Backwards.C", "(1, 2)", "(1, 3)"]),
    ],
)
def test_a_model_that_cannot_be_used_ends_in_one_line(files, capsys, command, model, code, words):
    source = str(files / model) if model in FILES else model
    assert main([command, source]) == code
    assert_one_line(capsys, *words)


@pytest.mark.parametrize("command", ["design", "build"])
def test_a_failed_assumption_returns_1_and_builds_nothing(files, capsys, command):
    assert main([command, str(files / "zero.py")]) == 1
    assert_one_line(capsys, "zero")


def test_an_alpha_beyond_the_zeros_returns_1(capsys):
    motor = next(path for path in EXAMPLES if path.stem == "dc_motor")
    assert main(["design", str(motor), "--alpha", "499"]) == 0
    capsys.readouterr()
    assert main(["design", str(motor), "--alpha", "501"]) == 1
    assert_one_line(capsys, "alpha", "501")


@pytest.mark.parametrize("pi", ["0", "-1", "nan", "inf"])
def test_a_pi_that_is_not_above_zero_returns_2(capsys, pi):
    assert main(["design", "flexible_joint", f"--pi={pi}"]) == 2
    assert_one_line(capsys, "pi", "expected a finite number > 0")


def test_a_unit_that_is_none_returns_2_and_leaves_nothing(files, capsys):
    assert main(["build", str(files / "unit.py"), "--out", "."]) == 2
    assert_one_line(capsys, "bananas")


def test_a_folder_that_cannot_be_written_returns_2(tmp_path, capsys):
    (tmp_path / "file").write_text("")
    assert main(["build", "flexible_joint", "--out", str(tmp_path / "file" / "sub")]) == 2
    assert_one_line(capsys, "file that can be written")


@pytest.mark.parametrize(
    ("words", "code", "says"),
    [
        (["--step-size", "0"], 2, ["step size"]),
        (["--step-size=-0.001"], 2, ["step size"]),
        (["--stop-time", "-1"], 2, ["stop time"]),
        (["--step-size", "0.003", "--stop-time", "0.01"], 2, ["0.003"]),
        (["--output-interval", "0.0015"], 2, ["output interval"]),
        (["--start-values", "observer.alpha"], 2, ["--start-values", "pairs NAME VALUE", "1 words"]),
        (["--start-values", "observer.alfa", "1"], 2, ["alfa", "did you mean 'alpha'?"]),
        (["--start-values", "alpha", "1"], 2, ["did you mean 'observer.alpha'?"]),
        (["--start-values", "observer.alpha", "one"], 2, ["observer.alpha", "one"]),
        (["--input-file", "missing.csv"], 2, ["missing.csv"]),
        (["--start-values-file", "missing.json"], 2, ["missing.json", "a JSON file that can be read"]),
        (["--start-values", "observer.pi_end", "-1"], 1, ["observer", "pi_end", "received -1.0"]),
    ],
)
def test_a_simulation_that_cannot_be_run_ends_in_one_line(flexible_joint, capsys, words, code, says):
    command = ["simulate", str(flexible_joint.system), *words, "--output-file", "out.csv"]
    assert main(command if "--stop-time" in words else [*command, "--stop-time", "0.1"]) == code
    assert_one_line(capsys, *says)


def test_a_system_that_is_missing_broken_or_none_ends_in_one_line(flexible_joint, tmp_path, capsys):
    broken, cut, plain = tmp_path / "broken.ssp", tmp_path / "cut.ssp", tmp_path / "system.txt"
    broken.write_bytes(flexible_joint.system.read_bytes()[:1000])
    plain.write_text("")
    with zipfile.ZipFile(flexible_joint.system) as whole, zipfile.ZipFile(cut, "w") as archive:
        for name in whole.namelist():
            if not name.endswith("Observer.fmu"):
                archive.writestr(name, whole.read(name))
    for path, word in (
        (tmp_path / "missing.ssp", "missing.ssp"),
        (broken, "broken.ssp"),
        (cut, "FlexibleJointObserver.fmu"),
        (plain, ".ssp or .fmu"),
    ):
        assert main(["simulate", str(path), "--output-file", "out.csv"]) == 2
        assert_one_line(capsys, word)


def test_simulate_wants_either_a_system_or_the_demo(capsys):
    assert main(["simulate"]) == 2
    assert_one_line(capsys, "neither")
    assert main(["simulate", "x.ssp", "--demo"]) == 2
    assert_one_line(capsys, "both")


def test_a_result_that_exists_survives_a_run_that_fails(flexible_joint, capsys):
    Path("out.csv").write_text("older")
    words = ["--stop-time", "0.1", "--output-file", "out.csv", "--start-values", "observer.pi_end", "-1"]
    assert main(["simulate", str(flexible_joint.system), *words]) == 1
    assert [(path.name, path.read_text()) for path in Path.cwd().iterdir()] == [("out.csv", "older")]
    capsys.readouterr()


# -- as a program


def run(*words, **options):
    command = [sys.executable, "-m", "ndob_fmu", *map(str, words)]
    environment = ENVIRONMENT | {"PYTHONPATH": str(ROOT)}
    return subprocess.run(command, env=environment, capture_output=True, text=True, check=False, **options)


def said(done):
    """Return the lines on stderr but for what a slow machine makes a command say of its progress."""
    return [line for line in done.stderr.splitlines() if not line.startswith("ndob-fmu: still ")]


def test_the_program_returns_the_exit_code_and_prints_no_traceback(files):
    done = run("design", files / "zero.py")
    assert (done.returncode, done.stdout, len(said(done))) == (1, "", 1)
    done = run("simulate", "missing.ssp")
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
    done = run("nonsense")
    assert done.returncode == 2
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize(
    ("package", "words", "extra"),
    [
        ("distributed", ["sweep", "s.toml"], "study"),
        ("pyarrow", ["sweep", "s.toml"], "study"),
        ("plotly", ["report", "."], "report"),
    ],
)
def test_a_command_whose_extra_is_not_installed_says_how_to_get_it(package, words, extra):
    program = f"import sys; sys.modules[{package!r}] = None; from ndob_fmu.cli import main; sys.exit(main({words!r}))"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert f'pip install "ndob-fmu[{extra}]"' in done.stderr


def test_the_program_tells_its_version_and_its_commands():
    assert run("--version").stdout.strip() == ndob_fmu.__version__
    shown = run("--help").stdout
    assert [
        word for word in ("check", "design", "build", "simulate", "sweep", "report", "demo") if word not in shown
    ] == []


PRINTS = [
    ["check", "flexible_joint", "--json"],
    ["design", "flexible_joint", "--json", "--step-size", "1e-3"],
    ["build", "flexible_joint"],
    ["simulate", "{plant}", "--stop-time", "0.01", "--start-values", "motor_torque", "0", "load_torque", "0"],
    ["report", "{run}"],
]


def printed_to(words, stream, flexible_joint, tmp_path):
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "result.csv").write_text('"time","a.y"\n0,1\n1,2\n')
    words = [word.format(plant=flexible_joint.plant, run=tmp_path / "run") for word in words]
    return subprocess.run(
        [sys.executable, "-u", "-m", "ndob_fmu", *words],
        env=ENVIRONMENT | {"PYTHONPATH": str(ROOT)},
        stdout=stream,
        stderr=subprocess.PIPE,
        text=True,
        check=False,
    )


@pytest.mark.parametrize("words", PRINTS, ids=lambda words: " ".join(words[:1]))
def test_a_reader_that_has_gone_ends_a_command_without_a_word(words, flexible_joint, tmp_path):
    """As in `ndob-fmu check flexible_joint | head -1`; unbuffered, so that every line meets the closed pipe."""
    read, write = os.pipe()
    os.close(read)
    done = printed_to(words, write, flexible_joint, tmp_path)
    os.close(write)
    assert said(done) == []
    assert done.returncode == 141


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="the device that is always full is Linux's")
def test_an_output_that_cannot_be_written_is_said_in_a_line(flexible_joint, tmp_path):
    with Path("/dev/full").open("w") as full:
        done = printed_to(["check", "flexible_joint"], full, flexible_joint, tmp_path)
    assert done.returncode == 2
    assert said(done) == ["ndob-fmu: the output cannot be written: No space left on device"]
