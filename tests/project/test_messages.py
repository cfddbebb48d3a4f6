"""Every error is one line that a person can read: at most 300 characters, however long the names and lists are."""

from __future__ import annotations

import ast
import pickle
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import ndob_fmu
from ndob_fmu.cosim import System, Variable, simulate
from ndob_fmu.errors import MESSAGE_LIMIT, NdobError, SimulationError, UsageError, nearest, one_of, some_of
from ndob_fmu.results.recording import Recording
from ndob_fmu.runtime.base_errors import IntegrationError
from tests.helpers.mock_components import Mock

ONE_TEXT = (" ", ",", ".")  # what puts the words of a text, the cells of a row or the parts of a name together
FILES = sorted(Path(ndob_fmu.__file__).parent.rglob("*.py"))


def subclasses(of):
    return [of, *(deeper for direct in of.__subclasses__() for deeper in subclasses(direct))]


@given(st.text(), st.text(), st.text(), st.text(), st.integers(1, 400))
def test_a_report_is_one_line_of_at_most_300_characters_that_says_all_it_has_to(
    where, expected, received, likely, times
):
    message = str(NdobError.report(where * times, expected=expected * times, received=received, likely=likely * times))
    assert len(message) <= MESSAGE_LIMIT
    assert len(message.splitlines()) <= 1
    assert ": expected " in message
    assert ", received " in message
    assert ("; likely cause: " in message) == bool(likely)


def test_a_short_text_stays_whole_beside_a_long_one():
    message = str(NdobError.report("plant.ssp", expected="x" * 9000, received="'the name'", likely="a misspelt name"))
    assert message.startswith("plant.ssp: expected xxx")
    assert message.endswith("xxx, received 'the name'; likely cause: a misspelt name")
    assert len(message) > MESSAGE_LIMIT - 3


@pytest.mark.parametrize("kind", [error for error in subclasses(NdobError) if error is not NdobError])
def test_every_error_is_bounded_also_where_a_place_is_put_in_front_and_survives_the_way_between_processes(kind):
    error = kind(f"study.toml: {kind.report('plant', expected='x' * 300, received='y')}\nmore")
    assert len(str(error)) == MESSAGE_LIMIT
    assert "\n" not in str(error)
    assert str(pickle.loads(pickle.dumps(error))) == str(error)


def test_the_runtime_s_errors_are_among_those_tested():
    assert {IntegrationError, SimulationError} <= set(subclasses(NdobError))


def test_no_error_lists_names_without_a_bound():
    """A list in a message goes through `one_of` or `some_of`, which say how many there are, and that there are none."""
    found = []
    for path in FILES:
        for function in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(function, ast.FunctionDef):
                methods = [node for node in ast.walk(function) if isinstance(node, ast.Attribute)]
                if any(node.attr == "report" for node in methods):
                    joins = [node for node in methods if node.attr == "join" and isinstance(node.value, ast.Constant)]
                    found += [f"{path.name}:{n.lineno}" for n in joins if n.value.value not in ONE_TEXT]
    assert found == []


def test_few_names_are_listed_many_are_counted_and_none_is_said():
    assert one_of("component", []) == "the name of a component, but there are no components"
    assert one_of("component", ["plant"]) == "the component plant"
    assert one_of("signal dictionary", ["a", "b"]) == "one of the signal dictionaries a, b"
    many = [f"parameter_{k}" for k in range(2000)]
    assert one_of("parameter", many, "parameter_1999x").startswith("one of the 2000 parameters, such as parameter_1999")
    assert one_of("parameter", many, "qqq").startswith("one of the 2000 parameters, such as parameter_0, ")
    assert some_of([]) == "none"
    assert some_of(["a", "b"]) == "a, b"
    assert some_of(["a" * 90, "b" * 90, "c"]) == f"{'a' * 90} and 2 more"
    assert len(some_of(["a" * 9000])) <= 100
    assert nearest("gian", ["gain", "u"]) == "did you mean 'gain'?"
    assert nearest("gian", []) == ""


def test_the_names_that_have_more_in_front_are_the_nearest_of_a_name():
    known = ["noisy_std", "angle_noise_std", "pressure_of_the_oil_noise_std", "u"]
    assert nearest("noise_std", known) == "did you mean 'angle_noise_std' or 'pressure_of_the_oil_noise_std'?"


def test_a_name_that_each_disturbance_has_is_nearest_with_these():
    known = ["disturbance_order", "disturbance_bound.wind", "disturbance_bound.slope"]
    assert nearest("disturbance_bound", known) == "did you mean 'disturbance_bound.wind' or 'disturbance_bound.slope'?"


LARGE = 3000


def large():
    names = [f"vehicle.axle_{k // 100}.wheel_{k}.contact_patch.slip_angle_measured" for k in range(LARGE)]
    variables = [Variable(name, "parameter") for name in names]
    return System({"car": Mock([], ["y"], output=lambda x, u: [0.0], parameters=variables)})


@pytest.mark.parametrize(
    ("name", "near"),
    [
        ("car.vehicle.axle_7.wheel_712.contact_patch.slip_angle_mesured", "axle_7.wheel_712.contact_patch"),
        ("vehicle.axle_7.wheel_712.contact_patch.slip_angle_mesured", "axle_7.wheel_712.contact_patch"),
    ],
)
def test_a_misspelt_name_among_thousands_gets_the_nearest_names_and_their_number(name, near):
    with pytest.raises(NdobError) as refused:
        simulate(large(), stop_time=1.0, step_size=1.0, start_values={name: 1.0})
    message = str(refused.value)
    assert len(message) <= MESSAGE_LIMIT
    assert f"one of the {LARGE + 1} variables" in message
    assert "did you mean" in message
    assert near in message.partition("did you mean")[2]


@pytest.mark.parametrize(
    ("attempt", "said"),
    [
        (
            lambda: System().port("plant.x"),
            "'plant.x': expected component.variable, with the name of a component, but there are no components, "
            "received a system without components",
        ),
        (
            lambda: System().component("plant"),
            "component plant: expected the name of a component, but there are no components, received 'plant'",
        ),
        (
            lambda: Recording(np.zeros(1), (), np.zeros((1, 0)))["e"],
            "recording: expected the name of a signal, but there are no signals, received 'e'",
        ),
        (
            lambda: System({"a": Mock()}).port("a.x"),
            "variable of a: expected the name of a variable, but there are no variables, received 'x'",
        ),
    ],
)
def test_a_list_without_names_is_a_whole_sentence(attempt, said):
    with pytest.raises((NdobError, UsageError)) as refused:
        attempt()
    assert str(refused.value) == said


def test_warnings_about_large_systems_are_short_lines(caplog):
    """A loop through many signals that has no solution, many inputs that nothing drives, and NaN at the end."""
    count = 60
    every = [f"signal_number_{k}_of_a_component" for k in range(count)]
    through = [
        Variable(f"{name}_out", "output", settable=False, dependencies=(name,), initial_dependencies=(name,))
        for name in every
    ]
    more = [f"{name}_that_nothing_drives" for name in every]

    def without_solution(x, u):
        return [float(u[every[0]] < 0.5), *(u[name] for name in every[1:])]

    part = Mock([*every, *more], through, output=without_solution)
    pairs = [(f"{every[k]}_out", every[(k + 1) % count]) for k in range(count)]
    system = System({"a": part}, tuple((("a", source), ("a", target)) for source, target in pairs))
    part.step = lambda time, step_size: part.__dict__.update(output=lambda x, u: [np.nan] * count)
    simulate(system, stop_time=1.0, step_size=1.0)
    said = [record.getMessage() for record in caplog.records]
    assert [
        words
        for words in ("do not settle", "nothing drives", "algebraic loop", "ends in NaN")
        if words not in " ".join(said)
    ] == []
    assert [text for text in said if len(text) > MESSAGE_LIMIT or "\n" in text] == []
