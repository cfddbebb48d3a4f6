"""Tools that import the FMUs get the trajectories that our own master gets: importer_runs.py."""

from __future__ import annotations

import numpy as np
import pytest

from tests.helpers.fmi_instance import unpacked
from tests.helpers.native_host import compile_host
from tests.helpers.needs import ECOS, FRONT
from tests.importers.importer_runs import RUNS, TOLERANCE, Bench, difference
from tests.importers.tools_page import BEGIN, END, PAGE, VERSIONS, all_runs

pytestmark = FRONT


@pytest.fixture(scope="module")
def bench(flexible_joint, tmp_path_factory):
    folder = tmp_path_factory.mktemp("importers")
    return Bench(
        flexible_joint.plant, flexible_joint.observer, flexible_joint.system, compile_host(folder), folder, at_most=1000
    )


@pytest.mark.parametrize(
    ("tool", "study"),
    [
        pytest.param(tool, study, marks=ECOS if tool.startswith("ecos") else ())
        for study, tools in RUNS.items()
        for tool in tools
    ],
)
def test_a_tool_gets_the_trajectories_of_our_master(bench, tool, study):
    assert bench.difference(tool, study) <= TOLERANCE


def test_a_trajectory_that_is_late_or_slightly_wrong_is_found():
    t = np.arange(11) * 1e-3
    rows = np.column_stack([t, 3.0 + t, 1e-3 * t])
    assert difference(rows, rows) == 0.0
    assert difference(rows[1:], rows) == np.inf
    for column, wrong, found in ((0, 1e-3, np.inf), (1, 1e-8, 1e-8), (2, 1e-14, 1e-9)):  # a signal of size 1e-5 last
        moved = rows.copy()
        moved[:, column] += wrong
        assert difference(moved, rows) == pytest.approx(found, rel=1e-2)


def test_steps_that_differ_by_the_rounding_of_times_give_the_bits_of_equal_steps(flexible_joint):
    """A high gain would show the differences of such steps, and a design for each of them would take its time."""
    with unpacked(flexible_joint.observer) as instance:
        counted, rounded, varied = instance("counted"), instance("rounded"), instance("varied")
        for one in (counted, rounded, varied):
            one.begin(start_time=7.0, motor_angle_noise_std=1e-6, link_angle_noise_std=1e-6)
        sizes, steps = set(), []
        for k in range(50):
            t, H, y = 7.0 + k * 1e-3, (7.0 + (k + 1) * 1e-3) - (7.0 + k * 1e-3), 1.0 + 0.01 * k
            sizes.add(H)
            H_other = H * (1.0 + 1e-6 * (k % 2))
            samples = {"motor_angle": y, "link_angle": y}
            now = [
                one.step(t, size, **samples) for one, size in ((counted, 7.001 - 7.0), (rounded, H), (varied, H_other))
            ]
            steps.append([tuple(outputs.values()) for outputs in now])
    assert len(sizes) > 1
    assert all(a == b for a, b, _ in steps)
    assert any(a != c for a, _, c in steps)


def test_the_page_has_a_row_for_each_tool_and_no_cell_that_fails():
    written = PAGE.read_text("utf-8").partition(BEGIN)[2].partition(END)[0]
    head, _, *rows = ([cell.strip() for cell in line.split("|")[1:-1]] for line in written.splitlines() if "|" in line)
    assert head == ["Tool", *RUNS]
    assert len(rows) == len(VERSIONS)
    for tool, row in zip(VERSIONS, rows, strict=True):
        assert row[0].startswith(tool)
        assert [cell != "–" for cell in row[1:]] == [tool in tools for tools in all_runs().values()]
        assert all(float(cell) <= TOLERANCE for cell in row[1:] if cell != "–")
    assert written.count("0 findings") == 2
