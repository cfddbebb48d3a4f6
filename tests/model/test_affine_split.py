"""ẋ and y as they stand in a textbook, taken apart: exactly, and into the matrices that a user would have written."""

import numpy as np
import pytest
import sympy

from ndob_fmu import Model
from ndob_fmu.codegen.compile_model import linear_part
from ndob_fmu.codegen.emit import emit_python
from ndob_fmu.model.affine_split import NotAffineError, split
from tests.helpers.general_plants import ARM, BALL, CART
from tests.helpers.problems import MODELS, RANDOM, to_model

A_CHANNEL = {"channel_bound": 1.0}


def symbols(stem, count):
    return tuple(sympy.Symbol(f"{stem}{i}", real=True) for i in range(count))


def random_equations(seed, n, m, q):
    """Return ẋ (n,) with linear, nonlinear and turning terms, and x, u, d and two parameters."""
    random = np.random.default_rng(seed)
    x, u, d, p = symbols("x", n), symbols("u", m), symbols("d", q), symbols("p", 2)
    functions = [
        sympy.sin(x[0] * p[0]),
        x[1] * u[0] / (2 + x[0] ** 2),
        sympy.exp(-p[1] * x[-1]),
        sympy.tanh(x[0] - u[-1]),
    ]
    derivatives = []
    for _ in range(n):
        pick = [*x, *u, *d, *functions, d[0] * sympy.cos(x[1]), d[-1] / (1 + p[0] * x[0] ** 2), p[0] * (x[0] - x[-1])]
        weights = random.normal(size=len(pick)) * (random.random(len(pick)) < 0.4)
        derivatives.append(
            sympy.Add(*(round(float(w), 2) * part / p[1] for w, part in zip(weights, pick, strict=True)))
        )
    return derivatives, x, u, d, p


@pytest.mark.parametrize(("seed", "n", "m", "q"), [(0, 4, 2, 3), (1, 5, 3, 1), (2, 3, 1, 2), (3, 6, 2, 4)])
def test_the_parts_add_up_to_what_was_written(seed, n, m, q):
    derivatives, x, u, d, p = random_equations(seed, n, m, q)
    outputs = [x[0] + derivatives[0].xreplace(dict.fromkeys(d, 0)), *x[1:]]
    parts = split(derivatives, outputs, x, u, d, channel=False)
    assert (parts.A.shape, parts.B.shape, parts.C.shape, parts.G_d.shape) == ((n, n), (n, m), (n, n), (n, q))
    for matrix in (parts.A, parts.B, parts.C, parts.G_f):
        assert not matrix.free_symbols & {*x, *u, *d}
    again = parts.A * sympy.Matrix(x) + parts.B * sympy.Matrix(u) + parts.G_d * sympy.Matrix(d)
    if parts.f:
        again += parts.G_f * sympy.Matrix(parts.f)
    measured = parts.C * sympy.Matrix(x) + sympy.Matrix(parts.output_rest)
    random = np.random.default_rng(seed)
    for _ in range(5):
        at = {symbol: float(random.uniform(0.3, 1.5)) for symbol in (*x, *u, *d, *p)}
        for one, other in zip([*again, *measured], [*derivatives, *outputs], strict=True):
            assert float(one.xreplace(at)) == pytest.approx(float(other.xreplace(at)), rel=1e-12, abs=1e-12)


@pytest.mark.parametrize("problem", RANDOM, ids=lambda problem: problem.name)
def test_a_linear_plant_written_as_equations_has_its_matrices(problem):
    model = to_model(problem.linear)
    linear = problem.linear
    n, m, q = len(linear.A), linear.B.shape[1], linear.G_d.shape[1]

    def dynamics(x, u, d, p):
        x, u, d = (
            [getattr(space, name) for name in names]
            for space, names in ((x, model.states), (u, model.inputs), (d, model.disturbances))
        )
        return [
            sum(float(linear.A[i, j]) * x[j] for j in range(n))
            + sum(float(linear.B[i, j]) * u[j] for j in range(m))
            + sum(float(linear.G_d[i, j]) * d[j] for j in range(q))
            for i in range(n)
        ]

    outputs = {
        name: lambda x, u, p, row=row: sum(
            float(c) * getattr(x, state) for c, state in zip(row, model.states, strict=True)
        )
        for name, row in zip(model.outputs, linear.C, strict=True)
    }
    written = Model(
        name="Written",
        states=model.states,
        inputs=model.inputs,
        disturbances=model.disturbances,
        dynamics=dynamics,
        outputs=outputs,
    )
    found = linear_part(written)
    for name in ("A", "B", "C", "G_d"):
        np.testing.assert_array_equal(getattr(found, name), getattr(linear, name))


def as_equations(model, **changes):
    """Return the same plant, written as ẋ."""
    field = model.vector_field

    def dynamics(x, u, d, p):
        return field.derivatives(field.driven_by([getattr(d, name) for name in model.disturbances]))

    outputs = {name: lambda x, u, p, h=h: h for name, h in zip(model.outputs, field.outputs, strict=True)}
    kept = [
        *(
            "name",
            "description",
            "states",
            "inputs",
            "disturbances",
            "parameters",
            "units",
            "descriptions",
            "lipschitz",
        ),
        *("disturbance_bound", "noise_std", "x0", "xhat0", "xhat0_std", "observer", "disturbance", "experiment"),
    ]
    return Model(**{label: getattr(model, label) for label in kept}, dynamics=dynamics, outputs=outputs, **changes)


@pytest.mark.parametrize("name", ["flexible_joint", "dc_motor", "car_in_crosswind", "three_tank"])
def test_both_forms_of_a_plant_are_the_same_code(name):
    """So plant and observer are the same to the last bit."""
    assert emit_python(as_equations(MODELS[name])) == emit_python(MODELS[name])


def test_the_flexible_joint_as_it_stands_in_a_textbook_is_the_built_in_one():
    joint = MODELS["flexible_joint"]

    def dynamics(x, u, d, p):
        spring = p.joint_stiffness * (x.link_angle - x.motor_angle)
        return [
            x.link_rate,
            -spring - p.gravity_torque * sympy.sin(x.link_angle),
            x.motor_rate,
            spring - p.motor_damping * x.motor_rate + u.motor_torque + d.load_torque,
        ]

    changes = {label: getattr(joint, label) for label in ("name", "description", "states", "inputs", "outputs")}
    changes |= {label: getattr(joint, label) for label in ("disturbances", "parameters", "units", "descriptions")}
    changes |= {
        label: getattr(joint, label) for label in ("lipschitz", "disturbance_bound", "noise_std", "x0", "xhat0")
    }
    changes |= {label: getattr(joint, label) for label in ("observer", "disturbance", "experiment")}
    assert emit_python(Model(dynamics=dynamics, **changes)) == emit_python(joint)


def test_a_force_through_the_disturbances_channel_is_matched():
    model = as_equations(MODELS["dc_motor"])
    assert model.matched
    assert [str(f) for f in model.f_expressions] == ["-friction_torque*tanh(shaft_rate/friction_rate)"]


def test_one_function_in_two_equations_is_one_unknown_input():
    """As the rate of a reaction, which uses up the substance and heats the tank."""

    def dynamics(x, u, d, p):
        rate = p.k * sympy.exp(-p.E / x.T) * x.c
        return [p.q * (u.feed - x.c) - rate, p.q * (d.T_feed - x.T) + p.heat * rate]

    model = Model(
        name="Tank",
        states=["c", "T"],
        inputs=["feed"],
        outputs=["T"],
        disturbances=["T_feed"],
        dynamics=dynamics,
        parameters={"k": 7e10, "E": 8750.0, "q": 1.0, "heat": 200.0},
        disturbance_nominal=350.0,
        x0=[0.5, 350.0],
        xhat0=[0.5, 350.0],
    )
    assert len(model.f_expressions) == 1
    heat = model.symbols["heat"]
    assert (model.parts.G_f - sympy.Matrix([1, -heat])).is_zero_matrix or (
        model.parts.G_f + sympy.Matrix([1, -heat])
    ).is_zero_matrix


def test_one_turning_direction_with_a_bound_is_a_channel():
    arm = MODELS["tool_on_arm"]
    same = as_equations(arm, channel_bound=[0.7 / 1.2, 0.3 / 0.4], channel_rate=arm.channel_rate)
    assert same.vector_field.has_paper_form
    assert len(same.channel_expressions) == 2
    assert same.matched


@pytest.mark.parametrize(
    ("model", "constant", "linear"),
    [(ARM, False, True), (CART, True, False), (BALL, False, True)],
    ids=["arm", "cart", "ball"],
)
def test_what_has_no_constant_matrices_is_known_as_such(model, constant, linear):
    field = model.vector_field
    assert (field.directions_are_constant, field.outputs_are_linear) == (constant, linear)
    assert not field.has_paper_form


def test_a_sensor_that_an_input_is_fed_through_to_says_so():
    assert CART.vector_field.feedthrough == ((), (0,))


@pytest.mark.parametrize(
    "written",
    [
        lambda x, d: x * d**2,
        lambda x, d: sympy.sin(d) + x,
        lambda x, d: sympy.Max(d, x),
        lambda x, d: sympy.sign(d),
        lambda x, d: sympy.Piecewise((d, d > 0), (2 * d, True)),
        lambda x, d: sympy.floor(d),
    ],
)
def test_what_is_not_affine_in_the_disturbance_is_found(written):
    x, d = symbols("x", 1), symbols("d", 1)
    with pytest.raises(NotAffineError) as caught:
        split([x[0], written(x[0], d[0])], [x[0]], x, (), d, channel=False)
    assert (caught.value.state, caught.value.disturbance) == (1, d[0])


def test_what_is_affine_only_after_simplification_is_taken():
    x, d = symbols("x", 1), symbols("d", 1)
    parts = split([(x[0] + d[0]) ** 2 - d[0] ** 2], [x[0]], x, (), d, channel=False)
    assert parts.G_d[0, 0] == 2 * x[0]


def test_cases_that_are_constants_stay_as_they_were_written():
    """Friction of 1 or −1 has the slope 0 in v, and is not a constant."""
    v, u, d = sympy.symbols("v u d", real=True)
    friction = sympy.Piecewise((1, v > 0), (-1, True))
    parts = split([u + d - 3 * friction - 2 * v], [v], [v], [u], [d], channel=False)
    assert parts.A[0, 0] == -2
    assert (parts.G_f * sympy.Matrix(parts.f))[0] == -3 * friction


def test_a_disturbance_that_chooses_between_constants_is_refused():
    v, d = sympy.symbols("v d", real=True)
    with pytest.raises(NotAffineError):
        split([sympy.Piecewise((1, d > 0), (-1, True)) - v], [v], [v], [], [d], channel=False)
