"""What the benchmarks share: how a figure gets onto the page that `benchmarks.performance` writes."""

from __future__ import annotations

import pytest

from benchmarks.figures import Section


@pytest.fixture
def section(benchmark):
    """Return a function that puts a section of the page beside what pytest-benchmark keeps of this benchmark."""

    def keep(section: Section) -> None:
        benchmark.extra_info["section"] = section.as_dict()

    return keep
