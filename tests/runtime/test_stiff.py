"""The exponential integrator, and the choice between it and the explicit one."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from itertools import pairwise

import numpy as np
import pytest
import sympy
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from ndob_fmu.codegen.compile_model import compile_model
from ndob_fmu.model.model import Model
from ndob_fmu.runtime.base_errors import IntegrationError
from ndob_fmu.runtime.blocks.disturbance import KINDS, Generator
from ndob_fmu.runtime.blocks.plant import Plant
from ndob_fmu.runtime.equations import ObserverDefaults
from ndob_fmu.runtime.numerics import stiff
from ndob_fmu.runtime.numerics.integrate import adapt_in_few, cash_karp, integrate
from ndob_fmu.runtime.numerics.sliding import no_surfaces
from ndob_fmu.runtime.numerics.stiff import integrate_any, integrate_stiff
from ndob_fmu.runtime.step.layout import Layout
from ndob_fmu.runtime.step.time_update import predict_plant

H = 0.01
# What is required of a stiff plant, of the size of each state; the integrator's own tolerance leaves less.
WITHIN = 1e-6


class Problem:
    """x' = f(t, x) with its slopes, counted: `evaluations` of f and `linearisations`."""

    def __init__(self, f, slopes, surfaces=no_surfaces):
        self.f, self.of_f, self.surfaces = f, slopes, surfaces
        self.evaluations = self.linearisations = 0

    def derivatives(self, t, x):
        self.evaluations += 1
        return np.array(self.f(t, *x), dtype=float)

    def slopes(self, t, x):
        self.linearisations += 1
        rows = np.array(self.of_f(t, *x), dtype=float)
        return rows[:, :-1], rows[:, -1]

    def reference(self, x, t_end):
        """Return x(t_end) of Radau's method."""
        options = {"rtol": 1e-11, "atol": 1e-16, "jac": lambda t, x: np.array(self.of_f(t, *x), dtype=float)[:, :-1]}
        return solve_ivp(lambda t, x: self.f(t, *x), (0.0, t_end), x, method="Radau", **options).y[:, -1]


def symbolic(f, n):
    """Return the problem x' = f(t, x1 … xn), written in SymPy."""
    t, *x = symbols = sympy.symbols(f"t, x1:{n + 1}", real=True)
    rates = sympy.Matrix(f(*symbols))
    of_f = rates.jacobian([*x, t])
    return Problem(sympy.lambdify(symbols, list(rates)), sympy.lambdify(symbols, of_f.tolist()))


def lag(rate):
    """An oscillator behind a lag of the given rate (1/s), driven by a sine."""
    return symbolic(lambda t, x, v, a: [v, -x - 0.3 * v + a, rate * (sympy.sin(6 * t) + 1 - a)], 3)


def friction(rate):
    """A mass on a spring with friction as steep as `rate` (1/s) where it turns."""
    return symbolic(lambda t, x, v: [v, -20 * x - 5 * sympy.tanh(v * rate / 5) + 3 * sympy.sin(6 * t) + 4], 2)


def valve(rate):
    return symbolic(lambda t, x, y: [-rate * (x**3 - sympy.cos(t)), x - y], 2)


def van_der_pol(mu):
    return symbolic(lambda t, x, v: [v, mu * ((1 - x**2) * v - x)], 2)


def robertson():
    return symbolic(
        lambda t, a, b, c: [
            -0.04 * a + 1e4 * b * c,
            0.04 * a - 1e4 * b * c - 3e7 * b**2,
            3e7 * b**2,
        ],
        3,
    )


# The most evaluations of x' that a step may take: four for each substep that is tried.
CASES = {
    **{f"lag {rate:g}": (lag(rate), (1.0, 0.0, 0.0), H, 60) for rate in (1e2, 1e4, 1e5, 1e6, 1e7)},
    **{f"friction {rate:g}": (friction(rate), (0.5, 0.02), H, 1000) for rate in (1e2, 1e4, 1e6, 1e7)},
    **{f"valve {rate:g}": (valve(rate), (2.0, 0.0), H, 400) for rate in (1e2, 1e4, 1e6, 1e7)},
    "van der Pol 1e3": (van_der_pol(1e3), (2.0, 0.0), H, 120),
    "van der Pol 1e6": (van_der_pol(1e6), (2.0, 0.0), H, 60),
    "van der Pol 1e6, near its jump": (van_der_pol(1e6), (2.0, 0.0), 0.8, 2500),
    "Robertson": (robertson(), (1.0, 0.0, 0.0), 0.3, 450),
}


@pytest.mark.parametrize("name", CASES)
def test_a_stiff_step_agrees_with_radau_at_a_bounded_cost(name):
    problem, x, t_end, most = CASES[name]
    problem.evaluations = 0
    found = integrate_stiff(problem.derivatives, problem.slopes, np.array(x), t_end)
    assert problem.evaluations <= most
    np.testing.assert_allclose(found, problem.reference(x, t_end), rtol=WITHIN, atol=1e-12)


@pytest.mark.parametrize("rate", [1e-3, 1.0, 1e3, 1e6, 1e9])
def test_a_decay_of_any_rate_takes_one_substep_and_ends_where_it_must(rate):
    """x' = −λ (x − 2), from 3: L-stability is that a fast decay is over after one substep."""
    problem = Problem(lambda t, x: [-rate * (x - 2.0)], lambda t, x: [[-rate, 0.0]])
    found = integrate_stiff(problem.derivatives, problem.slopes, np.array([3.0]), 1.0)
    assert found == pytest.approx([2.0 + math.exp(-rate)], rel=1e-14)
    assert problem.linearisations == 1


@pytest.mark.parametrize("damping", [0.0, 1e-3, 0.3])
def test_a_fast_oscillation_takes_one_substep(damping):
    """100 rad in a step, with an input that rises as t²: the method is exact for both."""
    w = 1e4
    problem = symbolic(lambda t, x, v: [v, -(w**2) * (x - t**2) - 2 * damping * w * v], 2)
    problem.evaluations = 0
    found = integrate_stiff(problem.derivatives, problem.slopes, np.array([1.0, 0.0]), H)
    assert (problem.evaluations, problem.linearisations) == (3, 1)
    A = np.zeros((5, 5))  # of x, v, t², 2 t, 2
    A[:2, :3] = [[0.0, 1.0, 0.0], [-(w**2), -2.0 * damping * w, w**2]]
    A[2, 3] = A[3, 4] = 1.0
    expected = (expm(A * H) @ [1.0, 0.0, 0.0, 0.0, 2.0])[:2]
    np.testing.assert_allclose(found / [1.0, w], expected / [1.0, w], rtol=0, atol=1e-9)


def test_the_method_is_of_order_4(monkeypatch):
    """The error of substeps of one length, against half that length: 2⁴."""
    problem = symbolic(lambda t, x, y: [-x * y + sympy.cos(t), sympy.sin(x) - 5 * y**2], 2)
    start, t_end = np.array([1.0, 0.5]), 1.0
    monkeypatch.setattr(stiff, "RELATIVE_TOLERANCE", np.inf)
    expected = problem.reference(start, t_end)

    def error(substeps):
        monkeypatch.setattr(
            stiff, "cut", lambda planned, left: left if left < 1.5 * t_end / substeps else t_end / substeps
        )
        return np.max(np.abs(integrate_stiff(problem.derivatives, problem.slopes, start, t_end) - expected))

    orders = [math.log2(error(n) / error(2 * n)) for n in (8, 16, 32)]
    assert orders[-1] == pytest.approx(4.0, abs=0.15)


def test_the_error_is_estimated_and_kept_to_the_tolerance(monkeypatch):
    problem = friction(1e4)
    x, expected = np.array([0.5, 0.02]), problem.reference((0.5, 0.02), H)
    costs = []
    for tolerance in (1e-4, 1e-6, 1e-8):
        monkeypatch.setattr(stiff, "RELATIVE_TOLERANCE", tolerance)
        problem.evaluations = 0
        found = integrate_stiff(problem.derivatives, problem.slopes, x, H)
        costs.append(problem.evaluations)
        np.testing.assert_allclose(found, expected, rtol=tolerance)
    assert costs[0] < costs[1] < costs[2]


def test_where_the_slopes_have_no_value_the_substep_is_explicit():
    """A tank that is empty at first: 1/(2 √x) divides by zero there."""

    def flow(x):
        return math.copysign(math.sqrt(abs(x)), x)

    problem = Problem(lambda t, x: [1.0 - flow(x)], lambda t, x: [[-0.5 / math.sqrt(abs(x)), 0.0]])
    found = integrate_stiff(problem.derivatives, problem.slopes, np.array([0.0]), 0.5)
    s = float(found[0]) ** 0.5  # t = −2 (√x + log(1 − √x))
    assert -2.0 * (s + math.log(1.0 - s)) == pytest.approx(0.5, rel=WITHIN)


def test_a_right_hand_side_that_jumps_back_and_forth_is_given_up():
    problem = Problem(lambda t, x: [-math.copysign(1.0, x - 0.3)], lambda t, x: [[0.0, 0.0]])
    assert integrate_stiff(problem.derivatives, problem.slopes, np.array([0.3]), H) is None
    assert problem.evaluations <= 3 * stiff.MOST_SUBSTEPS


def test_a_solution_that_leaves_the_finite_numbers_is_given_up():
    """x' = 1 + x² is tan t, infinite at π/2."""
    problem = Problem(lambda t, x: [1.0 + x * x], lambda t, x: [[2.0 * x, 0.0]])
    assert integrate_stiff(problem.derivatives, problem.slopes, np.array([0.0]), 2.0) is None
    assert problem.evaluations <= 3 * stiff.MOST_SUBSTEPS
    with pytest.raises(IntegrationError, match=r"leaves the finite numbers|more than 100000 substeps"):
        integrate_any(problem.derivatives, problem.slopes, no_surfaces, np.array([0.0]), 2.0, 2.0)


# -- the choice


def test_few_explicit_substeps_are_taken_as_they_always_were():
    """Bit for bit: the choice is only made where many would be needed."""
    for rate in (1.0, 30.0, 300.0):
        problem = lag(rate)
        explicit = integrate(problem.derivatives, np.array([1.0, 0.0, 0.9]), 0.0, H, H)
        chosen = integrate_any(problem.derivatives, problem.slopes, no_surfaces, np.array([1.0, 0.0, 0.9]), H, H)
        np.testing.assert_array_equal(chosen[0], explicit[0])
        assert chosen[1] == explicit[1]
        assert problem.linearisations == 0


@pytest.mark.parametrize("rate", [1e5, 1e6, 1e7])
def test_many_explicit_substeps_are_given_up_early(rate):
    problem = lag(rate)
    problem.evaluations = 0
    assert (
        adapt_in_few(partial(cash_karp, problem.derivatives, H), np.array([1.0, 0.0, 0.0]), 0.0, H, H, stops=False)
        is None
    )
    assert problem.evaluations <= 6 * 34
    found, substep = integrate_any(problem.derivatives, problem.slopes, no_surfaces, np.array([1.0, 0.0, 0.0]), H, H)
    np.testing.assert_allclose(found, problem.reference((1.0, 0.0, 0.0), H), rtol=WITHIN)
    assert substep == H


def test_a_kink_costs_the_explicit_method_few_substeps_and_is_left_to_it():
    """A spring with play: the substep shrinks to nothing at the kink and grows again."""
    problem = Problem(
        lambda t, x, v: [v, -400.0 * (max(x - 0.3, 0.0) + min(x, 0.0))],
        lambda t, x, v: [[0.0, 1.0, 0.0], [-400.0 if not 0.0 < x < 0.3 else 0.0, 0.0, 0.0]],
    )
    for start in ([0.299, 1.0], [0.01, -2.0], [0.295, 2.0]):
        explicit, _ = integrate(problem.derivatives, np.array(start), 0.0, H, H)
        chosen, _ = integrate_any(problem.derivatives, problem.slopes, no_surfaces, np.array(start), H, H)
        np.testing.assert_array_equal(chosen, explicit)
    assert problem.linearisations == 0


def test_what_both_methods_find_too_hard_ends_in_the_error_of_the_explicit_one():
    """A spring of the force 1e16 x³ swings 1e5 times in the step."""
    problem = Problem(lambda t, x, v: [v, -1e16 * x**3], lambda t, x, v: [[0.0, 1.0, 0.0], [-3e16 * x**2, 0.0, 0.0]])
    with pytest.raises(IntegrationError, match=r"more than 100000 substeps in one communication step"):
        integrate_any(problem.derivatives, problem.slopes, no_surfaces, np.array([1.0, 0.0]), H, H)


# -- a right-hand side that jumps


def block(push, friction=10.0, surfaces=no_surfaces):
    """v̇ = push(t) − friction sign(v): a mass on a rough table."""
    return Problem(
        lambda t, x, v: [v, push(t) - friction * np.sign(v)],
        lambda t, x, v: [[0.0, 1.0, 0.0], [0.0, 0.0, 0.0]],
        surfaces,
    )


def at_standstill(x):
    """The surface v = 0."""
    return np.array([[x[1], 0.0, 1.0]])


def moved(problem, start, duration):
    """Return [x, v] after steps of H, and the largest number of evaluations in one of them."""
    x, h, most = np.array(start), H, 0
    for k in range(round(duration / H)):
        problem.evaluations, t = 0, k * H
        shifted = Problem(lambda since, *x, t=t: problem.f(t + since, *x), problem.of_f, problem.surfaces)
        x, h = integrate_any(shifted.derivatives, shifted.slopes, shifted.surfaces, x, H, h)
        most = max(most, shifted.evaluations)
    return x, most


def test_friction_holds_a_mass_that_is_pushed_less():
    """It creeps by less than a thousandth of what the push alone would do."""
    for share in (0.0, 0.3, 0.9, -0.6):
        (x, v), most = moved(block(lambda t, share=share: share * 10.0), [0.0, 0.0], 0.5)
        assert abs(v) <= 2.0 * 10.0 * H / 64.0
        assert abs(x) <= 1e-3 * 0.5 * 10.0 * 0.5**2
        assert most <= 3600


@pytest.mark.parametrize("share", [0.0, 0.3, 0.9, -0.6])
def test_a_mass_that_a_known_surface_holds_does_not_move_and_costs_a_few_evaluations(share):
    (x, v), most = moved(block(lambda t: share * 10.0, surfaces=at_standstill), [0.0, 0.0], 0.5)
    assert (x, v) == pytest.approx((0.0, 0.0), abs=1e-100)
    assert most <= 30


def test_a_known_surface_lets_a_mass_go_inside_a_step():
    """With the push 20 t against 10 it leaves at t = 0.503, inside a step: v = 10 s², x = 10 s³/3 after s more."""
    problem = block(lambda t: 10.0 + 20.0 * (t - 0.503), surfaces=at_standstill)
    (x, v), _ = moved(problem, [0.0, 0.0], 1.0)
    assert v == pytest.approx(10.0 * 0.497**2, abs=1e-9)
    assert x == pytest.approx(10.0 * 0.497**3 / 3.0, abs=1e-9)


def test_a_mass_comes_to_rest_on_a_known_surface_where_its_energy_is_gone():
    """From v = 1 against 10 after 0.05 m."""
    (x, v), most = moved(block(lambda t: 0.0, surfaces=at_standstill), [0.0, 1.0], 0.5)
    assert x == pytest.approx(0.05, abs=1e-12)
    assert v == 0.0
    assert most <= 600


def test_two_masses_that_friction_couples_move_as_one():
    """v₁' = 6 − 10 sign(v₁ − v₂), v₂' = 10 sign(v₁ − v₂)/2 from rest: both take 6/3 = 2, the contact 4 of 10."""

    def f(t, v, w):
        rubs = 10.0 * np.sign(v - w)
        return [6.0 - rubs, 0.5 * rubs]

    problem = Problem(f, lambda t, v, w: np.zeros((2, 3)), lambda x: np.array([[x[0] - x[1], 1.0, -1.0]]))
    (v, w), most = moved(problem, [0.3, 0.3], 0.5)
    assert [v, w] == pytest.approx([0.3 + 2.0 * 0.5] * 2, rel=1e-12)
    assert most <= 30


def test_two_surfaces_hold_and_let_go_each_for_itself():
    """A block on a block on a table: 4 on the upper one is held by 5, against the table the whole needs 3."""

    def f(t, v, w):
        between, below = 5.0 * np.sign(v - w), 3.0 * np.sign(w)
        return [4.0 - between, between - below]

    problem = Problem(
        f, lambda t, v, w: np.zeros((2, 3)), lambda x: np.array([[x[0] - x[1], 1.0, -1.0], [x[1], 0.0, 1.0]])
    )
    (v, w), _ = moved(problem, [0.0, 0.0], 0.5)
    assert [v, w] == pytest.approx([0.25, 0.25], rel=1e-9)  # 4 − 3 moves two masses of 1 by 0.5 t


def test_friction_lets_a_mass_go_that_is_pushed_more():
    """With the push 20 t against 10 it leaves at t = 0.5: v = 10 s², x = 10 s³/3 after s more."""
    (x, v), _ = moved(block(lambda t: 20.0 * t), [0.0, 0.0], 1.0)
    assert v == pytest.approx(10.0 * 0.5**2, abs=2.0 * 10.0 * H / 64.0)
    assert x == pytest.approx(10.0 * 0.5**3 / 3.0, abs=1e-3)


def test_friction_stops_a_mass_where_its_energy_is_gone():
    """From v = 1 against 10 after 0.05 m; there it stays."""
    (x, v), _ = moved(block(lambda t: 0.0), [0.0, 1.0], 0.5)
    assert x == pytest.approx(0.05, abs=1e-4)
    assert abs(v) <= 2.0 * 10.0 * H / 64.0


def test_a_mass_that_changes_its_direction_once_is_followed_exactly():
    """v̇ = 20 − 10 sign(v) from v = −1: still after 1/30 s, where x = −1/60."""
    (x, v), _ = moved(block(lambda t: 20.0), [0.0, -1.0], 0.1)
    s = 0.1 - 1.0 / 30.0
    assert v == pytest.approx(10.0 * s, abs=1e-9)
    assert x == pytest.approx(5.0 * s**2 - 1.0 / 60.0, abs=1e-9)


# -- plants and predictions


def motor_with_lag(rate=1e6, **changes):
    """ẋ = v, v̇ = −20 x − 5 tanh(v) + a + d, ȧ = rate (u − a): a state of the drive that is far faster than H."""
    fields = {
        "name": "Lagged",
        "states": ["x", "v", "a"],
        "inputs": ["u"],
        "outputs": ["x"],
        "disturbances": ["d"],
        "parameters": {"rate": rate},
        "A": [[0, 1, 0], [-20, 0, 1], [0, 0, -sympy.Symbol("rate")]],
        "B": [[0], [0], [sympy.Symbol("rate")]],
        "C": [[1, 0, 0]],
        "G_d": [[0], [1], [0]],
        "f": lambda x, u, p: [-5 * sympy.tanh(x.v)],
        "lipschitz": 5.0,
        "observer": ObserverDefaults(),
    }
    return compile_model(Model(**(fields | changes)))


def counted(eq):
    """Return the equations, and the numbers of evaluations that are made with them by name."""
    counts = {"derivatives": 0, "linearisation": 0, "plant_trial": 0}

    def counting(name, function):
        def call(*arguments):
            counts[name] += 1
            return function(*arguments)

        return call

    steps = replace(eq.steps, plant_trial=counting("plant_trial", eq.steps.plant_trial))
    functions = {name: counting(name, getattr(eq, name)) for name in ("derivatives", "linearisation")}
    return replace(eq, steps=steps, **functions), counts


@pytest.mark.parametrize("rate", [1e4, 1e5, 1e6, 1e7])
@pytest.mark.parametrize("kind", ["sine", "chirp", "step"])
def test_a_plant_with_a_fast_lag_takes_a_bounded_number_of_evaluations_and_agrees_with_radau(rate, kind):
    """The generator begins inside the second step. `step` and `step_by_definition` take the same decisions."""
    eq, counts = counted(motor_with_lag(rate))
    generator = Generator(KINDS[kind], 2.0, 3.0, 0.0137)
    plant = Plant(eq, (rate,), (generator,))
    state = by_definition = plant.init((0.3, -0.2, 0.7), 0.0)
    expected = np.array(state.x)
    options = {"method": "Radau", "rtol": 1e-11, "atol": 1e-14}
    for k, u in enumerate([1.0, 3.0, 3.0, -2.0]):
        counts.update(dict.fromkeys(counts, 0))
        state = plant.step(state, (u,), (0.5,), (k + 1) * H)
        assert counts["plant_trial"] <= 2 * 530
        assert counts["derivatives"] <= 300
        assert counts["linearisation"] <= 100
        by_definition = plant.step_by_definition(by_definition, (u,), (0.5,), (k + 1) * H)
        stops = [k * H, generator.start_time, (k + 1) * H] if k == 1 else [k * H, (k + 1) * H]
        for begin, end in pairwise(stops):
            last = math.nextafter(end, begin)

            def slope(t, x, u=u, last=last):
                return eq.derivatives(x, (u,), (0.5 + generator(min(t, last)),), (rate,))

            expected = solve_ivp(slope, (begin, end), expected, **options).y[:, -1]
        np.testing.assert_allclose(state.x, expected, rtol=WITHIN)
        np.testing.assert_allclose(state.x, by_definition.x, rtol=1e-11)


def test_the_cost_of_a_step_of_a_linear_stiff_plant_does_not_grow_with_its_rate():
    costs = {}
    for rate in (1e5, 1e6, 1e7, 1e8):
        eq, counts = counted(motor_with_lag(rate, f=None, lipschitz=None, G_f=None))
        Plant(eq, (rate,), (Generator(),)).step(
            Plant(eq, (rate,), (Generator(),)).init((0.3, -0.2, 0.7), 0.0), (1.0,), (0.5,), H
        )
        costs[rate] = counts
    assert all(counts.pop("plant_trial") <= 36 for counts in costs.values()), costs
    assert all(counts == {"derivatives": 3, "linearisation": 1} for counts in costs.values()), costs


@pytest.mark.parametrize("order", range(4))
def test_the_prediction_of_a_stiff_plant_agrees_with_radau(order):
    """d is continued by its Taylor series, as over any step."""
    eq, counts = counted(motor_with_lag())
    series = [0.8, -3.0, 40.0][:order]
    xi_hat = np.array([0.3, -0.2, 0.7, *series])
    layout = Layout(n=3, q=1, order=order, own=(order,), biased=(), uncertain=())
    found = predict_plant(eq, layout, (1e6,), xi_hat, (2.0,), H, None if order else np.array([0.8]))
    assert counts["derivatives"] <= 6 * 30 + 100
    d = series or [0.8]

    def slope(t, x):
        return eq.derivatives(x, (2.0,), (sum(c * t**i / math.factorial(i) for i, c in enumerate(d)),), (1e6,))

    expected = solve_ivp(slope, (0.0, H), xi_hat[:3], method="Radau", rtol=1e-11, atol=1e-14).y[:, -1]
    np.testing.assert_allclose(found[:3], expected, rtol=WITHIN)
