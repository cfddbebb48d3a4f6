"""Which Pythons `make versions` uses, and its message if there is none."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests import lower_bounds, versions

PROJECT = (Path(__file__).parents[2] / "pyproject.toml").read_text("utf-8")


def test_the_lowest_set_runs_on_the_oldest_python_that_the_project_allows():
    assert re.search(r'^requires-python = ">=(.*)"', PROJECT, re.MULTILINE)[1] == versions.SETS[0].pythons[0]


def test_each_requirement_has_one_lower_bound():
    listed = PROJECT.split("[project]")[1].split("[tool.")[0]
    found = re.findall(r'^    "([a-z0-9-]+)(?:\[.*\])?(>=)?', listed, re.MULTILINE)
    bounded = [name for name, bound in found if bound]
    assert len(bounded) >= 20
    assert len(set(bounded)) == len(bounded)  # of two bounds only the higher one would be tried
    assert {name for name, bound in found if not bound} == {"ndob-fmu"}


def test_a_bound_that_another_package_lifts_is_told_with_the_one_that_does():
    listed = ["a>=1.0", 'b>=2.1; extra == "test"', 'c>=3; extra == "other"', 'd>=4; python_version < "3"', "e>=5", "f"]
    direct = lower_bounds.needed(listed, "test")
    assert [one.name for one in direct] == ["a", "b", "e", "f"]
    installed = {"a": "1.0.0", "b": "2.2", "e": "5.1", "f": "6"}
    lines = lower_bounds.not_at_bound(direct, installed.__getitem__, lambda name: ["g 7 (>=2.2)"] * (name == "b"))
    assert lines == [
        "b: expected the lower bound 2.1, received 2.2; needed by g 7 (>=2.2)",
        "e: expected the lower bound 5, received 5.1; no such release, or others exclude what it needs",
        "f: expected the lower bound None, received 6; no such release, or others exclude what it needs",
    ]
    assert lower_bounds.not_at_bound(direct[:1], installed.__getitem__, lambda name: []) == []


@pytest.mark.parametrize(("ci", "code"), [("true", 1), ("", 0)])
def test_a_python_that_a_machine_should_have_is_missed_under_ci_only(monkeypatch, tmp_path, capsys, ci, code):
    monkeypatch.setattr(versions, "FOLDER", tmp_path)
    monkeypatch.setattr(versions, "uv", lambda: "false")
    monkeypatch.setattr(versions, "why_no_other_root", lambda: "")
    monkeypatch.setattr(versions.shutil, "which", lambda *args, **options: None)
    monkeypatch.setenv("CI", ci)
    assert versions.run(versions.SETS[1]) == code
    assert (
        capsys.readouterr().out
        == "versions, newest: nothing is tried; debootstrap is missing: apt-get install debootstrap\n"
    )


def test_a_machine_that_can_have_no_newest_python_says_so_in_one_line(monkeypatch, capsys):
    monkeypatch.setenv("CI", "true")
    monkeypatch.setattr(versions, "uv", lambda: "false")
    monkeypatch.setattr(versions, "why_no_other_root", lambda: "only root can run Debian in a folder")
    assert versions.run(versions.SETS[1]) == 0
    assert capsys.readouterr().out == (
        "versions, newest: nothing is tried; uv neither finds nor downloads Python 3.14, "
        "and only root can run Debian in a folder\n"
    )
