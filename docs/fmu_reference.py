"""Write docs/fmu_reference.md from the model descriptions of the FMUs: python docs/fmu_reference.py build/fmus."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from fmpy import read_model_description

PAGE = Path(__file__).with_name("fmu_reference.md")
_HEAD = """# FMU reference

<!-- Written by `python docs/fmu_reference.py build/fmus`; changes belong there or into the FMUs. -->

Every variable of the FMUs that `make build` makes, as their model descriptions have them. A plant and an observer of
your own model have the same ones under its names. [fmi_behaviour.md](fmi_behaviour.md) says what an FMU does at each
call of a host.
"""
_KINDS = {"input": "Inputs", "output": "Outputs", "parameter": "Parameters"}


def page(paths: Sequence[Path]) -> str:
    """Return the page for some FMUs."""
    return "\n".join([_HEAD, *(line for path in paths for line in _fmu(path))]) + "\n"


def _fmu(path: Path) -> Iterator[str]:
    model = read_model_description(path)
    experiment, ability = model.defaultExperiment, model.coSimulation
    yield f"## {model.modelName}\n"
    yield f"{model.description}.\n"
    yield "| | |\n|---|---|"
    yield f"| default experiment | {experiment.startTime} to {experiment.stopTime} s, step {experiment.stepSize} s |"
    yield f"| variable communication step | {_yes(ability.canHandleVariableCommunicationStepSize)} |"
    yield f"| FMU state can be saved | {_yes(ability.canGetAndSetFMUstate)} |"
    yield f"| FMU state can be serialised | {_yes(ability.canSerializeFMUstate)} |"
    yield f"| several instances in a process | {_yes(not ability.canBeInstantiatedOnlyOncePerProcess)} |\n"
    for causality, title in _KINDS.items():
        chosen = [variable for variable in model.modelVariables if variable.causality == causality]
        if chosen:
            yield f"### {title} of {model.modelName}\n"
            yield "| Name | Type | Unit | Start | Range | Variability | |\n|---|---|---|---|---|---|---|"
            yield from map(_row, chosen)
            yield ""


def _row(variable: Any) -> str:
    bounds = f"{variable.min or '…'} to {variable.max or '…'}" if variable.min or variable.max else ""
    kind = variable.type
    if variable.type == "Enumeration":
        kind = ", ".join(f"{item.value} {item.name}" for item in variable.declaredType.items)
    cells = (
        f"`{variable.name}`",
        kind,
        (variable.unit or "").replace(".", "·"),
        variable.start or "",
        bounds,
        variable.variability or "",
        variable.description or "",
    )
    return "| " + " | ".join(cell.replace("|", "∣").replace("\n", " ") for cell in cells) + " |"


def _yes(flag: bool) -> str:
    return "yes" if flag else "no"


if __name__ == "__main__":
    PAGE.write_text(page(sorted(Path(sys.argv[1]).glob("*.fmu"))), "utf-8")
    print(PAGE)
