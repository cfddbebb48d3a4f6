"""A log of a plant that a controller drives tells a parameter, where it holds the samples that the controller had."""

from math import cos, sin

import pytest

from ndob_fmu.log.fit.fit_log import fit_log
from ndob_fmu.log.made_log import Sensor, make_log, walk
from ndob_fmu.model.model import Model

STOP, INERTIA = 12.0, 2e-3
MEASURED = {"angle": 1e-3, "rate": 0.3}


def drive(**sensors):
    """Return a drive whose inertia is told a quarter too small."""
    noise = MEASURED | dict.fromkeys(sensors, 1e-4)
    return Model(
        name="Drive",
        states=["angle", "rate"],
        inputs=["torque"],
        outputs={"angle": lambda x, u, p: x.angle, "rate": lambda x, u, p: x.rate, **sensors},
        disturbances=["load"],
        dynamics=lambda x, u, d, p: [x.rate, (u.torque - 2e-3 * x.rate + d.load) / p.inertia],
        parameters={"inertia": 0.75 * INERTIA},
        noise_std=noise,
        disturbance_bound=0.5,
        xhat0_std=[0.01, 0.1],
    )


WITH_TWO_ENCODERS = drive(other_angle=lambda x, u, p: x.angle, other_rate=lambda x, u, p: x.rate)


def follow(t, y):
    """Return the torque of a controller that believes the last two sensors."""
    angle, rate = 3.0 * sin(2.0 * t) + sin(5.3 * t), 6.0 * cos(2.0 * t) + 5.3 * cos(5.3 * t)
    acceleration = -12.0 * sin(2.0 * t) - 28.1 * sin(5.3 * t)
    return [INERTIA * acceleration + 0.9 * (angle - y[-2]) + 0.05 * (rate - y[-1])]


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_inertia_is_found_where_the_log_has_the_samples_of_the_controller_and_not_where_it_lacks_them(
    tmp_path, seed
):
    """The torque answers to the noise that the log shows. If not, it tells of the states what no sample says."""

    def off(driven):
        """Return the error of the inertia over its standard deviation, in a log of that drive."""
        make_log(
            driven,
            tmp_path / "log.csv",
            follow,
            step=5e-3,
            stop_time=STOP,
            disturbances={"load": walk(size=0.1, pace=1.0, seed=6 + seed, stop_time=STOP)},
            sensors={name: Sensor(std) for name, std in MEASURED.items()},
            parameters={"inertia": INERTIA},
            jitter=0.03,
            seed=seed,
        )
        # The model of `fit` has no other encoders, and columns that no output has are left alone.
        found = fit_log(drive(), tmp_path / "log.csv", tmp_path, free=["inertia"]).parameters["inertia"]
        return abs(found.value - INERTIA) / found.std

    assert off(drive()) < 2.0
    assert off(WITH_TWO_ENCODERS) > 2.5
