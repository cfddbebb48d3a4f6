"""Fixtures for all tests: the FMUs of the paper's example, built once; and a rule for continuous integration."""

from __future__ import annotations

import os
import signal
import tempfile
from dataclasses import dataclass
from pathlib import Path

import pytest
from hypothesis import settings

from ndob_fmu import build, load_model
from ndob_fmu.cosim import parameter_sets
from ndob_fmu.fmu.components import build_components
from ndob_fmu.fmu.controller import build_controller
from ndob_fmu.packages import build_ssp
from ndob_fmu.support.shipped import shipped_folder

# A test of random cases without a number of its own has few in the suite, and many varying ones in `make soak`.
settings.register_profile("suite", max_examples=25, deadline=None, derandomize=True)
settings.register_profile("soak", max_examples=1000, deadline=None, print_blob=True)
settings.load_profile("suite")

STRICT = os.environ.get("CI", "").lower() == "true"


@dataclass(frozen=True)
class Built:
    """The artefacts of `make build`, in a folder of the session's own."""

    plant: Path
    observer: Path
    system: Path


@pytest.fixture
def nothing_left_behind(tmp_path, monkeypatch):
    """A test that uses this also shows that no temporary folder outlives it."""
    folder = tmp_path / "tmp"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    yield
    assert list(folder.iterdir()) == []


@pytest.fixture(autouse=True, scope="session")
def patient():
    """On a busy machine commands take long; tests/support/test_progress.py alone tests what they say then."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("ndob_fmu.cli.PATIENCE", 600.0)
        yield


@pytest.fixture(scope="session")
def flexible_joint(tmp_path_factory) -> Built:
    folder = tmp_path_factory.mktemp("flexible_joint")
    plant, observer = build(load_model("flexible_joint"), folder)
    return Built(plant, observer, build_ssp(shipped_folder("ssp") / "open_loop", folder, folder))


@pytest.fixture(scope="session")
def components(flexible_joint) -> dict[str, Path]:
    """Return the FMUs of the records by their names; they lie beside the plant and the observer."""
    return {path.stem: path for path in build_components(flexible_joint.plant.parent)}


@dataclass(frozen=True)
class Shipped:
    """All FMUs and systems of `make build`; sets: the parameter sets besides the nominal one."""

    fmus: Path
    systems: Path
    sets: frozenset[str]


@pytest.fixture(scope="session")
def shipped(flexible_joint, components) -> Shipped:
    fmus = flexible_joint.plant.parent  # where `components` lie as well
    systems = fmus / "systems"
    build_controller(load_model("flexible_joint"), fmus)
    sets = set()
    for path in shipped_folder("ssp").glob("*/SystemStructure.ssd"):
        for one in (None, *parameter_sets(path.parent)):
            build_ssp(path.parent, fmus, systems, parameter_set=one)
            sets.add(one)
    return Shipped(fmus, systems, frozenset(sets - {None}))


def _fail_if_skipped(report):
    # Under CI=true: a test that is skipped there would run nowhere.
    if STRICT and report.skipped and not hasattr(report, "wasxfail"):
        report.outcome = "failed"
        report.longrepr = f"skipped under CI=true, which counts as a failure: {report.longrepr}"
    return report


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport():
    return _fail_if_skipped((yield))


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report():
    return _fail_if_skipped((yield))


@pytest.fixture(autouse=True, scope="session")
def ctrl_c_interrupts():
    """A suite that a script starts in the background inherits an ignored Ctrl-C; tests that send it need Python's."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)
