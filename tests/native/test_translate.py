"""The translator: the meaning of Python survives in C, and what has no translation is refused by file and line."""

from __future__ import annotations

import numpy as np
import pytest

from ndob_fmu.native.translate.print_c import translate
from ndob_fmu.runtime.base_errors import DesignError
from tests.helpers.translated import Library, difference
from tests.native import known_forms

_RANDOM = np.random.default_rng(3)
_TALL, _WIDE, _SQUARE = (
    _RANDOM.standard_normal((5, 3)),
    _RANDOM.standard_normal((2, 4)),
    _RANDOM.standard_normal((4, 4)),
)
_LOW_RANK = _RANDOM.standard_normal((5, 2)) @ _RANDOM.standard_normal((2, 4))
CASES = [
    ("stops_at_the_first_that_decides", -1.0, False),
    ("stops_at_the_first_that_decides", -1.0, True),
    ("stops_at_the_first_that_decides", 2.0, True),
    ("stops_at_the_first_that_holds", -1.0, True),
    ("stops_at_the_first_that_holds", -1.0, False),
    ("takes_one_branch", -1.0, True),
    ("takes_one_branch", -1.0, False),
    ("is_between", 1.0, 1.0, 2.0),
    ("is_between", 1.0, 2.0, 2.0),
    ("keeps_a_view", _TALL),
    ("carries_over_a_loop", _SQUARE, 5),
    ("collects", np.array([1.0, -2.0, 3.0, 4.0, 5.0, -6.0, 7.0])),
    *(("floor_and_rest", x, y) for x in (7, -7) for y in (3, -3)),
    ("largest_of", 1.0, 2.0),
    ("largest_of", 2.0, float("nan")),
    ("tries", -1.0),
    ("tries", 0.5),
    ("tries", 2.0),
    ("calls_inside", np.array([1.0, 2.0]), 0.5),
    *(
        (name, x)
        for name in ("singular_values", "made_again", "is_orthogonal", "inverse", "norms")
        for x in (_TALL, _WIDE, _LOW_RANK)
    ),
    ("of_symmetric", _SQUARE),
    ("solution", _TALL, _RANDOM.standard_normal(5)),
    ("solution", _LOW_RANK, _RANDOM.standard_normal((5, 2))),
    ("basis", _TALL),
    ("calls_a_value", 3.0),
    *(("place_of", name, ("angle", "rate")) for name in ("angle", "rate", "torque")),
    *((name, x) for name in ("is_one_of", "is_none_of") for x in (1, 2, 4)),
]


@pytest.fixture(scope="module")
def forms(tmp_path_factory):
    translation = translate(["tests.native.known_forms"], "translated")
    assert translation.refused == {}
    return Library(translation, tmp_path_factory.mktemp("forms"))


@pytest.mark.parametrize("case", CASES, ids=lambda case: case[0])
def test_a_form_means_in_c_what_it_means_in_python(forms, case):
    name, *arguments = case
    (definition,) = [one for one in forms.translation.definitions if one.node.name == name]
    try:
        expected = getattr(known_forms, name)(*arguments)
    except np.linalg.LinAlgError:
        with pytest.raises(np.linalg.LinAlgError):
            forms.call(definition, arguments)
        return
    scale = 1.0 if name == "is_orthogonal" else 0.0
    own = forms.call(definition, arguments)
    assert difference(np.add(expected, scale), np.add(own, scale)) <= 1e-14 * 30


def test_an_error_carries_the_text_of_the_one_that_it_follows_from(forms):
    (definition,) = [one for one in forms.translation.definitions if one.node.name == "says_why"]
    assert forms.call(definition, [2.0]) == 2.0
    with pytest.raises(DesignError):
        forms.call(definition, [-2.0])
    assert forms.arena.message.decode() == "no answer (-2 is below 0)"


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("yields", "refused_forms.py:13: expected"),
        (
            "calls_what_is_unknown",
            "refused_forms.py:17: expected a function that has a translation, received np.unique",
        ),
        ("changes_an_argument", "refused_forms.py:21: expected an entry of an array or list that this function made"),
        ("changes_a_type", "refused_forms.py:27: expected"),
        ("takes_any", "refused_forms.py:31: expected types that have a translation, received * or **"),
        ("steps_over", "refused_forms.py:36: expected a slice without a step"),
        ("catches_all", "refused_forms.py:40: expected except"),
    ],
)
def test_what_has_no_translation_is_refused_by_file_and_line(name, expected):
    refused = translate(["tests.native.refused_forms"], "translated").refused
    assert refused[f"tests.native.refused_forms.{name}"].startswith(expected)


def test_a_function_that_uses_a_refused_one_is_refused_with_its_name():
    refused = translate(["ndob_fmu.runtime.numerics.integrate"], "translated").refused
    assert all("expected" in why or " uses " in why for why in refused.values())
