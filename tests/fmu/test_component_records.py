"""What every component's record promises: a page, an icon, described variables, and a slave and a test of its own."""

from __future__ import annotations

import io
import re
from pathlib import Path

import matplotlib.image
import pytest
from fmpy import read_model_description

from ndob_fmu import load_model
from ndob_fmu.analysis.controller_design import design_controller
from ndob_fmu.fmu.components import records
from ndob_fmu.fmu.controller import controller_record
from ndob_fmu.fmu.icon import draw_icon
from ndob_fmu.fmu.manual import page
from ndob_fmu.support.units import base_unit

ROOT = Path(__file__).parents[2]
MODEL = load_model("flexible_joint")
RECORDS = {record.name: record for record in records()}
EVERY = {**RECORDS, "FlexibleJointController": controller_record(MODEL, design_controller(MODEL).feedback)}


@pytest.fixture(params=EVERY)
def record(request):
    return EVERY[request.param]


def test_each_module_of_the_folder_is_a_record_with_a_name_of_its_own():
    folder = ROOT / "ndob_fmu" / "fmu" / "component_records"
    modules = {path.stem for path in folder.glob("[!_]*.py")}
    assert {re.sub("(?<=[a-z])(?=[A-Z])", "_", name).lower() for name in RECORDS} == modules
    assert [*RECORDS] == sorted(RECORDS)


def test_an_fmu_is_built_for_each_record_and_says_what_the_record_says(shipped):
    for name, record in RECORDS.items():
        described = read_model_description(str(shipped.fmus / f"{name}.fmu"))
        assert (described.modelName, described.description) == (name, record.text)
        assert [v.name for v in described.modelVariables] == [v.name for v in record.variables]
        assert float(described.defaultExperiment.stopTime) == record.experiment.stop_time
        assert float(described.defaultExperiment.stepSize) == record.experiment.step_size


def test_text_and_page_say_what_it_is(record):
    assert record.text
    assert not record.text.endswith(".")
    text = page(record.name, record.text, record.page, record.variables)
    headings = re.findall("<h2>(.*?)</h2>", text)
    assert headings[:3] == ["Equations", "Variables", "Timing"]
    listed = re.findall(r"<tr><td><code>(.*?)</code>", text)
    assert sorted(listed) == sorted(variable.name for variable in record.variables)
    # A parameter that the page names exists.
    for name in re.findall("<code>([a-z_]+)</code>", record.page):
        assert name in listed


def test_the_page_is_plain_html_that_needs_no_network(record):
    text = page(record.name, record.text, record.page, record.variables)
    assert set(re.findall(r"""(?:href|src)=["'](.*?)["']""", text)) == {"licenses/license.txt"}
    for tag in ("p", "pre", "code", "h2", "h3", "table", "tr", "td"):
        assert len(re.findall(f"<{tag}[ >]", text)) == text.count(f"</{tag}>"), tag
    assert "{{" not in text


def test_the_icons_are_pictures_that_differ():
    drawn = {name: draw_icon(each.icon) for name, each in EVERY.items()}
    assert len(set(drawn.values())) == len(EVERY)
    for png in drawn.values():
        assert matplotlib.image.imread(io.BytesIO(png)).shape[:2] == (200, 200)


def test_the_icon_has_an_arrow_in_where_there_is_an_input_and_one_out_where_there_is_an_output(record):
    causalities = {variable.causality for variable in record.variables}
    assert bool(record.icon.into) == ("input" in causalities)
    assert bool(record.icon.out) == ("output" in causalities)


def test_the_variables_are_described_and_their_units_known(record):
    names = [variable.name for variable in record.variables]
    assert len(names) == len(set(names))
    for variable in record.variables:
        assert variable.description
        assert not variable.description.endswith(".")
        assert not variable.unit or base_unit(variable.unit) is not None
        assert set(variable.depends_on) <= {v.name for v in record.variables if v.causality == "input"}
        if variable.causality != "output":
            assert variable.start is not None
        if variable.enumeration:
            assert variable.type == "Enumeration"
            assert variable.start in variable.enumeration.items.values()
            assert set(variable.enumeration.texts) == set(variable.enumeration.items)


@pytest.mark.parametrize("name", RECORDS)
def test_the_documentation_has_it(name):
    assert f"| `{name}` |" in (ROOT / "docs" / "systems.md").read_text("utf-8")
    assert f"\n## {name}\n" in (ROOT / "docs" / "fmu_reference.md").read_text("utf-8")
