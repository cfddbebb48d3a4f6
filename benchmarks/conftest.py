"""A fixture for all benchmarks: it puts their figures onto the page that `benchmarks.performance` writes."""

from __future__ import annotations

import pytest

from benchmarks.figures import Section


@pytest.fixture
def section(benchmark):
    """Return a function that adds a section of the page to the data of pytest-benchmark."""

    def keep(section: Section) -> None:
        benchmark.extra_info["section"] = section.as_dict()

    return keep
