"""The C source of an FMU: one file, which any C99 compiler takes, and FMI's headers beside it."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import fmpy

from ndob_fmu.fmu.rules_header import rules_header
from ndob_fmu.interface.variables import Variable
from ndob_fmu.native.join import joined
from ndob_fmu.native.short_code import fast, short
from ndob_fmu.native.start_values import first_values
from ndob_fmu.native.variable_table import counts, quoted, variable_table

SHELL = Path(__file__).parent / "shell"
HEADERS = Path(fmpy.__file__).parent / "c-code"
_ARRAYS = Path(__file__).parent / "c"
_FRONT_SHELL = Path(__file__).parents[1] / "fmu" / "shell"
_IN_EVERY_STEP = ("handles.c", "environment.c", "values.c", "instance.c")
_SELDOM: tuple[str, ...] = ("text.c", "log.c", "states.c")
_HEADER_FILES = {
    2: ("fmi2Functions.h", "fmi2FunctionTypes.h", "fmi2TypesPlatform.h"),
    3: ("fmi3Functions.h", "fmi3FunctionTypes.h", "fmi3PlatformTypes.h"),
}
_TEXT_OR_COMMENT = re.compile(r'(?s)(?P<text>"(?:[^"\\\n]|\\.)*")|/\*.*?\*/')
_BEGINNING = """\
/* {name}, written by ndob-fmu; do not edit. C99, without any library but the compiler's own.
 *
 * One file, without comments, so that FMUs are small: ndob_fmu/native and ndob_fmu/runtime have the texts that it is
 * made of, with their comments. */

/* A product and a sum are rounded one after the other, as everywhere: fused, they would give other bits. */
#if defined(__GNUC__) && !defined(__clang__)
#pragma GCC optimize("fp-contract=off")
#else
#pragma STDC FP_CONTRACT OFF
#endif

#include <math.h>
#include <string.h>
"""


@dataclass(frozen=True)
class ComponentCode:
    """What computes, as C text.

    text: definitions of the functions `start`, `show`, `step` and `possible`, of the types `Core` and `State`, and of
        all that these use
    has_end: whether there is a function `end` too
    sizes_state: whether `start` takes the memory of the state; then there is a function `tuning` too
    """

    text: str
    has_end: bool = False
    sizes_state: bool = False


def sources(name: str, token: str, variables: Sequence[Variable], code: ComponentCode, fmi: int) -> dict[str, str]:
    """Return the C files of an FMU by their names.

    token: guid in FMI 2, instantiationToken in FMI 3
    fmi: FMI's version, 2 or 3
    """
    members = f"{counts(variables)}, .core_size = sizeof(Core), .state_size = sizeof(State)"
    names = ("start", "show", "step", "possible", *(("end",) if code.has_end else ()))
    beginning, seldom = _BEGINNING.format(name=name), _SELDOM
    if code.sizes_state:
        members += ", .sizes_state = true, .tuning = tuning"
        beginning += "#define SIZES_STATE\n"
        seldom += ("state_memory.c",)
    functions = ", ".join(f".{function} = {function}" for function in names)
    of_component = [
        _without_local_includes(SHELL / "fmu.h"),
        *short(text_functions()),
        code.text,
        variable_table(variables),
    ]
    of_shell = [
        f"static const Fmu fmu = {{{members}, {functions}}};\n",
        rules_header(),
        _without_local_includes(SHELL / "shell.h"),
        _without_local_includes(_FRONT_SHELL / "utf8.c"),
        *fast(*(_without_local_includes(SHELL / file) for file in _IN_EVERY_STEP)),
        *short(*(_without_local_includes(SHELL / file) for file in seldom)),
        *fast(_without_local_includes(SHELL / f"fmi{fmi}.c")),
    ]
    if fmi == 3:
        of_shell.append(_unsupported_of_fmi3())
    elif code.sizes_state:
        of_shell.append(_without_local_includes(SHELL / "many_steps.c"))
    headers = {file: _with_its_licence((HEADERS / file).read_text("utf-8")) for file in _HEADER_FILES[fmi]}
    # The comments of the first values say which is which, for `start_values`.
    text = [beginning, _without_comments(of_component), first_values(token, variables), _without_comments(of_shell)]
    return {f"{name}.c": "\n".join(text), **headers}


def text_functions() -> str:
    """Return the functions that write numbers and messages, for the shell, the component and its arrays."""
    texts = [(_ARRAYS / f"nd_text.{end}").read_text("utf-8") for end in "hc"]
    return joined(texts, "nd_print nd_print_of nd_shortest")


def _without_comments(texts: Sequence[str]) -> str:
    without = re.sub(_TEXT_OR_COMMENT, lambda found: found["text"] or "", "\n".join(texts))
    lines = re.sub(r"\s*\n\s*\n", "\n\n", re.sub(r"[ \t]+\n", "\n", without))
    return re.sub(r"(?m)^(?: {4})+", lambda indent: "\t" * (len(indent[0]) // 4), lines)


def _with_its_licence(header: str) -> str:
    """Return a header of FMI without its comments but for whose it is; `documentation/licenses` has the licence."""
    owners = next(found[0] for found in re.finditer(r"Copyright.*?All rights reserved\.", header, re.DOTALL))
    told = f"/* {' '.join(owners.split())} Licence: documentation/licenses/fmi-headers.txt */"
    return f"{told}\n{_without_comments([header])}"


def _without_local_includes(path: Path) -> str:
    """Return a source without what is joined to it, but with FMI's headers."""
    text = path.read_text("utf-8")
    return re.sub(r'(?m)^#include "(?!fmi\d)[^"]*"\n', "", text)


def _unsupported_of_fmi3() -> str:
    """Return the functions of FMI 3.0 that these FMUs do not have, from FMI's own header."""
    types = (HEADERS / "fmi3FunctionTypes.h").read_text("utf-8")
    own = set(re.findall(r"\bfmi3\w+(?=\()", (SHELL / "fmi3.c").read_text("utf-8")))
    own |= {f"fmi3{way}{kind}" for way in ("Get", "Set") for kind in ("Float64", "Int32", "Int64", "Boolean")}
    functions = []
    for name, arguments in re.findall(r"typedef fmi3Status (fmi3\w+)TYPE\s*\(([^;]*)\);", types):
        if name in own:
            continue
        names = [re.sub(r"\[\]", "", argument).split()[-1].lstrip("*") for argument in arguments.split(",")]
        unused = "".join(f", (void){each}" for each in names[1:]).removeprefix(", ")
        body = f"{unused + '; ' if unused else ''}return unsupported(instance, {quoted(name)});"
        functions.append(f"fmi3Status {name}({' '.join(arguments.split())}) {{ {body} }}")
    return "\n".join(functions) + "\n"
