"""Method 1 in C, over many steps: the estimates of the paper's observer in Python."""

from __future__ import annotations

import ctypes
import re
import subprocess

import numpy as np
import pytest

from ndob_fmu.codegen.compile_model import compile_model
from ndob_fmu.native.paper import paper_observer_text
from ndob_fmu.native.sources import text_functions
from ndob_fmu.runtime.design.schedule import PiSchedule
from ndob_fmu.runtime.step.paper_observer import paper_observer
from tests.helpers.problems import MODELS
from tests.helpers.translated import FLAGS, compiler
from tests.native.test_sampled_observer import BEGINNING, outputs_of

MEMORY = 1 << 23
END = """
static Paper observer;
int begin(void *block, size_t bytes, const double *p, int parameters, double pi_start, double pi_end,
          double ramp_time) {
    static const double noise[] = {1e-5, 1e-5}, bound[] = {2.0}, nominal[] = {0.5};
    memset(&observer, 0, sizeof observer);
    paper_memory(&observer, block, bytes);
    set_equations(&observer.equations, &observer.lasting);
    observer.parameters = nd_view_of(&observer.lasting, parameters, p);
    nd_array given[] = {nd_around(2, noise), nd_around(1, bound), nd_around(1, nominal)};
    return paper_start(&observer, pi_start, pi_end, ramp_time, 1.0, &given[0], &given[1], &given[2]);
}
void first_state(const double *x, double *state) {
    nd_array x_hat = nd_around(4, x);
    paper_first_state(&observer, &x_hat, state);
}
int advance_by(double *state, const double *u, const double *y, double step, double *outputs) {
    nd_array given[] = {nd_around(1, u), nd_around(2, y)};
    return paper_step(&observer, state, &given[0], &given[1], step, outputs);
}
int show(const double *state, const double *y, double *outputs) {
    nd_array given = nd_around(2, y);
    return paper_show(&observer, state, &given, outputs);
}
int possible(const double *state) { return paper_possible(&observer, state); }
const char *message(void) { return observer.scratch.message; }
"""


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    folder = tmp_path_factory.mktemp("paper")
    texts = [BEGINNING, text_functions(), *paper_observer_text(MODELS["flexible_joint"]), END]
    source = folder / "paper.c"
    source.write_text(re.sub(r'(?m)^#include "[^"]*"\n', "", "\n".join(texts)), "utf-8")
    flags = [flag for flag in FLAGS if flag != "-Werror"]
    quiet = ["-Wno-unused-function", "-Wno-unused-const-variable", "-Wno-unused-variable"]
    command = [compiler(), *flags, *quiet, "-shared", "-fPIC", str(source), "-lm", "-o", str(folder / "p.so")]
    done = subprocess.run(command, check=False, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    found = ctypes.CDLL(str(folder / "p.so"))
    found.message.restype = ctypes.c_char_p
    return found


def doubles(values):
    return (ctypes.c_double * len(values))(*values)


def begun(library, p, schedule):
    """Return the block of memory, which must stay alive, and the error."""
    block, number = ctypes.create_string_buffer(MEMORY), ctypes.c_double
    pi = (number(schedule[0]), number(schedule[1]), number(schedule[2]))
    p = doubles(p)
    return (block, p), library.begin(block, ctypes.c_size_t(MEMORY), p, len(p), *pi)


@pytest.mark.parametrize("schedule", [(1.0, 1e12, 0.2), (1e8, 1e8, 0.0)], ids=["a ramp of pi", "a constant pi"])
def test_the_estimates_are_those_of_python_over_many_steps(library, schedule):
    """With steps of different length, and a sample that is not finite."""
    model = MODELS["flexible_joint"]
    eq, p = compile_model(model), model.parameter_values()
    settings = {"noise_std": (1e-5, 1e-5), "disturbance_bound": (2.0,), "disturbance_nominal": (0.5,)}
    observer = paper_observer(eq, p, PiSchedule(*schedule), alpha=1.0, **settings)
    alive, error = begun(library, p, schedule)
    assert error == 0, library.message()
    own, outputs = (ctypes.c_double * 200)(), (ctypes.c_double * 200)()
    library.first_state(doubles(eq.xhat0), own)
    state, twins, rows = observer.init(eq.xhat0), [], []
    for k in range(300):
        y = [1.0 + 0.1 * np.sin(5e-3 * k), np.nan if k == 120 else 1.0 + 0.05 * np.cos(3e-3 * k)]
        H = 1e-3 * (1.0 + 0.5 * (k % 3))
        state, estimate = observer.step(state, (0.1,), y, H)
        twins.append(outputs_of(estimate))
        assert library.advance_by(own, doubles([0.1]), doubles(y), ctypes.c_double(H), outputs) == 0
        rows.append(outputs[: len(twins[-1])])
    twins, rows = np.array(twins), np.array(rows)
    np.testing.assert_array_equal(rows[:, -2], twins[:, -2])
    scale = np.maximum(np.max(np.abs(twins), axis=0), 1e-9)
    assert np.max(np.abs(twins - rows) / scale) <= 1e-9
    assert library.possible(own) == 1
    own[len(eq.states)] = -1.0  # the time since the start
    assert library.possible(own) == 0
    assert len(alive) == 2


def test_a_schedule_that_cannot_be_used_is_refused_with_the_words_of_python(library):
    _, error = begun(library, MODELS["flexible_joint"].parameter_values(), (-1.0, 1e12, 1.0))
    assert error != 0
    assert library.message().startswith(b"pi_start: expected a finite number > 0, received -1")
