"""The picture of the folders is drawn from the code and must show what the code imports today."""

from __future__ import annotations

import sys
from importlib import import_module
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def architecture():
    sys.path.insert(0, str(ROOT / "docs"))
    try:
        return import_module("architecture")
    finally:
        sys.path.remove(str(ROOT / "docs"))


@pytest.fixture
def checkout(tmp_path):
    """Two folders that import each other by two modules, a third beside them, and a component."""
    files = {
        "ndob_fmu/__init__.py": '"""A package."""\n',
        "ndob_fmu/model/__init__.py": '"""What the user writes."""\n',
        "ndob_fmu/model/plant.py": '"""A plant."""\n\n\ndef late():\n    import ndob_fmu.codegen.emit\n',
        "ndob_fmu/codegen/__init__.py": '"""Source code of the steps."""\n',
        "ndob_fmu/codegen/emit.py": '"""Text."""\nfrom ndob_fmu.model.plant import late\n\n\nclass Encoder: ...\n',
        "ndob_fmu/interface/__init__.py": '"""Variables."""\n',
        "ndob_fmu/interface/names.py": '"""Names, of an encoder too."""\nfrom ndob_fmu.model import plant\n',
        "README.md": "one\ntwo\n",
    }
    for name, text in files.items():
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, "utf-8")
    return tmp_path


def test_the_picture_is_that_of_the_code(architecture):
    assert architecture.PICTURE.read_bytes() == architecture.picture(ROOT), "run `python docs/architecture.py`"


def test_the_picture_has_a_box_for_each_folder_and_an_arrow_for_each_import_between_two(architecture, checkout):
    drawn = architecture.picture(checkout).decode()
    assert [drawn.count(f">{name}/</tspan>") for name in ("model", "codegen", "interface")] == [1, 1, 1]
    assert drawn.count("marker-end") == 3
    (checkout / "ndob_fmu/codegen/emit.py").write_text('"""Text."""\n', "utf-8")
    assert architecture.picture(checkout).decode().count("marker-end") == 2


def test_an_arrow_that_follows_from_others_is_left_out(architecture, checkout):
    (checkout / "ndob_fmu/interface/names.py").write_text("import ndob_fmu.codegen.emit\n", "utf-8")
    (checkout / "ndob_fmu/model/plant.py").write_text("", "utf-8")
    before = architecture.picture(checkout)
    (checkout / "ndob_fmu/interface/names.py").write_text(
        "import ndob_fmu.codegen.emit, ndob_fmu.model.plant\n", "utf-8"
    )
    assert architecture.picture(checkout) == before


def test_the_figures_find_circles_missing_docstrings_and_the_files_that_know_a_component(architecture, checkout):
    said = architecture.figures(checkout)
    assert "circles of imports among modules: 1\n    ndob_fmu.codegen.emit, ndob_fmu.model.plant\n" in said
    assert "circles among folders: 1\n    codegen, model\n" in said
    assert "public names without a docstring: 2\n" in said
    assert "    ndob_fmu.codegen.emit: Encoder\n    ndob_fmu.model.plant: late\n" in said
    assert "component 'encoder': 1\n    ndob_fmu/codegen/emit.py\n" in said
    assert "README: 2 lines\n" in said


def test_a_stop_is_noted_once_in_the_order_of_the_calls():
    sys.path.insert(0, str(ROOT / "docs"))
    try:
        stops = import_module("stops").stops
    finally:
        sys.path.remove(str(ROOT / "docs"))

    def inner():
        return 1

    def outer():
        return inner() + inner()

    with stops(lambda frame: frame.f_code.co_name if frame.f_code.co_name in ("inner", "outer") else None) as found:
        outer()
    inner()
    assert found == ["outer", "inner"]
