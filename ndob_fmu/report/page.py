"""The HTML page of a report, which is one file."""

from __future__ import annotations

import base64
from itertools import count
from pathlib import Path

import plotly.graph_objects as go
from jinja2 import Environment, PackageLoader, StrictUndefined
from plotly.offline import get_plotlyjs

from ndob_fmu.errors import UsageError
from ndob_fmu.report.content import Content
from ndob_fmu.report.run_page import run_content
from ndob_fmu.results.run_files import SYSTEM_PICTURE
from ndob_fmu.support.extras import extra
from ndob_fmu.support.files import atomic_path

_CONFIGURATION = {
    "displaylogo": False,
    "responsive": True,
    "toImageButtonOptions": {"format": "svg"},
    # Results must not go to a server by one click.
    "showSendToCloud": False,
    "plotlyServerURL": "",
}


def write_report(folder: str | Path, path: str | Path | None = None) -> Path:
    """Write the report of the run or study in ``folder`` to ``path``, by default report.html there; return its path.

    Raises UsageError if the folder has neither, or if a file in it cannot be read or the page not be written.
    """
    folder = Path(folder)
    page = Path(path) if path is not None else folder / "report.html"
    html = _render(_content(folder), _picture(folder))
    with atomic_path(page) as temporary:
        temporary.write_text(html, "utf-8")
    return page


def _content(folder: Path) -> Content:
    if (folder / "study.json").exists():
        with extra("study"):
            from ndob_fmu.report.study_page import study_content
        return study_content(folder)
    if (folder / "result.csv").exists():
        return run_content(folder)
    raise UsageError.report(
        str(folder),
        expected="a folder with result.csv (a run) or study.json (a study)",
        received="neither" if folder.is_dir() else "no folder",
        likely="`ndob-fmu demo`, `simulate --results DIR` and `sweep` make one",
    )


def _picture(folder: Path) -> str:
    """Return the picture of the system as a data URI: as an image it cannot run scripts or load anything."""
    path = folder / SYSTEM_PICTURE
    if not path.exists():
        return ""
    return "data:image/svg+xml;base64," + base64.b64encode(path.read_bytes()).decode()


def _render(content: Content, picture: str) -> str:
    environment = Environment(
        loader=PackageLoader("ndob_fmu.report", "."), autoescape=True, undefined=StrictUndefined, trim_blocks=True
    )
    number = count()
    first, *others = (
        (section.title, [(caption, _drawn(figure, next(number))) for caption, figure in section.figures])
        for section in (content.first, *content.sections)
    )
    return environment.get_template("page.html.jinja").render(
        content=content, picture=picture, first=first, others=others, plotly=get_plotlyjs()
    )


def _drawn(figure: go.Figure, number: int) -> str:
    text: str = figure.to_html(full_html=False, include_plotlyjs=False, div_id=f"plot-{number}", config=_CONFIGURATION)
    return text
