"""Native observers beside the Python FMUs of the same models, as hosts run them."""

from __future__ import annotations

from ctypes import byref, c_char_p, c_size_t, c_void_p
from pathlib import Path
from random import Random
from time import process_time

import fmpy
import numpy as np
import pytest

from ndob_fmu.cli import main
from ndob_fmu.codegen.compile_model import compile_model
from ndob_fmu.fmu.build import build_part
from ndob_fmu.model.loading import load_model
from ndob_fmu.native.build import build_native
from tests.fuzz.library import Library
from tests.fuzz.walk import Walk
from tests.helpers.checkers import findings
from tests.helpers.fmi_instance import DISCARD, OK, opened
from tests.helpers.needs import FRONT

pytestmark = FRONT
ROOT = Path(__file__).parents[2]
JOINT, ARM, CYLINDER, TOOL = (
    "flexible_joint",
    *(str(ROOT / "examples" / f"{name}.py") for name in ("two_link_arm", "hydraulic_cylinder", "tool_on_arm")),
)
STEPS = 600
# Of a signal's range: gains come from another linear algebra. Without noise they are at the edge of the numbers.
EQUAL, EQUAL_WITHOUT_NOISE = 1e-9, 1e-6
# The weights of jumps follow from residuals over their σ. The last bit of a sample near 1 is 1e-11 of a σ of 1e-5, and
# each jump in the log makes the difference larger. In nine draws of the last bits, the estimates of an observer alone
# move by up to 1.1e-9 of a range. NumPy adds products in another order on each processor, with as much.
EQUAL_BUT_FOR_LAST_BITS = 5e-9
CASES = {
    "method 2": (JOINT, {"noise_std": 1e-5}, EQUAL),
    "method 2, without noise": (JOINT, {}, EQUAL_WITHOUT_NOISE),
    "method 2, order 0": (JOINT, {"noise_std": 1e-5, "disturbance_order": 0}, EQUAL),
    "method 2, order 3, lag": (
        JOINT,
        {"noise_std": 1e-5, "disturbance_order": 3, "lag": 0.05},
        EQUAL_BUT_FOR_LAST_BITS,
    ),
    "method 2, delay and offset": (
        JOINT,
        {"noise_std": 1e-5, "link_angle_delay": 0.01, "motor_angle_bias_std": 0.01},
        EQUAL,
    ),
    "method 2, estimated": (JOINT, {"noise_std": 1e-5, "estimate_parameters": True, "gravity_torque_std": 0.1}, EQUAL),
    "method 1": (JOINT, {"method": 1, "pi_end": 1e6, "pi_ramp_time": 0.2}, EQUAL),
    "two disturbances": (ARM, {}, EQUAL),
    "ranges": (CYLINDER, {}, EQUAL),
    "ranges, method 1": (CYLINDER, {"method": 1, "pi_end": 1e6, "pi_ramp_time": 0.1}, EQUAL),
    "a channel": (TOOL, {}, EQUAL),
    "a channel, lag": (TOOL, {"lag": 0.05, "disturbance_order": 1}, EQUAL),
    "a channel, method 1": (TOOL, {"method": 1, "pi_end": 1e6, "pi_ramp_time": 0.2}, EQUAL),
}


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """Return the model, its observer as a Python FMU, and its plant and observer as native ones."""
    known = {}

    def build(name, fmi=2):
        if (name, fmi) not in known:
            model, folder = load_model(name), tmp_path_factory.mktemp("observers")
            known[name, fmi] = (
                model,
                build_part(model, "Observer", folder / "python"),
                *build_native(model, folder, fmi=fmi),
            )
        return known[name, fmi]

    return build


def samples(model, plant):
    """Return a log of the plant under a sine of the disturbance, with noise, an outlier, and a gap."""
    eq, H = compile_model(model), model.experiment.step_size
    times = np.arange(STEPS + 1) * H
    inputs = {name: np.full(STEPS + 1, 0.5 * sum(eq.ranges.get(name, (0.0, 0.0)))) for name in eq.inputs}
    inputs |= {
        d: nominal + 0.3 * bound * np.sin(0.02 * np.arange(STEPS + 1))
        for d, nominal, bound in zip(eq.disturbances, eq.disturbance_nominal, eq.disturbance_bound, strict=True)
    }
    given = np.array(list(zip(times, *inputs.values(), strict=True)), dtype=[(n, float) for n in ("time", *inputs)])
    run = fmpy.simulate_fmu(str(plant), stop_time=STEPS * H, step_size=H, output_interval=H, input=given)
    random, log = np.random.default_rng(7), {"time": times} | {name: inputs[name] for name in eq.inputs}
    for name, std in zip(eq.outputs, eq.noise_std, strict=True):
        log[name] = run[name] + (std or 1e-5) * random.standard_normal(STEPS + 1)
    log[eq.outputs[0]][200] += 0.5
    log[eq.outputs[-1]][300:310] = np.nan
    return np.array(list(zip(*log.values(), strict=True)), dtype=[(name, float) for name in log])


def estimates(fmu, model, case, log):
    """Return the outputs of an observer over a log, with the settings of a case."""
    eq, H, values = compile_model(model), model.experiment.step_size, dict(CASES[case][1])
    if "noise_std" in values:
        std = values.pop("noise_std")
        values |= {f"{output}_noise_std": std for output in eq.outputs}
    return fmpy.simulate_fmu(
        str(fmu), stop_time=STEPS * H, step_size=H, output_interval=H, input=log, start_values=values
    )


def of_range(expected, found, variable):
    """Return the largest difference of an output of two runs, over its range."""
    column, own = (run[variable].astype(float) for run in (expected, found))
    return np.max(np.abs(own - column)) / max(np.ptp(column), np.max(np.abs(column)), 1e-12)


@pytest.mark.parametrize("case", CASES)
def test_a_native_observer_gives_the_estimates_of_the_python_fmu(built, case):
    name, _, bound = CASES[case]
    model, python, plant, native = built(name)
    log = samples(model, plant)
    expected, found = (estimates(fmu, model, case, log) for fmu in (python, native))
    np.testing.assert_array_equal(found["valid"], expected["valid"])
    for variable in expected.dtype.names:
        if variable == "consistency" and bound == EQUAL_WITHOUT_NOISE:
            continue  # of residuals that are rounding errors
        assert of_range(expected, found, variable) <= bound, variable


def test_last_bits_of_the_samples_move_the_estimates_of_order_3_about_as_much_as_another_linear_algebra_may(built):
    model, _, plant, native = built(JOINT)
    log, random = samples(model, plant), np.random.default_rng(0)
    runs = []
    for _ in range(3):
        moved = log.copy()
        for output in model.outputs:
            moved[output] = np.nextafter(log[output], random.choice([-np.inf, np.inf], len(log)))
        runs.append(estimates(native, model, "method 2, order 3, lag", moved))
    assert max(of_range(runs[0], run, "load_torque_std") for run in runs[1:]) > 0.2 * EQUAL


def test_fmi_3_gives_the_bits_of_fmi_2(built):
    model, _, plant, native = built(JOINT)
    log, H = samples(model, plant), model.experiment.step_size
    runs = [
        fmpy.simulate_fmu(str(fmu), stop_time=STEPS * H, step_size=H, output_interval=H, input=log)
        for fmu in (native, built(JOINT, 3)[3])
    ]
    for variable in runs[0].dtype.names:
        np.testing.assert_array_equal(runs[1][variable], runs[0][variable])


@pytest.mark.parametrize("fmi", [2, 3])
def test_the_model_descriptions_are_valid(built, fmi):
    for fmu in built(JOINT, fmi)[2:]:
        assert findings(fmu) == []


@pytest.mark.parametrize("name", [JOINT, TOOL])
def test_a_state_goes_on_as_it_did_in_another_instance_and_from_bytes(built, name):
    library = Library(Path(fmpy.extract(str(built(name)[3]))))
    lag = next(variable.reference for variable in library.variables if variable.name == "lag")
    fmu = fmpy.instantiate_fmu(library.folder, fmpy.read_model_description(str(library.folder)))
    other = fmpy.instantiate_fmu(library.folder, fmpy.read_model_description(str(library.folder)))
    inputs, outputs = library.references("Real", "input"), library.references("Real", "output")

    def step(instance, k):
        instance.setReal(inputs, [0.1 + 0.01 * i + 0.001 * (i + 1) * k for i in range(len(inputs))])
        instance.doStep(k * 1e-3, 1e-3)
        return instance.getReal(outputs)

    for each in (fmu, other):
        each.setReal([lag], [0.02])
        each.setupExperiment(startTime=0.0)
        each.enterInitializationMode()
        each.exitInitializationMode()
    for k in range(50):
        step(fmu, k)
    state = fmu.getFMUState()
    data = fmu.serializeFMUState(state)
    expected = [step(fmu, k) for k in range(50, 80)]
    other.setFMUState(other.deserializeFMUState(data))
    assert [step(other, k) for k in range(50, 80)] == expected
    fmu.setFMUState(state)
    assert [step(fmu, k) for k in range(50, 80)] == expected
    for each in (fmu, other):
        each.freeInstance()


def test_bytes_whose_settings_ask_for_a_warning_are_read_without_one(built):
    """They are only tried then. The warning comes where the state is taken."""
    library = Library(Path(fmpy.extract(str(built(JOINT)[3]))))
    # Of two offsets a constant disturbance explains one.
    offsets = [variable.reference for variable in library.variables if variable.name.endswith("_bias_std")]
    warned, other = (
        fmpy.instantiate_fmu(library.folder, fmpy.read_model_description(str(library.folder))) for _ in range(2)
    )
    warned.setReal(offsets, [0.01, 0.01])
    for each in (warned, other):
        each.setupExperiment(startTime=0.0)
        each.enterInitializationMode()
        each.exitInitializationMode()
        each.doStep(0.0, 1e-3)
    data, state = warned.serializeFMUState(warned.getFMUState()), c_void_p()
    status = other.dll.fmi2DeSerializeFMUstate(
        c_void_p(other.component), c_char_p(data), c_size_t(len(data)), byref(state)
    )
    assert status == OK
    for each in (warned, other):
        each.freeInstance()


def own_bytes_taken(instance):
    """Return the statuses of reading the bytes of an instance's state, and of taking the state over."""
    status, state = instance.from_bytes(instance.bytes_of(instance.state()))
    return status, instance.setFMUState(state)


# Times and lengths of steps (s), and the first angle in each.
ODD_RUNS = {
    "a first step that begins a thousandth early": ({}, [(-1e-6, 1e-3, 1.0)]),
    "steps that begin half a thousandth late": (
        {"method": 1, "pi_end": 1e6, "pi_ramp_time": 0.02},
        [(1.0005e-3 * k, 1e-3, 1.0) for k in range(40)],
    ),
    "a change of the smallest number": ({}, [(1e-3 * k, 1e-3, y) for k, y in enumerate([5e-324, 0.0, 0.5, 0.5])]),
    "a number whose square is infinite": (
        {"disturbance_order": 0},
        [(1e-3 * k, 1e-3, y) for k, y in enumerate([1.0, 1.0, 1e200, -1e300, 1.0])],
    ),
}


@pytest.mark.parametrize("target", ["python", "native"])
@pytest.mark.parametrize("case", ODD_RUNS)
def test_what_an_instance_remembers_comes_back_from_its_bytes_after_odd_steps_and_samples(built, case, target):
    settings, steps = ODD_RUNS[case]
    with opened(built(JOINT)[1 if target == "python" else 3]) as instance:
        instance.begin(**settings)
        for t, H, angle in steps:
            instance.step(t, H, motor_angle=angle, link_angle=1.0)
            assert own_bytes_taken(instance) == (OK, OK), instance.said


def test_what_a_plant_remembers_comes_back_from_its_bytes_where_the_stop_time_is_rounded(built, flexible_joint):
    for plant in (flexible_joint.plant, built(JOINT)[2]):
        with opened(plant) as instance:
            instance.begin(stop_time=0.0)
            instance.step(0.0, 5e-324)
            assert own_bytes_taken(instance) == (OK, OK), instance.said


@pytest.mark.parametrize("target", ["python", "native"])
def test_a_number_whose_square_is_infinite_counts_as_not_measured(built, target):
    shown = []
    for odd in (1e200, np.nan):
        with opened(built(JOINT)[1 if target == "python" else 3]) as instance:
            instance.begin()
            shown.append(
                [instance.step(1e-3 * k, 1e-3, motor_angle=odd if k == 20 else 1.0, link_angle=1.0) for k in range(40)]
            )
    assert shown[0] == shown[1]


@pytest.mark.parametrize("target", ["python", "native"])
def test_a_step_that_does_not_go_further_than_the_last_one_is_discarded(built, target):
    """It may begin before the end of the last one, by a thousandth of that."""
    with opened(built(JOINT)[1 if target == "python" else 3]) as instance:
        instance.begin()
        instance.step(0.0, 1e-2, motor_angle=1.0, link_angle=1.0)
        assert instance.doStep(1e-2 - 1e-5, 5e-6) == DISCARD
        assert instance.said == [
            "end of the step: expected a finite time after 0.01 s, where the last one ended, received 0.009995 s"
        ]


def test_a_saved_state_is_no_larger_than_its_settings_ask_for(built):
    library = Library(Path(fmpy.extract(str(built(JOINT)[3]))))
    lag = next(variable.reference for variable in library.variables if variable.name == "lag")
    sizes = []
    for seconds in (0.0, 0.02, 0.0):
        fmu = fmpy.instantiate_fmu(library.folder, fmpy.read_model_description(str(library.folder)))
        fmu.setReal([lag], [seconds])
        fmu.setupExperiment(startTime=0.0)
        fmu.enterInitializationMode()
        fmu.exitInitializationMode()
        fmu.doStep(0.0, 1e-3)
        sizes.append(len(fmu.serializeFMUState(fmu.getFMUState())))
        fmu.freeInstance()
    # A lag keeps 65 instants, each with 48 responses to jumps, but none yet of those that are not used.
    assert sizes[0] == sizes[2] < 8_000 < 25_000 < sizes[1] < 45_000


def test_random_legal_and_illegal_calls_have_the_statuses_of_fmi(built, components):
    fmus = (*built(JOINT)[2:], built(TOOL)[3], components["Encoder"])
    folders = [Path(fmpy.extract(str(fmu))) for fmu in fmus]
    walk = Walk([Library(folder) for folder in folders], Random(2), lambda _: None)
    walk.wander(4000)
    walk.close()
    assert walk.made >= 4000


REFUSED = [
    (JOINT, {"disturbance_order": 0, "disturbance_nominal": 0.5}, "and 0 with disturbance_order 0, received 0.5"),
    (ARM, {"method": 1}, "the paper's form of"),
    (TOOL, {"disturbance_nominal": 0.5}, "expected 0 with a channel, received 0.5"),
    (JOINT, {"disturbance_order": 3, "disturbance_bound": 1e-320}, "that are finite, received 9.99989e-321 and"),
]


@pytest.mark.parametrize(("name", "values", "why"), REFUSED)
def test_settings_that_do_not_fit_are_refused_in_the_words_of_the_python_fmu(built, name, values, why):
    answers = []
    for fmu in (built(name)[1], built(name)[3]):
        library = Library(Path(fmpy.extract(str(fmu))))
        handle = library.new()
        for variable in library.variables:
            if variable.name in values:
                library.set(handle, [variable.reference], [values[variable.name]], variable.type)
        library.setup(handle, 0.0)
        library.EnterInitializationMode(handle)
        answers.append((library.ExitInitializationMode(handle), [text for _, _, text in library.said]))
        library.FreeInstance(handle)
    assert answers[1] == answers[0]
    assert answers[0][0] == 3
    assert why in answers[0][1][0]


def test_the_command_builds_native_fmus_and_says_what_fits_which_target(tmp_path, capsys):
    assert main(["build", JOINT, "--target", "native", "--out", str(tmp_path), "--fmi", "3"]) == 0
    assert [Path(line).name for line in capsys.readouterr().out.split()] == [
        "FlexibleJointPlant.fmu",
        "FlexibleJointObserver.fmu",
    ]
    assert main(["build", JOINT, "--fmi", "3", "--out", str(tmp_path)]) == 2
    assert "build --fmi 3: expected --target native, received --target python" in capsys.readouterr().err


def test_an_estimate_of_method_1_outside_its_range_is_said_in_the_words_of_the_python_fmu(built):
    model, python, _, native = built(CYLINDER)
    (state, (_, high)) = next((name, model.ranges[name]) for name in model.states if name in model.ranges)
    told = []
    for fmu in (python, native):
        library = Library(Path(fmpy.extract(str(fmu))))
        references = {variable.name: variable.reference for variable in library.variables}
        handle = library.new(logging=1)
        library.set(handle, [references["method"]], [1], "Integer")
        library.set(handle, [references[f"{state}_hat_start"]], [2.0 * high])
        library.begin(handle)
        assert library.step(handle, 0.0, model.experiment.step_size) in (0, 1)
        told.append([text for _, _, text in library.said if "outside its range" in text])
        library.FreeInstance(handle)
    assert told[0] == told[1]
    assert told[0]


@pytest.mark.parametrize(
    ("rate", "step_size", "part"),
    [(1e16, 1e-3, "times the plant's fastest mode"), (None, 1e-9, "of the plant's shortest time constant")],
)
def test_an_absurd_rate_or_step_is_said_in_the_words_of_the_python_fmu(built, rate, step_size, part):
    _, python, _, native = built(JOINT)
    told = []
    for fmu in (python, native):
        library = Library(Path(fmpy.extract(str(fmu))))
        references = {variable.name: variable.reference for variable in library.variables}
        handle = library.new(logging=1)
        if rate is not None:
            library.set(handle, [references["disturbance_rate"]], [rate])
        library.begin(handle)
        library.step(handle, 0.0, step_size)
        told.append([text for _, _, text in library.said])
        library.FreeInstance(handle)
    assert told[0] == told[1]
    assert any(part in text for text in told[0])


def test_an_instance_takes_the_tuning_over_from_one_of_the_same_parameters(built):
    """The results have the same bits, whether others of the same or of other parameters came before."""
    _, _, _, fmu = built(JOINT)
    folder, description = fmpy.extract(str(fmu)), fmpy.read_model_description(str(fmu))
    references = {v.name: v.valueReference for v in description.modelVariables}
    slaves = []

    def first_step(bound):
        slave = fmpy.instantiate_fmu(folder, description)
        slaves.append(slave)
        slave.setupExperiment(startTime=0.0)
        slave.enterInitializationMode()
        slave.setReal([references["disturbance_bound"]], [bound])
        slave.exitInitializationMode()
        slave.setReal([references["link_angle"], references["motor_angle"]], [0.1, 0.11])
        begin = process_time()
        slave.doStep(0.0, 1e-3)
        taken = process_time() - begin
        return taken, slave.getReal([references["load_torque_hat"], references["load_torque_std"]])

    alone, other = first_step(2.0), first_step(3.0)
    again = [first_step(2.0) for _ in range(5)]
    assert {tuple(values) for _, values in (alone, *again)} == {tuple(alone[1])}
    assert alone[1] != other[1]
    assert min(taken for taken, _ in again) < 0.3 * min(alone[0], other[0])
    for slave in slaves:
        slave.terminate()
        slave.freeInstance()
