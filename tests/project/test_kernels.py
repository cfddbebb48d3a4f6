"""Written digits are the same on every processor, and the suite runs other kernels."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

from ndob_fmu.analysis.controller_design import design_controller
from ndob_fmu.support.digits import certain_digits
from tests.helpers.problems import MODELS
from tests.kernels import AGREE_TO, KERNELS, digest, environment, largest_difference, running, verdict


def test_computed_numbers_are_written_to_nine_digits_and_rounding_errors_of_zeros_as_zero():
    computed = np.array([[-163.99999999998778, 0.40981333335756], [1.5e-14, 2.5e-10]])
    assert certain_digits(computed).tolist() == [[-164.0, 0.409813333], [0.0, 2.5e-10]]


@pytest.mark.parametrize("name", MODELS)
def test_gains_of_a_controller_that_differ_in_their_last_digits_are_the_same_default(name):
    gain = np.array(design_controller(MODELS[name]).feedback.gain)
    random = np.random.default_rng(0)
    elsewhere = gain * (1.0 + 1e-13 * random.normal(size=gain.shape)) + 1e-15 * random.normal(size=gain.shape)
    np.testing.assert_array_equal(certain_digits(elsewhere), gain)


@pytest.mark.skipif(not running(), reason="NumPy has no OpenBLAS whose kernels could be chosen")
def test_a_kernel_that_is_asked_for_is_the_one_that_runs():
    program = "from tests.kernels import running; print(running())"
    done = subprocess.run(
        [sys.executable, "-c", program], env=environment("Prescott"), capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() in KERNELS["Prescott"]


def test_the_kernels_fail_together_where_one_fails_or_builds_other_bytes(capsys):
    assert verdict([(0, "a"), (0, "a"), (0, "")]) == 0
    assert verdict([(0, "a"), (1, "a")]) == 1
    assert capsys.readouterr().out == ""
    assert verdict([(0, "a"), (0, "b")]) == 1
    assert "expected the same bytes" in capsys.readouterr().out


def test_a_number_of_one_kernel_that_differs_is_found_with_its_name():
    first = {"tuning": np.array([1.0, 2.0]), "steps": np.array([0.5])}
    assert largest_difference([first, first])[0] == 0.0
    difference, where = largest_difference([first, first, {**first, "steps": np.array([0.5 + 1e-6])}])
    assert difference == pytest.approx(1e-6)
    assert where == "steps"
    assert not largest_difference([first, {**first, "steps": np.array([np.nan])}])[0] <= AGREE_TO


def test_a_byte_or_a_name_changes_the_digest_of_a_folder(tmp_path):
    (tmp_path / "a").write_bytes(b"1")
    first = digest(tmp_path)
    (tmp_path / "a").write_bytes(b"2")
    second = digest(tmp_path)
    (tmp_path / "a").rename(tmp_path / "b")
    assert len({first, second, digest(tmp_path)}) == 3
