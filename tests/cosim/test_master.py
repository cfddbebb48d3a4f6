"""The fixed-step master, on components with exact answers."""

from __future__ import annotations

import io
import itertools
import os
import signal
import sys

import numpy as np
import pytest

from ndob_fmu.cosim import System, Variable, simulate
from ndob_fmu.errors import CouplingError, SimulationError, UsageError
from tests.helpers.mock_components import Mock, constant, gain, integrator, ramp

SCHEMES = ["jacobi", "gauss-seidel", "extrapolation"]


def chain(*names):
    """Connections y → u along the names."""
    return tuple(((a, "y"), (b, "u")) for a, b in itertools.pairwise(names))


def oscillator(scheme, step_size, observed=()):
    """x'' = -x from (1, 0) as two integrators in a loop, x' = v and v' = -x."""
    minus = Mock(["u"], ["y"], output=lambda x, u: [x], step=lambda x, u, t, h: x - h * u["u"], x=0.0)
    system = System({"x": integrator(1.0), "v": minus}, (*chain("x", "v"), *chain("v", "x")))
    return simulate(system, stop_time=2.0, step_size=step_size, scheme=scheme)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_an_integrator_driven_by_a_constant_is_exact_at_every_point(scheme):
    system = System({"source": constant(3.0), "sum": integrator(1.0)}, chain("source", "sum"))
    recording = simulate(system, start_time=0.5, stop_time=2.0, step_size=0.25, scheme=scheme)
    assert recording.names == ("source.y", "sum.y")
    assert recording.columns.shape == (7, 2)
    np.testing.assert_array_equal(recording.time, [0.5, 0.75, 1.0, 1.25, 1.5, 1.75, 2.0])
    np.testing.assert_array_equal(recording["sum.y"], 1.0 + 3.0 * (recording.time - 0.5))


def test_jacobi_delays_every_pass_through_by_one_step_and_gauss_seidel_does_not():
    parts = ("clock", "first", "second")

    def run(scheme):
        system = System(dict(zip(parts, [ramp(), gain(), gain()], strict=True)), chain(*parts))
        return simulate(system, stop_time=1.0, step_size=0.25, scheme=scheme)

    jacobi, gauss_seidel = run("jacobi"), run("gauss-seidel")
    np.testing.assert_array_equal(jacobi["clock.y"], [0, 0.25, 0.5, 0.75, 1])
    np.testing.assert_array_equal(jacobi["first.y"], [0, 0, 0.25, 0.5, 0.75])
    np.testing.assert_array_equal(jacobi["second.y"], [0, 0, 0, 0.25, 0.5])
    for part in parts:
        np.testing.assert_array_equal(gauss_seidel[f"{part}.y"], gauss_seidel.time)


def test_gauss_seidel_goes_through_the_components_in_the_order_of_the_system():
    system = System({"second": gain(), "clock": ramp()}, chain("clock", "second"))
    recording = simulate(system, stop_time=1.0, step_size=0.25, scheme="gauss-seidel")
    np.testing.assert_array_equal(recording["second.y"], [0, 0, 0.25, 0.5, 0.75])


def test_outputs_at_the_start_are_right_along_a_chain_listed_backwards():
    parts = {"d": gain(2.0), "c": gain(3.0), "b": gain(5.0), "a": constant(7.0)}
    recording = simulate(System(parts, chain("a", "b", "c", "d")), stop_time=1.0, step_size=0.5)
    np.testing.assert_array_equal(recording.columns[0], [210, 105, 35, 7])
    np.testing.assert_array_equal(recording["d.y"], [210, 210, 210])


def test_a_signal_that_passes_twice_through_one_component_is_right_at_the_start():
    double = Mock(["a", "b"], ["p", "q", "r"], output=lambda x, u: [1.0, 2 * u["a"], 3 * u["b"]])
    connections = ((("double", "p"), ("one", "u")), (("one", "y"), ("double", "a")))
    connections += ((("double", "q"), ("two", "u")), (("two", "y"), ("double", "b")))
    system = System({"two": gain(), "one": gain(), "double": double}, connections)
    recording = simulate(system, stop_time=1.0, step_size=1.0)
    assert recording["double.r"][0] == 6.0


def test_an_input_file_that_shows_in_an_output_at_once_is_no_algebraic_loop(tmp_path, caplog):
    path = tmp_path / "in.csv"
    path.write_text('"time","gain.u"\n0.0,3.0\n')
    gain = Mock(["u"], ["y"], output=lambda x, u: [2.0 * u["u"]])
    recording = simulate(System({"gain": gain}), input_file=path, stop_time=0.2, step_size=0.1)
    assert recording["gain.y"][0] == 6.0
    assert caplog.text == ""


def test_time_is_counted_so_that_a_million_small_steps_end_exactly_where_asked():
    part = ramp()
    recording = simulate(System({"clock": part}), stop_time=20.0, step_size=1e-3, output_interval=2.5)
    np.testing.assert_array_equal(recording.time, [0, 2.5, 5, 7.5, 10, 12.5, 15, 17.5, 20])
    assert part.times == [(k * 1e-3, 1e-3) for k in range(20000)]


def test_the_output_interval_thins_the_rows_but_not_the_steps():
    fine = oscillator("jacobi", 0.125)
    system = System({"x": integrator(1.0), "source": constant(1.0)}, chain("source", "x"))
    every, third = (simulate(system, stop_time=2.0, step_size=0.125, output_interval=h) for h in (None, 0.375))
    assert len(fine.time) == 17
    np.testing.assert_array_equal(third.time, every.time[::3])
    np.testing.assert_array_equal(third.columns, every.columns[::3])


@pytest.mark.parametrize(
    ("times", "parts"),
    [
        ({"step_size": 0.0}, ["step size", "positive", "0.0"]),
        ({"step_size": -0.1}, ["step size", "positive", "-0.1"]),
        ({"step_size": float("nan")}, ["step size", "finite", "nan"]),
        ({"stop_time": float("inf")}, ["stop time", "finite", "inf"]),
        ({"stop_time": 0.0}, ["stop time", "after the start", "0.0 s"]),
        ({"stop_time": 1.05}, ["whole number of steps of 0.1 s", "10.5 steps"]),
        ({"step_size": 3.0}, ["whole number of steps of 3.0 s", "nearest that fits is 3 s"]),
        ({"output_interval": 0.25}, ["output interval", "whole number of steps", "2.5 steps"]),
        ({"output_interval": 0.05}, ["output interval", "whole number of steps", "nearest that fits is 0.1 s"]),
        ({"output_interval": -0.1}, ["output interval", "positive"]),
        ({"output_interval": 2.0}, ["output interval", "at most 1.0 s"]),
        ({"step_size": 1e-300}, ["fits in memory", "step size"]),
        ({"step_size": 1e-15}, ["fits in memory", "step size"]),
        ({"scheme": "seidel"}, ["scheme", "one of the schemes jacobi, gauss-seidel, extrapolation", "'seidel'"]),
        ({"order": ["a"]}, ["order", "the scheme gauss-seidel", "'jacobi'"]),
        ({"scheme": "gauss-seidel", "order": []}, ["order", "each of the components a once", "none"]),
        ({"scheme": "gauss-seidel", "order": ["a", "a"]}, ["order", "each of the components a once", "a, a"]),
        ({"stop_time": None}, ["stop time", "received none"]),
        ({"step_size": None}, ["step size", "received none"]),
    ],
)
def test_times_that_cannot_be_used_are_refused_in_one_line_before_anything_runs(times, parts):
    part = constant(1.0)
    with pytest.raises(UsageError) as refused:
        simulate(System({"a": part}), **({"stop_time": 1.0, "step_size": 0.1} | times))
    assert all(text in str(refused.value) for text in parts), str(refused.value)
    assert "\n" not in str(refused.value)
    assert part.calls == []


def test_a_stop_time_within_rounding_of_a_whole_number_of_steps_is_accepted():
    assert len(simulate(System({"a": ramp()}), stop_time=0.1 + 0.2, step_size=0.1).time) == 4
    assert len(simulate(System({"a": ramp()}), start_time=1e3, stop_time=1e3 + 0.3, step_size=0.1).time) == 4


def test_calls_come_in_the_order_that_the_interface_states():
    part = integrator()
    system = System({"a": part, "one": constant(1.0)}, chain("one", "a"))
    simulate(system, stop_time=0.2, step_size=0.1)
    step = ["set_inputs", "step", "get_outputs"]
    exchange = ["set_inputs", "get_outputs"]
    assert part.calls == ["setup", "get_outputs", *exchange, "initialize", "get_outputs", *step, *step, "close"]
    assert part.times == [(0.0, 0.1), (0.1, 0.1)]


class BrokenError(Exception):
    pass


def failing(call, error=BrokenError, at=0.0):
    def on(name, time):
        if name == call and not time < at:
            raise error

    return on


@pytest.mark.parametrize("call", ["setup", "set_inputs", "get_outputs", "initialize", "step"])
@pytest.mark.parametrize("error", [BrokenError, KeyboardInterrupt])
def test_every_component_is_released_when_the_second_fails_anywhere(call, error):
    first, second, third = constant(1.0), integrator(on=failing(call, error)), gain()
    system = System({"first": first, "second": second, "third": third}, chain("first", "second", "third"))
    with pytest.raises(error):
        simulate(system, stop_time=1.0, step_size=0.5)
    for part in (first, second, third):
        assert part.calls.count("close") == part.calls.count("setup")
    assert first.calls[-1] == second.calls[-1] == "close"
    assert bool(third.calls) == (call != "setup")


def test_a_release_that_fails_does_not_keep_the_others_from_theirs():
    first, second = constant(1.0), integrator(on=failing("close"))
    with pytest.raises(BrokenError):
        simulate(System({"a": first, "b": second}, chain("a", "b")), stop_time=1.0, step_size=0.5)
    assert first.calls[-1] == "close"


def test_ctrl_c_waits_for_the_end_of_a_step_so_that_no_component_can_swallow_it():
    def swallow(x, u, t, h):
        try:
            os.kill(os.getpid(), signal.SIGINT)
        except KeyboardInterrupt:
            raise SimulationError("the interrupt looked like a failed step") from None
        return t + h

    part = Mock([], ["y"], output=lambda x, u: [x], step=swallow, x=0.0)
    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt):
        simulate(System({"a": part}), stop_time=1.0, step_size=0.25)
    assert part.times == [(0.0, 0.25)]
    assert part.calls[-1] == "close"
    assert signal.getsignal(signal.SIGINT) is before


def test_a_second_ctrl_c_ends_a_step_that_does_not_end():
    def stuck(x, u, t, h):
        os.kill(os.getpid(), signal.SIGINT)
        os.kill(os.getpid(), signal.SIGINT)
        raise AssertionError("went on after the second interrupt")

    part = Mock([], ["y"], output=lambda x, u: [x], step=stuck, x=0.0)
    with pytest.raises(KeyboardInterrupt):
        simulate(System({"a": part}), stop_time=1.0, step_size=0.25)


def test_the_same_system_can_run_twice_with_the_same_result():
    system = System({"source": constant(3.0), "sum": integrator(1.0)}, chain("source", "sum"))
    first, second = (simulate(system, stop_time=1.0, step_size=0.125) for _ in range(2))
    np.testing.assert_array_equal(first.columns, second.columns)


def test_a_run_that_ends_in_nan_says_which_signal_was_the_first_and_when(caplog):
    def run(*lost):
        """Run clocks that are NaN from one time to another, and return what is said."""
        parts = {"d": constant(np.inf)}
        for name, (begin, end) in zip("abc", lost, strict=False):
            parts[name] = ramp()
            parts[name].output = lambda x, u, b=begin, e=end: [np.nan if b <= x < e else x]
        caplog.clear()
        simulate(System(parts), stop_time=1.0, step_size=0.25)
        return [record.getMessage().removeprefix("the run ends in NaN: ") for record in caplog.records]

    assert run((0.25, 0.75)) == []  # samples that were lost on the way
    lost = run((0.75, 9), (0.5, 9), (0.0, 0.5))
    assert lost == ["b.y is the first, from t = 0.5 s on; 2 of 4 signals are NaN at the end"]
    assert run((0.0, 9)) == ["a.y is the first, from t = 0 s on; 1 of 2 signals are NaN at the end"]
    assert run((1.0, 9)) == ["a.y is the first, from t = 1 s on; 1 of 2 signals are NaN at the end"]


def test_integers_and_booleans_keep_their_type_in_the_recording():
    outputs = [
        Variable("n", "output", "Integer"),
        Variable("ok", "output", "Boolean"),
        Variable("s", "output", "String"),
    ]
    part = Mock([], outputs, output=lambda x, u: [x, x > 0], step=lambda x, u, t, h: x + 1, x=0)
    recording = simulate(System({"a": part}), stop_time=1.0, step_size=0.5)
    assert recording.names == ("a.n", "a.ok")
    assert recording["a.n"].dtype == np.int64
    assert recording["a.ok"].tolist() == [False, True, True]


class Terminal(io.StringIO):
    def isatty(self):
        return True


@pytest.mark.parametrize(
    ("stream", "progress", "quiet", "shown"),
    [
        (Terminal, None, 0.0, True),
        (io.StringIO, None, 0.0, False),
        (io.StringIO, True, 0.0, True),
        (Terminal, False, 0.0, False),
        (Terminal, None, None, False),
    ],
)
def test_a_progress_bar_shows_on_terminals_or_on_request_and_only_for_long_runs(
    monkeypatch, stream, progress, quiet, shown
):
    if quiet is not None:
        monkeypatch.setattr("ndob_fmu.cosim.master.fixed_step.QUIET_SECONDS", quiet)
    monkeypatch.setattr(sys, "stderr", stream())
    simulate(System({"a": ramp()}), stop_time=1.0, step_size=0.01, progress=progress)
    assert ("step" in sys.stderr.getvalue()) == shown


def write(path, header, *rows):
    path.write_text("\n".join([header, *rows]) + "\n")
    return path


def test_an_input_file_is_held_from_row_to_row_and_the_last_of_equal_times_counts(tmp_path):
    rows = ["0,1,-1", "0.3,2,-2", "0.5,3,-3", "0.5,4,-4", "2,5,-5"]
    file = write(tmp_path / "u.csv", '"time","a.u","b.u"', *rows)
    a, b = integrator(), gain()
    simulate(System({"a": a, "b": b}), stop_time=1.0, step_size=0.1, input_file=file)
    assert [u["u"] for u in a.received] == [1, 1, 1, 2, 2, 4, 4, 4, 4, 4]
    assert [u["u"] for u in b.received] == [-1, -1, -1, -2, -2, -4, -4, -4, -4, -4]


def test_an_input_file_is_there_during_initialization_and_starts_with_the_row_before_the_start(tmp_path):
    file = write(tmp_path / "u.csv", '"time","b.u"', "-1,7", "0,8", "5,9")
    recording = simulate(System({"b": gain(2.0)}), start_time=1, stop_time=2.0, step_size=0.5, input_file=file)
    np.testing.assert_array_equal(recording["b.y"], [16, 16, 16])


def test_a_lost_sample_in_the_input_file_reaches_the_component_as_nan(tmp_path):
    file = write(tmp_path / "u.csv", '"time","b.u"', "0,nan", "1,2")
    recording = simulate(System({"b": gain()}), stop_time=2.0, step_size=1.0, input_file=file)
    np.testing.assert_array_equal(recording["b.y"], [np.nan, np.nan, 2.0])


@pytest.mark.parametrize(
    ("header", "rows", "error", "parts"),
    [
        ('"time","a.u","a.y"', ["0,1,1"], CouplingError, ["column a.y", "numeric or Boolean input", "output"]),
        ('"time","a.uu"', ["0,1"], CouplingError, ["variable of a", "did you mean 'u'?"]),
        ('"time","a.u","a.u"', ["0,1,1"], UsageError, ["different names"]),
        ('"time","a.u"', ["0.5,1"], UsageError, ["row at or before the start, 0 s", "0.5 s"]),
        ('"time","a.u"', ["0,1", "1,2", "0.5,3"], UsageError, ["do not decrease"]),
        ('"time","a.u"', ["nan,1"], UsageError, ["finite times"]),
        ('"a.u","time"', ["1,0"], UsageError, ['the first of them "time"']),
        ('"time";"a.u"', ["0;1"], UsageError, ["another separator than the comma"]),
        ('"time","a.u"', ["0,one"], UsageError, ["numbers separated by commas", "one"]),
        ('"time","a.u"', ["0,1,2"], UsageError, ["rows of 2 values", "1 rows of 3 values"]),
        ('"time","a.u"', [], UsageError, ["rows of 2 values", "0 rows"]),
        ('"time","a.u","a.on"', ["0,1,2"], CouplingError, ["column a.on", "true, false, 1 or 0 (Boolean)", "2.0"]),
        ('"time","a.u","a.n"', ["0,1,0.5"], CouplingError, ["column a.n", "whole numbers (Integer)", "0.5"]),
    ],
)
def test_an_input_file_that_cannot_be_used_says_why_and_where(tmp_path, header, rows, error, parts):
    typed = [Variable("u", "input"), Variable("on", "input", "Boolean"), Variable("n", "input", "Integer")]
    part = Mock(typed, ["y"], output=lambda x, u: [0])
    system = System({"a": part}, start_values={("a", "on"): False, ("a", "n"): 0})
    file = write(tmp_path / "u.csv", header, *rows)
    with pytest.raises(error) as refused:
        simulate(system, stop_time=1.0, step_size=0.5, input_file=file)
    assert all(text in str(refused.value) for text in parts), str(refused.value)
    assert part.calls == []


def test_true_and_false_in_an_input_file_are_booleans_however_they_are_written(tmp_path):
    written = ["true", "FALSE", "True", "0", "1", "false"]
    rows = [f"{k},{word},{k}.5e0" for k, word in enumerate(written)]
    file = write(tmp_path / "u.csv", '"time","a.on","a.u"', *rows)
    part = Mock([Variable("on", "input", "Boolean"), Variable("u", "input")], ["y"], output=lambda x, u: [u["on"]])
    simulate(System({"a": part}), stop_time=6.0, step_size=1.0, input_file=file)
    assert [u["on"] for u in part.received] == [1, 0, 1, 0, 1, 0]
    assert [u["u"] for u in part.received] == [0.5, 1.5, 2.5, 3.5, 4.5, 5.5]


def test_two_columns_for_one_input_are_refused(tmp_path):
    system = System({"a": gain()}).expose("level", "a.u")
    file = write(tmp_path / "u.csv", '"time","a.u","level"', "0,1,2")
    with pytest.raises(CouplingError, match=r"input a\.u: .* received the columns a\.u and level"):
        simulate(system, stop_time=1.0, step_size=1.0, input_file=file)


def test_a_missing_input_file_is_named(tmp_path):
    with pytest.raises(UsageError, match=r"absent\.csv: expected a readable CSV file"):
        simulate(System({"a": gain()}), stop_time=1.0, step_size=0.5, input_file=tmp_path / "absent.csv")
