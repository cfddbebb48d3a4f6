"""A component's C text put together: what is written by hand around functions that are translated from the runtime."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path

from ndob_fmu.interface.variables import Variable
from ndob_fmu.native.join import joined
from ndob_fmu.native.short_code import fast, short
from ndob_fmu.native.sources import ComponentCode
from ndob_fmu.native.translate.print_c import Translation, translate

_HERE = Path(__file__).parent
_HEADERS = ("nd.h", "nd_loops.h", "nd_pairs.h", "nd_linear.h")
# What a step consists of.
_FAST = "memory views make entries entrywise products reflections jumps"
_SHORT = "forms along numbers solve random rotations eigenvalues"
# The C files on arrays, which include the headers beside them.
ARRAY_FILES = tuple(_HERE / "c" / f"nd_{name}.c" for name in f"{_FAST} {_SHORT} text".split())


def component(wanted: Mapping[str, Sequence[str]], own: Sequence[str]) -> ComponentCode:
    """Return a component made of its own texts, of functions of the runtime, by module, and of the arrays."""
    runtime = runtime_texts({f"ndob_fmu.runtime.{module}": names for module, names in wanted.items()})
    has_end = any(re.search(r"(?m)^static void end\(", text) for text in own)
    text = joined([*runtime, *own], "start show step possible end")
    return ComponentCode(text, has_end)


def runtime_texts(
    wanted: Mapping[str, Sequence[str]],
    *,
    copied: Sequence[str] = (),
    stored: Sequence[str] = (),
    unmoved: Sequence[str] = (),
) -> list[str]:
    """Return the C texts of the arrays and of the wanted functions, by full name of their module.

    copied, stored, unmoved: as `translate`
    """
    only = tuple(f"{module}.{name}" for module, names in wanted.items() for name in names)
    translation = _translation(tuple(wanted), only, tuple(copied), tuple(stored), tuple(unmoved))
    arrays = fast(*map(_text, _HEADERS), *_arrays(_FAST))
    return [*arrays, translation.header, *short(*_arrays(_SHORT), translation.source)]


def _arrays(names: str) -> list[str]:
    return [_text(f"nd_{name}.c") for name in names.split()]


def _text(name: str) -> str:
    return (_HERE / "c" / name).read_text("utf-8")


@cache
def _translation(
    modules: tuple[str, ...],
    only: tuple[str, ...],
    copied: tuple[str, ...],
    stored: tuple[str, ...],
    unmoved: tuple[str, ...],
) -> Translation:
    translation = translate(modules, "translated", only=only, copied=copied, stored=stored, unmoved=unmoved)
    if translation.refused:
        raise ValueError(f"functions that do not translate: {next(iter(translation.refused.values()))}")
    return translation


def part(name: str) -> str:
    """Return a file of the folder `component`."""
    return (_HERE / "component" / name).read_text("utf-8")


def places(variables: Sequence[Variable]) -> str:
    """Return the value references of variables in C, as AT_<name>; a dot of a name is an underscore."""
    entries = ", ".join(f"AT_{re.sub(r'[^0-9A-Za-z_]', '_', v.name)} = {i}" for i, v in enumerate(variables))
    return f"enum {{ {entries} }};\n"
