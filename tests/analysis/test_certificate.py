"""The bound holds in every run with the frozen gain, and the worst run that can be found comes close to it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ndob_fmu.analysis.certificate import certify
from ndob_fmu.codegen.compile_model import compile_model, linear_part
from ndob_fmu.runtime.blocks.plant import Plant
from ndob_fmu.runtime.design.gains import paper_gains
from ndob_fmu.runtime.numerics.exponential import exponential
from ndob_fmu.runtime.step.converged_step import converged_step
from ndob_fmu.runtime.step.sampled_observer import SampledObserver
from tests.helpers.observers import sampled_observer
from tests.helpers.problems import MODELS

FLEXIBLE = MODELS["flexible_joint"]
NOISE = 1e-4
WARM_UP = 3.0


def observer_for(model, order, *, noise_std=NOISE, rate=None):
    equations = compile_model(model)
    bound = equations.disturbance_bound
    return sampled_observer(
        equations,
        model.parameter_values(),
        order=order,
        noise_std=[noise_std] * len(model.outputs),
        disturbance_bound=bound,
        disturbance_rate=rate or [b * 6.0 ** max(order, 1) for b in bound],
        x_hat=equations.x0,
        x_std=np.ones(len(equations.states)),
        alpha=model.observer.alpha,
        pi=1e8,
        adapt_noise=False,  # the samples have none
    )


def certificate_of(observer: SampledObserver, H):
    return certify(
        observer.design(H),
        disturbance_rate=observer.known.disturbance_rate,
        disturbance_bound=observer.known.disturbance_bound,
        lipschitz=observer.equations.lipschitz,
        f_states=observer.equations.f_states,
    )


class Played:
    """A disturbance whose r-th derivative is one constant per piece of time, integrated exactly."""

    def __init__(self, rates, piece, order, start=0.0):
        self.piece, self.order = piece, order
        self.breaks = tuple(np.arange(1, len(rates)) * piece)
        values = np.zeros((len(rates) + 1, order + 1))
        values[0, 0] = start
        for k, rate in enumerate(rates):
            values[k, order] = rate
            values[k + 1, :order] = [self._taylor(values[k], i, piece) for i in range(order)]
        self.values = values

    def _taylor(self, derivatives, i, s):
        total, term = 0.0, 1.0
        for j in range(i, self.order + 1):
            total += derivatives[j] * term
            term *= s / (j - i + 1)
        return total

    def __call__(self, t):
        k = min(int(t / self.piece + 1e-9), len(self.values) - 2)
        return self._taylor(self.values[k], 0, t - k * self.piece)


def errors_of(observer, model, disturbance, H, steps):
    """Run plant and observer, both from the true state, and return |d̂ − d| at the sample, ahead, and |x̂ − x|."""
    return run_of(observer, model, disturbance, H, steps)[0]


def run_of(observer, model, disturbance, H, steps):
    """Return these errors, and whether the gain was frozen before each step."""
    equations = compile_model(model)
    plant = Plant(equations, observer.parameters, [disturbance])
    x, o = plant.init(equations.x0, 0.0), observer.init(equations.x0)
    C = observer.system.linear.C
    u = [0.0] * len(equations.inputs)
    found, frozen = [], []
    for k in range(steps):
        frozen.append(o.memory.converged)
        o, e = observer.step(o, u, C @ x.x, H)
        now = disturbance(k * H)
        x = plant.step(x, u, [0.0], (k + 1) * H)
        then = disturbance((k + 1) * H)
        found.append([abs(e.d_at_sample[0] - now), abs(e.d_hat[0] - then), *np.abs(np.subtract(e.x_hat, x.x))])
    return np.array(found), np.array(frozen)


def worst_rates(observer, H, rate, steps, pieces):
    """Return the r-th derivative that the linear error system finds worst for the last sample: a bang-bang signal."""
    design = observer.design(H)
    F = design.discrete.Phi @ (np.eye(len(design.K)) - design.K @ design.system.C)
    row = design.system.selector @ (np.eye(len(design.K)) - design.K @ design.system.C)
    within = [
        exponential(design.system.A * (H * (1.0 - (i + 0.5) / pieces))) @ design.system.noise for i in range(pieces)
    ]
    signs = []
    for _ in range(steps):
        signs.append([float(np.sign((row @ column)[0, 0])) for column in within])
        row = row @ F
    return rate * np.array(signs[::-1]).ravel()


@pytest.mark.parametrize(("order", "H"), [(1, 2e-3), (2, 5e-3), (3, 1e-2)])
def test_the_worst_disturbance_of_the_class_comes_within_a_factor_two_of_the_bound_and_never_beyond(order, H):
    observer = observer_for(FLEXIBLE, order)
    bound = certificate_of(observer, H)
    rate = float(observer.known.disturbance_rate[0])
    steps = round(WARM_UP / H)
    # The derivative that is worst for the last sample alternates so fast that d itself hardly moves.
    played = Played(worst_rates(observer, H, rate, steps, 4), H / 4, order)
    found, frozen = run_of(observer, FLEXIBLE, played, H, steps + 1)
    assert bound.exists
    assert found[-1, 0] <= bound.at_sample[0]
    assert bound.at_sample[0] <= 2.0 * found[-1, 0]
    assert np.all(found[:, 1] <= bound.ahead[0])
    # The start is from the true state. Where the covariance runs again, because the samples have no noise, the gain is
    # another one, and a state's error may exceed the bound of the frozen gain.
    until = np.flatnonzero(frozen)[-1] if np.any(frozen) else len(frozen)
    assert np.all(found[:until, 2:] <= bound.states + 1e-12)


@pytest.mark.parametrize(("order", "H"), [(1, 2e-3), (2, 5e-3), (3, 1e-2)])
def test_the_bound_is_that_of_the_frozen_gain(order, H):
    observer = observer_for(FLEXIBLE, order)
    bound, eq = certificate_of(observer, H), observer.equations
    rate, steps = float(observer.known.disturbance_rate[0]), round(WARM_UP / H)
    played = Played(worst_rates(observer, H, rate, steps, 4), H / 4, order)
    frozen = converged_step(observer.tuned(H).model, observer.designs.at(H, H), H, (1.0,) * len(eq.outputs))
    every_sample = replace(frozen.gain, gate=(np.inf,) * len(eq.outputs))
    plant, C = Plant(eq, observer.parameters, [played]), observer.system.linear.C
    u = [0.0] * len(eq.inputs)
    x, state = plant.init(eq.x0, 0.0), observer.init(eq.x0)
    xi, squares = state.xi_hat, state.squares
    for k in range(steps + 1):
        done = frozen.observer_step(xi, (*u, *(C @ x.x)), squares, frozen.constants, every_sample, H)
        at_sample = abs(done.xi_at_sample[len(eq.states)] - played(k * H))
        assert at_sample <= bound.at_sample[0]
        xi, squares = done.xi_hat, done.squares
        x = plant.step(x, u, [0.0], (k + 1) * H)
        assert abs(xi[len(eq.states)] - played((k + 1) * H)) <= bound.ahead[0]
        assert np.all(np.abs(np.subtract(xi[: len(eq.states)], x.x)) <= bound.states + 1e-12)
    assert bound.at_sample[0] <= 2.0 * at_sample


@pytest.mark.parametrize("seed", range(6))
def test_the_bound_holds_for_random_disturbances_of_the_class(seed):
    random = np.random.default_rng(seed)
    order, H = int(random.integers(1, 4)), float(random.choice([2e-3, 5e-3, 1e-2]))
    observer = observer_for(FLEXIBLE, order, noise_std=float(random.choice([0.0, 1e-6, 1e-4])))
    bound, rate = certificate_of(observer, H), float(observer.known.disturbance_rate[0])
    pieces, piece = 60, 0.05
    # Switching by chance, but turned round where d would drift away: then it stays of the size of its bound.
    rates = rate * random.choice([-1.0, 1.0], pieces) * random.uniform(0.3, 1.0, pieces)
    for k in range(1, pieces):
        if order == 1 and abs(sum(rates[:k]) * piece) > 5.0:
            rates[k] = -np.sign(sum(rates[:k])) * abs(rates[k])
    found = errors_of(observer, FLEXIBLE, Played(rates, piece, order), H, round(pieces * piece / H))
    # The estimate starts from the true state but without the derivatives of d, which the bound of the steady state
    # does not speak of.
    late = found[round(1.5 / H) :]
    assert np.all(late[:, 0] <= bound.at_sample[0])
    assert np.all(late[:, 1] <= bound.ahead[0])
    assert np.all(late[:, 2:] <= bound.states + 1e-9)


def test_without_a_disturbance_order_the_bound_uses_the_disturbance_itself_for_the_states():
    observer = observer_for(FLEXIBLE, 0)
    H, amplitude, pulsation = 5e-3, 5.0, 6.0
    bound = certificate_of(observer, H)

    class Sine:
        breaks = ()

        def __call__(self, t):
            return amplitude * np.sin(pulsation * t)

    found = errors_of(observer, FLEXIBLE, Sine(), H, round(WARM_UP / H))[round(1.5 / H) :]
    assert np.all(found[:, 0] <= bound.at_sample[0])
    assert np.all(found[:, 1] <= bound.ahead[0])
    assert np.all(found[:, 2:] <= bound.states)
    assert bound.at_sample[0] <= 2.0 * found[:, 0].max()


def test_samples_with_errors_widen_the_bound_by_no_less_than_their_worst_case():
    observer = observer_for(FLEXIBLE, 2)
    design, known = observer.design(5e-3), observer.known
    alone, with_errors = (
        certify(
            design,
            disturbance_rate=known.disturbance_rate * 0.0,
            disturbance_bound=known.disturbance_bound,
            lipschitz=0.0,
            f_states=(),
            sample_error=error,
        )
        for error in (0.0, 1e-3)
    )
    assert alone.at_sample[0] == 0.0
    # Independent: the worst samples are the signs of the impulse response, summed here by plain simulation.
    F, C, K = design.error_dynamics, design.system.C, design.K
    row, total = design.system.selector @ K, 0.0
    step = F.copy()
    total += np.sum(np.abs(row))
    current = design.system.selector
    for _ in range(4000):
        current = current @ step
        total += np.sum(np.abs(current @ K))
    assert C.shape == (2, 6)
    assert with_errors.at_sample[0] == pytest.approx(1e-3 * total, rel=1e-6)


def test_where_f_can_undo_the_observer_there_is_no_bound():
    observer = observer_for(FLEXIBLE, 2)
    design, known = observer.design(1e-2), observer.known
    bound = certify(
        design,
        disturbance_rate=known.disturbance_rate,
        disturbance_bound=known.disturbance_bound,
        lipschitz=1e5,
        f_states=(0,),
    )
    assert not bound.exists
    assert bound.loop_gain >= 1.0
    assert np.all(np.isinf(bound.at_sample))
    assert bound.to_dict()["disturbance_at_sample"] is None


def theorem_3_bound(Q, *, pi, alpha, lipschitz, disturbance_bound):
    """Return the bound of ‖x̃‖ of Theorem 3, as docs/theory.md derives it; infinite where β γ ≥ 1."""
    beta = float(np.sqrt(np.linalg.norm(Q, 2) / (2.0 * alpha * pi)))
    return beta * disturbance_bound / (1.0 - beta * lipschitz) if beta * lipschitz < 1.0 else float("inf")


def test_theorem_3_gives_the_figures_of_its_derivation_and_is_looser_as_printed():
    linear = linear_part(FLEXIBLE)
    Q = paper_gains(linear, pi=1e12, alpha=1.0).riccati.Q
    ours = theorem_3_bound(Q, pi=1e12, alpha=1.0, lipschitz=10.0, disturbance_bound=2.0)
    beta = np.sqrt(np.linalg.norm(Q, 2) / 1e12)
    printed = beta * 2.0 / (1.0 - beta * 10.0)
    assert ours == pytest.approx(0.07, abs=0.01)
    assert printed == pytest.approx(0.12, abs=0.02)
    low = paper_gains(linear, pi=1e4, alpha=1.0).riccati.Q
    assert theorem_3_bound(low, pi=1e4, alpha=1.0, lipschitz=10.0, disturbance_bound=2.0) == float("inf")


def theorem_3_factor(pi, *, printed=False):
    """Return β of Theorem 3 in the example, as derived or as printed."""
    Q = paper_gains(linear_part(FLEXIBLE), pi=pi, alpha=1.0).riccati.Q
    return float(np.sqrt(np.linalg.norm(Q, 2) / ((1.0 if printed else 2.0) * pi)))


def test_theorem_3_gives_a_bound_from_a_lower_pi_on_than_its_printed_form():
    Q = paper_gains(linear_part(FLEXIBLE), pi=1e8, alpha=1.0).riccati.Q
    at_1e8 = theorem_3_bound(Q, pi=1e8, alpha=1.0, lipschitz=10.0, disturbance_bound=2.0)
    assert at_1e8 == pytest.approx(1.106, abs=0.001)
    assert theorem_3_factor(1e8, printed=True) * 10.0 >= 1.0
    assert theorem_3_factor(2.5e7) * 10.0 > 1.0 > theorem_3_factor(3.5e7) * 10.0


def test_the_constants_with_which_theorem_5_calls_its_input_regular_grow_with_pi():
    # v' contains √π W C (A x̃ + G v). Were M₀ ≥ √π ‖W C A‖ ‖x̃‖ bounded, K of Lemma 4 would not depend on π.
    linear = linear_part(FLEXIBLE)
    of_state, beta = [], []
    for pi in (1e10, 1e12, 1e14):
        of_state.append(np.sqrt(pi) * np.linalg.norm(paper_gains(linear, pi=pi, alpha=1.0).W @ linear.C @ linear.A, 2))
        beta.append(theorem_3_factor(pi))
    np.testing.assert_allclose(np.divide(of_state[1:], of_state[:-1]), 10.0, rtol=1e-6)
    np.testing.assert_allclose(np.divide(beta[1:], beta[:-1]), 100.0 ** (-1 / 8), rtol=0.01)
