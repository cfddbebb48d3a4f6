"""The text is plain: phrases that made readers stumble do not come back."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
# Write in their place: invalid; converged (a gain); at zero speed (a plant); no observer exists; inside the gate.
RIDDLES = (
    "that is none",
    "which is none",
    "at rest",
    "come to rest",
    "comes to rest",
    "admits no",
    "admit no",
    "as they usually are",
    "usual sample",
    "for good",
    "whatever it is",
    "what comes of it",
    "what came of it",
    "exactly or not at all",
    "host's. what",
)
FOLDERS = ("ndob_fmu", "fmus", "docs", "benchmarks", "examples", "ssp")
KINDS = (".py", ".c", ".h", ".md", ".html", ".jinja", ".toml", ".ipynb")
TEXTS = [
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    ROOT / "build_fmu.py",
    *(path for folder in FOLDERS for path in sorted((ROOT / folder).rglob("*")) if path.suffix in KINDS),
]


def riddles_in(text):
    """Return the riddles in a text, also across the lines of a paragraph or comment."""
    joined = re.sub(r"\s*\n[\s#*|>]*", " ", text.replace("None", "")).lower()
    return [riddle for riddle in RIDDLES if re.search(rf"\b{re.escape(riddle)}\b", joined)]


@pytest.mark.parametrize("path", TEXTS, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_no_text_has_a_riddle(path):
    assert riddles_in(path.read_text("utf-8")) == []


def test_riddles_are_found_across_lines():
    assert riddles_in("# a value that\n    # is none\n") == ["that is none"]
    assert riddles_in("Files are written whole or not\nat all, format is at restore") == []
