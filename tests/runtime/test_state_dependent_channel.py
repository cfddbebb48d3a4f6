"""A disturbance whose direction depends on the state: why the paper's extension fails, and what works in its place."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import sympy

from ndob_fmu import Model, build, check, design
from ndob_fmu.analysis.direction import shortest_direction
from ndob_fmu.analysis.lipschitz import largest_slope
from ndob_fmu.codegen.compile_model import compile_model, linear_part
from ndob_fmu.codegen.emit import emit_python
from ndob_fmu.cosim import FmuComponent, System, simulate
from ndob_fmu.errors import AssumptionError, ModelError
from ndob_fmu.runtime.blocks.disturbance import KINDS, Generator
from ndob_fmu.runtime.blocks.plant import Plant
from ndob_fmu.runtime.design.lumping import lumped, lumped_bound, lumped_rate
from ndob_fmu.runtime.design.schedule import PiSchedule
from ndob_fmu.runtime.numerics.zeros import balance, pencil_zeros
from ndob_fmu.runtime.step.channel_observer import VANISHING, read_out
from ndob_fmu.runtime.step.observer import Estimate
from ndob_fmu.runtime.step.paper_observer import paper_observer
from tests.helpers.observers import sampled_observer
from tests.helpers.problems import MODELS

JOINT = linear_part(MODELS["flexible_joint"])
ARM = MODELS["tool_on_arm"]
TURNING = (0.0, 3.0)  # N·m: at this torque the elbow turns round and round, at 4 rad/s on average
AMPLITUDE = 10.0

# -- the paper's extension, eqs. (13)–(14): z = [x, d], ż = A_z z + G₁ n₁(x) x₅ + G₂ n₂(x) x₅ + e₅ ḋ


def extended(split=(0.0, 0.0), C=JOINT.C):
    """Return the extended system as a model: n_i = n̄_i + ñ_i(x), n̄ = `split` in A_z, and f_i = ñ_i(x) x₅.

    The plant is the flexible joint with a load on link and motor, n₁ = cos(link angle), n₂ = 1 + sin(motor angle)/2.
    """
    G = np.eye(4)[:, [1, 3]]
    A = np.block([[JOINT.A, (G @ split)[:, None]], [np.zeros((1, 5))]])
    return Model(
        name="Extended",
        states=["link_angle", "link_rate", "motor_angle", "motor_rate", "load"],
        outputs=[f"y{i}" for i in range(len(C))],
        disturbances=["load_rate"],
        A=A,
        C=np.hstack([C, np.zeros((len(C), 1))]),
        G_f=np.eye(5)[:, [1, 3]],
        G_d=np.eye(5)[:, [4]],
        f=lambda x, u, p: [
            (sympy.cos(x.link_angle) - split[0]) * x.load,
            (1 + sympy.sin(x.motor_angle) / 2 - split[1]) * x.load,
        ],
    )


def observability_rank(linear):
    return int(np.linalg.matrix_rank(np.vstack([linear.C @ np.linalg.matrix_power(linear.A, k) for k in range(5)])))


ALL_OUTPUTS = np.vstack([JOINT.C, np.eye(4)[[1, 3]]])
SPLITS = np.random.default_rng(13).normal(size=(12, 2))


def test_the_extended_system_as_printed_does_not_show_the_disturbance_to_any_output():
    model = extended()
    report = check(model)
    assert observability_rank(linear_part(model)) == 4  # of 5
    assert observability_rank(linear_part(extended(C=ALL_OUTPUTS))) == 4
    assert not report["observable"].passed
    assert set(report["observable"].values["hidden_modes"].values()) == {"load"}
    assert not report["minimum_phase"].passed
    assert report["minimum_phase"].values["normal_rank"] == 2


@pytest.mark.parametrize("split", SPLITS, ids=str)
def test_with_a_nominal_direction_it_is_observable_but_two_of_its_three_unknown_inputs_are_all_that_is_seen(split):
    for outputs in (2, 3, 4):
        linear = linear_part(extended(split, ALL_OUTPUTS[:outputs]))
        system = balance(linear.A, linear.G, linear.C)
        assert observability_rank(linear) == 5
        assert linear.G.shape == (5, 3)
        assert pencil_zeros(system.A, system.G, system.C)[1] == 2


@pytest.mark.parametrize("outputs", [2, 3, 4])
def test_with_a_nominal_direction_it_is_never_minimum_phase_whatever_is_measured(outputs):
    """No output helps: the third of the unknown inputs reaches all of them as a combination of the other two."""
    model = extended(SPLITS[0], ALL_OUTPUTS[:outputs])
    report = check(model)
    assert report["observable"].passed
    assert report["outputs_at_least_unknown_inputs"].passed == (outputs >= 3)
    assert not report["minimum_phase"].passed
    assert report["minimum_phase"].values["normal_rank"] == 2
    with pytest.raises(AssumptionError, match="outputs_at_least_unknown_inputs" if outputs < 3 else "minimum_phase"):
        report.require("method 1")


@pytest.mark.parametrize("split", SPLITS[:3], ids=str)
def test_the_derivatives_channel_is_the_nominal_direction_behind_an_integrator(split):
    """C_z (sI − A_z)⁻¹ e₅ = C (sI − A)⁻¹ (G₁ n̄₁ + G₂ n̄₂) / s: why the rank is 2 whatever is measured."""
    linear = linear_part(extended(split))
    for s in (0.7, -1.3 + 2.0j):
        of_rate = linear.C @ np.linalg.solve(s * np.eye(5) - linear.A, linear.G_d[:, 0])
        nominal = JOINT.C @ np.linalg.solve(s * np.eye(4) - JOINT.A, np.eye(4)[:, [1, 3]] @ split) / s
        np.testing.assert_allclose(of_rate, nominal, rtol=1e-10)


def test_its_nonlinearity_has_no_lipschitz_constant():
    """|∂(n(x) d)/∂x| grows with d: the slope found grows with the box that is searched."""
    near, far = (largest_slope(replace(extended(), x0=[0, 0, 0, 0, load])).value for load in (1.0, 100.0))
    assert far > 50.0 * near


def test_the_lumped_inputs_satisfy_every_assumption():
    system = balance(JOINT.A, np.eye(4)[:, [1, 3]], JOINT.C)
    zeros, rank = pencil_zeros(system.A, system.G, system.C)
    assert (len(zeros), rank) == (0, 2)
    with_channel = replace(
        extended(),
        **{"name": "Lumped", "states": ARM.states, "A": JOINT.A, "C": JOINT.C, "G_f": None, "f": None},
        **{"G_d": np.eye(4)[:, [1, 3]], "x0": None, "xhat0": None, "xhat0_std": None},
        channel=lambda x, u, p: [sympy.cos(x.shoulder_angle), 1],
    )
    report = check(with_channel, alpha=1.0)
    assert report.passed, str(report)
    assert report["relative_degree"].values == {"n[0]*load_rate": 2, "n[1]*load_rate": 2}


# -- what ships: the read-out


class Fixed:
    """An observer of w that says what it is told to."""

    def __init__(self, w, std, x_at_sample, x_hat, *, valid=True):
        self.says = Estimate(
            x_hat=tuple(x_hat),
            d_hat=tuple(w[1]),
            x_at_sample=tuple(x_at_sample),
            d_at_sample=tuple(w[0]),
            d_std=tuple(std),
            d_lagged=tuple(w[0]),
            d_lagged_std=tuple(0.5 * np.array(std)),
            residual=(0.0, 0.0),
            residual_std=(1.0, 1.0),
            valid=valid,
            consistency=1.0,
        )

    def init(self, x_hat):
        return SimpleNamespace(u=(0.0, 0.0))

    def estimate(self, state, y):
        return self.says

    def step(self, state, u, y, H):
        return state, self.says


def read(w, std=(1.0, 1.0), elbow=(0.5, 0.7), last=0.0, model=ARM, valid=True):
    """Return the estimate of d at the sample and ahead from the ŵ (2,k) and elbow angles there."""
    states = [[0.0, 0.0, angle, 0.0] for angle in elbow]
    observer = read_out(
        compile_model(model), model.parameter_values(), Fixed(w, std, *states, valid=valid), disturbance_bound=[20.0]
    )
    state = replace(observer.init(model.xhat0), d_hat=(last,))
    after, estimate = observer.step(state, [0.0, 0.0], [0.0, 0.0], 1e-3)
    np.testing.assert_array_equal(after.d_hat, estimate.d_hat)
    return estimate


def n(elbow):
    return np.array([0.3 + 0.4 * np.cos(elbow), 0.3])


def test_a_consistent_estimate_of_the_lumped_inputs_is_read_exactly():
    estimate = read([7.0 * n(0.5), -3.0 * n(0.7)], std=[0.2, 5.0])
    assert estimate.d_at_sample == pytest.approx([7.0], rel=1e-14)
    assert estimate.d_hat == pytest.approx([-3.0], rel=1e-14)
    assert estimate.valid


def test_with_equal_error_bars_it_is_the_projection_on_the_direction():
    """d̂ = nᵀ ŵ / ‖n‖², std = σ / ‖n‖."""
    w = np.array([[1.0, 2.0], [0.4, -1.0]])
    estimate = read(w, std=[0.1, 0.1])
    assert estimate.d_at_sample == pytest.approx([n(0.5) @ w[0] / (n(0.5) @ n(0.5))], rel=1e-14)
    assert estimate.d_hat == pytest.approx([n(0.7) @ w[1] / (n(0.7) @ n(0.7))], rel=1e-14)
    assert estimate.d_std == pytest.approx([0.1 / np.linalg.norm(n(0.7))], rel=1e-14)
    assert estimate.d_lagged == pytest.approx(estimate.d_at_sample, rel=1e-14)
    assert estimate.d_lagged_std == pytest.approx([0.05 / np.linalg.norm(n(0.5))], rel=1e-14)


def test_the_lagged_estimate_is_read_along_the_direction_of_its_own_time():
    """The elbow turns by 0.1 rad a step; the lag is four steps, and d was 7 N then."""
    H, steps, lag = 5e-3, 12, 4
    lumped_observer = Fixed([n(0.0)] * 2, [0.1, 0.1], [0.0] * 4, [0.0] * 4)
    observer = read_out(
        compile_model(ARM), ARM.parameter_values(), lumped_observer, disturbance_bound=[20.0], lag=lag * H
    )
    state = observer.init(ARM.xhat0)
    for k in range(steps):
        now, then = 0.1 * k, 0.1 * max(k - lag, 0)
        lumped_observer.says = replace(
            lumped_observer.says,
            x_at_sample=(0.0, 0.0, now, 0.0),
            d_at_sample=tuple(3.0 * n(now)),
            d_lagged=tuple(7.0 * n(then)),
        )
        state, estimate = observer.step(state, [0.0, 0.0], [0.0, 0.0], H)
        assert estimate.d_at_sample == pytest.approx([3.0])
        assert estimate.d_lagged == pytest.approx([7.0])
        assert estimate.d_lagged_std == pytest.approx([0.05 / np.linalg.norm(n(then))])


def test_an_estimate_of_ten_times_the_error_counts_a_hundredth():
    clean, noisy = read([[0.0, 1.0]] * 2, std=[1.0, 0.1], elbow=(0.0, 0.0)), read([[1.0, 0.0]] * 2, std=[1.0, 0.1])
    assert clean.d_hat[0] == pytest.approx(30.0 / (0.49 + 9.0))
    assert abs(noisy.d_hat[0]) < 0.1


def test_its_error_bar_is_that_of_independent_errors():
    random = np.random.default_rng(4)
    std = np.array([0.3, 0.05])
    drawn = [read([5.0 * n(0.5), 5.0 * n(0.7) + std * random.normal(size=2)], std=std).d_hat[0] for _ in range(2000)]
    assert np.std(drawn) == pytest.approx(read([n(0.5)] * 2, std=std).d_std[0], rel=0.05)


def test_error_bars_of_zero_do_no_harm():
    for std in ([0.0, 0.0], [0.0, 0.1]):
        assert read([7.0 * n(0.5), -3.0 * n(0.7)], std=std).d_hat == pytest.approx([-3.0], rel=1e-8)


RADIAL = replace(  # a force along the forearm, which has no lever arm where the arm is stretched or folded
    ARM, channel=lambda x, u, p: [p.upper_arm * sympy.sin(x.elbow_angle), 0], channel_bound=[0.4, 0.3]
)


@pytest.mark.parametrize(
    ("elbow", "at_sample", "ahead", "std", "valid"),
    [
        ((1.0, 1.1), 5.0, 6.0, 1.0 / (0.4 * np.sin(1.1)), True),
        ((1.0, 0.0999), 5.0, 5.0, 20.0, False),
        ((-0.0999, 1.1), -2.5, 6.0, 1.0 / (0.4 * np.sin(1.1)), False),
        ((0.05, 0.0), -2.5, -2.5, 20.0, False),
        ((np.nan, 1.1), -2.5, 6.0, 1.0 / (0.4 * np.sin(1.1)), False),
        ((1.0, np.inf), 5.0, 5.0, 20.0, False),
    ],
)
def test_where_the_direction_vanishes_the_last_disturbance_is_held_and_not_valid(elbow, at_sample, ahead, std, valid):
    w = [5.0 * 0.4 * np.sin([elbow[0], 0.0]), [6.0 * 0.4 * np.sin(elbow[1]) if elbow[1] < 9.0 else 1.0, 0.0]]
    estimate = read(w, elbow=elbow, last=-2.5, model=RADIAL)
    assert estimate.d_at_sample == pytest.approx([at_sample])
    assert estimate.d_hat == pytest.approx([ahead])
    assert estimate.d_std == pytest.approx([std])
    assert estimate.valid == valid


def test_a_bad_sample_is_not_made_valid_by_a_good_direction():
    assert not read([n(0.5), n(0.7)], valid=False).valid


def test_a_direction_that_cannot_be_evaluated_counts_as_vanishing():
    model = replace(ARM, channel=lambda x, u, p: [1 / x.elbow_angle, sympy.sqrt(1 + x.elbow_angle)], channel_bound=9.0)
    assert read([[0.0, 0.0]] * 2, elbow=(0.0, 0.0), last=4.0, model=replace(model)).d_hat == (4.0,)
    assert not read([[0.0, 0.0]] * 2, elbow=(1.0, -2.0), model=model).valid


@pytest.mark.parametrize("order", [0, 1, 2, 3])
def test_the_lumped_rate_bounds_the_derivatives_of_the_product(order):
    """n = 0.7 cos Ωt, d = D₀ sin ωt: n d = 0.35 D₀ (sin (ω + Ω)t + sin (ω − Ω)t)."""
    r, omega, Omega = max(order, 1), 8.0, ARM.channel_rate
    largest = 0.35 * 20.0 * ((omega + Omega) ** r + abs(omega - Omega) ** r)
    bound = lumped_rate(compile_model(ARM), [20.0], [20.0 * omega**r], order=order)
    assert largest <= bound[0] <= 2.0 * largest
    assert bound[1] == pytest.approx(bound[0] * 0.3 / 0.7)
    assert list(lumped_bound(compile_model(ARM), [20.0])) == pytest.approx([14.0, 6.0])


def test_a_rate_that_is_unknown_stays_unknown():
    assert list(lumped_rate(compile_model(ARM), [20.0], [0.0], order=2)) == [0.0, 0.0]


@pytest.mark.parametrize("changes", [{"disturbance_rate": -1.0}, {"disturbance_bound": -1.0}])
def test_bounds_that_make_no_sense_are_refused_for_the_lumped_inputs_too(changes):
    with pytest.raises(ModelError, match=rf"{next(iter(changes))}: expected one finite number"):
        design(ARM, step_size=1e-2, **changes)


# -- what ships: both observers on the arm, the direction turning with the elbow


def observer_of(model, method, *, order=2, noise_std=0.0, bound=20.0, pi=1e10):
    eq, p = compile_model(model), model.parameter_values()
    rate, sigma = [bound * (2.0 * np.pi) ** max(order, 1)], [noise_std] * len(eq.outputs)
    if method == 1:
        within = lumped_bound(eq, [bound])
        schedule = PiSchedule(1e2, pi, 1.0)
        made = paper_observer(lumped(eq), p, schedule, alpha=1.0, noise_std=sigma, disturbance_bound=within)
    else:
        made = sampled_observer(
            lumped(eq),
            p,
            order=order,
            noise_std=sigma,
            disturbance_bound=lumped_bound(eq, [bound]),
            disturbance_rate=lumped_rate(eq, [bound], rate, order=order),
            x_hat=eq.xhat0,
            x_std=eq.xhat0_std,
            alpha=1.0,
            pi=pi,
        )
    return read_out(eq, p, made, disturbance_bound=[bound])


def run(model, observer, H, *, torque=TURNING, noise_std=0.0, stop=2.6, signal=None):
    """Return a namespace of columns over the steps: true and estimated d at the sample and at the end of the step, …"""
    random = np.random.default_rng(1)
    signal = signal or Generator(KINDS["sine"], AMPLITUDE, 1.0)
    eq = compile_model(model)
    plant = Plant(eq, model.parameter_values(), [signal])
    x, state = plant.init(eq.x0, 0.0), observer.init(eq.xhat0)
    C = linear_part(model).C
    rows = []
    for k in range(round(stop / H)):
        y = C @ x.x + noise_std * random.normal(size=len(C))
        x = plant.step(x, list(torque), [0.0], (k + 1) * H)
        state, e = observer.step(state, torque, y, H)
        now, then = signal(k * H), signal((k + 1) * H)
        rows.append([k * H, now, e.d_at_sample[0], then, e.d_hat[0], e.d_std[0], e.valid, x.x[2]])
    names = ("t", "d", "d_at_sample", "d_ahead", "d_hat", "d_std", "valid", "elbow")
    return SimpleNamespace(**dict(zip(names, np.array(rows).T, strict=True)))


@pytest.mark.parametrize(
    ("order", "H", "at_sample", "ahead"),
    [(2, 1e-3, 3e-5, 1.2e-4), (2, 1e-2, 3e-3, 1.2e-2), (3, 1e-3, 2e-7, 1e-6), (3, 1e-2, 2e-4, 1e-3)],
)
def test_the_force_is_found_while_its_direction_turns(order, H, at_sample, ahead):
    found = run(ARM, observer_of(ARM, 2, order=order), H)
    late = found.t > 0.5
    assert np.ptp(found.elbow[late]) > 2.0 * np.pi
    assert found.valid.all()
    assert np.max(np.abs(found.d_at_sample - found.d)[late]) < at_sample * AMPLITUDE
    assert np.max(np.abs(found.d_hat - found.d_ahead)[late]) < ahead * AMPLITUDE


@pytest.mark.parametrize(
    ("order", "H", "stop", "rms"),
    [(2, 1e-3, 2.5, 0.018), (2, 1e-2, 9.0, 0.036), (3, 1e-3, 2.5, 0.011), (3, 1e-2, 9.0, 0.025)],
)
def test_with_the_encoders_noise_it_is_found_within_its_error_bar(order, H, stop, rms):
    sigma = ARM.noise_std
    found = run(ARM, observer_of(ARM, 2, order=order, noise_std=sigma, bound=AMPLITUDE), H, noise_std=sigma, stop=stop)
    late = found.t > 0.5
    error = np.abs(found.d_hat - found.d_ahead)[late]
    # In one of some thousand samples noise looks like a jump of the force; then the error bar covers it.
    usual = np.sort(error)[: -max(1, len(error) // 500)]
    assert np.sqrt(np.mean(usual**2)) < rms * AMPLITUDE
    assert np.all(error < np.maximum(5.0 * found.d_std[late], 5.0 * rms * AMPLITUDE))
    assert np.mean(error < 2.0 * found.d_std[late]) > 0.9


@pytest.mark.parametrize("method", [1, 2])
def test_where_the_force_has_no_lever_arm_its_last_value_is_held_and_it_is_found_again(method):
    found = run(RADIAL, observer_of(RADIAL, method), 1e-3, stop=2.6 if method == 1 else 1.5)
    late = found.t > (1.5 if method == 1 else 0.2)
    short = np.abs(np.sin(found.elbow)) < VANISHING  # at the ends of the steps
    near = np.abs(np.abs(np.sin(found.elbow)) - VANISHING) < 0.01
    assert (short & late).sum() > 20
    assert not found.valid[late & short & ~near].any()
    assert found.valid[late & ~short & ~near].all()
    assert (found.d_std[late & short & ~near] == 20.0).all()
    held = np.flatnonzero(late & short & ~near)
    both = held[1:][np.diff(held) == 1]
    assert (found.d_hat[both] == found.d_hat[both - 1]).all()
    error = np.abs(found.d_hat - found.d_ahead)
    assert np.max(error[late & ~short & ~near]) < (0.2 if method == 1 else 2e-3) * AMPLITUDE
    assert np.max(error[late]) < 0.5 * AMPLITUDE


def test_a_direction_of_one_is_no_direction():
    motor, signal = MODELS["dc_motor"], Generator(KINDS["sine"], 1.0, 1.0)
    one, other = (
        run(model, observer_of(model, 2, bound=1.5), 1e-2, torque=(0.0,), stop=0.5, signal=signal)
        for model in (motor, replace(motor, channel=lambda x, u, p: [1]))
    )
    for name in ("d_at_sample", "d_hat", "d_std", "valid"):
        np.testing.assert_allclose(getattr(other, name), getattr(one, name), rtol=1e-9, atol=1e-12, err_msg=name)


def test_a_direction_may_turn_with_an_input():
    """The side force in the tool's own frame, at an angle that is known: the observer's direction follows u."""
    turned = replace(ARM, channel=lambda x, u, p: [p.forearm * sympy.cos(u.elbow_torque), p.forearm], channel_bound=0.3)
    found = run(turned, observer_of(turned, 2), 1e-3, stop=1.0)
    assert np.max(np.abs(found.d_hat - found.d_ahead)[found.t > 0.5]) < 2e-3 * AMPLITUDE


# -- the FMUs


@pytest.fixture(scope="module")
def arm_fmus(tmp_path_factory):
    return build(ARM, tmp_path_factory.mktemp("arm"))


def coupled(arm_fmus, H, method):
    """Run both FMUs with the elbow turning; return the recording."""
    components = {"plant": FmuComponent(arm_fmus[0], "plant"), "observer": FmuComponent(arm_fmus[1], "observer")}
    connections = [(("plant", name), ("observer", name)) for name in ARM.outputs]
    torques = dict(zip(ARM.inputs, TURNING, strict=True))
    starts = {(part, name): value for part in components for name, value in torques.items()}
    starts |= {("plant", "tool_force"): 0.0, ("observer", "method"): method}
    starts |= {("observer", f"{name}_noise_std"): 0.0 for name in ARM.outputs}
    return simulate(System(components, connections, starts), stop_time=STOP, step_size=H)


STOP = 1.8


@pytest.mark.parametrize(("method", "H", "allowed"), [(2, 1e-3, 3e-5), (2, 1e-2, 3e-3), (1, 1e-3, 0.03)])
def test_the_fmus_find_the_force_while_its_direction_turns_as_their_core_does(arm_fmus, method, H, allowed):
    recording = coupled(arm_fmus, H, method)
    d, d_at_sample = recording["plant.tool_force_total"], recording["observer.tool_force_at_sample"]
    late = recording.time[:-1] > STOP - 0.5
    assert np.ptp(recording["plant.elbow_angle"]) > 2.0 * np.pi
    assert np.max(np.abs(d_at_sample[1:] - d[:-1])[late]) < allowed * AMPLITUDE
    core = run(ARM, observer_of(ARM, method), H, stop=STOP)
    for name, ours in (("hat", core.d_hat), ("at_sample", core.d_at_sample), ("std", core.d_std)):
        np.testing.assert_allclose(recording[f"observer.tool_force_{name}"][1:], ours, rtol=0, atol=1e-6 * AMPLITUDE)
    assert (recording["observer.valid"][1:] == core.valid).all()


def test_the_fmus_have_the_variables_of_one_disturbance(arm_fmus):
    plant, observer = ({v.name: v for v in FmuComponent(fmu).variables} for fmu in arm_fmus)
    assert plant["tool_force"].causality == "input"
    assert {"tool_force_total", "disturbance.kind", "upper_arm"} <= set(plant)
    assert {"tool_force_hat", "tool_force_at_sample", "tool_force_std", "disturbance_bound", "disturbance_rate"} <= set(
        observer
    )
    assert not [name for name in {*plant, *observer} if "[" in name]


# -- the model


def test_the_plants_equations_are_those_of_the_lumped_inputs_in_the_direction():
    eq, p, random = compile_model(ARM), ARM.parameter_values(), np.random.default_rng(6)
    x, u = random.normal(size=4), random.normal(size=2)
    assert eq.channel.direction(x, u, p) == pytest.approx(n(x[2]))
    assert eq.derivatives(x, u, [2.5], p) == pytest.approx(lumped(eq).derivatives(x, u, 2.5 * n(x[2]), p))
    definitions = emit_python(ARM).split("def plant_constants")[0].split("\n\n\n")
    of_rates = [text for text in definitions if text.startswith(("def nonlinearity(", "def lumped_derivatives("))]
    slopes = [
        text for text in definitions if text.partition("(")[0].endswith(("linearisation", "slopes", "sensitivity"))
    ]
    assert (len(of_rates), len(slopes)) == (2, 6)
    rest = [text for text in definitions if text not in slopes]
    # In the nonlinearity and in one function of derivatives.
    assert "".join(rest).count("math.tanh") == "".join(of_rates).count("math.tanh") == 4


def test_other_parameter_values_reach_the_direction():
    longer = tuple(2.0 * value for value in ARM.parameter_values())
    assert compile_model(ARM).channel.direction((0.0,) * 4, (0.0,) * 2, longer) == pytest.approx((1.4, 0.6))


def test_a_model_without_channel_is_untouched():
    motor = compile_model(MODELS["dc_motor"])
    observer = Fixed([[0.0]] * 2, [1.0], [0.0], [0.0])
    assert motor.channel is None
    assert lumped(motor) is motor
    assert read_out(motor, (), observer, disturbance_bound=[1.0]) is observer
    assert "hannel" not in emit_python(MODELS["dc_motor"])


def two(x, u, p):
    return [sympy.cos(x.elbow_angle), 1]


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        (
            {"channel": lambda x, u, p: [1, 1, x.elbow_angle]},
            "G_d: expected shape (4, 3) because 4 states are named and",
        ),
        ({"channel": lambda x, u, p: [1]}, "channel returns 1 expressions, received shape (4, 2)"),
        ({"disturbances": ["tool_force", "weight"]}, "disturbances: expected one disturbance where there is a channel"),
        (
            {"channel": lambda x, u, p: [x.wrist, 1]},
            "elbow_rate, received x.wrist; likely cause: a name that is not declared",
        ),
        ({"channel": lambda x, u, p: [sympy.Symbol("wrist"), 1]}, "ToolOnArm.channel: expected expressions in"),
        ({"channel": lambda x, u, p: [sympy.Symbol("tool_force"), 1]}, "received the symbol 'tool_force'"),
        ({"channel": lambda x, u, p: []}, "channel: expected at least one expression, received none"),
        ({"channel": lambda x, u, p: 1}, "channel: expected channel(x, u, p) returning a list"),
        ({"channel_bound": [1.0] * 3}, "channel_bound: expected one finite number > 0, or 2, one for each entry of n"),
        ({"channel_bound": 0.0}, "channel_bound: expected one finite number > 0, or 2"),
        ({"channel_rate": -1.0}, "channel_rate: expected a finite number ≥ 0 (rad/s), received -1.0"),
        ({"channel": None, "channel_bound": None, "channel_rate": 5.0}, "channel_rate: expected a channel"),
        ({"channel": None, "channel_bound": 2.0, "channel_rate": 0.0}, "channel_bound: expected a channel"),
    ],
)
def test_a_channel_that_makes_no_sense_is_refused_in_one_line(changes, says):
    with pytest.raises(ModelError) as caught:
        replace(ARM, **changes)
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_direction_that_cannot_be_evaluated_at_the_start_is_refused():
    model = replace(ARM, channel=lambda x, u, p: [1 / x.shoulder_rate, 1])
    with pytest.raises(ModelError, match="expected matrices and f and channel that can be evaluated"):
        compile_model(model)


def test_check_tells_how_short_the_direction_becomes_and_where():
    row = check(ARM)["direction"]
    assert row.values["shortest"] == pytest.approx(1.0, rel=1e-3)  # the elbow's lever arm, in its bound
    assert row.values["largest_entry"] == pytest.approx(1.0, rel=1e-3)
    vanishing = shortest_direction(RADIAL)
    assert vanishing.length < 1e-6
    assert abs(np.sin(vanishing.at["elbow_angle"])) < 1e-6
    assert shortest_direction(replace(ARM, channel=lambda x, u, p: [p.forearm, 0.6])).length == pytest.approx(
        np.hypot(0.3 / 0.7, 2.0)
    )
    assert "direction" not in [row.name for row in check(MODELS["dc_motor"]).rows]


def test_the_design_of_the_lumped_inputs_bounds_the_error_of_the_force():
    """d̂ = aᵀ ŵ with aᵀ n = 1, and so |d̂ − d| ≤ Σ |a_j| |ŵ_j − w_j|."""
    found = design(ARM, step_size=1e-2, noise_std=0.0)
    assert found.disturbances == ("n[0]*tool_force", "n[1]*tool_force")
    assert found.disturbance_bound == pytest.approx((14.0, 6.0))
    assert found.disturbance_rate == pytest.approx(
        [n_bound * 20.0 * (5.0 + 2.0 * np.pi) ** 2 for n_bound in (0.7, 0.3)]
    )
    bounds, sigma = found.certificate.at_sample, found.error_bar
    found = run(ARM, observer_of(ARM, 2), 1e-2)
    late = found.t > 0.5
    directions = np.array([n(angle) / sigma for angle in found.elbow])
    a = directions / np.sum(directions**2, axis=1)[:, None] / sigma
    assert (np.abs(found.d_at_sample - found.d) < np.abs(a) @ bounds)[late].all()
