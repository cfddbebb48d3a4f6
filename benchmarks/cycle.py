"""One cycle of an FMU through fmpy: setReal of all inputs, doStep, getReal of all outputs.

The peer is an empty slave built by pythonfmu as it is: the same variables as attributes, a do_step that only returns.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from fmpy import extract, read_model_description
from fmpy.fmi2 import FMU2Slave
from pythonfmu.builder import FmuBuilder

from ndob_fmu import Model, build
from ndob_fmu.codegen.compile_model import compile_model
from ndob_fmu.interface.model_variables import observer_variables
from ndob_fmu.interface.variables import Variable
from ndob_fmu.runtime.blocks.disturbance import KINDS, Generator
from ndob_fmu.runtime.blocks.plant import Plant

STEP = 1e-3
WARM_UP = 15_000  # steps, after which the gains of all models of the benchmarks are frozen

_EMPTY = '''"""A slave that has the variables of {name} and does nothing."""

from pythonfmu import Boolean, Fmi2Causality, Fmi2Slave, Fmi2Variability, Integer, Real

VARIABLES = {variables!r}
TYPES = {{"Real": Real, "Boolean": Boolean, "Integer": Integer, "Enumeration": Integer}}


class Empty{name}(Fmi2Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        for name, kind, causality, variability, start in VARIABLES:
            setattr(self, name, start)
            variable = TYPES[kind](name, causality=Fmi2Causality[causality], variability=Fmi2Variability[variability])
            self.register_variable(variable, nested=False)

    def do_step(self, current_time, step_size):
        return True
'''
_STARTS = {"Real": 0.0, "Boolean": False, "Integer": 0, "Enumeration": 0}


def build_empty(name: str, variables: Sequence[Variable], folder: Path) -> Path:
    """Write `Empty<name>.fmu` with pythonfmu's own builder and return its path."""
    script = folder / f"empty_{name.lower()}.py"
    listed = [
        (v.name.rpartition(".")[2], v.type, v.causality, v.variability, _STARTS[v.type] if v.start is None else v.start)
        for v in variables
    ]
    script.write_text(_EMPTY.format(name=name, variables=listed), "utf-8")
    return Path(FmuBuilder.build_FMU(script, dest=folder))


@dataclass
class Cycled:
    """An instance of an FMU and how far it has come; `samples` are the inputs before each step (steps, inputs)."""

    fmu: Any
    inputs: list[int]
    outputs: list[int]
    samples: list[list[float]]
    steps: int = 0

    def run(self, count: int) -> None:
        """Make so many cycles."""
        fmu, inputs, outputs = self.fmu, self.inputs, self.outputs
        for k in range(self.steps, self.steps + count):
            fmu.setReal(inputs, self.samples[k])
            fmu.doStep(k * STEP, STEP)
            fmu.getReal(outputs)
        self.steps += count


@contextmanager
def instance(path: Path, samples: list[list[float]], told: Mapping[str, float] | None = None) -> Iterator[Cycled]:
    """Give a new instance after its initialization; told: start values of parameters."""
    description, folder = read_model_description(path), extract(path)
    fmu = FMU2Slave(
        guid=description.guid,
        unzipDirectory=folder,
        modelIdentifier=description.coSimulation.modelIdentifier,
        instanceName=path.stem,
    )
    fmu.instantiate()
    references = {
        causality: [
            v.valueReference for v in description.modelVariables if (v.type, v.causality) == ("Real", causality)
        ]
        for causality in ("input", "output")
    }
    fmu.setupExperiment(startTime=0.0)
    fmu.enterInitializationMode()
    fmu.setReal(references["input"], samples[0])
    for variable in description.modelVariables:
        if told and variable.name in told:
            fmu.setReal([variable.valueReference], [told[variable.name]])
    fmu.exitInitializationMode()
    try:
        yield Cycled(fmu, references["input"], references["output"], samples)
    finally:
        fmu.freeInstance()
        shutil.rmtree(folder, ignore_errors=True)


def samples_of(model: Model, steps: int) -> list[list[float]]:
    """Return inputs and outputs of the plant (steps, m + p), under a sine of half the bound as the disturbance."""
    eq = compile_model(model)
    plant = Plant(eq, model.parameter_values(), [Generator(KINDS["sine"], b / 2, 0.5) for b in eq.disturbance_bound])
    C = eq.linear_part(model.parameter_values()).C
    u, d = [0.0] * len(eq.inputs), [0.0] * len(eq.disturbances)
    state, rows = plant.init(eq.x0, 0.0), []
    for k in range(steps):
        rows.append([*u, *(C @ np.array(state.x)).tolist()])
        state = plant.step(state, u, d, (k + 1) * STEP, STEP)
    return rows


def cycles(model: Model, folder: Path, release: ExitStack, count: int, rounds: int) -> dict[str, Callable[[], None]]:
    """Return `count` cycles of the model's observer, with a converged gain, and of the empty slave."""
    variables = observer_variables(compile_model(model))
    paths = {
        "observer": build(model, folder)[1],
        "empty slave": build_empty(f"{model.name}Observer", variables, folder),
    }
    samples = samples_of(model, WARM_UP + count * rounds)
    found = {}
    for name, path in paths.items():
        cycled = release.enter_context(instance(path, samples))
        cycled.run(WARM_UP)
        found[name] = lambda cycled=cycled: cycled.run(count)
    return found
