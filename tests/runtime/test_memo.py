"""Designs are made once for all instances of the same parameters, and the memo of them stays small."""

from __future__ import annotations

import gc
import time
import weakref
from dataclasses import dataclass

import numpy as np
import pytest

from ndob_fmu.runtime.memo import SharedResults, by_value
from tests.helpers.fmi_instance import OK, unpacked

H = 1e-3


@dataclass(frozen=True)
class Part:
    matrix: np.ndarray
    factors: tuple[np.ndarray, float]


def part(last=1.0):
    return Part(np.array([[0.5, last]]), (np.zeros(2), 0.25))


def test_things_of_the_same_values_are_one_key_and_those_that_differ_in_a_bit_are_two():
    assert hash(by_value(part())) == hash(by_value(part()))
    assert by_value(part()) == by_value(part())
    others = [part(np.nextafter(1.0, 2.0)), part(-1.0), Part(np.array([0.5, 1.0]), part().factors)]
    assert len({by_value(each) for each in (part(), *others)}) == 4
    assert by_value((0.0,)) != by_value((-0.0,))


def test_a_result_is_computed_once_for_a_key_and_again_once_others_have_taken_its_place():
    made = []
    shared = SharedResults(2)

    def ask(key):
        return shared((key,), lambda: made.append(key) or len(made))

    assert [ask(key) for key in "aabab"] == [1, 1, 2, 1, 2]
    assert [ask(key) for key in "cab"] == [3, 4, 5]


def test_what_raises_is_asked_again():
    shared = SharedResults(2)
    for _ in range(2):
        with pytest.raises(ZeroDivisionError):
            shared((1,), lambda: 1 / 0)
    assert shared((1,), lambda: 5) == 5


def test_shared_arrays_cannot_be_written_and_nothing_else_is_kept():
    class Observer:
        pass

    shared, observer = SharedResults(2), Observer()
    kept = weakref.ref(observer)

    def compute(observer=observer):
        return part()

    value = shared((1,), compute)
    for array in (value.matrix, value.factors[0]):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 2.0
    del compute, observer
    gc.collect()
    assert kept() is None


@pytest.mark.parametrize("method", [1, 2])
def test_further_instances_of_the_same_parameters_take_a_fraction_of_the_first_ones_time(flexible_joint, method):
    with unpacked(flexible_joint.observer) as instance:
        instance()  # what the first one of a process imports
        costs = []
        for name in range(8):
            began = time.process_time()
            one = instance(str(name))
            one.begin(method=method, pi_end=1.25e8)  # not in the memo of another test
            assert one.doStep(0.0, H) == OK
            costs.append(time.process_time() - began)
        assert sum(costs[1:]) / 7 < 0.4 * costs[0]
