"""Numbers in messages of native FMUs are written as Python writes them, without printf."""

from __future__ import annotations

import ctypes
import struct
import subprocess

import numpy as np
import pytest

from ndob_fmu.native.runtime_code import ARRAY_FILES
from tests.helpers.translated import FLAGS, SOURCES, compiler

EDGES = [
    0.0,
    -0.0,
    0.5,
    1.5,
    2.5,
    0.05,
    9.5,
    99.5,
    0.1,
    1e15,
    1e16,
    123456.5,
    999999.5,
    9.9999995,
    1e-4,
    1e-5,
    2.0**-1022,
]
EDGES += [5e-324, 1.5e-323, 2.0**-1021, 1.7976931348623157e308, 2.0**53, 2.0**89, 9007199254740993.0, 1e22, 1e23, 5e-5]
EDGES += [float("inf"), float("-inf"), float("nan")]


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    target = tmp_path_factory.mktemp("text") / "text.so"
    command = [compiler(), *FLAGS, "-shared", "-fPIC", f"-I{SOURCES}", *map(str, ARRAY_FILES), "-lm", "-o", str(target)]
    subprocess.run(command, check=True)
    return ctypes.CDLL(str(target))


def numbers() -> list[float]:
    rng = np.random.default_rng(5)
    any_bits = [struct.unpack("<d", rng.bytes(8))[0] for _ in range(1500)]
    usual = (rng.normal(size=1500) * 10.0 ** rng.integers(-9, 9, 1500)).tolist()
    short = [round(value, int(digits)) for value, digits in zip(usual, rng.integers(0, 6, 1500), strict=True)]
    powers = [2.0**k for k in range(-1074, 1024, 7)]
    return [*EDGES, *any_bits, *usual, *short, *powers]


def test_the_fewest_digits_that_give_a_number_back_are_those_of_repr(library):
    text = ctypes.create_string_buffer(64)
    found = {}
    for number in numbers():
        library.nd_shortest(text, ctypes.c_size_t(64), ctypes.c_double(number))
        found[repr(number)] = text.value.decode()
    assert {expected: written for expected, written in found.items() if written != expected} == {}


@pytest.mark.parametrize(
    "form", ["%g", "%.3g", "%.17g", "%.1g", "%+.6g", "%.1e", "%.6e", "%.0e", "%.0f", "%.1f", "%.3f"]
)
def test_a_number_in_a_format_is_written_as_python_does(library, form):
    text = ctypes.create_string_buffer(400)
    wrong = {}
    for number in numbers():
        library.nd_print(text, ctypes.c_size_t(400), form.encode(), ctypes.c_double(number))
        if text.value.decode() != form % number:
            wrong[form % number] = text.value.decode()
    assert wrong == {}


def test_texts_and_integers_stand_in_a_message_that_is_cut_where_its_room_ends(library):
    text = ctypes.create_string_buffer(b"x" * 32)
    given = (ctypes.c_char_p(b"mass"), ctypes.c_int(-2147483648), ctypes.c_char_p(b"abcdef"))
    library.nd_print(text, ctypes.c_size_t(28), b"%s: %d %.3s 100 %%", *given)
    assert text.value == b"mass: -2147483648 abc 100 %"
    library.nd_print(text, ctypes.c_size_t(9), b"%s: %d %.3s 100 %%", *given)
    assert text.value == b"mass: -2"
