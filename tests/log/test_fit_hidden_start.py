"""A parameter that only its product with a state shows, which no sensor measures."""

import numpy as np
import pytest

from ndob_fmu.log.fit import fit_parameters
from ndob_fmu.log.fit.fit_log import fit_log
from ndob_fmu.log.made_log import Sensor, make_log, sines
from ndob_fmu.model.model import Model

# A charge burns down, and heats a bath: half of the charge with twice the heat does the same.
BATH = Model(
    name="Bath",
    states=["charge", "temperature"],
    inputs=["heater"],
    outputs=["temperature"],
    disturbances=["loss"],
    dynamics=lambda x, u, d, p: [-0.005 * x.charge, p.heat * x.charge - p.cooling * x.temperature + u.heater + d.loss],
    parameters={"heat": 0.8, "cooling": 0.1},
    noise_std={"temperature": 0.05},
    disturbance_bound=0.5,
    x0=[20.0, 30.0],
)


@pytest.fixture
def log(tmp_path):
    path = tmp_path / "log.csv"
    make_log(
        BATH,
        path,
        lambda t, _: [1.0 if t % 60.0 < 30.0 else 0.0],
        step=1.0,
        stop_time=600.0,
        disturbances={"loss": sines(0.2, 0.01, 3)},
        sensors={"temperature": Sensor(0.05)},
        parameters={"heat": 0.92},
        seed=2,
    )
    return path


def test_a_parameter_of_which_a_hidden_start_tells_all_is_not_found(log, tmp_path):
    heat = fit_log(BATH, log, tmp_path / "out", free=["heat"]).parameters.get("heat")
    assert heat is None or abs(heat.value - 0.92) < 3.0 * heat.std


def test_a_search_that_does_not_arrive_tells_no_parameter(log, tmp_path, monkeypatch):
    """As along a ridge of equal products, where each step says that there is far to go, and none makes it likelier."""
    step_of, fit_class, fits = fit_parameters.most_likely, fit_parameters.fit_class, []

    def never_there(problem, *given):
        prior = problem.parameter_std
        return step_of(problem, *given)._replace(step=-0.9 * prior, covariance=np.diag((1e-3 * prior) ** 2))

    def kept(*given, **more):
        fits.append(fit_class(*given, **more))
        return fits[-1]

    monkeypatch.setattr(fit_parameters, "most_likely", never_there)
    monkeypatch.setattr(fit_parameters, "fit_class", kept)
    found = fit_log(BATH, log, tmp_path / "out", free=["heat"])
    assert found.parameters == {}
    assert np.sqrt(fits[0].covariance[0, 0]) > 0.9 * fits[0].problem.parameter_std[0]
