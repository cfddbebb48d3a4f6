"""The benchmarks run, and return the figures for their page."""

from __future__ import annotations

import pytest

from benchmarks.sweep_throughput import rows


def test_the_throughput_of_a_sweep_is_measured():
    found = list(rows(["study"], quick=True))
    assert [row.unit for row in found] == ["s", "runs/s"]
    assert found[0].measured * found[1].measured == pytest.approx(4)  # runs
