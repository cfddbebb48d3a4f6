"""The built FMUs, driven through fmpy: against SciPy, against their own core, and where they are misused."""

from __future__ import annotations

import logging
from contextlib import contextmanager
from math import inf, nan

import fmpy
import numpy as np
import pytest
from fmpy.fmi2 import FMU2Slave
from scipy.integrate import solve_ivp

from ndob_fmu import build
from ndob_fmu.codegen.compile_model import compile_model, linear_part
from ndob_fmu.cosim import FmuComponent, System, simulate
from ndob_fmu.cosim.component import recordable
from ndob_fmu.errors import SimulationError
from ndob_fmu.runtime.blocks.disturbance import Generator
from ndob_fmu.runtime.blocks.plant import Plant
from ndob_fmu.runtime.design.gains import orthogonal_factor
from ndob_fmu.runtime.design.schedule import PiSchedule, gain_table
from ndob_fmu.runtime.step.paper_observer import paper_observer
from tests.helpers.observers import sampled_observer
from tests.helpers.problems import MODELS

STATES = ("link_angle", "link_rate", "motor_angle", "motor_rate")
MODEL = MODELS["flexible_joint"]
PAPER = {"method": 1}
# A moderate π, reached soon, so that a few seconds show all of the schedule.
MODERATE = {**PAPER, "pi_end": 1e6, "pi_ramp_time": 1.0}


class Driven:
    """One component, driven call by call and read by name."""

    def __init__(self, fmu, starts=(), *, start_time=0.0, inputs=()):
        self.component = FmuComponent(fmu)
        self.inputs = tuple(inputs)
        self.names = [variable.name for variable in recordable(self.component.variables)]
        self.component.setup(start_time, start_time + 100.0, dict(starts), self.inputs)

    def set(self, **values):
        self.component.set_inputs(np.array([values[name] for name in self.inputs], dtype=float))

    def get(self):
        values = np.empty(len(self.names))
        self.component.get_outputs(values)
        return dict(zip(self.names, values.tolist(), strict=True))


@contextmanager
def driven(fmu, starts=(), **options):
    instance = None
    try:
        instance = Driven(fmu, starts, **options)
        yield instance
    finally:
        if instance is not None:
            instance.component.close()


def flexible_joint_equations(t, x, torque, gravity=10.0, stiffness=1.0, damping=1.0):
    """Return ẋ of the paper's example, written out by hand."""
    link, link_rate, motor, motor_rate = x
    spring = stiffness * (link - motor)
    return [link_rate, -spring - gravity * np.sin(link), motor_rate, spring - damping * motor_rate + torque]


def exact_plant(times, x0, torque, *, breaks=(), **parameters):
    """Return x (len(times), 4) by DOP853 at its finest, restarted where the torque(t) has a kink."""
    x, t, rows = np.array(x0, dtype=float), times[0], [np.array(x0, dtype=float)]
    for end in [*breaks, times[-1]]:
        inside = times[(times > t) & (times <= end)]
        solution = solve_ivp(
            lambda s, x: flexible_joint_equations(s, x, torque(s), **parameters),
            (t, end),
            x,
            method="DOP853",
            rtol=1e-12,
            atol=1e-13,
            t_eval=np.union1d(inside, [end]),
        )
        rows += list(solution.y.T[: len(inside)])
        x, t = solution.y[:, -1], end
    return np.array(rows)


# -- the plant


def test_the_plant_follows_its_equations_over_the_default_experiment(flexible_joint):
    recording = simulate(flexible_joint.plant, step_size=0.01)
    exact = exact_plant(recording.time, [1.0, 1.0, 1.0, 1.0], lambda t: 2.0)
    assert recording.time[-1] == 20.0
    for column, state in enumerate(STATES):
        np.testing.assert_allclose(recording[f"FlexibleJointPlant.{state}"], exact[:, column], rtol=0, atol=1e-8)


def test_the_plant_follows_its_equations_with_other_parameters_and_a_sine_that_sets_in_inside_a_step(flexible_joint):
    parameters = {"gravity_torque": 4.0, "joint_stiffness": 7.0, "motor_damping": 0.3}
    x0 = [0.3, -0.4, 0.5, 2.0]
    recording = simulate(
        flexible_joint.plant,
        step_size=0.01,
        stop_time=20.0,
        start_values={
            **parameters,
            **{f"{state}_start": value for state, value in zip(STATES, x0, strict=True)},
            "disturbance.kind": 3,
            "disturbance.amplitude": 2.5,
            "disturbance.frequency": 1.3,
            "disturbance.start_time": 3.3333,
            "motor_torque": 0.75,
            "load_torque": -0.5,
        },
    )

    def torque(t):
        return 0.25 + (2.5 * np.sin(2.0 * np.pi * 1.3 * (t - 3.3333)) if t >= 3.3333 else 0.0)

    exact = exact_plant(recording.time, x0, torque, breaks=[3.3333], gravity=4.0, stiffness=7.0, damping=0.3)
    for column, state in enumerate(STATES):
        np.testing.assert_allclose(recording[f"FlexibleJointPlant.{state}"], exact[:, column], rtol=0, atol=1e-8)
    total = [torque(t) - 0.75 for t in recording.time]
    np.testing.assert_allclose(recording["FlexibleJointPlant.load_torque_total"], total, rtol=0, atol=1e-12)


def test_the_plants_trajectory_hardly_depends_on_the_communication_step(flexible_joint):
    coarse = simulate(flexible_joint.plant, step_size=0.5, stop_time=10.0)
    fine = simulate(flexible_joint.plant, step_size=0.01, output_interval=0.5, stop_time=10.0)
    np.testing.assert_allclose(coarse.columns, fine.columns, rtol=0, atol=1e-8)


# -- the observer, and both together


def torque_at(k):
    return 0.5 * np.sin(0.3 * k)


SIGMA = [1e-3, 2e-3]  # rad, of motor and link


def paper_core(eq, parameters, x_hat):
    tuning = {"noise_std": SIGMA, "disturbance_bound": [3.0]}
    return paper_observer(eq, parameters, PiSchedule(10.0, 1e8, 0.5), alpha=0.5, **tuning)


def sampled_core(eq, parameters, x_hat):
    tuning = {"noise_std": SIGMA, "disturbance_bound": [3.0], "disturbance_rate": [20.0], "order": 1, "pi": 1e8}
    return sampled_observer(eq, parameters, alpha=0.5, x_hat=x_hat, x_std=[0.3, 0.4, 0.5, 0.6], **tuning)


@pytest.mark.parametrize(("method", "make"), [(1, paper_core), (2, sampled_core)])
def test_the_observer_is_its_core_to_the_last_bit(flexible_joint, method, make):
    eq = compile_model(MODEL)
    parameters = [9.0, 1.5, 0.8]
    core = make(eq, parameters, [0.1, 0.2, 0.3, 0.4])
    state = core.init([0.1, 0.2, 0.3, 0.4])
    starts = {
        **dict(zip(eq.parameters, parameters, strict=True)),
        **dict(zip((f"{name}_hat_start" for name in STATES), [0.1, 0.2, 0.3, 0.4], strict=True)),
        **dict(zip((f"{name}_hat_start_std" for name in STATES), [0.3, 0.4, 0.5, 0.6], strict=True)),
        **{"method": method, "alpha": 0.5, "pi_start": 10.0, "pi_end": 1e8, "pi_ramp_time": 0.5},
        **{
            "motor_angle_noise_std": SIGMA[0],
            "link_angle_noise_std": SIGMA[1],
            "disturbance_bound": 3.0,
            "disturbance_rate": 20.0,
            "disturbance_order": 1,
        },
    }
    with driven(flexible_joint.observer, starts, inputs=["link_angle", "motor_torque", "motor_angle"]) as observer:
        observer.component.initialize()
        for k in range(300):
            y = [np.cos(0.01 * k), np.sin(0.02 * k)]
            observer.set(motor_angle=y[0], link_angle=y[1], motor_torque=torque_at(k))
            observer.component.step(0.002 * k, 0.002)
            state, estimate = core.step(state, [torque_at(k)], y, 0.002)
            got = observer.get()
            assert [got[f"{name}_hat"] for name in STATES] == list(estimate.x_hat)
            assert [got["load_torque_hat"]] == list(estimate.d_hat)
            assert [got["load_torque_at_sample"]] == list(estimate.d_at_sample)
            assert [got["load_torque_std"]] == list(estimate.d_std)
            assert [got["motor_angle_residual"], got["link_angle_residual"]] == list(estimate.residual)
            assert [got["motor_angle_residual_std"], got["link_angle_residual_std"]] == list(estimate.residual_std)
            assert got["valid"] == estimate.valid


def test_the_coupled_fmus_are_the_same_plant_and_observer_run_as_plain_python(flexible_joint):
    steps, H = 3000, 1e-3
    starts = {f"observer.{name}": value for name, value in MODERATE.items()}
    recording = simulate(flexible_joint.system, stop_time=steps * H, step_size=H, start_values=starts)

    eq = compile_model(MODEL)
    parameters = list(eq.parameters.values())
    plant = Plant(eq, parameters, [Generator(kind=1, amplitude=2.0)])
    observer = paper_observer(eq, parameters, PiSchedule(1.0, 1e6, 1.0), alpha=1.0)
    x, x_hat = plant.init(eq.x0, 0.0), observer.init(eq.xhat0)
    truth, estimates = [x.x], []
    for k in range(steps):
        x_hat, estimate = observer.step(x_hat, [0.0], observer.linear.C @ x.x, H)
        x = plant.step(x, [0.0], [0.0], (k + 1) * H)
        truth.append(x.x)
        estimates.append([*estimate.x_hat, *estimate.d_hat])
    plants = np.column_stack([recording[f"plant.{name}"] for name in STATES])
    observers = np.column_stack([recording[f"observer.{name}_hat"] for name in (*STATES, "load_torque")])
    np.testing.assert_allclose(plants, truth, rtol=0, atol=1e-10)
    np.testing.assert_allclose(observers[1:], estimates, rtol=0, atol=1e-10)


def continuous_solution(times):
    """Return x̂ and d̂ (len(times), 5) of plant and observer as one system of differential equations, y continuous."""
    linear = linear_part(MODEL)
    schedule = PiSchedule(1.0, MODERATE["pi_end"], MODERATE["pi_ramp_time"])
    table = gain_table(linear, schedule, alpha=1.0)

    def derivatives(t, state):
        x, x_hat = state[:4], state[4:]
        f_hat = linear.G_f[:, 0] * (-10.0 * np.sin(x_hat[0]))
        error = linear.C @ (x - x_hat)
        dx_hat = linear.A @ x_hat + f_hat + table.gain(schedule.log_pi(t)) @ error
        return [*flexible_joint_equations(t, x, 2.0), *dx_hat]

    state, rows = np.array([1.0] * 4 + [-1.0] * 4), []
    for begin, end in ((0.0, schedule.ramp_time), (schedule.ramp_time, times[-1])):
        inside = times[(times > begin) & (times <= end)]
        solution = solve_ivp(
            derivatives,
            (begin, end),
            state,
            method="DOP853",
            rtol=1e-12,
            atol=1e-13,
            t_eval=np.union1d(inside, [end]),
        )
        for t, column in zip(solution.t, solution.y.T, strict=True):
            if t in inside:
                log_pi = schedule.log_pi(t)
                W = orthogonal_factor(linear, table.gain(log_pi))
                estimate = np.exp(0.5 * log_pi) * W @ linear.C @ (column[:4] - column[4:])
                rows.append([*column[4:], *(linear.selector @ estimate)])
        state = solution.y[:, -1]
    return np.array(rows)


def test_the_coupled_fmus_converge_to_the_continuous_system_with_order_three(flexible_joint):
    """The error of a quadratic through the samples is O(H³), in the output and in everything made from it."""
    times = np.linspace(1.52, 2.0, 25)
    exact = continuous_solution(times)
    step_sizes = np.array([4e-3, 2e-3, 1e-3])
    errors = []
    for H in step_sizes:
        starts = {f"observer.{name}": value for name, value in MODERATE.items()}
        recording = simulate(
            flexible_joint.system, stop_time=2.0, step_size=H, output_interval=0.02, start_values=starts
        )
        rows = np.searchsorted(recording.time, times - 1e-9)
        np.testing.assert_allclose(recording.time[rows], times, atol=1e-12)
        estimates = np.column_stack([recording[f"observer.{name}_hat"][rows] for name in (*STATES, "load_torque")])
        errors.append(np.abs(estimates - exact).max(axis=0))
    slopes = np.polyfit(np.log(step_sizes), np.log(errors), 1)[0]
    assert np.all(slopes > 2.8), slopes
    assert np.all(slopes < 3.3), slopes


def test_changed_physical_parameters_change_both_fmus_alike(flexible_joint):
    def late_error(**changes):
        starts = {f"observer.{name}": value for name, value in MODERATE.items()}
        starts |= {name.replace("__", "."): value for name, value in changes.items()}
        recording = simulate(flexible_joint.system, stop_time=5.0, step_size=5e-3, start_values=starts)
        error = recording["observer.load_torque_hat"] - recording["plant.load_torque_total"]
        return np.abs(error[recording.time >= 4.0]).max()

    both = late_error(
        plant__joint_stiffness=3.0,
        observer__joint_stiffness=3.0,
        plant__gravity_torque=6.0,
        observer__gravity_torque=6.0,
    )
    assert both < 0.1
    assert late_error(plant__joint_stiffness=3.0) > 5.0 * both


# -- outputs in initialization mode


@pytest.mark.parametrize("start_time", [0.0, 2.5])
def test_the_plants_outputs_are_right_before_the_first_step_and_follow_what_is_set(flexible_joint, start_time):
    starts = {"link_angle_start": 0.25, "motor_rate_start": -2.0, "disturbance.kind": 2, "disturbance.amplitude": 3.0}
    options = {"start_time": start_time, "inputs": ["load_torque", "motor_torque"]}
    with driven(flexible_joint.plant, starts, **options) as plant:
        expected = {"motor_angle": 1.0, "link_angle": 0.25, "link_rate": 1.0, "motor_rate": -2.0}
        for load in (0.0, 0.5):
            plant.set(load_torque=load, motor_torque=9.0)
            assert plant.get() == {**expected, "load_torque_total": 3.0 * start_time + load}
        plant.component.initialize()
        assert plant.get() == {**expected, "load_torque_total": 3.0 * start_time + 0.5}


def test_the_observers_outputs_are_right_before_the_first_step_and_follow_what_is_set(flexible_joint):
    linear = linear_part(MODEL)
    table = gain_table(linear, PiSchedule(100.0, 1e6, 1.0), alpha=1.0)
    gain = 10.0 * (linear.selector @ orthogonal_factor(linear, table.gain(np.log(100.0))))[0]
    starts = {**MODERATE, "pi_start": 100.0, "motor_angle_hat_start": 0.5}
    with driven(flexible_joint.observer, starts, inputs=["motor_angle", "link_angle"]) as observer:
        for y in ([0.0, 0.0], [1.0, 2.0], [0.4, -0.9]):
            observer.set(motor_angle=y[0], link_angle=y[1])
            got = observer.get()
            residual = [y[0] - 0.5, y[1] + 1.0]
            assert [got[f"{name}_hat"] for name in STATES] == [-1.0, -1.0, 0.5, -1.0]
            assert [got["motor_angle_residual"], got["link_angle_residual"]] == pytest.approx(residual, abs=1e-15)
            assert got["load_torque_hat"] == got["load_torque_at_sample"] == pytest.approx(gain @ residual, rel=1e-12)
            assert got["valid"] == 1.0
        observer.component.initialize()
        assert observer.get() == got


def test_the_first_row_of_a_coupled_run_has_the_right_values(flexible_joint):
    recording = simulate(flexible_joint.system, stop_time=0.01, start_values={"plant.motor_angle_start": 0.125})
    assert recording["plant.motor_angle"][0] == 0.125
    assert recording["observer.motor_angle_residual"][0] == 1.125
    assert recording["observer.link_angle_residual"][0] == 2.0


# -- what is refused, and what is survived


@pytest.mark.parametrize(
    ("name", "value", "says"),
    [
        ("pi_end", -1.0, "pi_end: expected a finite number > 0, received -1.0"),
        ("pi_end", nan, "pi_end: expected a finite number > 0, received nan"),
        ("pi_start", 0.0, "pi_start: expected a finite number > 0, received 0.0"),
        ("pi_ramp_time", -1.0, "pi_ramp_time: expected a finite number of at least 0, received -1.0"),
        ("alpha", -1.0, "alpha: expected a finite number > 0, received -1.0"),
        ("joint_stiffness", inf, "joint_stiffness: expected a finite number, received inf"),
        ("method", 77, "method: expected one of 1 (paper)"),
        ("disturbance_order", 4, "disturbance_order: expected a finite number of at least 0 and at most 3, received 4"),
    ],
)
def test_an_observer_with_parameters_that_mean_nothing_ends_with_one_message(flexible_joint, caplog, name, value, says):
    caplog.set_level(logging.INFO, logger="ndob_fmu.fmu")
    with pytest.raises(SimulationError) as error, driven(flexible_joint.observer, {**PAPER, name: value}) as observer:
        observer.component.initialize()
    assert says in str(error.value)
    assert len(caplog.records) == 1
    # The process and its interpreter are as good as before.
    with driven(flexible_joint.observer, PAPER) as observer:
        observer.component.initialize()
        observer.component.step(0.0, 1e-3)
        assert observer.get()["valid"] == 1.0


@pytest.mark.parametrize(
    ("name", "value", "says"),
    [
        ("disturbance.kind", 6, "disturbance.kind: expected one of 0 (none), 1 (constant), 2 (ramp), 3 (sine)"),
        ("disturbance.frequency", -1.0, "disturbance.frequency: expected a finite number of at least 0"),
        ("link_angle_start", nan, "link_angle_start: expected a finite number, received nan"),
    ],
)
def test_a_plant_with_parameters_that_mean_nothing_ends_with_one_message(flexible_joint, name, value, says):
    with pytest.raises(SimulationError) as error, driven(flexible_joint.plant, {name: value}) as plant:
        plant.component.initialize()
    assert says in str(error.value)


@pytest.mark.parametrize("step_size", [0.0, -1e-3, nan, inf])
def test_a_step_that_does_not_go_forward_is_discarded_and_the_next_one_taken(flexible_joint, step_size):
    for fmu in (flexible_joint.plant, flexible_joint.observer):
        with driven(fmu) as instance:
            instance.component.initialize()
            before = instance.get()
            with pytest.raises(SimulationError, match=r"discard.*communication step: expected a finite time > 0 s"):
                instance.component.step(0.0, step_size)
            assert instance.get() == before
            instance.component.step(0.0, 1e-3)
            assert instance.get() != before


@pytest.mark.filterwarnings("ignore::RuntimeWarning")  # the warnings filter of the process rules inside an FMU too
def test_a_plant_that_leaves_the_finite_numbers_says_so(flexible_joint):
    with driven(flexible_joint.plant, {"motor_damping": -1e5}) as plant:
        plant.component.initialize()
        with pytest.raises(SimulationError, match="finite numbers"):
            plant.component.step(0.0, 0.01)


def test_a_plant_holds_its_inputs_where_they_are_no_numbers(flexible_joint, caplog):
    with driven(flexible_joint.plant, inputs=["motor_torque", "load_torque"]) as plant:
        plant.set(motor_torque=0.5, load_torque=0.0)
        plant.component.initialize()
        plant.component.step(0.0, 1e-3)
        plant.set(motor_torque=nan, load_torque=inf)
        plant.component.step(1e-3, 1e-3)
        held = plant.get()
    with driven(flexible_joint.plant, inputs=["motor_torque", "load_torque"]) as plant:
        plant.set(motor_torque=0.5, load_torque=0.0)
        plant.component.initialize()
        plant.component.step(0.0, 1e-3)
        plant.component.step(1e-3, 1e-3)
        assert plant.get() == held
    assert "not finite" in caplog.text


@pytest.mark.parametrize(("method", "bad"), [(1, nan), (1, inf), (2, nan), (2, -inf)])
def test_the_observer_coasts_over_bad_samples_and_recovers(flexible_joint, method, bad):
    """Half a second without one of the two sensors, in the middle of a run."""
    H, dark = 5e-3, range(500, 600)
    recorded = simulate(flexible_joint.plant, step_size=H, stop_time=6.0)
    y = {name: recorded[f"FlexibleJointPlant.{name}"] for name in ("motor_angle", "link_angle")}
    estimate, valid = [], []
    with driven(flexible_joint.observer, {**MODERATE, "method": method}, inputs=list(y)) as observer:
        observer.set(**{name: values[0] for name, values in y.items()})
        observer.component.initialize()
        for k in range(len(recorded.time) - 1):
            observer.set(motor_angle=bad if k in dark else y["motor_angle"][k], link_angle=y["link_angle"][k])
            observer.component.step(k * H, H)
            got = observer.get()
            assert np.all(np.isfinite(list(got.values())))
            estimate.append(got["load_torque_hat"])
            valid.append(got["valid"] == 1.0)
    # Method 2 goes on with the other sensor.
    assert [k for k in range(len(valid)) if not valid[k]] == (list(dark) if method == 1 else [])
    assert np.abs(np.array(estimate[dark.start : dark.stop]) - 2.0).max() < 0.1
    assert np.abs(np.array(estimate[-100:]) - 2.0).max() < 0.1


# -- instances


@pytest.mark.parametrize("method", [1, 2])
def test_a_reset_instance_repeats_its_trajectory_to_the_last_bit(flexible_joint, tmp_path, method):
    for fmu in (flexible_joint.plant, flexible_joint.observer):
        read = fmpy.read_model_description(str(fmu))
        outputs = [v.valueReference for v in read.modelVariables if v.causality == "output" and v.type == "Real"]
        reference = {v.name: v.valueReference for v in read.modelVariables}
        folder = fmpy.extract(str(fmu), unzipdir=str(tmp_path / read.modelName))
        instance = FMU2Slave(
            guid=read.guid, unzipDirectory=folder, modelIdentifier=read.modelName, instanceName="instance"
        )
        instance.instantiate()

        def trajectory(first_start, instance=instance, reference=reference, outputs=outputs):
            instance.setupExperiment(startTime=0.0)
            if "method" in reference:
                instance.setInteger([reference["method"]], [method])
            if first_start is not None:
                name, value = first_start
                instance.setReal([reference[name]], [value])
            instance.enterInitializationMode()
            instance.exitInitializationMode()
            rows = [instance.getReal(outputs)]
            for k in range(50):
                instance.doStep(k * 1e-3, 1e-3)
                rows.append(instance.getReal(outputs))
            return rows

        first = trajectory(None)
        instance.reset()
        other = trajectory(("joint_stiffness", 5.0))
        assert other != first
        instance.reset()
        assert trajectory(None) == first  # reset also restores the start values
        instance.terminate()
        instance.freeInstance()


def test_two_interleaved_observers_are_two_single_ones(flexible_joint):
    def sample(k, which):
        return {"motor_angle": np.sin(0.1 * k + which), "link_angle": np.cos(0.1 * k - which)}

    starts = [{**MODERATE, "alpha": 0.5}, {"method": 2, "joint_stiffness": 2.0}]

    def start(which):
        return driven(flexible_joint.observer, starts[which], inputs=["motor_angle", "link_angle"])

    alone = []
    for which in range(2):
        with start(which) as observer:
            observer.component.initialize()
            for k in range(100):
                observer.set(**sample(k, which))
                observer.component.step(k * 1e-3, 1e-3)
            alone.append(observer.get())
    with start(0) as one, start(1) as other:
        for observer in (one, other):
            observer.component.initialize()
        for k in range(100):
            for which, observer in enumerate((one, other)):
                observer.set(**sample(k, which))
                observer.component.step(k * 1e-3, 1e-3)
        assert [one.get(), other.get()] == alone


def test_an_observer_of_another_plant_runs_beside_the_first(flexible_joint, tmp_path):
    motor = build(MODELS["dc_motor"], tmp_path)[1]
    systems = {"joint": FmuComponent(flexible_joint.observer, "joint"), "motor": FmuComponent(motor, "motor")}
    starts = {(name, v.name): 0.5 for name, c in systems.items() for v in c.variables if v.causality == "input"}
    together = simulate(System(systems, start_values=starts), stop_time=0.05, step_size=1e-3)
    for name, component in systems.items():
        own = {port: value for port, value in starts.items() if port[0] == name}
        alone = simulate(System({name: component}, start_values=own), stop_time=0.05, step_size=1e-3)
        for column in alone.names:
            np.testing.assert_array_equal(alone[column], together[column])
