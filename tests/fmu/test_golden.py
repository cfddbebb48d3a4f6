"""The shipped references: made anew they are the same, and the observer's show what it is for."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from fmpy.util import read_csv

FMUS = Path(__file__).parents[2] / "fmus"


def reference(name, suffix="_ref"):
    return read_csv(FMUS / name / f"{name}{suffix}.csv")


def worst_error(suffix, start, stop):
    """Return the largest error of the load torque's estimate in a span of time."""
    true, found = reference("FlexibleJointPlant", suffix), reference("FlexibleJointObserver", suffix)
    span = (true["time"] > start) & (true["time"] < stop)
    return np.abs(found["load_torque_hat"] - true["load_torque_total"])[span].max()


@pytest.mark.parametrize(("start", "stop"), [(0.05, 6.0), (6.2, 10.0), (10.2, 16.0), (16.2, 20.0)])
def test_the_sampled_data_observer_finds_the_load_again_after_each_jump_and_knows_the_motors(start, stop):
    """At ten times the default step. The motor's torque jumps at 4, 8 and 12 s, the load's at 6, 10 and 16 s."""
    assert worst_error("_ref", start, stop) < 1e-4


def test_the_sampled_data_observer_follows_a_jump_of_the_load_between_two_rows_of_its_reference():
    """The load's torque falls by 1.5 N·m at 6 s. Five samples, without noise, lie between two rows.

    What is left comes from the instant of the jump, which is not certain; it is a tenth of the error bar.
    """
    found = reference("FlexibleJointObserver", "_ref")
    before, after = (found["load_torque_hat"][np.isclose(found["time"], time)][0] for time in (6.0, 6.05))
    assert before - after == pytest.approx(1.5, abs=1e-2)


def test_the_papers_observer_finds_its_constant_disturbance():
    """At ten times the default step, at which it is off by 3 % at most."""
    assert worst_error("_paper_ref", 12.0, 20.0) < 0.1
    plant, observer = (reference(f"FlexibleJoint{part}", "_paper_ref") for part in ("Plant", "Observer"))
    final = [plant[state][-1] - observer[f"{state}_hat"][-1] for state in ("link_angle", "motor_angle", "motor_rate")]
    assert np.linalg.norm(final) < 5e-3


def test_the_references_are_what_their_generator_writes(tmp_path):
    subprocess.run([sys.executable, FMUS / "tools" / "regenerate.py", tmp_path], check=True, capture_output=True)
    committed = sorted(path for ending in ("_ref.csv", "_in.csv", ".opt") for path in FMUS.glob(f"*/*{ending}"))
    assert [path.relative_to(FMUS) for path in committed] == sorted(
        (path.relative_to(tmp_path) for path in tmp_path.glob("*/*")), key=lambda path: committed.index(FMUS / path)
    )
    for path in committed:
        new = tmp_path / path.relative_to(FMUS)
        if path.suffix == ".opt":
            assert new.read_text() == path.read_text()
            continue
        old_table, new_table = read_csv(path), read_csv(new)
        assert old_table.dtype.names == new_table.dtype.names
        for name in old_table.dtype.names:
            # Not to the last bit: another machine's arithmetic unit may round the steps of the solver otherwise.
            # Without noise the consistency is a ratio of numbers that are small themselves.
            atol = 1e-5 if name == "consistency" else 1e-7
            np.testing.assert_allclose(new_table[name], old_table[name], rtol=0, atol=atol, err_msg=f"{path} {name}")


@pytest.mark.parametrize("path", sorted(FMUS.glob("FlexibleJoint*/*")), ids=lambda path: path.name)
def test_no_reference_file_is_large(path):
    assert path.stat().st_size < 300_000
