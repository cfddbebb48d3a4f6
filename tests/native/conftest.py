"""What all tests of translated code share: the translation, its library, and calls of the twins in Python."""

from __future__ import annotations

import platform

import pytest

from ndob_fmu.native.translate.print_c import translate
from tests.helpers.translated import Library, Recorder, forget_results
from tests.native.runs import RUNS
from tests.native.scope import MODULES, WRAPPERS

# These compare binaries for ARM, in an emulator, with those for x86-64.
collect_ignore = [] if platform.machine() == "x86_64" else ["test_c_host.py"]


@pytest.fixture(scope="session")
def translation():
    return translate(MODULES, "translated", leave_out=WRAPPERS)


@pytest.fixture(scope="session")
def library(translation, tmp_path_factory):
    return Library(translation, tmp_path_factory.mktemp("translated"))


@pytest.fixture(scope="session")
def recorded(translation):
    forget_results(translation.definitions)
    recorder = Recorder(translation.definitions)
    for run in RUNS:
        with recorder.running():
            run()
    return recorder.calls
