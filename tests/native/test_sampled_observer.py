"""Method 2 in C, over many steps: the estimates of the observer in Python."""

from __future__ import annotations

import ctypes
import re
import subprocess
from functools import cache

import numpy as np
import pytest

from ndob_fmu.codegen.compile_model import compile_model
from ndob_fmu.native.observer import sampled_observer_text
from ndob_fmu.native.sources import text_functions
from ndob_fmu.runtime.blocks.disturbance import KINDS, Generator
from ndob_fmu.runtime.blocks.plant import Plant
from ndob_fmu.runtime.design.ranges import continued
from ndob_fmu.runtime.step.sampled_observer import sampled_observer
from ndob_fmu.runtime.step.settings import observer_settings
from tests.helpers.general_plants import BALL, CART, TROLLEY
from tests.helpers.problems import MODELS
from tests.helpers.translated import FLAGS, compiler

JOINT = MODELS["flexible_joint"]
MODELS_HERE = {model.name: model for model in (JOINT, CART, BALL, TROLLEY)}
H = 1e-3
MEMORY = 1 << 24

BEGINNING = """
#include <float.h>
#include <math.h>
#include <stdbool.h>
static bool finite_number(double number) { return fabs(number) <= DBL_MAX; }
static bool not_a_number(double number) { return !(fabs(number) <= HUGE_VAL); }
"""
# All arrays of the settings in one, one behind the other, in the order of the fields.
END = """
static Sampled observer;
static double first[1 << 16];
int begin(void *block, size_t bytes, const double *given, const int *sizes, int order, int adapts) {
    ObserverSettings *s = &observer.settings;
    nd *const fields[] = {&observer.parameters, &s->sensors.noise_std, &s->sensors.delay, &s->sensors.bias_std,
        &s->disturbance_bound, &s->disturbance_nominal, &s->disturbance_rate, &s->x_std, &s->parameter_std,
        &s->state_noise, &s->estimated, &s->own_order};
    memset(&observer, 0, sizeof observer);
    sampled_memory(&observer, block, bytes);
    set_equations(&observer.equations, &observer.lasting);
    for (int i = 0; i < 12; given += sizes[i], i++) *fields[i] = nd_view_of(&observer.lasting, sizes[i], given);
    s->order = order, s->adapt_noise = adapts != 0;
    s->lag = *given++, s->alpha = *given++, s->pi = *given++;
    nd_array x_hat = nd_around(observer.equations.states.n, given);
    return sampled_start(&observer, &x_hat, first, 1 << 16);
}
int first_state(double *state) {
    memcpy(state, first, observer.count * sizeof *first);
    return (int)observer.count;
}
int advance_by(double *state, const double *u, const double *y, double step, double *outputs) {
    nd_array given[] = {nd_around(observer.equations.inputs.n, u), nd_around(observer.equations.outputs.n, y)};
    return sampled_step(&observer, state, &given[0], &given[1], step, outputs);
}
int advance_translated(double *state, const double *u, const double *y, double step, double *outputs) {
    if (setjmp(observer.full)) return SAMPLED_NO_MEMORY;
    observer.scratch.used = 0;
    nd_array given[] = {nd_around(observer.equations.inputs.n, u), nd_around(observer.equations.outputs.n, y)};
    step_in_memory(&observer, state, &given[0], &given[1], step, outputs);
    return observer.scratch.error;
}
int advance_in_place(double *state, const double *u, const double *y, double step, double *outputs) {
    nd_array given[] = {nd_around(observer.equations.inputs.n, u), nd_around(observer.equations.outputs.n, y)};
    return step_as_kept(&observer, state, &given[0], &given[1], step, outputs);
}
int has_frozen(const double *state) {
    if (setjmp(observer.full)) return -1;
    observer.scratch.used = 0;
    return given_state(&observer, state)->memory.converged;
}
int possible(const double *state) { return sampled_possible(&observer, state); }
const char *message(void) { return observer.scratch.message; }
"""


@pytest.fixture(scope="module")
def library_of(tmp_path_factory):
    """Return the library of a model's observer, compiled when it is asked for first."""
    return cache(lambda name: compiled(MODELS_HERE[name], tmp_path_factory.mktemp("observer")))


def compiled(model, folder):
    source = folder / "observer.c"
    texts = [BEGINNING, text_functions(), *sampled_observer_text(model), END]
    source.write_text(re.sub(r'(?m)^#include "[^"]*"\n', "", "\n".join(texts)), "utf-8")
    flags = [flag for flag in FLAGS if flag != "-Werror"]
    quiet = ["-Wno-unused-function", "-Wno-unused-const-variable"]
    command = [compiler(), *flags, *quiet, "-shared", "-fPIC", str(source), "-lm", "-o", str(folder / "o.so")]
    done = subprocess.run(command, check=False, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    return ctypes.CDLL(str(folder / "o.so"))


class Native:
    """An observer in C, with a state."""

    def __init__(self, library, model, settings, x_hat):
        self.library = library
        self.library.message.restype = ctypes.c_char_p
        self.block = ctypes.create_string_buffer(MEMORY)
        s, sensors = settings, settings.sensors
        fields = [model.parameter_values(), sensors.noise_std, sensors.delay, sensors.bias_std, s.disturbance_bound]
        fields += [s.disturbance_nominal, s.disturbance_rate, s.x_std, s.parameter_std, s.state_noise, s.estimated]
        fields += [s.own_order]
        numbers = [float(v) for field in [*fields, [s.lag, s.alpha, s.pi], x_hat] for v in field]
        self.given = (ctypes.c_double * len(numbers))(*numbers)
        sizes = (ctypes.c_int * 12)(*map(len, fields))
        self.error(
            self.library.begin(self.block, ctypes.c_size_t(MEMORY), self.given, sizes, s.order, int(s.adapt_noise))
        )
        self.state, self.outputs = (ctypes.c_double * 100_000)(), (ctypes.c_double * 1000)()
        self.size = self.library.first_state(self.state)

    def error(self, code):
        assert code == 0, self.library.message()

    def step(self, u, y, H):
        u, y = (ctypes.c_double * len(u))(*u), (ctypes.c_double * len(y))(*y)
        self.error(self.library.advance_by(self.state, u, y, ctypes.c_double(H), self.outputs))
        return np.array(self.outputs[:])


def outputs_of(estimate):
    e = estimate
    parts = (e.x_hat, e.d_hat, e.d_at_sample, e.d_std, e.d_lagged, e.d_lagged_std, e.residual, e.residual_std)
    return np.array([*(v for part in parts for v in part), e.valid, e.consistency], dtype=float)


CASES = {
    **{f"order {order}": ("FlexibleJoint", {"order": order}) for order in (0, 1, 2, 3)},
    "delays, an offset, a lag": ("FlexibleJoint", {"delay": [0.0, 3e-3], "bias_std": [1e-3, 0.0], "lag": 0.02}),
    "uncertain parameters": ("FlexibleJoint", {"parameter_std": [0.1] * 3}),
    "disturbances of two orders": ("Trolley", {"order": 2, "own_order": (0, 1)}),
    "a plant without the paper's form": ("Cart", {}),
    "a plant whose estimate leaves its ranges": ("Ball", {}),
}


@pytest.mark.parametrize("case", CASES, ids=str)
def test_the_estimates_are_those_of_python_over_many_steps(case, library_of):
    """With outliers, a gap, and jumps of the disturbance; steps in between have a frozen gain where it is as good."""
    name, changes = CASES[case]
    model = MODELS_HERE[name]
    eq, p = compile_model(model), model.parameter_values()
    settings = observer_settings(eq, noise_std=[1e-5] * len(eq.outputs), **changes)
    observer = sampled_observer(continued(eq), p, settings, eq.xhat0)
    native = Native(library_of(name), model, settings, eq.xhat0)
    random = np.random.default_rng(5)
    state, x, d = observer.init(eq.xhat0), list(eq.x0), 0.3 * np.array(eq.disturbance_bound)
    u = [0.1] * len(eq.inputs)
    twins, own = [], []
    for k in range(250):
        d = -d if k in (120, 190) else d
        y = np.array(eq.output(x, u, p)) + 1e-5 * random.standard_normal(len(eq.outputs))
        y[0] = np.nan if k == 100 else y[0] + (k in (70, 220))
        state, estimate = observer.step(state, u, y.tolist(), H)
        twins.append(outputs_of(estimate))
        own.append(native.step(u, y, H)[: len(twins[-1])])
        x = (np.array(x) + H * np.array(eq.derivatives(x, u, d.tolist(), p))).tolist()
    twins, own = np.array(twins), np.array(own)
    scale = np.maximum(np.ptp(twins, axis=0), 1e-9)
    np.testing.assert_array_equal(own[:, -2], twins[:, -2])
    assert np.max(np.abs(twins - own) / scale) <= 1e-9
    assert native.library.possible(native.state) == 1
    native.state[0] = np.nan
    assert native.library.possible(native.state) == 0


@pytest.mark.parametrize("std", [0.0, 1e-6, 1e-4])
def test_the_gain_is_frozen_in_the_same_steps_as_in_python(std, library_of):
    eq, p = compile_model(JOINT), JOINT.parameter_values()
    settings = observer_settings(eq, noise_std=[std] * 2)
    observer = sampled_observer(eq, p, settings, eq.xhat0)
    native = Native(library_of("FlexibleJoint"), JOINT, settings, eq.xhat0)
    plant = Plant(eq, p, [Generator(KINDS["constant"], 2.0, 0.0)])
    random, state, truth, frozen = np.random.default_rng(3), observer.init(eq.xhat0), plant.init(eq.x0, 0.0), 0
    for k in range(300):
        y = np.array(eq.output(truth.x, [0.0], p)) + std * random.standard_normal(2)
        state, _ = observer.step(state, [0.0], y.tolist(), H)
        native.step([0.0], y, H)
        assert native.library.has_frozen(native.state) == state.memory.converged, k
        frozen += state.memory.converged
        truth = plant.step(truth, [0.0], [0.0], (k + 1) * H, H)
    assert frozen > 50


def test_a_step_with_a_frozen_gain_has_the_bits_of_the_translated_one(library_of):
    """Step by step from the same state, with outliers, gaps, a lost input, another step size, and larger noise."""
    eq = compile_model(JOINT)
    library = library_of(JOINT.name)
    native = Native(library, JOINT, observer_settings(eq, noise_std=[1e-5] * 2, adapt_noise=True), eq.xhat0)
    random = np.random.default_rng(6)
    twin = (ctypes.c_double * len(native.state))()
    ours, theirs = (ctypes.c_double * 17)(), (ctypes.c_double * 17)()
    in_place, p = [], JOINT.parameter_values()
    x = list(eq.x0)
    for k in range(1500):
        u = [np.nan if k == 700 else 0.1]
        y = np.array(eq.output(x, u, p)) + (3e-5 if k > 1200 else 1e-5) * random.standard_normal(2)
        y[k % 2] = {600: np.nan, 800: 1e3, 801: np.inf}.get(k, y[k % 2])
        step = 2.0 * H if k in (900, 901) else H
        given = [(ctypes.c_double * len(one))(*one) for one in (u, y)]
        ctypes.memmove(twin, native.state, ctypes.sizeof(twin))
        before = bytes(twin)
        taken = library.advance_in_place(twin, *given, ctypes.c_double(step), ours)
        assert library.advance_translated(native.state, *given, ctypes.c_double(step), theirs) == 0
        assert bytes(twin) == (bytes(native.state) if taken else before)
        assert not taken or bytes(ours) == bytes(theirs)
        in_place.append(bool(taken))
        x = (np.array(x) + step * np.array(eq.derivatives(x, [0.1], [1.0], p))).tolist()
    assert sum(in_place) > 300
    assert not any(in_place[k] for k in (600, 700, 800, 801, 900, 901))


def test_a_step_that_cannot_be_taken_says_why_and_leaves_the_state(library_of):
    model = JOINT
    eq = compile_model(model)
    native = Native(library_of(model.name), model, observer_settings(eq, noise_std=[1e-5] * 2), eq.xhat0)
    before = bytes(native.state)
    with pytest.raises(AssertionError, match=r"communication step: expected at most .* received 1e.06 s"):
        native.step([0.1], [1.0, 1.0], 1e6)
    assert bytes(native.state) == before
