"""A model's equations for many rows: the numbers of the equations of one row, and no error where a row has none."""

import numpy as np
import pytest

from ndob_fmu.codegen.compile_model import compile_model
from ndob_fmu.codegen.row_functions import row_functions
from ndob_fmu.model.model import Model

MODEL = Model(
    name="Motor",
    states=["rate", "current"],
    inputs=["voltage"],
    outputs={"speed": lambda x, u, p: 3 * x.rate + p.offset, "current": lambda x, u, p: x.current},
    disturbances=["load"],
    dynamics=lambda x, u, d, p: [(x.current - x.rate**3 + d.load) / p.inertia, u.voltage - 2 * x.current],
    parameters={"inertia": 0.5, "offset": 1.0},
    disturbance_bound=1.0,
)
K = 1500


def rows(model, inertia=None):
    """Arguments of K rows, with parameters that are the same in all rows, or with an inertia of each."""
    random = np.random.default_rng(3)
    told = np.array(model.parameter_values())
    p = np.broadcast_to(told, (K, len(told)))
    if inertia is not None:
        p = np.column_stack([inertia, p[:, 1]])
    return random.normal(size=(K, 2)), random.normal(size=(K, 1)), random.normal(size=(K, 1)), p


@pytest.mark.parametrize("inertia", [None, np.linspace(0.2, 2.0, K)], ids=["the same", "of each row"])
def test_each_row_has_the_numbers_of_the_equations_with_constants_and_parameters_or_without(inertia):
    equations, functions, (x, u, d, p) = compile_model(MODEL), row_functions(MODEL), rows(MODEL, inertia)
    slopes, sensitivity = functions.slopes(x, u, d, p), functions.sensitivity(x, u, d, p)
    derivatives, outputs = functions.derivatives(x, u, d, p), functions.output(x, u, d, p)
    for k in (0, 999, 1000, K - 1):
        at = [part[k].tolist() for part in (x, u, d, p)]
        for found, expected in (
            (slopes[k].ravel(), equations.linearisation(*at)),
            (sensitivity[k].ravel(), equations.sensitivity(*at)),
            (derivatives[k], equations.derivatives(*at)),
            (outputs[k], equations.output(at[0], at[1], at[3])),
        ):
            np.testing.assert_allclose(found, expected, rtol=1e-14)
    assert np.all(slopes[:, 2, 0] == 3.0)


def test_a_parameter_of_0_that_is_divided_by_gives_rows_without_numbers_and_no_error():
    x, u, d, p = rows(MODEL)
    found = row_functions(MODEL).derivatives(x, u, d, np.broadcast_to([0.0, 1.0], p.shape))
    assert not np.isfinite(found[:, 0]).any()
    assert np.isfinite(found[:, 1]).all()
