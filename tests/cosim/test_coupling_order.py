"""How accurate each coupling scheme is, what components of other rates see, and which loops are found."""

from __future__ import annotations

import itertools
import logging
import zipfile
from xml.etree import ElementTree

import numpy as np
import pytest
from fmpy.util import read_csv

from ndob_fmu.cli import main
from ndob_fmu.cosim import FmuComponent, System, Variable, algebraic_loops, simulate
from ndob_fmu.errors import CouplingError, UsageError
from ndob_fmu.packages import build_ssp
from tests.helpers.coupling_fmus import coupling_fmus
from tests.helpers.mock_components import Mock, constant, gain, integrator, ramp

ORDERS = {"jacobi": 1, "gauss-seidel": 1, "extrapolation": 2}
ONE_STEP = {"stop_time": 1.0, "step_size": 1.0}
STEPS = 2.0 ** -np.arange(5, 10)


def static(function, *, declared=True, initially=()):
    """y = function(u), at once; `initially`: the inputs that it declares to depend on during initialization."""
    y = Variable("y", "output", dependencies=("u",) if declared else None, initial_dependencies=initially)
    return Mock(["u"], [y], output=lambda x, u: [function(u["u"])])


def slope(error_at, steps=STEPS):
    """The order of the error: its fitted slope over the step, both logarithmic."""
    return np.polyfit(np.log(steps), np.log([error_at(h) for h in steps]), 1)[0]


LOOP = ((("v", "y"), ("x", "u")), (("x", "y"), ("v", "u"), -1.0))


def damped(**more):
    """x' = v and v' = -x - v from (1, 0); each component is exact for a held input."""
    decay = Mock(
        ["u"],
        ["y"],
        output=lambda x, u: [x],
        step=lambda x, u, t, h: u["u"] + (x - u["u"]) * np.exp(-h),
        x=0.0,
    )
    return System({"x": integrator(1.0), "v": decay}, LOOP, **more)


def error_of(step_size, scheme, every=1, **more):
    """The largest error of the damped loop over 2 s, at every so many communication points."""
    recording = simulate(
        damped(**more), stop_time=2.0, step_size=step_size, output_interval=every * step_size, scheme=scheme
    )
    t, w = recording.time, np.sqrt(0.75)
    decay, sine = np.exp(-t / 2), np.sin(w * t) / w
    return np.abs(recording.columns - np.column_stack([decay * (np.cos(w * t) + sine / 2), -decay * sine])).max()


@pytest.mark.parametrize(("scheme", "order"), ORDERS.items())
def test_a_closed_loop_converges_with_the_order_of_its_scheme(scheme, order):
    assert slope(lambda h: error_of(h, scheme)) == pytest.approx(order, abs=0.05)


@pytest.mark.parametrize(("scheme", "order"), ORDERS.items())
def test_a_closed_loop_of_fmus_converges_with_the_same_order(scheme, order, tmp_path_factory):
    """x' = v and v' = -x from (1, 0)."""
    path = coupling_fmus(tmp_path_factory.getbasetemp()) / "Integrator.fmu"
    parts = {name: FmuComponent(path, name) for name in ("x", "v")}
    system = System(parts, LOOP, {("x", "y"): 1.0})

    def error_at(h):
        recording = simulate(system, start_time=0.0, stop_time=2.0, step_size=h, scheme=scheme)
        found = np.column_stack([recording["x.y"], recording["v.y"]])
        return np.abs(found - np.column_stack([np.cos(recording.time), -np.sin(recording.time)])).max()

    assert slope(error_at, STEPS[:4]) == pytest.approx(order, abs=0.05)


@pytest.mark.parametrize("scheme", ["gauss-seidel", "extrapolation"])
def test_the_order_of_gauss_seidel_and_extrapolation_holds_for_a_controller_without_states(scheme):
    """x' = -3 x through a component that declares to show its input at once; its first output has no line to go by."""
    parts = {"x": integrator(1.0), "controller": static(lambda u: -3 * u, initially=("u",))}
    system = System(parts, ((("x", "y"), ("controller", "u")), (("controller", "y"), ("x", "u"))))

    def error_at(h):
        recording = simulate(system, stop_time=2.0, step_size=h, scheme=scheme)
        exact = np.outer(np.exp(-3 * recording.time), [1, -3])
        return np.abs(recording.columns - exact)[2:].max()

    assert slope(error_at) == pytest.approx(ORDERS[scheme], abs=0.1)


@pytest.mark.parametrize(("scheme", "order"), ORDERS.items())
@pytest.mark.parametrize("slow", ["x", "v"])
def test_the_order_holds_where_one_component_takes_four_steps_in_one(scheme, order, slow):
    """At the ends of its steps, that is: what it holds in between is of order one to look at."""
    found = slope(lambda h: error_of(h, scheme, every=4, step_ratios={slow: 4}))
    assert found == pytest.approx(order, abs=0.05)


def test_an_output_that_only_shows_does_not_move_an_input_out_of_the_middle_of_the_step():
    part = Mock(["u"], [Variable("shown", "output", dependencies=("u",))], output=lambda x, u: [u["u"]])
    system = System({"clock": ramp(), "part": part}, ((("clock", "y"), ("part", "u")),))
    simulate(system, stop_time=3.0, step_size=1.0, scheme="extrapolation")
    assert received(part) == [0, 1.5, 2.5]


def test_a_jump_inside_a_step_leaves_extrapolation_with_order_one():
    steps = 0.1 / (2.0 ** np.arange(3, 8) + 0.5)  # the jump at 0.1 comes in the middle of a step

    def error_at(h):
        jump = Mock([], ["y"], output=lambda x, u: [float(x >= 0.1)], step=lambda x, u, t, h: t + h, x=0.0)
        system = System({"jump": jump, "x": integrator()}, ((("jump", "y"), ("x", "u")),))
        recording = simulate(system, stop_time=round(0.2 / h) * h, step_size=h, scheme="extrapolation")
        return np.abs(recording["x.y"] - np.maximum(recording.time - 0.1, 0)).max()

    assert slope(error_at, steps) == pytest.approx(1.0, abs=0.1)


def received(part, name="u"):
    return [u[name] for u in part.received]


def test_extrapolation_gives_the_value_in_the_middle_of_the_step_from_the_second_step_on():
    part = integrator()
    system = System({"clock": ramp(), "x": part}, ((("clock", "y"), ("x", "u"), 10.0, 1.0),))
    simulate(system, stop_time=1.0, step_size=0.25, scheme="extrapolation")
    assert received(part) == [1 + 10 * t for t in (0.0, 0.375, 0.625, 0.875)]


@pytest.mark.parametrize(
    ("source", "target"),
    [
        (Variable("y", "output", variability="discrete"), Variable("u", "input")),
        (Variable("y", "output"), Variable("u", "input", variability="discrete")),
        (Variable("y", "output", "Integer"), Variable("u", "input", "Integer")),
        (Variable("y", "output", "Boolean"), Variable("u", "input", "Boolean")),
        (Variable("y", "output", "Enumeration"), Variable("u", "input", "Enumeration")),
    ],
)
def test_what_is_not_continuous_at_both_ends_is_held(source, target):
    counter = Mock([], [source], output=lambda x, u: [x % 2], step=lambda x, u, t, h: x + 1, x=0)
    part = Mock([target], ["y"], output=lambda x, u: [0.0])
    simulate(
        System({"a": counter, "b": part}, ((("a", "y"), ("b", "u")),)),
        stop_time=4.0,
        step_size=1.0,
        scheme="extrapolation",
    )
    assert received(part) == [0, 1, 0, 1]


def test_the_columns_of_an_input_file_are_held_in_every_scheme(tmp_path):
    file = tmp_path / "u.csv"
    file.write_text('"time","x.u"\n0,1\n1,2\n2,4\n')
    for scheme in ORDERS:
        part = integrator()
        simulate(System({"x": part}), stop_time=3.0, step_size=1.0, input_file=file, scheme=scheme)
        assert received(part) == [1, 2, 4]


@pytest.mark.parametrize("lost", [np.nan, np.inf])
def test_a_lost_sample_costs_extrapolation_one_step_only(lost):
    sensor = Mock([], ["y"], output=lambda x, u: [lost if x == 2 else float(x)], step=lambda x, u, t, h: x + 1, x=0)
    part = Mock(["u"], ["y"], output=lambda x, u: [0.0])
    system = System({"a": sensor, "b": part}, ((("a", "y"), ("b", "u")),))
    simulate(system, stop_time=6.0, step_size=1.0, scheme="extrapolation")
    np.testing.assert_array_equal(received(part), [0.0, 1.5, lost, 3.0, 4.5, 5.5])


# -- the order of Gauss–Seidel


@pytest.mark.parametrize(("order", "seen"), [(None, [0, 0, 1, 2]), (["clock", "second"], [0, 1, 2, 3])])
def test_gauss_seidel_steps_in_the_order_that_is_stated_and_records_in_that_of_the_system(order, seen):
    system = System({"second": gain(), "clock": ramp()}, ((("clock", "y"), ("second", "u")),))
    recording = simulate(system, stop_time=3.0, step_size=1.0, scheme="gauss-seidel", order=order)
    assert recording.names == ("second.y", "clock.y")
    np.testing.assert_array_equal(recording["second.y"], seen)


NAMESPACE = "http://ssp-standard.org/SSP1/SystemStructureDescription"
INTEGRATORS = f"""
<ssd:SystemStructureDescription version="1.0" name="loop" xmlns:ssd="{NAMESPACE}">
  <ssd:System name="loop">
    <ssd:Elements>
      <ssd:Component name="x" source="Integrator.fmu"/>
      <ssd:Component name="v" source="Integrator.fmu"/>
    </ssd:Elements>
    <ssd:Connections>
      <ssd:Connection startElement="v" startConnector="y" endElement="x" endConnector="u"/>
      <ssd:Connection startElement="x" startConnector="y" endElement="v" endConnector="u"/>
    </ssd:Connections>
  </ssd:System>
</ssd:SystemStructureDescription>"""


def test_the_command_line_takes_an_order_and_every_scheme(tmp_path, tmp_path_factory, capsys):
    """ẋ = v and v̇ = x from (1, 0), one step of 0.5 s and another: who has whose value of which instant."""
    (tmp_path / "loop").mkdir()
    (tmp_path / "loop" / "SystemStructure.ssd").write_text(INTEGRATORS)
    system = build_ssp(tmp_path / "loop", coupling_fmus(tmp_path_factory.getbasetemp()), tmp_path)

    def run(*words):
        file = tmp_path / "out.csv"
        times = ["--stop-time", "1", "--step-size", "0.5", "--start-values", "x.y", "1", "--output-file", str(file)]
        assert main(["simulate", str(system), *times, "--scheme", *words]) == 0
        capsys.readouterr()
        rows = read_csv(file)
        return rows["x.y"].tolist(), rows["v.y"].tolist()

    assert run("jacobi") == ([1, 1, 1.25], [0, 0.5, 1])
    assert run("gauss-seidel") == ([1, 1, 1.25], [0, 0.5, 1.125])
    assert run("gauss-seidel", "--order", "v", "x") == ([1, 1.25, 1.8125], [0, 0.5, 1.125])
    assert run("extrapolation") == ([1, 1, 1.375], [0, 0.5, 1])


def test_samples_of_the_shipped_observer_are_not_extrapolated(flexible_joint):
    def run(**options):
        return simulate(flexible_joint.system, stop_time=0.05, **options).columns

    np.testing.assert_array_equal(run(scheme="extrapolation"), run(scheme="jacobi"))
    assert not np.array_equal(run(scheme="gauss-seidel"), run(scheme="jacobi"))


def test_an_order_that_names_no_component_is_refused_with_the_nearest_one():
    system = System({"plant": ramp(), "observer": ramp()})
    with pytest.raises(
        CouplingError,
        match=r"component plnat: expected one of the components observer, plant, received 'plnat'; .*'plant'",
    ):
        simulate(system, **ONE_STEP, scheme="gauss-seidel", order=["observer", "plnat"])


# -- components with other rates


def sampled(ratio, **options):
    """A clock every 0.25 s, and a sampler of it with `ratio` of these steps."""
    clock, sampler = ramp(), gain()
    system = System(
        {"clock": clock, "sampler": sampler}, ((("clock", "y"), ("sampler", "u")),), step_ratios={"sampler": ratio}
    )
    return simulate(system, step_size=0.25, **options), clock, sampler


@pytest.mark.parametrize("scheme", ORDERS)
def test_a_slow_component_sees_its_own_steps_and_takes_none_beyond_the_end(scheme):
    recording, clock, sampler = sampled(3, stop_time=2.0, scheme=scheme)
    assert clock.times == [(0.25 * k, 0.25) for k in range(8)]
    assert sampler.times == [(0.0, 0.75), (0.75, 0.75)]
    assert sampler.calls.count("set_inputs") == 2 + 1  # one of them in the initial exchange
    np.testing.assert_array_equal(recording["clock.y"], recording.time)


@pytest.mark.parametrize(
    ("scheme", "seen"),
    [
        ("jacobi", [0, 0, 0, 0, 0, 0, 0.75, 0.75, 0.75]),  # what was there when its step began
        ("gauss-seidel", [0, 0, 0, 0.75, 0.75, 0.75, 1.5, 1.5, 1.5]),  # what is there when its step ends
        ("extrapolation", [0, 0, 0, 0, 0, 0, 1.125, 1.125, 1.125]),  # the middle of its second step, 0.75 to 1.5 s
    ],
)
def test_outputs_of_a_slow_component_appear_at_the_end_of_its_step_and_are_held_until_the_next(scheme, seen):
    recording, _, _ = sampled(3, stop_time=2.0, scheme=scheme)
    np.testing.assert_array_equal(recording["sampler.y"], seen)


def test_a_slow_source_is_extrapolated_from_its_own_last_two_values():
    clock, part = ramp(), integrator()
    system = System({"clock": clock, "x": part}, ((("clock", "y"), ("x", "u")),), step_ratios={"clock": 2})
    simulate(system, stop_time=2.0, step_size=0.25, scheme="extrapolation")
    assert received(part) == [0, 0, 0.625, 0.875, 1.125, 1.375, 1.625, 1.875]


def test_a_ratio_of_one_changes_nothing():
    plain, same = (simulate(damped(step_ratios=r), stop_time=1.0, step_size=0.125) for r in ({}, {"x": 1, "v": 1}))
    np.testing.assert_array_equal(plain.columns, same.columns)


@pytest.mark.parametrize("ratio", [0, -1, 2.5, 2.0, True, "2", float("nan")])
def test_a_ratio_that_is_no_whole_number_is_refused_by_name(ratio):
    with pytest.raises(UsageError) as refused:
        System({"encoder": ramp()}, step_ratios={"encoder": ratio})
    assert str(refused.value).startswith("step ratio of encoder: expected a whole number of communication steps")
    assert repr(ratio) in str(refused.value)


def test_a_ratio_of_a_component_that_does_not_exist_is_refused():
    with pytest.raises(CouplingError, match=r"'encodr'; likely cause: did you mean 'encoder'\?"):
        System({"encoder": ramp()}, step_ratios={"encodr": 2})


# -- factor and offset of a connection


@pytest.mark.parametrize("scheme", ORDERS)
def test_a_connection_may_scale_its_signal(scheme):
    part = gain()
    system = System({"a": constant(2.0), "b": part}, ((("a", "y"), ("b", "u"), 3.0, -1.0),))
    recording = simulate(system, stop_time=1.0, step_size=0.5, scheme=scheme)
    np.testing.assert_array_equal(recording["b.y"], [5.0, 5.0, 5.0])


@pytest.mark.parametrize(
    ("kind", "scaling", "error", "text"),
    [
        ("Integer", (2.0,), CouplingError, "no factor and no offset for a signal of type Integer"),
        ("Boolean", (1.0, 1.0), CouplingError, "no factor and no offset for a signal of type Boolean"),
        ("Real", (float("nan"),), UsageError, "a finite factor and offset"),
    ],
)
def test_a_scaling_that_makes_no_sense_is_refused(kind, scaling, error, text):
    parts = {
        "a": Mock([], [Variable("y", "output", kind)], output=lambda x, u: [0]),
        "b": Mock([Variable("u", "input", kind)], []),
    }
    with pytest.raises(error, match=text):
        System(parts, ((("a", "y"), ("b", "u"), *scaling),))


# -- algebraic loops


def ring(**parts):
    """Each component drives the next, the last the first."""
    names = [*parts, next(iter(parts))]
    return System(parts, tuple(((a, "y"), (b, "u")) for a, b in itertools.pairwise(names)))


@pytest.mark.parametrize("k", [0.5, -0.9, 0.999, 2.0, -3.0, 1e3])
def test_a_loop_at_the_start_is_solved_also_where_its_gain_is_above_one(k, caplog):
    """y = k (1 + y), so that y = k / (1 - k)."""
    recording = simulate(ring(up=gain(k), back=static(lambda u: 1 + u)), **ONE_STEP)
    assert recording["up.y"][0] == pytest.approx(k / (1 - k), rel=1e-8)
    assert recording["back.y"][0] == pytest.approx(1 / (1 - k), rel=1e-8)


def test_a_long_loop_at_the_start_is_solved_although_each_exchange_leads_further_away():
    recording = simulate(ring(up=gain(1e3), back=static(lambda u: 1 + u), **{n: gain() for n in "abcdef"}), **ONE_STEP)
    np.testing.assert_allclose(recording.columns[0], [1e3 / -999, *[1 / -999] * 7], rtol=1e-8)


def test_a_nonlinear_loop_at_the_start_is_solved(caplog):
    """y = cos y, beside a signal that flows into the loop and one that leaves it."""
    loop = ring(a=static(np.cos, declared=False), b=gain())
    parts = {**loop.components, "after": gain(2.0)}
    system = System(parts, (*loop.connections, (("b", "y"), ("after", "u"))))
    recording = simulate(system, **ONE_STEP)
    np.testing.assert_allclose(recording.columns[0], np.array([1, 1, 2]) * 0.7390851332151607, rtol=1e-9)
    assert caplog.text == ""


def test_a_loop_of_several_signals_at_the_start_is_solved():
    """y = A y + b with gains far above one and three signals in each direction."""
    rng = np.random.default_rng(5)
    A, b = 4 * rng.normal(size=(3, 3)), rng.normal(size=3)
    names = ["0", "1", "2"]
    linear = Mock([f"u{i}" for i in names], [f"y{i}" for i in names], output=lambda x, u: A @ list(u.values()) + b)
    back = Mock([f"u{i}" for i in names], [f"y{i}" for i in names], output=lambda x, u: list(u.values()))
    pairs = tuple(((s, f"y{i}"), (t, f"u{i}")) for s, t in (("a", "b"), ("b", "a")) for i in names)
    recording = simulate(System({"a": linear, "b": back}, pairs), **ONE_STEP)
    np.testing.assert_allclose(recording.columns[0, :3], np.linalg.solve(np.eye(3) - A, b), rtol=1e-7)


@pytest.mark.parametrize("function", [lambda u: 1 + u, lambda u: u**2 + 1, lambda u: float("nan") if u > 5 else 2 + u])
def test_a_loop_without_a_solution_is_named_with_all_that_it_passes(function, caplog):
    simulate(ring(up=gain(), back=static(function, declared=False, initially=("u",))), **ONE_STEP)
    assert "do not settle: algebraic loop up.y → back.u → back.y → up.u → up.y; the first" in caplog.text


def test_a_signal_that_never_comes_to_rest_without_a_loop_is_named(caplog):
    count = itertools.count()
    restless = Mock([], ["y"], output=lambda x, u: [next(count)])
    simulate(System({"a": restless, "b": gain()}, ((("a", "y"), ("b", "u")),)), **ONE_STEP)
    assert "do not settle: a.y, b.y change whenever they are read" in caplog.text


def test_a_loop_of_booleans_that_flips_for_ever_is_named(caplog):
    y = Variable("y", "output", "Boolean")
    u = Variable("u", "input", "Boolean")
    flip = Mock([u], [y], output=lambda x, u: [not u["u"]])
    keep = Mock([u], [y], output=lambda x, u: [u["u"]])
    simulate(ring(flip=flip, keep=keep), **ONE_STEP)
    assert "algebraic loop flip.y → keep.u → keep.y → flip.u → flip.y" in caplog.text


def test_dependencies_tell_which_loop_is_one():
    def loops(**parts):
        return [(str(loop), loop.declared) for loop in algebraic_loops(ring(**parts), initial=False)]

    nothing = Mock(["u"], [Variable("y", "output", dependencies=())])
    through, unknown = static(abs), gain()
    assert loops(a=through, b=nothing) == loops(a=unknown, b=nothing) == []
    assert loops(a=through, b=static(abs)) == [("a.y → b.u → b.y → a.u → a.y", True)]
    assert loops(a=through, b=unknown) == [("a.y → b.u → b.y → a.u → a.y", False)]


def test_initialization_has_its_own_dependencies():
    only_then = Mock(["u"], [Variable("y", "output", dependencies=(), initial_dependencies=("u",))])
    system = ring(a=only_then, b=static(abs, initially=("u",)))
    assert algebraic_loops(system, initial=False) == ()
    assert [str(loop) for loop in algebraic_loops(system, initial=True)] == ["a.y → b.u → b.y → a.u → a.y"]


def test_two_loops_through_one_component_are_both_found():
    names = ("p", "q")
    hub = Mock([f"u_{i}" for i in names], [Variable(f"y_{i}", "output", dependencies=(f"u_{i}",)) for i in names])
    parts = {"hub": hub, "p": static(abs), "q": static(abs)}
    there = tuple((("hub", f"y_{i}"), (i, "u")) for i in names)
    back = tuple(((i, "y"), ("hub", f"u_{i}")) for i in names)
    found = [str(loop) for loop in algebraic_loops(System(parts, there + back), initial=False)]
    assert found == [f"hub.y_{i} → {i}.u → {i}.y → hub.u_{i} → hub.y_{i}" for i in names]


@pytest.mark.parametrize("declared", [True, False])
def test_a_loop_that_acts_with_a_delay_during_the_run_is_told_only_if_it_is_sure_to_exist(declared, caplog):
    with caplog.at_level(logging.WARNING):
        simulate(ring(a=static(lambda u: 0.5 * u), b=static(abs, declared=declared)), **ONE_STEP)
    assert ("algebraic loop a.y → b.u → b.y → a.u → a.y: after the start" in caplog.text) == declared


# -- what an FMU's model description says


def declared(path, target, listed, variability="continuous"):
    """Copy Gain.fmu with what depends on what in its model description; 1, 2 and 4 are a, b and y there."""
    with zipfile.ZipFile(path) as before, zipfile.ZipFile(target, "w") as after:
        for name in before.namelist():
            data = before.read(name)
            if name == "modelDescription.xml":
                root = ElementTree.fromstring(data)
                structure = root.find("ModelStructure")
                structure.clear()
                structure.extend(listed)
                root.find("ModelVariables")[3].set("variability", variability)
                data = ElementTree.tostring(root)
            after.writestr(name, data)
    return target


def unknowns(tag, **attributes):
    element = ElementTree.Element(tag)
    ElementTree.SubElement(element, "Unknown", {"index": "4", **attributes})
    return element


@pytest.fixture
def gain_fmu(tmp_path_factory):
    return coupling_fmus(tmp_path_factory.getbasetemp()) / "Gain.fmu"


@pytest.mark.parametrize(
    ("step", "initial", "expected"),
    [
        ({}, None, (None, None)),
        ({"dependencies": ""}, None, ((), None)),
        ({"dependencies": "2"}, {"dependencies": "1 2 3"}, (("b",), ("a", "b"))),
        ({"dependencies": "1", "dependenciesKind": "constant"}, {"dependencies": ""}, (("a",), ())),
    ],
)
def test_dependencies_of_an_fmu_are_read_and_those_left_out_may_be_all(gain_fmu, tmp_path, step, initial, expected):
    listed = [unknowns("Outputs", **step)] + ([] if initial is None else [unknowns("InitialUnknowns", **initial)])
    y = next(v for v in FmuComponent(declared(gain_fmu, tmp_path / "G.fmu", listed)).variables if v.name == "y")
    assert (y.dependencies, y.initial_dependencies) == expected


def test_an_output_that_starts_at_its_start_value_depends_on_nothing_then(gain_fmu):
    integrator = {v.name: v for v in FmuComponent(gain_fmu.with_name("Integrator.fmu")).variables}
    assert integrator["y"].initial_dependencies == ()
    assert integrator["half"].initial_dependencies is None


def test_the_shipped_fmus_say_that_between_steps_nothing_passes_at_once(flexible_joint):
    system = System(
        {"plant": FmuComponent(flexible_joint.plant), "observer": FmuComponent(flexible_joint.observer)},
        (
            (("plant", "link_angle"), ("observer", "link_angle")),
            (("observer", "load_torque_hat"), ("plant", "load_torque")),
        ),
    )
    assert algebraic_loops(system, initial=False) == ()


def test_a_loop_of_two_fmus_is_solved_at_the_start_and_its_delay_is_told(gain_fmu, tmp_path, caplog):
    """y = -3 (1 + y), a loop with a gain above one."""
    through = [unknowns("Outputs", dependencies="1"), unknowns("InitialUnknowns", dependencies="1")]
    path = declared(gain_fmu, tmp_path / "G.fmu", through)
    starts = {("up", "k"): -3.0, ("up", "b"): 1.0, ("back", "k"): 1.0, ("back", "b"): 0.0}
    pairs = ((("up", "y"), ("back", "a")), (("back", "y"), ("up", "a")))
    system = System({name: FmuComponent(path, name) for name in ("up", "back")}, pairs, starts)
    recording = simulate(system, **ONE_STEP)
    np.testing.assert_allclose(recording.columns[0], [-0.75, -0.75], rtol=1e-9)
    assert "algebraic loop up.y → back.a → back.y → up.a → up.y: after the start" in caplog.text


@pytest.mark.parametrize(("variability", "seen"), [("continuous", 1.75), ("discrete", 1.5)])
def test_a_discrete_output_of_an_fmu_is_held(gain_fmu, tmp_path, variability, seen):
    listed = [unknowns("Outputs", dependencies="1 2")]
    parts = {"clock": ramp(), "g": FmuComponent(declared(gain_fmu, tmp_path / "G.fmu", listed, variability), "g")}
    part = parts["x"] = integrator()
    system = System(parts, ((("clock", "y"), ("g", "a")), (("g", "y"), ("x", "u"))), {("g", "k"): 1.0, ("g", "b"): 0.0})
    simulate(system, stop_time=2.0, step_size=0.5, scheme="extrapolation")
    assert received(part)[-1] == seen
