"""Disturbance source, encoder and controller: their mathematics, and the FMUs that carry it."""

from __future__ import annotations

import math

import numpy as np
import pytest
import sympy
from fmpy.validation import validate_fmu

from ndob_fmu import Model, NdobError, load_model, simulate
from ndob_fmu.analysis.controller_design import design_controller
from ndob_fmu.codegen.compile_model import compile_model
from ndob_fmu.errors import DesignError, ModelError, UsageError
from ndob_fmu.fmu.components import build_components, records
from ndob_fmu.fmu.controller import build_controller, controller_record
from ndob_fmu.runtime.blocks.controller import Controller, Target
from ndob_fmu.runtime.blocks.disturbance import KINDS, Generator
from ndob_fmu.runtime.blocks.disturbance_source import INTERPOLATIONS, SOURCE_KINDS, disturbance_source
from ndob_fmu.runtime.blocks.encoder import Encoder, angle_of_a_count
from ndob_fmu.runtime.blocks.random_numbers import normal, philox, uniforms
from ndob_fmu.runtime.blocks.sampled_measurement import Sampling
from ndob_fmu.runtime.numerics.integrate import integrate
from tests.helpers.fmi_instance import ERROR, OK, opened, unpacked

MODEL = load_model("flexible_joint")

# -- random numbers


@pytest.mark.parametrize("index", [0, 1, 12345, 2**64 - 2])
def test_the_random_words_are_those_of_philox(index):
    """NumPy has the same generator, but counts before it draws."""
    key = (0x0123456789ABCDEF, 42)
    theirs = np.random.Philox(key=np.array(key, dtype=np.uint64), counter=index)
    assert philox(key, (index + 1, 0, 0, 0)) == tuple(int(word) for word in theirs.random_raw(4))


def test_the_noise_is_standard_normal_and_uncorrelated():
    drawn = np.array([normal(*uniforms(7, k)[:2]) for k in range(20_000)])
    assert abs(drawn.mean()) < 4.0 / math.sqrt(len(drawn))
    assert abs(drawn.var() - 1.0) < 4.0 * math.sqrt(2.0 / len(drawn))
    assert abs((drawn**4).mean() - 3.0) < 4.0 * math.sqrt(96.0 / len(drawn))
    assert abs(np.mean(drawn[1:] * drawn[:-1])) < 4.0 / math.sqrt(len(drawn))


# -- disturbance source


def source(kind, **options):
    defaults = {"amplitude": 1.0, "frequency": 1.0, "start_time": 0.0, "seed": 0, "profile": "", "interpolation": 1}
    return disturbance_source(SOURCE_KINDS[kind], **{**defaults, **options})


@pytest.mark.parametrize("kind", KINDS)
def test_the_kinds_of_the_plants_generator_mean_the_same_in_the_source(kind):
    ours = source(kind, amplitude=3.0, frequency=0.7, start_time=0.4)
    theirs = Generator(KINDS[kind], 3.0, 0.7, 0.4)
    assert [ours(t) for t in np.linspace(0.0, 12.0, 97)] == [theirs(t) for t in np.linspace(0.0, 12.0, 97)]


def test_the_spectrum_of_the_noise_is_flat_up_to_its_frequency_and_empty_above():
    """Density amplitude²/frequency: 2² / 20 Hz. Averaged over seeds, Hann window, 100 Hz samples over 10.24 s."""
    samples, rate, band = 1024, 100.0, 20.0
    window = np.hanning(samples)
    density = np.zeros(samples // 2 + 1)
    for seed in range(30):
        signal = source("noise", amplitude=2.0, frequency=band, seed=seed)
        record = np.array([signal(k / rate) for k in range(samples)])
        density += 2.0 * np.abs(np.fft.rfft(window * record)) ** 2 / (rate * np.sum(window**2)) / 30.0
    frequency = np.fft.rfftfreq(samples, 1.0 / rate)
    fourths = [density[(frequency > low) & (frequency < low + 4.5)].mean() for low in (0.5, 5.5, 10.5, 15.0)]
    np.testing.assert_allclose(fourths, 4.0 / band, rtol=0.1)  # 4 standard deviations of 30 seeds × 46 lines / 1.5
    assert density[frequency > 21.0].max() < 1e-4 * 4.0 / band


def test_the_noise_has_its_standard_deviation_and_a_normal_distribution():
    values = np.concatenate(
        [
            [signal(t) for t in np.arange(0.0, 25.0, 0.05)]
            for signal in (source("noise", amplitude=2.0, frequency=10.0, seed=s) for s in range(8))
        ]
    )
    assert values.std() == pytest.approx(2.0, rel=0.03)
    assert np.mean(np.abs(values) < 2.0) == pytest.approx(0.6827, abs=0.02)


def test_the_noise_is_a_function_of_seed_and_time_alone():
    one, same, other = (source("noise", frequency=5.0, seed=seed) for seed in (3, 3, 4))
    fine = [one(0.001 * k) for k in range(1000)]
    assert fine[::10] == [same(0.001 * k) for k in range(0, 1000, 10)]
    assert np.corrcoef(fine, [other(0.001 * k) for k in range(1000)])[0, 1] < 0.9
    assert source("noise", start_time=1.0)(0.999) == 0.0


@pytest.fixture
def profile(tmp_path):
    path = tmp_path / "gust.csv"
    path.write_text('"time","torque"\n1.0,10\n2.0,30\n\n4.0,-10\n', "utf-8")
    return str(path)


@pytest.mark.parametrize(
    ("interpolation", "expected"),
    [
        ("linear", [0.0, 20.0, 20.0, 40.0, 60.0, 20.0, -20.0, -20.0]),
        ("held", [0.0, 20.0, 20.0, 20.0, 60.0, 60.0, -20.0, -20.0]),
    ],
)
def test_a_profile_is_read_from_its_file(profile, interpolation, expected):
    """At τ = −0.1, 0, 1, 1.5, 2, 3, 4 and 9 s, twice the values of the file."""
    signal = source(
        "profile", amplitude=2.0, start_time=5.0, profile=profile, interpolation=INTERPOLATIONS[interpolation]
    )
    assert [signal(5.0 + tau) for tau in (-0.1, 0.0, 1.0, 1.5, 2.0, 3.0, 4.0, 9.0)] == expected


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("time,d\n0,1\n0,2\n", "times that ascend, received 0 after 0"),
        ("time,d\n0,1\n1,inf\n", "data row 2: expected two finite numbers, time and value, received '1,inf'"),
        ("time,d\n0\n", "data row 1: expected two finite numbers"),
        ("time,d\n", "expected at least one row, received none"),
    ],
)
def test_a_profile_that_is_none_is_refused_with_its_row(tmp_path, text, said):
    path = tmp_path / "broken.csv"
    path.write_text(text, "utf-8")
    with pytest.raises(NdobError, match=r"broken\.csv") as refused:
        source("profile", profile=str(path))
    assert said in str(refused.value)


# -- encoder

LSB = 2.0 * math.pi / 4096


def encoder(*, counts_per_revolution=0, **options):
    defaults = {
        "noise_std": 0.0,
        "bias": 0.0,
        "seed": 0,
        "sample_time": 0.0,
        "delay": 0.0,
        "dropout_probability": 0.0,
        "between_samples_nan": False,
        "dropped_nan": True,
    }
    return Encoder(Sampling(**{**defaults, **options}, resolution=angle_of_a_count(counts_per_revolution)))


def shown(device, angles, step_size=0.01, start=0.0):
    """Return what is shown at the start and after each step, for the angle at the same times."""
    state = device.init(angles[0], start)
    values = [state.shown]
    for k, angle in enumerate(angles[1:], start=1):
        state = device.step(state, angle, start + k * step_size, step_size)
        values.append(state.shown)
    return values


RAMP = [float(k) for k in range(20)]


def test_an_ideal_encoder_shows_the_angle():
    assert shown(encoder(), RAMP) == RAMP


def test_the_rounding_errs_by_half_a_count_at_most_and_by_lsb_over_root_12_on_the_average():
    angles = np.linspace(-4.0, 4.0, 9973)
    errors = np.array(shown(encoder(counts_per_revolution=4096), angles.tolist())) - angles
    assert np.abs(errors).max() <= 0.5 * LSB * (1.0 + 1e-9)
    assert errors.std() == pytest.approx(LSB / math.sqrt(12.0), rel=0.02)
    assert abs(errors.mean()) < 0.02 * LSB


def test_the_bias_is_added_before_rounding():
    assert shown(encoder(counts_per_revolution=4, bias=0.3), [0.0, 0.6]) == [0.0, 0.5 * math.pi]


def test_the_noise_has_its_standard_deviation_and_goes_by_seed_and_sample():
    noisy, other = (np.array(shown(encoder(noise_std=0.1, seed=seed), [0.0] * 2000)) for seed in (1, 2))
    assert noisy.std() == pytest.approx(0.1, rel=0.06)
    assert abs(np.corrcoef(noisy, other)[0, 1]) < 0.1
    slow, slow_at_finer_steps = (
        shown(encoder(noise_std=0.1, seed=1, sample_time=0.1), [0.0] * (10 * steps + 1), 0.1 / steps)[::steps]
        for steps in (2, 5)
    )
    assert slow == slow_at_finer_steps == noisy[:11].tolist()


@pytest.mark.parametrize("start", [0.0, 0.3])
def test_between_samples_the_last_one_is_held_or_nothing_is_shown(start):
    held = shown(encoder(sample_time=0.03), RAMP[:8], start=start)
    assert held == [0.0, 0.0, 0.0, 3.0, 3.0, 3.0, 6.0, 6.0]
    nothing = shown(encoder(sample_time=0.03, between_samples_nan=True), RAMP[:8], start=start)
    np.testing.assert_equal(nothing, [0.0, math.nan, math.nan, 3.0, math.nan, math.nan, 6.0, math.nan])


def test_samples_between_steps_are_taken_at_the_end_of_the_step_across():
    assert shown(encoder(sample_time=0.025), RAMP[:9]) == [0.0, 0.0, 0.0, 3.0, 3.0, 5.0, 5.0, 5.0, 8.0]


def test_a_delay_of_whole_steps_is_exact_also_where_the_host_adds_up_its_times():
    device, step = encoder(delay=0.3), 0.1
    state, t, values = device.init(0.0, 0.0), 0.0, [0.0]
    for angle in RAMP[1:]:
        t += step
        state = device.step(state, angle, t, step)
        values.append(state.shown)
    assert values == [0.0, 0.0, 0.0, *RAMP[:-3]]


def test_another_delay_ends_with_the_first_step_after_it():
    assert shown(encoder(delay=0.025), RAMP) == [0.0, 0.0, 0.0, *RAMP[:-3]]
    assert shown(encoder(delay=0.02, sample_time=0.03), RAMP[:9]) == [0.0, 0.0, 0.0, 0.0, 0.0, 3.0, 3.0, 3.0, 6.0]


@pytest.mark.parametrize("dropped_nan", [True, False])
def test_as_many_samples_are_lost_as_the_probability_says(dropped_nan):
    angles = [float(k) for k in range(4000)]
    device = encoder(dropout_probability=0.2, dropped_nan=dropped_nan, seed=5)
    values = np.array(shown(device, angles))
    lost = np.isnan(values) if dropped_nan else values != angles
    assert lost.mean() == pytest.approx(0.2, abs=0.025)
    assert not lost[0]
    if not dropped_nan:
        np.testing.assert_array_equal(values[1:][lost[1:]], values[:-1][lost[1:]])


def test_an_angle_that_is_not_finite_is_a_lost_sample():
    np.testing.assert_equal(
        shown(encoder(counts_per_revolution=8), [0.0, math.inf, math.nan, 0.0]), [0.0, math.nan, math.nan, 0.0]
    )
    assert shown(encoder(dropped_nan=False), [2.0, math.nan, 3.0]) == [2.0, 2.0, 3.0]


@pytest.mark.parametrize("angle", [1e300, -1.7e308, 2.0**60])
def test_an_angle_so_large_that_its_counts_overflow_is_shown_as_it_is(angle):
    assert shown(encoder(counts_per_revolution=4096), [0.0, angle]) == [0.0, angle]


# -- controller


def joint_controller(**options):
    feedback = design_controller(MODEL).feedback
    defaults = {
        "parameters": MODEL.parameter_values(),
        "regulated": feedback.regulated,
        "gain": np.array(feedback.gain),
        "limit": np.zeros(1),
        "compensation": True,
    }
    return Controller(compile_model(MODEL), **{**defaults, **options})


def at_rest(controller, reference, disturbance, *, estimated, stop=30.0):
    """Return x at `stop` of the plant under this feedback, from x = 0, and the last command."""
    eq, target, x, substep = compile_model(MODEL), controller.start(), np.zeros(4), np.inf
    for k in range(int(stop / 0.02)):
        target, u = controller.step(target, [reference], x, [estimated])
        x, substep = integrate(
            lambda _, x, u=u: np.array(eq.derivatives(x.tolist(), u.tolist(), [disturbance], controller.parameters)),
            x, 0.02 * k, 0.02 * (k + 1), substep,
        )  # fmt: skip
    return x, u


def test_the_link_comes_to_rest_at_its_reference_against_gravity():
    x, u = at_rest(joint_controller(), 0.5, 0.0, estimated=0.0)
    np.testing.assert_allclose(x, [0.5, 0.0, 0.5 + 10.0 * math.sin(0.5), 0.0], atol=1e-6)
    assert u[0] == pytest.approx(10.0 * math.sin(0.5), abs=1e-6)


def test_an_estimated_torque_on_the_motor_is_cancelled_and_the_link_does_not_notice():
    controller = joint_controller()
    target = controller.start()
    plain, compensated = (controller.step(target, [0.3], [0.1, 0.2, 0.3, 0.4], [d])[1] for d in (0.0, 2.0))
    assert compensated - plain == pytest.approx(-2.0, abs=1e-9)
    switched_off = joint_controller(compensation=False)
    assert switched_off.step(target, [0.3], [0.1, 0.2, 0.3, 0.4], [2.0])[1] == pytest.approx(plain, abs=1e-9)
    assert abs(at_rest(switched_off, 0.3, 2.0, estimated=2.0)[0][0] - 0.3) > 0.02
    assert abs(at_rest(controller, 0.3, 2.0, estimated=2.0)[0][0] - 0.3) < 1e-6


def test_a_disturbance_that_the_inputs_do_not_reach_is_compensated_at_rest():
    """A torque on the link: the motor has to turn on until the joint's torsion balances it."""
    fields = {name: getattr(MODEL, name) for name in ("name", "states", "inputs", "outputs", "disturbances", "f")}
    matrices = {name: getattr(MODEL, name) for name in ("A", "B", "C", "G_f", "parameters", "lipschitz")}
    loaded = Model(**fields, **matrices, G_d=[[0], [1], [0], [0]])
    design = design_controller(loaded)
    assert design.unmatched == pytest.approx([1.0])
    controller = Controller(
        compile_model(loaded),
        loaded.parameter_values(),
        ("link_angle",),
        np.array(design.feedback.gain),
        np.zeros(1),
        True,
    )
    target, _ = controller.step(controller.start(), [0.2], np.zeros(4), [3.0])
    np.testing.assert_allclose(target.x, [0.2, 0.0, 0.2 + 10.0 * math.sin(0.2) - 3.0, 0.0], atol=1e-8)
    np.testing.assert_allclose(target.u, [10.0 * math.sin(0.2) - 3.0], atol=1e-8)


def test_commands_keep_within_their_limit_and_none_means_none():
    limited, unlimited = joint_controller(limit=np.array([1.5])), joint_controller()
    far = [[0.0], [3.0, 0.0, 0.0, 0.0], [0.0]]
    _, u = limited.step(limited.start(), *far)
    assert np.abs(u) == [1.5]
    assert limited.saturates(u)
    _, u = unlimited.step(unlimited.start(), *far)
    assert np.abs(u) > 100.0
    assert not unlimited.saturates(u)
    assert not unlimited.saturates(np.zeros(1))


@pytest.mark.parametrize("name", ["dc_motor", "three_tank", "car_in_crosswind", "tool_on_arm"])
def test_every_example_gets_a_controller_whose_poles_lie_left_of_the_pace(name):
    model = load_model(f"examples/{name}.py")
    design = design_controller(model, pace=3.0)
    assert design.poles.real.max() <= -3.0 * 0.999
    assert len(design.feedback.gain) == len(model.inputs)


def tank(drain):
    """A tank that a pump fills, whose flow grows with the square of its speed: at standstill it has no effect."""
    return Model(
        name="Tank",
        states=["level", "filtered"],
        inputs=["speed"],
        outputs=["level", "filtered"],
        disturbances=["leak"],
        A=[[-drain, 0], [1, -1]],
        B=[[0], [0]],
        C=[[1, 0], [0, 1]],
        G_d=[[-1], [0]],
        G_f=[[1], [0]],
        f=lambda x, u, p: [p.flow * u.speed**2],
        parameters={"flow": 2e-6},
        x0=[0.5, 0.5],
    )


def test_a_plant_whose_input_enters_through_f_is_controlled_around_its_start():
    model = tank(0.1)
    design = design_controller(model)
    assert design.unmatched == pytest.approx([0.0], abs=1e-9)  # the leak acts where the pump does
    feedback = (design.feedback.regulated, np.array(design.feedback.gain), np.zeros(1))
    controller = Controller(compile_model(model), model.parameter_values(), *feedback, compensation=True)
    held = controller.start()
    np.testing.assert_allclose(held.x, [0.5, 0.5], rtol=1e-9)
    np.testing.assert_allclose(held.u, [math.sqrt(0.1 * 0.5 / 2e-6)], rtol=1e-9)
    target, u = controller.step(held, [0.8], [0.8, 0.8], [0.03])
    np.testing.assert_allclose(u, [math.sqrt((0.1 * 0.8 + 0.03) / 2e-6)], rtol=1e-9)
    np.testing.assert_allclose(target.x, [0.8, 0.8], rtol=1e-9)


def test_a_tank_whose_outflow_has_no_slope_when_empty_is_linearised_exactly_at_its_start():
    """q √level has the slope q/(2 √level), infinite at the references' default of 0; sign(level) adds none."""
    model = Model(
        name="Orifice",
        states=["level"],
        inputs=["inflow"],
        outputs=["level"],
        disturbances=["leak"],
        A=[[0.0]],
        B=[[2.0]],
        C=[[1.0]],
        G_d=[[1.0]],
        f=lambda x, u, p: [-p.outflow * sympy.sign(x.level) * sympy.sqrt(sympy.Abs(x.level))],
        parameters={"outflow": 0.3},
        lipschitz=1.0,
        x0=[0.25],
    )
    controller = Controller(compile_model(model), (0.3,), ("level",), np.zeros((1, 1)), np.zeros(1), compensation=True)
    start = controller.start()
    np.testing.assert_allclose([*start.x, *start.u], [0.25, 0.3 * 0.5 / 2.0], rtol=1e-14)
    A, B = controller.jacobians(start)
    np.testing.assert_allclose([A[0, 0], B[0, 0]], [-0.3, 2.0], rtol=1e-14)
    with pytest.raises(
        DesignError, match=r"linearisation of Orifice at its rest position: expected finite slopes of f"
    ):
        controller.jacobians(Target(x=np.zeros(1), u=np.zeros(1)))


def test_what_a_compensation_cannot_reach_at_once_is_said():
    assert design_controller(MODEL).unmatched == pytest.approx([0.0], abs=1e-12)
    crosswind = design_controller(load_model("examples/car_in_crosswind.py"))
    assert crosswind.unmatched[0] > 0.1


@pytest.mark.parametrize(
    ("error", "options", "said"),
    [
        (UsageError, {"regulated": ["link_rat"]}, "expected 1 of link_angle, motor_angle, link_rate, motor_rate"),
        (UsageError, {"regulated": ["link_angle", "motor_angle"]}, "one for each input, received link_angle, motor"),
        (UsageError, {"pace": 0.0}, "pace: expected a finite number > 0"),
        (DesignError, {"regulated": ["link_rate"]}, "rest position"),
    ],
)
def test_a_controller_that_cannot_be_designed_is_refused_with_the_reason(error, options, said):
    with pytest.raises(error, match=said):
        design_controller(MODEL, **options)


def test_a_plant_without_inputs_gets_no_controller():
    fields = {name: getattr(MODEL, name) for name in ("states", "outputs", "disturbances", "f", "A", "C", "G_f", "G_d")}
    with pytest.raises(ModelError, match="expected a plant with inputs, received none"):
        design_controller(Model(name="Adrift", parameters=MODEL.parameters, lipschitz=10.0, **fields))


# -- the FMUs


@pytest.fixture(scope="module")
def fmus(tmp_path_factory):
    folder = tmp_path_factory.mktemp("components")
    return {path.stem: path for path in (*build_components(folder), build_controller(MODEL, folder))}


def test_the_fmus_pass_validation_and_are_the_same_at_every_build(fmus, tmp_path):
    assert {name: validate_fmu(str(path)) for name, path in fmus.items()} == {name: [] for name in fmus}
    again = (*build_components(tmp_path), build_controller(MODEL, tmp_path))
    assert [path.name for path in again if path.read_bytes() != fmus[path.stem].read_bytes()] == []


def test_the_components_have_these_names():
    """They are what connections and parameter sets of users rely on."""
    named = {record.name: [v.name for v in record.variables] for record in records()}
    assert [*named["DisturbanceSource"], *named["Encoder"], *named["TorsionSpring"]] == [
        *("disturbance", "disturbance.kind", "disturbance.amplitude", "disturbance.frequency"),
        *("disturbance.start_time", "disturbance.seed", "disturbance.profile", "disturbance.interpolation"),
        *("angle", "measured_angle", "new_sample", "counts_per_revolution", "noise_std", "bias", "seed"),
        *("sample_time", "delay", "dropout_probability", "dropped_sample", "between_samples"),
        *("angle_a", "angle_b", "torque_a", "torque_b", "stiffness"),
    ]
    controller = controller_record(MODEL, design_controller(MODEL).feedback)
    assert [v.name for v in controller.variables] == [
        *("link_angle_reference", "link_angle_hat", "link_rate_hat", "motor_angle_hat", "motor_rate_hat"),
        *("load_torque_hat", "motor_torque", "saturated", "gravity_torque", "joint_stiffness", "motor_damping"),
        *("gain.link_angle", "gain.link_rate", "gain.motor_angle", "gain.motor_rate"),
        *("motor_torque_limit", "compensation"),
    ]


def test_the_source_shows_the_signal_of_the_end_of_each_step_whatever_the_step(fmus):
    options = {"disturbance.kind": 6, "disturbance.amplitude": 2.0, "disturbance.frequency": 3.0, "disturbance.seed": 9}
    signal = source("noise", amplitude=2.0, frequency=3.0, seed=9)
    for step_size in (0.1, 0.25):
        recording = simulate(fmus["DisturbanceSource"], stop_time=1.0, step_size=step_size, start_values=options)
        expected = [signal(t) for t in recording.time]
        np.testing.assert_allclose(recording["DisturbanceSource.disturbance"], expected, rtol=1e-12)


def test_a_profile_goes_from_the_file_to_the_output(fmus, profile):
    options = {"disturbance.kind": 7, "disturbance.profile": profile, "disturbance.interpolation": 2}
    recording = simulate(fmus["DisturbanceSource"], stop_time=4.0, step_size=1.0, start_values=options)
    assert recording["DisturbanceSource.disturbance"].tolist() == [10.0, 10.0, 30.0, 30.0, -10.0]


def test_a_profile_that_is_missing_is_an_error_with_its_path_after_which_another_can_be_given(fmus, profile):
    with opened(fmus["DisturbanceSource"]) as instance:
        assert instance.setupExperiment(startTime=0.0) == OK
        assert instance.set("disturbance.kind", SOURCE_KINDS["profile"]) == OK
        assert instance.set("disturbance.profile", "gone/gust.csv") == OK
        assert instance.enterInitializationMode() == OK
        assert instance.exitInitializationMode() == ERROR
        assert "expected the path of a CSV file" in instance.said[-1]
        assert "'gone/gust.csv' (No such file or directory)" in instance.said[-1]
        assert instance.set("disturbance.profile", profile) == OK
        assert instance.exitInitializationMode() == OK
        assert instance.step(0.0, 1.5) == {"disturbance": 20.0}


NOISY = {
    "counts_per_revolution": 4096,
    "noise_std": 1e-3,
    "bias": 0.1,
    "seed": 3,
    "sample_time": 0.02,
    "delay": 0.05,
    "dropout_probability": 0.3,
}


def test_the_encoder_fmu_is_its_core(fmus):
    device = encoder(**NOISY)
    state = device.init(0.25, 0.0)
    with opened(fmus["Encoder"]) as instance:
        assert instance.setupExperiment(startTime=0.0) == OK
        assert [instance.set(name, value) for name, value in {**NOISY, "angle": 0.25}.items()] == [OK] * 8
        assert instance.enterInitializationMode() == OK
        assert instance.get() == {"measured_angle": state.shown, "new_sample": True}
        assert instance.exitInitializationMode() == OK
        for k in range(100):
            state = device.step(state, math.sin(k), 0.01 * k + 0.01, 0.01)
            got = instance.step(0.01 * k, 0.01, angle=math.sin(k))
            np.testing.assert_equal(got, {"measured_angle": state.shown, "new_sample": state.new})


def test_an_encoder_whose_state_is_restored_in_another_instance_goes_on_to_the_bit(fmus):
    with unpacked(fmus["Encoder"]) as instances:
        first, second = instances("first"), instances("second")
        first.begin(**NOISY)
        for k in range(23):
            first.step(0.01 * k, 0.01, angle=0.1 * k)
        data = first.bytes_of(first.state())
        expected = [first.step(0.01 * k, 0.01, angle=0.1 * k) for k in range(23, 60)]
        second.begin()  # with other parameters, which the state brings along
        status, state = second.from_bytes(data)
        assert status == OK
        second.fmu.setFMUState(state)
        np.testing.assert_equal([second.step(0.01 * k, 0.01, angle=0.1 * k) for k in range(23, 60)], expected)


@pytest.mark.parametrize(("name", "value"), [("dropout_probability", 1.5), ("delay", -1.0), ("dropped_sample", 3)])
def test_an_encoder_parameter_out_of_its_range_is_refused(fmus, name, value):
    with opened(fmus["Encoder"]) as instance:
        assert instance.setupExperiment(startTime=0.0) == OK
        assert instance.set(name, value) == ERROR
        assert name in instance.said[-1]


def test_the_controller_fmu_is_its_core_and_holds_what_is_not_finite(fmus):
    core = joint_controller(limit=np.array([20.0]))
    estimates = {"link_angle_hat": 0.1, "link_rate_hat": 0.2, "motor_angle_hat": 0.3, "motor_rate_hat": 0.4}
    given = [[0.3], list(estimates.values()), [2.0]]
    target, first = core.step(core.start(), *given)
    with opened(fmus["FlexibleJointController"]) as instance:
        instance.begin(motor_torque_limit=20.0)
        got = instance.step(0.0, 0.01, link_angle_reference=0.3, load_torque_hat=2.0, **estimates)
        assert got["motor_torque"] == pytest.approx(first[0], rel=1e-9)
        assert got["saturated"] == 1
        near = {name: value / 20.0 for name, value in estimates.items()}
        _, second = core.step(target, [0.0], list(near.values()), [2.0])
        got = instance.step(0.01, 0.01, link_angle_reference=0.0, **near)
        assert got["motor_torque"] == pytest.approx(second[0], rel=1e-9)
        assert got["saturated"] == 0
        assert instance.set("load_torque_hat", math.nan) == OK
        assert instance.doStep(0.02, 0.01) == OK
        assert "not finite are held" in instance.said[-1]
        assert instance.get()["motor_torque"] == pytest.approx(second[0], rel=1e-9)


def test_the_spring_pulls_its_ends_together(fmus):
    with opened(fmus["TorsionSpring"]) as instance:
        instance.begin(stiffness=3.0)
        assert instance.step(0.0, 0.1, angle_a=0.5, angle_b=0.7) == pytest.approx({"torque_a": 0.6, "torque_b": -0.6})
