"""What lies in an FMU for its reader: icon, page, licences, and what it needs on the host."""

from __future__ import annotations

import html
import io
import re
import zipfile
from html.parser import HTMLParser
from importlib.metadata import distribution
from pathlib import Path
from xml.etree import ElementTree

import fmpy
import matplotlib
import matplotlib.image
import numpy as np
import pytest
import sympy

from ndob_fmu import Model
from ndob_fmu.codegen.compile_model import compile_model
from ndob_fmu.fmu.icon import draw_icon, model_icon
from ndob_fmu.fmu.manual import manual
from ndob_fmu.interface.model_variables import observer_variables, plant_variables
from tests.helpers.problems import MODELS

ROOT = Path(__file__).parents[2]
VARIABLES = {"Plant": plant_variables, "Observer": observer_variables}


def page(model, part):
    return manual(model, part, VARIABLES[part](compile_model(model)))


def tank(**changes):
    """A tank whose outflow SymPy writes as a Piecewise, with a text that HTML could mistake for its own."""
    fields = {
        "name": "Tank",
        "description": "level < 2 m & <b>no</b> lid",
        "states": ["level"],
        "outputs": ["gauge"],
        "disturbances": ["leak"],
        "A": [[-1]],
        "C": [[2]],
        "G_d": [[1]],
        "f": lambda x, u, p: [sympy.Piecewise((-x.level / 2, x.level > 1), (0, True))],
        "lipschitz": 0.5,
    }
    return Model(**(fields | changes))


@pytest.fixture(scope="module")
def files(flexible_joint):
    """Return the plant's files for its reader by their paths."""
    with zipfile.ZipFile(flexible_joint.plant) as archive:
        return {
            name: archive.read(name)
            for name in archive.namelist()
            if name == "model.png" or name.startswith("documentation/")
        }


def test_they_lie_where_fmi_wants_them(files):
    assert set(files) == {
        "model.png",
        "documentation/index.html",
        "documentation/externalDependencies.txt",
        *(f"documentation/licenses/{name}.txt" for name in ("license", "ndob-fmu", "pythonfmu", "fmi-headers")),
    }


# -- icon


def pixels(png):
    return matplotlib.image.imread(io.BytesIO(png))


def test_the_icon_is_a_picture_of_the_size_that_fmi_recommends(files):
    picture = pixels(files["model.png"])
    assert picture.shape[:2] == (200, 200)
    # A frame with ink in it, arrows that reach to the left and right edges, nothing above and below.
    inked = (picture[..., :3].min(axis=2) < 0.6).mean(axis=0)
    assert (inked[5:195] > 0).all()
    assert (picture[:15, :, :3] == 1).all()


def test_icons_tell_plant_from_observer_and_one_model_from_another():
    drawn = {draw_icon(model_icon(model, part)) for model in MODELS.values() for part in ("Plant", "Observer")}
    assert len(drawn) == 2 * len(MODELS)


def test_a_plant_without_inputs_shows_none():
    with_input = tank(name="Same", inputs=["pump"], B=[[1]])
    left = [
        pixels(draw_icon(model_icon(model, "Plant")))[:, 4:36, :3] < 0.6 for model in (tank(name="Same"), with_input)
    ]
    arrows = [np.flatnonzero(ink.any(axis=2).mean(axis=1) > 0.9) for ink in left]
    assert [len(np.flatnonzero(np.diff(rows, prepend=-9) > 1)) for rows in arrows] == [1, 2]


def test_a_users_style_for_figures_changes_neither_the_icon_nor_is_it_changed():
    before = draw_icon(model_icon(MODELS["flexible_joint"], "Plant"))
    with matplotlib.rc_context({"font.size": 30, "savefig.dpi": 300, "lines.linewidth": 9, "font.family": "serif"}):
        assert draw_icon(model_icon(MODELS["flexible_joint"], "Plant")) == before
        assert matplotlib.rcParams["savefig.dpi"] == 300


@pytest.mark.parametrize("name", ["X", "AVeryLongNameOfAPlantThatGoesOnAndOn", "with_underscores_in_it", "a" * 40])
def test_a_name_of_any_length_stays_inside_the_block(name):
    drawn = pixels(draw_icon(model_icon(tank(name=name), "Plant")))
    other = pixels(draw_icon(model_icon(tank(name="Y"), "Plant")))
    differs = (drawn != other).any(axis=(0, 2))
    assert differs.any()
    assert not differs[:42].any()
    assert not differs[158:].any()


# -- page


class Tags(HTMLParser):
    """Note what was opened and never closed, and every attribute."""

    def __init__(self):
        super().__init__()
        self.open, self.attributes = [], []

    def handle_starttag(self, tag, attrs):
        self.attributes += attrs
        if tag != "meta":
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.attributes += attrs

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


@pytest.mark.parametrize("part", ["Plant", "Observer"])
@pytest.mark.parametrize("name", MODELS)
def test_the_page_is_whole_and_needs_no_network(name, part):
    text = page(MODELS[name], part)
    tags = Tags()
    tags.feed(text)
    assert tags.open == []
    assert {value for key, value in tags.attributes if key in ("src", "href")} == {"licenses/license.txt"}
    assert "$" not in text
    for formula in re.findall("<math.*?</math>", text):
        ElementTree.fromstring(re.sub(r"&(?!lt;|gt;|amp;)", "&amp;", formula))


@pytest.mark.parametrize("name", MODELS)
def test_the_equations_on_the_page_are_those_that_run(name):
    model = MODELS[name]
    random = np.random.default_rng(7)
    named = (model.states, model.inputs, model.disturbances)
    x, u, d = (random.uniform(0.5, 1.5, len(names)).tolist() for names in named)
    values = dict(zip(model.states, x, strict=True)) | dict(zip(model.inputs, u, strict=True)) | dict(model.parameters)
    values |= {f"{name}_total": value for name, value in zip(model.disturbances, d, strict=True)}
    (text,) = re.findall("<pre>(der.*?)</pre>", page(model, "Observer"), flags=re.DOTALL)
    sides = dict(line.split(" = ", 1) for line in html.unescape(text).splitlines())
    symbols = {key: sympy.Symbol(key) for key in values}
    got = [float(sympy.sympify(sides[f"der({s})"], locals=symbols).subs(values)) for s in model.states]
    expected = compile_model(model).derivatives(x, u, d, list(model.parameters.values()))
    np.testing.assert_allclose(got, expected, rtol=1e-12, atol=1e-12)
    calculated = {output for output in model.outputs if output not in model.states}
    assert set(sides) == {f"der({s})" for s in model.states} | calculated


def test_names_with_underscores_stay_whole_in_the_formulas():
    text = page(MODELS["flexible_joint"], "Plant")
    assert "<mi>gravity_torque</mi>" in text
    assert "<msub>" not in text


@pytest.mark.parametrize("name", MODELS)
def test_the_formulas_have_their_brackets_where_browsers_show_them(name):
    """Not as SymPy before 1.14 wrote them: as <mfenced>, of which browsers show the contents only."""
    text = page(MODELS[name], "Plant")
    assert "mfenced" not in text
    formulas = "".join(re.findall("<math.*?</math>", text))
    assert formulas.count("<mo>(</mo>") == formulas.count("<mo>)</mo>")
    if any(e.has(sympy.Function) for e in MODELS[name].f_expressions):
        assert "<mo>(</mo>" in formulas


def test_a_case_distinction_is_shown_as_one():
    (formula,) = re.findall("<math.*?Piecewise|<math[^§]*?<mtable>.*?</math>", page(tank(), "Plant"))
    assert formula.count("<mtr>") == 2
    assert "otherwise" in formula
    assert "piecewise" not in formula


def test_the_models_own_words_cannot_break_the_page():
    text = page(tank(), "Plant")
    assert "level &lt; 2 m &amp; &lt;b&gt;no&lt;/b&gt; lid" in text
    assert "<b>" not in text


def rows_of(text):
    rows = re.findall(r"<tr><td><code>(.*?)</code></td>(.*?)</tr>", text)
    return {name: re.findall("<td>(.*?)</td>", rest) for name, rest in rows}


def test_the_page_lists_every_variable_with_unit_start_and_range():
    rows = rows_of(page(MODELS["flexible_joint"], "Observer"))
    assert set(rows) == {v.name for v in observer_variables(compile_model(MODELS["flexible_joint"]))}
    assert rows["method"][1:3] == ["2 (sampled_data)", "1 paper, 2 sampled_data"]
    assert rows["disturbance_order"][1:3] == ["2", "≥ 0, ≤ 3"]
    assert rows["pi_end"][1:3] == ["1e+12", "&gt; 0"]
    assert rows["alpha"][:2] == ["1/s", "1"]
    assert rows["motor_torque"][:3] == ["N.m", "0", "t"]


@pytest.mark.parametrize("name", MODELS)
def test_the_page_says_which_instant_each_output_belongs_to(name):
    model = MODELS[name]
    plant, observer = rows_of(page(model, "Plant")), rows_of(page(model, "Observer"))
    at_sample = {"valid", "consistency", *(f"{d}_at_sample" for d in model.disturbances)}
    at_sample |= {f"{y}{suffix}" for y in model.outputs for suffix in ("_residual", "_residual_std")}
    for rows, variables in ((plant, plant_variables), (observer, observer_variables)):
        for variable in variables(compile_model(model)):
            if variable.causality == "output":
                lagged = variable.name.endswith(("_lagged", "_lagged_std"))
                instant = "t − lag" if lagged else "t" if variable.name in at_sample else "t + H"
                assert rows[variable.name][1] == instant


def test_only_the_observer_of_a_turning_direction_speaks_of_one():
    assert "n(x, u) d" in page(MODELS["tool_on_arm"], "Observer")
    assert "n(x, u) d" not in page(MODELS["flexible_joint"], "Observer")


# -- licences and dependencies


def words(text):
    return re.sub(r"[\s-]+", " ", text).strip()


def test_the_licences_are_those_of_what_is_inside(files):
    licences = {Path(name).stem: data.decode() for name, data in files.items() if "/licenses/" in name}
    assert licences["ndob-fmu"] == (ROOT / "LICENSE").read_text("utf-8")
    (own,) = [path for path in distribution("pythonfmu").files if path.name == "LICENSE"]
    assert licences["pythonfmu"] == own.locate().read_text("utf-8")
    header = (Path(fmpy.__file__).parent / "c-code" / "fmi2Functions.h").read_text("utf-8")
    terms = licences["fmi-headers"].partition("Copyright")[2]
    assert "BSD" in terms
    assert words(terms) in words(header)
    for name in set(licences) - {"license"}:
        assert f"{name}.txt" in licences["license"]


def test_what_the_host_needs_is_said_as_it_is_looked_for(files):
    text = files["documentation/externalDependencies.txt"].decode()
    sources = (ROOT / "ndob_fmu" / "fmu" / "python_core").glob("*.[ch]")
    looked_for = "".join(path.read_text("utf-8") for path in sources)
    (variable,) = re.findall(r'#define VARIABLE "(\w+)"', looked_for)
    (minor,) = re.findall(r"#define OLDEST_MINOR (\d+)", looked_for)
    assert variable in text
    assert f"Python 3.{minor} or newer" in text
    assert "NumPy" in text
    assert html.escape(text) in files["documentation/index.html"].decode()
