"""The symbolic plant: what its user may write, what is refused and how, and that every back end says the same."""

import zipfile
from dataclasses import replace

import numpy as np
import pytest
import sympy
from hypothesis import given
from hypothesis import strategies as st

from ndob_fmu import Model, load_model
from ndob_fmu.codegen.compile_model import compile_model, linear_part
from ndob_fmu.errors import ModelError, NdobError
from tests.helpers.problems import MODELS, RANDOM, to_model

# n, m, p, q1, q2 = 4, 2, 5, 3, 1: pairwise different, as a shape that is mistaken for another must not go unnoticed.
FIELDS = {
    "name": "Plant",
    "states": ["a", "b", "c", "d"],
    "inputs": ["u", "v"],
    "outputs": ["a", "y", "z", "d", "w"],
    "disturbances": ["load"],
    "A": [[0, 1, 0, 0], [-2, -3, 0, 1], [0, 0, -1, 0], [1, 0, 0, -4]],
    "B": [[0, 0], [1, 0], [0, 1], [0, 2]],
    "C": [[1, 0, 0, 0], [1, 1, 0, 0], [0, 0, 3, 0], [0, 0, 0, 1], [0, 1, 1, 0]],
    "G_f": [[0, 0, 1], [1, 0, 0], [0, 1, 0], [0, 0, 0]],
    "G_d": [[0], [0], [0], [1]],
    "f": lambda x, u, p: [p.k * sympy.sin(x.a * x.b), x.c**2 * u.v, sympy.exp(-x.d)],
    "parameters": {"k": 2.0},
}


def plant(**changes):
    return Model(**(FIELDS | changes))


def refused(**changes):
    with pytest.raises(ModelError) as caught:
        compile_model(plant(**changes))  # some contradictions show when the equations are written
    return one_line(caught.value)


def one_line(error: NdobError) -> str:
    message = str(error)
    assert "\n" not in message
    assert ": expected " in message
    assert ", received " in message
    assert error.exit_code == 2
    return message


# -- what may be written


def test_the_matrices_keep_their_shapes_though_all_dimensions_differ():
    linear = linear_part(plant())
    shapes = [M.shape for M in (linear.A, linear.B, linear.C, linear.G_f, linear.G_d, linear.G, linear.selector)]
    assert shapes == [(4, 4), (4, 2), (5, 4), (4, 3), (4, 1), (4, 4), (1, 4)]
    np.testing.assert_array_equal(linear.C, FIELDS["C"])
    np.testing.assert_array_equal(linear.B, FIELDS["B"])


def test_numpy_arrays_serve_as_matrices():
    arrays = {name: np.array(FIELDS[name], dtype=float) for name in ("A", "B", "C", "G_f", "G_d")}
    np.testing.assert_array_equal(linear_part(plant(**arrays)).C, FIELDS["C"])


def test_without_a_channel_of_its_own_f_enters_where_d_does():
    matched = plant(G_f=None, G_d=FIELDS["G_f"], disturbances=["p1", "p2", "p3"])
    assert matched.matched
    assert linear_part(matched).G.shape == (4, 3)
    assert not plant().matched


def test_whether_f_and_d_share_a_channel_is_a_matter_of_numbers_and_not_of_how_they_are_written():
    k = sympy.Symbol("k")
    written_twice = plant(
        G_f=[[0, 0], [1, 0], [0, 1 / k], [0, 0.5]],
        G_d=[[0.0, 0.0], [1.0, 0.0], [0.0, 1.0 / k], [0.0, sympy.Rational(1, 2)]],
        f=lambda x, u, p: [x.a**2, x.b**2],
        disturbances=["p1", "p2"],
    )
    assert written_twice.matched


def test_a_plant_without_inputs_and_without_f_is_a_plant():
    model = plant(inputs=(), B=None, f=None, G_f=None, parameters={})
    linear = linear_part(model)
    assert (linear.B.shape, linear.G_f.shape, linear.G.shape) == ((4, 0), (4, 0), (4, 1))
    assert compile_model(model).nonlinearity((1.0,) * 4, (), ()) == ()


def test_the_plant_starts_at_zero_unless_told_and_the_estimate_where_the_plant_does():
    model = plant(xhat0=[1, 2, 3, 4])
    assert (model.x0, model.xhat0) == ((0.0,) * 4, (1.0, 2.0, 3.0, 4.0))
    assert plant(x0=[1, 2, 3, 4]).xhat0 == (1.0, 2.0, 3.0, 4.0)
    assert plant().xhat0 == (0.0,) * 4


def test_the_start_is_as_uncertain_as_its_two_values_differ_or_else_as_the_state_can_vary():
    model = plant(x0=[1.0, 0, 0, 0], xhat0=[0.0] * 4, ranges={"a": (-5.0, 5.0), "b": (-1e-5, 2e-5)})
    assert model.xhat0_std == pytest.approx((1.0, 3e-5 / np.sqrt(12.0), 1.0, 1.0))
    assert plant(ranges={"b": (-1.0, 1.0)}, xhat0_std=[2.0] * 4).xhat0_std == (2.0,) * 4


def test_a_start_without_a_range_is_as_uncertain_as_it_is_large_in_whatever_unit():
    assert plant(x0=[350.0, -2e5, 4e-3, 0.0]).xhat0_std == (350.0, 2e5, 4e-3, 1.0)


def test_one_number_for_each_name_can_be_told_by_the_names():
    model = plant(x0={"b": 5}, xhat0={"b": 4, "c": 3}, xhat0_std={"b": 9})
    assert (model.x0, model.xhat0, model.xhat0_std) == ((0, 5, 0, 0), (0, 4, 3, 0), (1, 9, 3, 1))
    two = {"disturbances": ["wind", "load"], "G_d": [[0, 0], [1, 0], [0, 1], [0, 0]], "f": None, "G_f": None}
    model = plant(**two, disturbance_bound={"load": 3}, disturbance_nominal={"load": 7})
    assert (model.disturbance_bound, model.disturbance_nominal) == ((1, 3), (0, 7))


@pytest.mark.parametrize("label", ["x0", "xhat0", "xhat0_std", "disturbance_bound", "disturbance_nominal"])
def test_a_name_that_is_none_of_those_of_a_field_is_refused(label):
    says = refused(**{label: {"speed": 1.0}})
    assert says.startswith(f"Plant.{label}: expected ")
    assert says.endswith("received 'speed'")


def test_parameters_enter_matrices_under_their_names_and_can_be_replaced():
    k = sympy.Symbol("k")
    A = [[0, 1, 0, 0], [-k, -3, 0, 1], [0, 0, -1, 0], [1 / k, 0, 0, -4]]
    model = plant(A=A)
    assert linear_part(model).A[3, 0] == 0.5
    changed = linear_part(model, {"k": 8.0}).A
    assert (changed[1, 0], changed[3, 0]) == (-8.0, 0.125)


# -- every back end says the same


@pytest.mark.parametrize("model", [*MODELS.values(), plant()], ids=lambda model: model.name)
def test_the_jacobian_of_f_agrees_with_differences(model):
    random = np.random.default_rng(1)
    n = len(model.states)
    p = model.parameter_values()
    J = sympy.lambdify(
        [[model.symbols[s] for s in group] for group in (model.states, model.inputs, model.parameters)],
        model.vector_field.jacobian,
    )
    for _ in range(5):
        x, u = random.normal(size=n), random.normal(size=len(model.inputs))
        h = 1e-6
        differences = np.array(
            [
                np.subtract(
                    compile_model(model).nonlinearity(x + h * e, u, p),
                    compile_model(model).nonlinearity(x - h * e, u, p),
                )
                / (2.0 * h)
                for e in np.eye(n)
            ]
        ).T
        assert differences.shape == (len(model.f_expressions), n)
        np.testing.assert_allclose(J(x, u, p), differences, rtol=1e-6, atol=1e-7 * (1.0 + np.max(abs(differences))))


MANY = [*MODELS.values(), *(to_model(problem.linear, f"Random{i}") for i, problem in enumerate(RANDOM)), plant()]


@pytest.mark.parametrize("model", MANY, ids=lambda model: model.name)
def test_the_derivatives_are_those_of_the_matrices_and_f(model):
    """ẋ = A x + B u + G_f f(x, u) + G_d w, with w = d or n(x, u) d."""
    random = np.random.default_rng(2)
    linear, eq, p = linear_part(model), compile_model(model), model.parameter_values()
    for _ in range(5):
        x, u, d = (random.normal(size=len(group)) for group in (model.states, model.inputs, model.disturbances))
        f = np.array(eq.nonlinearity(x, u, p))
        w = d if eq.channel is None else np.array(eq.channel.direction(x, u, p)) * d
        expected = linear.A @ x + linear.B @ u + linear.G_f @ f + linear.G_d @ w
        np.testing.assert_allclose(eq.derivatives(x, u, d, p), expected, rtol=1e-12, atol=1e-12)


@given(st.lists(st.floats(-3.0, 3.0), min_size=4, max_size=4), st.floats(-2.0, 2.0))
def test_f_is_evaluated_as_it_is_written(x, v):
    a, b, c, d = x
    expected = (2.0 * np.sin(a * b), c**2 * v, np.exp(-d))
    assert PLANT_EQUATIONS.nonlinearity(x, (0.0, v), (2.0,)) == pytest.approx(expected, rel=1e-12, abs=1e-12)


PLANT_EQUATIONS = compile_model(plant())


def test_other_parameter_values_reach_f():
    assert PLANT_EQUATIONS.nonlinearity((1.0, 1.0, 0.0, 0.0), (0.0, 0.0), (5.0,))[0] == pytest.approx(5.0 * np.sin(1.0))


# -- what is refused


@pytest.mark.parametrize(
    ("matrix", "value", "because"),
    [
        ("A", np.zeros((4, 3)), "(4, 4) because 4 states are named, received shape (4, 3)"),
        ("B", np.zeros((2, 4)), "(4, 2) because 4 states and 2 inputs are named, received shape (2, 4)"),
        ("B", None, "(4, 2) because 4 states and 2 inputs are named, received shape (0, 0)"),
        ("C", np.zeros((4, 5)), "(5, 4) because 5 outputs and 4 states are named, received shape (4, 5)"),
        ("G_f", np.zeros((4, 1)), "(4, 3) because f returns 3 expressions, received shape (4, 1)"),
        ("G_d", np.zeros((1, 4)), "(4, 1) because 4 states and 1 disturbances are named, received shape (1, 4)"),
    ],
)
def test_a_matrix_of_another_shape_is_refused_with_both_shapes(matrix, value, because):
    assert f"Plant.{matrix}: expected shape {because}" in refused(**{matrix: value})


@pytest.mark.parametrize("value", ["abc", 3, [[0, 1], [0]]])
def test_what_is_no_matrix_is_refused(value):
    assert "Plant.A: expected a (4, 4) matrix, received" in refused(A=value)


@pytest.mark.parametrize(
    ("entry", "says"),
    [
        (float("nan"), "expected finite entries, received nan"),
        (float("inf"), "expected finite entries"),
        (1j, "expected real numbers or SymPy expressions"),
        (sympy.Symbol("stiffness"), "expected expressions in k, received the symbol 'stiffness'"),
        (sympy.Symbol("a"), "received the symbol 'a'; likely cause: a parameter that is not declared, or a state in"),
    ],
)
def test_a_matrix_holds_finite_numbers_and_declared_parameters_only(entry, says):
    assert says in refused(B=[[0, 0], [1, 0], [0, 1], [0, entry]])


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"states": ["a", "b", "c", "a"]}, "received 'a', which is also in states"),
        ({"inputs": ["u", "a"]}, "received 'a', which is also in states"),
        ({"disturbances": ["u"]}, "received 'u', which is also in inputs"),
        ({"parameters": {"k": 1.0, "load": 2.0}}, "received 'load', which is also in disturbances"),
        ({"outputs": ["a", "y", "y", "d", "w"]}, "received 'y', which is also in outputs"),
        ({"outputs": ["a", "y", "u", "d", "w"]}, "received 'u', which is also in inputs"),
    ],
)
def test_a_name_that_is_used_twice_is_refused_with_both_places(changes, says):
    assert says in refused(**changes)


@pytest.mark.parametrize("name", ["two words", "1st", "_a", "lambda", "größe", "a.b", "", 3])
def test_names_must_serve_as_variables_in_the_code_that_is_written(name):
    assert f"received {name!r}" in refused(states=["a", "b", "c", name])
    assert f"received {name!r}" in refused(name=name)


@pytest.mark.parametrize(
    "name",
    [
        "a_hat",
        "a_start",
        "y_residual",
        "load_at_sample",
        "load_lagged",
        "k_std",
        "y_delay",
        "lag",
        "alpha",
        "valid",
        "time",
    ],
)
def test_names_that_the_fmus_use_themselves_are_refused(name):
    assert f"expected names that the FMUs do not use themselves, received {name!r}" in refused(inputs=["u", name])


def test_a_string_is_no_list_of_names():
    assert "Plant.states: expected a list of names, received 'abcd'" in refused(states="abcd")


@pytest.mark.parametrize("group", ["states", "outputs", "disturbances"])
def test_a_plant_has_at_least_one_of_each(group):
    assert f"Plant.{group}: expected at least one name, received none" in refused(**{group: []})


def test_an_output_that_is_named_like_a_state_must_be_that_state():
    message = refused(outputs=["a", "b", "z", "d", "w"])
    assert "expected output 'b' to be the state of that name, received b = a + b" in message
    assert "rows of C are in another order" in refused(outputs=["d", "y", "z", "a", "w"])


def test_units_and_descriptions_of_unknown_names_are_refused():
    assert "Plant.units: expected one of the names a, b, c, d, k, load, u, v, w, y, z, received 'speed'" in refused(
        units={"speed": "m/s"}
    )
    assert "received 'speed'" in refused(descriptions={"speed": "of the car"})


@pytest.mark.parametrize("value", [float("nan"), float("inf"), "2", None, [1.0]])
def test_a_parameter_is_a_finite_number_at_the_start_and_when_replaced(value):
    assert f"parameter 'k' of Plant: expected a finite number, received {value!r}" in refused(parameters={"k": value})
    with pytest.raises(ModelError) as caught:
        linear_part(plant(), {"k": value})
    assert f"parameter 'k' of Plant: expected a finite number, received {value!r}" in one_line(caught.value)


def test_a_parameter_that_is_not_there_cannot_be_replaced():
    with pytest.raises(ModelError) as caught:
        plant().parameter_values({"K": 1.0})
    assert "expected the parameter k, received 'K'" in one_line(caught.value)


@pytest.mark.parametrize(("entry", "value"), [(1 / sympy.Symbol("k"), 0.0), (sympy.sqrt(sympy.Symbol("k")), -1.0)])
def test_parameters_at_which_the_matrices_cannot_be_evaluated_are_refused(entry, value):
    model = plant(B=[[0, 0], [1, 0], [0, 1], [0, entry]])
    with pytest.raises(ModelError) as caught:
        linear_part(model, {"k": value})
    assert f"expected finite real entries, received k = {value:g}" in one_line(caught.value)
    assert np.isfinite(linear_part(model, {"k": 4.0}).B).all()


@pytest.mark.parametrize("vector", ["x0", "xhat0"])
@pytest.mark.parametrize("value", [[1.0, 2.0], [1.0, 2.0, 3.0, float("nan")], 3.0])
def test_start_values_are_one_finite_number_per_state(vector, value):
    assert f"Plant.{vector}: expected 4 finite numbers, received {value!r}" in refused(**{vector: value})


@pytest.mark.parametrize("value", [-1.0, float("inf"), "large"])
def test_bounds_are_finite_and_not_negative(value):
    assert f"Plant.lipschitz: expected a finite number ≥ 0, received {value!r}" in refused(lipschitz=value)
    assert refused(disturbance_bound=value).startswith("Plant.disturbance_bound: expected ")


def test_the_noise_of_a_sample_is_said_for_each_output_or_for_all():
    assert plant(noise_std=2e-3).told("noise_std") == (2e-3,) * 5
    assert plant(noise_std={"z": 2, "a": 0.0}).told("noise_std") == (0.0, 1e-4, 2.0, 1e-4, 1e-4)
    assert compile_model(plant(noise_std={"y": 3e-3})).noise_std == (1e-4, 3e-3, 1e-4, 1e-4, 1e-4)
    fewer = replace(plant(noise_std={"y": 3e-3}), outputs=["y"], C=[[1, 1, 0, 0]])
    assert compile_model(fewer).noise_std == (3e-3,)


@pytest.mark.parametrize(
    ("value", "says"),
    [
        ({"z": -1.0}, "Plant.noise_std, z: expected a finite number ≥ 0, received -1.0"),
        ({"z": float("nan")}, "Plant.noise_std, z: expected a finite number ≥ 0, received nan"),
        ({"z": "small"}, "Plant.noise_std, z: expected a finite number ≥ 0, received 'small'"),
        ({"b": 1.0}, "Plant.noise_std: expected one of the names a, d, w, y, z, received 'b'"),
        ("small", "Plant.noise_std: expected one number, or {name: number} with names of a, y, z, d, w"),
        ([1.0, 2.0], "Plant.noise_std: expected one number, or {name: number}"),
    ],
)
def test_a_noise_that_no_sensor_has_is_refused(value, says):
    assert says in refused(noise_std=value)


def test_a_noise_among_the_observers_defaults_is_refused_with_what_replaces_it(tmp_path):
    path = tmp_path / "old.py"
    path.write_text("from ndob_fmu import ObserverDefaults\nObserverDefaults(noise_std=1e-3)\n")
    with pytest.raises(ModelError) as caught:
        load_model(path)
    assert "expected the noise of each sensor in Model(noise_std={output: number})" in one_line(caught.value)


@pytest.mark.parametrize(
    ("field", "value", "expected"),
    [
        ("delay", {"y": 0.02}, (0.0, 0.02, 0.0, 0.0, 0.0)),
        ("delay", 0.02, (0.02,) * 5),
        ("bias_std", {"w": 2}, (0.0, 0.0, 0.0, 0.0, 2.0)),
        ("parameter_std", {"k": 0.2}, (0.2,)),
        ("state_noise", {"c": 0.1, "a": 0.3}, (0.3, 0.0, 0.1, 0.0)),
    ],
)
def test_what_is_known_of_sensors_and_model_reaches_the_equations_in_order(field, value, expected):
    model = plant(**{field: value})
    assert model.told(field) == getattr(compile_model(model), field) == expected
    assert set(plant().told(field)) == {0.0}


@pytest.mark.parametrize(
    ("field", "value", "says"),
    [
        ("delay", {"y": -0.01}, "Plant.delay, y: expected a finite number ≥ 0, received -0.01"),
        ("bias_std", {"y": float("nan")}, "Plant.bias_std, y: expected a finite number ≥ 0, received nan"),
        ("parameter_std", {"kk": 1.0}, "Plant.parameter_std: expected the name k, received 'kk'"),
        ("state_noise", {"y": 1.0}, "Plant.state_noise: expected one of the names a, b, c, d, received 'y'"),
        ("state_noise", {"a": float("inf")}, "Plant.state_noise, a: expected a finite number ≥ 0, received inf"),
    ],
)
def test_what_is_wrongly_said_of_sensors_and_model_is_refused(field, value, says):
    assert says in refused(**{field: value})


def test_names_from_which_the_fmus_derive_the_same_are_refused():
    assert "derive 'y_bias_std'" in refused(parameters={"k": 2.0, "y_bias": 1.0})
    plant(parameters={"k": 2.0, "b_bias": 1.0})  # b is a state that no sensor has for its output


def nested_if(x, u, p):
    return [x.a if x.a > 0 else 0, 0, 0]


@pytest.mark.parametrize(
    ("f", "says"),
    [
        (lambda x, u, p: [x.angle, 0, 0], "received x.angle"),
        (lambda x, u, p: x.a, "is not iterable"),
        (lambda x, u, p: [np.sin(x.a), 0, 0], "has no"),
        (lambda x, u: [x.a, 0, 0], "takes 2 positional arguments"),
        (nested_if, "truth value"),
        (lambda x, u, p: [x.a > 0, 0, 0], "expected real numbers or SymPy expressions, received a > 0"),
        (lambda x, u, p: [sympy.I * x.a, 0, 0], "expected real numbers or SymPy expressions, received I*a"),
        (lambda x, u, p: [sympy.Symbol("load"), 0, 0], "received the symbol 'load'"),
        (lambda x, u, p: [x.a, 0], "(4, 2) because f returns 2 expressions, received shape (4, 3)"),
        (lambda x, u, p: [sympy.Function("g")(x.a), 0, 0], "expected functions with a Python form, received g(a)"),
        (lambda x, u, p: [1 / x.a, 0, 0], "Plant at its start values: expected matrices and f that can be evaluated"),
        ("sin(a)", "not callable"),
    ],
)
def test_a_misuse_of_f_is_explained(f, says):
    assert says in refused(f=f)


def test_an_error_inside_sympy_is_not_blamed_on_f():
    inside = {"__name__": "sympy.functions.stand_in"}
    exec("def broken(x): raise AttributeError('a fault of this library')", inside)
    with pytest.raises(AttributeError, match="of this library"):
        plant(f=lambda x, u, p: [inside["broken"](x.a), 0, 0])


# -- finding a model


def test_the_built_in_model_is_found_by_its_name():
    assert load_model("flexible_joint").name == "FlexibleJoint"


def test_a_file_with_a_model_is_found_by_its_path(tmp_path):
    path = tmp_path / "mine.py"
    path.write_text(
        "from ndob_fmu import Model\n"
        "model = Model(name='Mine', states=['a', 'b'], outputs=['a'], disturbances=['d'],\n"
        "              A=[[0, 1], [0, 0]], C=[[1, 0]], G_d=[[0], [1]])\n"
    )
    assert load_model(path).name == "Mine"
    assert load_model(str(path)).states == ("a", "b")


@pytest.mark.parametrize("source", ["flexible_joints", "no/such/file.py", ""])
def test_a_model_that_is_not_there_is_refused_with_the_built_in_names(source):
    with pytest.raises(ModelError) as caught:
        load_model(source)
    message = one_line(caught.value)
    assert "expected a built-in name (flexible_joint) or the path of a Python file that defines `model`" in message
    assert f"received {source!r}" in message


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("import ndob_fmu\n", "expected a file that defines `model = Model(...)`, received no `model`"),
        ("model = 3\n", "received `model` of type int"),
        ("x = 1\nmodel = \n", "SyntaxError: invalid syntax"),
        ("x = 1\n\nmodel = undefined\n", "NameError: name 'undefined' is not defined (line 3)"),
        ("import no_such_module_at_all\n", "ModuleNotFoundError"),
        ("import numpy\n\nnumpy.linalg.inv(numpy.zeros((2, 2)))\n", "LinAlgError: Singular matrix (line 3)"),
        ("raise ValueError('two\\nlines')\n", "ValueError: two lines (line 1)"),
        ("import sys\nsys.exit('done')\n", "SystemExit: done (line 2)"),
        ("\x00", "received"),
    ],
)
def test_a_broken_model_file_is_named_with_what_is_wrong_and_where(tmp_path, text, says):
    path = tmp_path / "broken.py"
    path.write_text(text)
    with pytest.raises(ModelError) as caught:
        load_model(path)
    message = one_line(caught.value)
    assert message.startswith(str(path))
    assert says in message


def test_a_model_file_that_contradicts_itself_is_named_with_the_contradiction(tmp_path):
    path = tmp_path / "wrong.py"
    path.write_text(
        "from ndob_fmu import Model\n"
        "model = Model(name='Wrong', states=['a', 'b'], outputs=['a'], disturbances=['d'],\n"
        "              A=[[0, 1]], C=[[1, 0]], G_d=[[0], [1]])\n"
    )
    with pytest.raises(ModelError) as caught:
        load_model(path)
    assert one_line(caught.value).startswith(f"{path}: Wrong.A: expected shape (2, 2) because 2 states are named")


def test_a_model_can_be_varied_without_touching_the_original():
    joint = MODELS["flexible_joint"]
    other = replace(joint, name="Other", x0=[0.0] * 4)
    assert (other.name, other.x0, joint.x0) == ("Other", (0.0,) * 4, (1.0,) * 4)
    np.testing.assert_array_equal(linear_part(other).A, linear_part(joint).A)


@pytest.mark.parametrize("text", ["a\x07bell", "\ud800", "\ufffe", 5])
def test_a_description_that_no_model_description_could_carry_is_refused(text):
    assert "text of a: expected characters that XML can carry" in refused(descriptions={"a": text})
    assert "text of description: expected characters that XML can carry" in refused(description=text)


def test_an_archive_in_place_of_a_model_file_is_called_one(tmp_path):
    path = tmp_path / "Plant.fmu"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", "")
    with pytest.raises(ModelError, match="expected a Python file that defines `model`, received an archive"):
        load_model(path)
