"""The documentation is built as it is published: every link leads somewhere, the notebook runs, the commands exist."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from html.parser import HTMLParser
from importlib import import_module
from pathlib import Path
from urllib.parse import unquote, urlsplit

import numpy as np
import pytest

from ndob_fmu.cli import command_parser
from ndob_fmu.runtime.numerics.integrate import RELATIVE_TOLERANCE
from ndob_fmu.runtime.numerics.riccati import RESIDUAL_TOLERANCE
from tests.helpers.clean_process import ENVIRONMENT

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PACKAGE = ROOT / "ndob_fmu"
PAGES = sorted(DOCS.glob("*.md"))


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """Build all pages; a warning, as of a link that leads nowhere or a cell that fails, is an error."""
    out = tmp_path_factory.mktemp("site")
    command = [
        sys.executable,
        "-m",
        "sphinx",
        "-W",
        "-n",
        "-q",
        "--keep-going",
        "-d",
        out / "doctrees",
        DOCS,
        out / "html",
    ]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return out / "html"


class _Page(HTMLParser):
    def __init__(self, path: Path) -> None:
        super().__init__()
        self.links: list[str] = []
        self.anchors = {"", "top"}
        self.feed(path.read_text("utf-8"))

    def handle_starttag(self, tag, attrs):
        found = dict(attrs)
        self.anchors |= {found[name] for name in ("id", "name") if found.get(name)}
        self.links += [found[name] for name in ("href", "src") if found.get(name)]


def test_every_page_is_built_and_every_link_within_leads_to_a_page_and_a_place_on_it(site):
    pages = {path: _Page(path) for path in site.glob("*.html")}
    assert {path.stem for path in PAGES} <= {path.stem for path in pages}
    checked = 0
    for path, page in pages.items():
        for link in page.links:
            parts = urlsplit(link)
            if parts.scheme or link.startswith("//"):
                continue
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            assert target.exists(), f"{path.name}: {link}"
            if target in pages and target.name not in ("search.html", "genindex.html"):
                assert unquote(parts.fragment) in pages[target].anchors, f"{path.name}: {link}"
            checked += 1
    assert checked > 200


def test_the_notebook_was_executed_and_shows_its_figure_and_numbers(site):
    html = (site / "main_job.html").read_text("utf-8")
    worst = re.search(r"largest error after 0\.5 s: (\S+) N·m", html)
    assert float(worst[1]) < 1e-4
    assert len(re.findall(r'<img[^>]*src="_images/[0-9a-f]+\.png"', html)) == 1
    assert "1.4162e+03" in html
    assert len(re.findall(r"step +\d+ ms: largest error", html)) == 4


def test_the_notebook_from_a_log_finds_noise_and_inertia_and_its_fmu_the_load(site):
    html = (site / "from_a_log.html").read_text("utf-8")
    for name, true in (("angle", 2.0 * np.pi / 2**16 / 12**0.5), ("rate", 0.02), ("inertia", 2e-3)):
        found, two_std = map(float, re.search(rf"{name}: (\S+) ± (\S+) ", html).groups())
        assert abs(found - true) < 1.5 * two_std < 0.2 * true
    rms = {key: float(mn) for key, mn in re.findall(r"(\w+, \w+)\.load\w*: RMS error (\S+) mN·m", html)}
    assert rms["fitted, smoother"] < rms["fitted, observer"] < 0.2 * rms["told, observer"]
    assert "fitted: the settings fit the log" in html
    assert float(re.search(r"largest error of the FMU after 0\.3 s: (\S+) mN·m", html)[1]) < 10.0


@pytest.mark.parametrize("path", sorted(DOCS.glob("*.ipynb")), ids=lambda path: path.stem)
def test_the_notebooks_lie_in_the_repository_without_outputs(path):
    assert '"output_type"' not in path.read_text("utf-8")


def test_the_reference_of_the_fmus_is_that_of_the_built_ones(shipped):
    sys.path.insert(0, str(DOCS))
    try:
        generator = import_module("fmu_reference")
    finally:
        sys.path.remove(str(DOCS))
    page = generator.page(sorted(shipped.fmus.glob("*.fmu")))
    assert page == generator.PAGE.read_text("utf-8"), "run `make docs`"


COMMANDS = [
    (path.name, line.replace("\\\n", " ").partition(" #")[0].strip())
    for path in [*PAGES, ROOT / "README.md"]
    for line in re.findall(r"^ {4}(ndob-fmu (?:.*\\\n)*.*)$", path.read_text("utf-8"), re.MULTILINE)
]


@pytest.mark.parametrize(("page", "line"), COMMANDS, ids=[f"{page}-{k}" for k, (page, _) in enumerate(COMMANDS)])
def test_every_command_in_the_documentation_is_one_that_the_program_takes(page, line):
    assert callable(command_parser().parse_args(shlex.split(line)[1:]).run)


def test_the_documentation_shows_every_command_of_the_program():
    assert {line.split()[1] for _, line in COMMANDS} == {
        "check",
        "design",
        "build",
        "estimate",
        "fit",
        "tune",
        "simulate",
        "sweep",
        "report",
        "demo",
    }


def test_the_tutorials_plant_and_coupling_run(tmp_path):
    blocks = re.findall(r"```python\n(.*?)```", (DOCS / "tutorial.md").read_text("utf-8"), re.DOTALL)
    (tmp_path / "pendulum.py").write_text(blocks[0], "utf-8")
    (tmp_path / "couple.py").write_text(blocks[1], "utf-8")
    environment = ENVIRONMENT | {"PYTHONPATH": str(ROOT), "PYTHONIOENCODING": "utf-8"}

    def run(*words):
        return subprocess.run(
            [sys.executable, *words], cwd=tmp_path, env=environment, capture_output=True, encoding="utf-8", check=True
        ).stdout

    run("-m", "ndob_fmu", "check", "pendulum.py")
    run("-m", "ndob_fmu", "build", "pendulum.py", "--out", "build/fmus")
    estimate, true = map(float, run("couple.py").split())
    assert estimate == pytest.approx(true, abs=0.02)


def test_the_functions_in_the_table_of_equations_exist():
    table = (DOCS / "theory.md").read_text("utf-8").split("\n## ")[0]
    named = re.findall(r"`([a-z_/]+)\.py: (\w+)`", table)
    assert len(named) >= 5
    for module, function in named:
        assert callable(getattr(import_module(f"ndob_fmu.{module.replace('/', '.')}"), function))


def test_the_files_that_the_pages_name_exist():
    """A path is meant from the repository's root or from the package."""
    pages = [*PAGES, ROOT / "README.md", ROOT / "CONTRIBUTING.md"]
    folders = {path.name for path in (*ROOT.iterdir(), *PACKAGE.iterdir()) if path.is_dir()} - {"build", "results"}
    named = {
        (page.name, path)
        for page in pages
        for path in re.findall(r"`([a-z_0-9/]+/[a-z_0-9]*(?:\.py|\.md|\.c|/)?)[`:]", page.read_text("utf-8"))
        if path.split("/")[0] in folders
    }
    assert len(named) >= 40
    assert [one for one in sorted(named) if not ((ROOT / one[1]).exists() or (PACKAGE / one[1]).exists())] == []


def test_the_tolerances_in_the_pages_are_those_of_the_code():
    theory = " ".join((DOCS / "theory.md").read_text("utf-8").split())
    plant = " ".join((ROOT / "fmus" / "FlexibleJointPlant" / "README.md").read_text("utf-8").split())
    assert f"relative residual in those states exceeds {_short(RESIDUAL_TOLERANCE)}" in theory
    assert f"Cash–Karp 5(4) with tolerance {_short(RELATIVE_TOLERANCE)}" in theory
    assert f"a relative tolerance of {_short(RELATIVE_TOLERANCE)}" in plant


def test_the_constants_of_method_2_in_the_theory_are_those_of_the_code():
    theory = " ".join((DOCS / "theory.md").read_text("utf-8").split())
    bank, fast, faulty, late, lag, noise, sensor, wrong, time = (
        import_module(f"ndob_fmu.runtime.step.{name}")
        for name in (
            "jump_bank",
            "converged_step",
            "faulty_samples",
            "delayed_outputs",
            "fixed_lag",
            "adaptive_noise",
            "sensor_memory",
            "reconsider",
            "time_update",
        )
    )
    tuned, model_error = (import_module(f"ndob_fmu.runtime.step.{name}") for name in ("tuned", "model_error"))
    at_sample, inside = bank._SHARES
    first = faulty._LEAST + faulty._TIMES * faulty.FIRST_RATE
    outliers = " or ".join((", ".join(f"α + {_short(v)} R" for v in faulty._OUTLIERS)).rsplit(", ", 1))
    said = [
        f"|e| > {faulty.SUSPICIOUS} √α",
        f"α replaced by e²/{faulty.SUSPICIOUS}²",
        f"λ₀ = {faulty._LEAST:g} + {faulty._TIMES:g} (λ + {faulty._BURST:g} b), at most {faulty._MOST:g}",
        f"about the last {sensor._OUTLIER_MEMORY:g} samples, {faulty.FIRST_RATE:g} before the first one",
        f"so that λ₀ begins as {first:g}",
        f"| repeats the sample before | {faulty._REPEATED:g}; as likely",
        f"normal, variance {outliers}",
        f"at least {_short(faulty._RAREST_REPEAT)}, if it repeats",
        f"the probability e⁻{str(-int(faulty._LOG_ODDS_AT_START)).translate(SUPERSCRIPT)}",
        f"at most {sensor._MOST_DEBT:g} nats",
        f"Beyond {wrong._HOPELESS:g} nats ({wrong._PATIENCE * wrong._HOPELESS:g} where",
        f"{wrong._NOISY:g} where e has both signs",
        f"e/√α exceeds {wrong._WRONG}, not the samples",
        f"is at most {sensor._FOLLOWS} times as large",
        f"the mean of e²/α over the last ten used samples exceeds {sensor._RULE:g}",
        f"if it was within {sensor._NEAR:g} √α",
        f"Beyond {wrong._LOST**2:g}-fold, P starts again",
        f"V = {bank._VARIANCE:g} D₀². p is the share",
        f"about the last {bank._RATE_MEMORY:g} samples, {bank.FIRST_RATE:g} before the first one",
        f"at least {bank._LEAST:.4f} and at most {bank._MOST:g}",
        f"the last {bank.LENGTH} steps: a jump at the sample ({at_sample / (at_sample + inside):.1g})",
        f"weight p (({bank._SURE:g} + Σ e²/α)/({bank._SURE:g} + Σ r²/s))^{{({bank._SURE:g} + n)/2}}",
        f"Student's distribution with {bank._SURE:g} degrees",
        f"exceed {bank._MENTIONED}, what is published",
        f"exceed {bank._CERTAIN}, and the likeliest",
        f"within {bank.LONG_AGO} samples",
        f"over about {noise._MEMORY:g} samples replaces",
        f"by ({noise._CLEAR:g} R/α)²",
        f"only while R is at least {sensor.MOST} α",
        f"that is no multiple of w, to {_short(noise._EQUAL)} of it",
        f"Where {noise._SEEN:g} changes told that w is the step",
        f"at most {noise._LONGEST_ROW - 1:g} of {noise._LONGEST_ROW:g}",
        f"{lag._KEPT} instants are kept over the `lag`",
        f"{late.PLACES} instants are kept; a delay of more than {late._KEPT} steps",
        f"by more than {time._STRAIGHT}/H, the step is taken in 2 to {time._MOST_PARTS} parts",
        f"at most {tuned._AS_GOOD}² times",
        f"at least {noise._SHOWN:g} samples of the noise",
        f"starts as {model_error._FIRST:g} of the root",
        f"more than {model_error._BEYOND:g} D₀ from its nominal value",
        f"rises {model_error._GROWTH:g}-fold with each sample",
        f"contradiction exceeds {model_error._LARGE:g}, by a half where",
        f"that exceeds {model_error._TOO_LARGE:g}; to {model_error._MOST:g} at most",
        f"contradiction is below {model_error._USUAL:g}. Below {model_error._LEAST:g} it is zero",
        f"within {100.0 * fast._CONVERGED:g} % of the converged ones",
        f"differs by more than {100.0 * fast._JITTER:g} %",
        f"between {fast._LEAST_SQUARES} and {fast._MOST_SQUARES:g}",
        f"for {sensor.LATE} times the longest usual interval",
    ]
    assert [phrase for phrase in said if phrase not in theory] == []


SUPERSCRIPT = str.maketrans("0123456789", "⁰¹²³⁴⁵⁶⁷⁸⁹")


def _short(number):
    return f"{number:.0e}".replace("e-0", "e-").replace("e+0", "e").replace("e+", "e")


def test_the_measures_and_entries_of_studies_are_all_documented():
    from ndob_fmu.study.measures import TAKES
    from ndob_fmu.study.study_file import _SECTIONS

    page = (DOCS / "studies.md").read_text("utf-8")
    assert [name for name in (*TAKES, *_SECTIONS) if not re.search(rf"`\[?{name}\]?`", page)] == []
