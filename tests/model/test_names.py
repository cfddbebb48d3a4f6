"""A model may use any name that Python can write after a dot; the code that is written of it hides nothing by them."""

import builtins
import keyword

import pytest
import sympy

from ndob_fmu import FmuComponent, Model, NdobError, System, build, design, simulate
from ndob_fmu.codegen.compile_model import compile_model
from tests.attacks.names import ROLES, judge, walk, with_name

BUILTINS = [name for name in dir(builtins) if not name.startswith("_") and not keyword.iskeyword(name)]
MATHEMATICS = ["E", "I", "N", "O", "Q", "S", "beta", "gamma", "zeta", "pi", "sin", "sqrt", "Abs", "Symbol"]
OTHERS = [
    "id",
    "self",
    "count",
    "index",
    "name",
    "type",
    "value",
    "dt",
    "t",
    "x",
    "u",
    "p",
    "math",
    "numpy",
    "np",
    "id_",
]


@pytest.mark.parametrize("role", ROLES)
def test_names_of_builtins_of_mathematics_and_of_methods_are_names_like_others(role):
    for name in [*MATHEMATICS, *OTHERS, "abs", "max", "float", "sum"][ROLES.index(role) :: len(ROLES)]:
        judge(role, name)
    walk(role, {"states": "id", "inputs": "abs", "outputs": "sin", "disturbances": "I", "parameters": "E"}[role])


def test_all_builtins_at_once_serve_as_parameters():
    values = {name: 0.5 + k for k, name in enumerate(BUILTINS)}
    model = Model(
        name="Builtins",
        states=["a"],
        outputs=["a"],
        disturbances=["d"],
        A=[[-1]],
        C=[[1]],
        G_d=[[1]],
        f=lambda x, u, p: [
            sympy.Max(x.a, 1) * sympy.Abs(x.a) * sum(k * getattr(p, name) for k, name in enumerate(BUILTINS))
        ],
        parameters=values,
    )
    found = compile_model(model).derivatives((2.5,), (), (0.0,), tuple(values.values()))
    expected = -2.5 + 2.5**2 * sum(k * value for k, value in enumerate(values.values()))
    assert found == pytest.approx((expected,), rel=1e-14)


@pytest.mark.parametrize("role", ROLES)
@pytest.mark.parametrize("name", ["lambda", "def", "None"])
def test_a_keyword_is_refused_with_a_name_that_would_do(role, name):
    with pytest.raises(NdobError) as refused:
        with_name(role, name)
    assert f"received {name!r}" in str(refused.value)
    assert f"{name}_ can" in str(refused.value)
    assert len(str(refused.value)) < 300


@pytest.mark.parametrize("entry", ["x.y", "foo(", "a b", "print", "1/0", "lambda", "[1]"])
def test_a_text_that_is_no_expression_is_refused_in_a_line(entry):
    fields = {"states": ["x"], "outputs": ["x"], "disturbances": ["d"], "C": [[1]], "G_d": [[1]]}
    with pytest.raises(NdobError, match=r"^Bad\.A: expected"):
        Model(name="Bad", A=[[entry]], **fields)


def test_a_motor_with_the_currents_id_and_iq_runs_as_fmus(tmp_path):
    """A motor in d and q, whose d axis is named as in every textbook; the names in the other roles are as bad."""
    R, L = sympy.symbols("max E")
    motor = Model(
        name="Motor",
        states=["rate", "id", "iq"],
        inputs=["abs", "float"],
        outputs=["rate", "id", "iq"],
        disturbances=["sum"],
        A=[[-1, 0, 2], [0, -R / L, 0], [-1, 0, -R / L]],
        B=[[0, 0], [1 / L, 0], [0, 1 / L]],
        C=[[1, 0, 0], [0, 1, 0], [0, 0, 1]],
        G_d=[[-1], [0], [0]],
        G_f=[[0, 0], [1, 0], [0, 1]],
        f=lambda x, u, p: [sympy.sin(x.rate) * sympy.Abs(x.iq), -sympy.sin(x.rate) * sympy.Max(x.id, -9)],
        parameters={"max": 2.0, "E": 0.1},
        lipschitz=20.0,
    )
    assert len(design(motor, step_size=1e-3).poles) == 3
    plant, observer = build(motor, tmp_path)
    sigma = {f"{name}_noise_std": 1e-6 for name in motor.outputs}
    system = System()
    system.add("plant", FmuComponent(plant), {"abs": 0.1, "float": 0.2, "sum": 0.7})
    system.add("observer", FmuComponent(observer), {"abs": 0.1, "float": 0.2, **sigma})
    for name in motor.outputs:
        system.connect(f"plant.{name}", f"observer.{name}")
    run = simulate(system, stop_time=0.1, step_size=1e-3)
    assert run["observer.sum_hat"][-1] == pytest.approx(0.7, rel=1e-2)
    assert run["observer.id_hat"][-1] == pytest.approx(run["plant.id"][-1], rel=1e-4)
