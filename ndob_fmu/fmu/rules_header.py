"""The rules of FMI as the C header that the shell includes."""

from __future__ import annotations

from collections.abc import Iterable

from ndob_fmu.interface.fmi_rules import CALLS, DEAD_MODES, MODES, NOT_SETTABLE, SETTABLE

NAME = "fmi2_rules.h"
# How front.txt writes the role of a variable.
ROLE_LETTERS = {"input": "i", "fixed": "f", "tunable": "t", "calculated": "o"}


def rules_header() -> str:
    """Return the text of `fmi2_rules.h`.

    Modes are bits of a set. For each call there is MODES_OF_fmi2<call>; MODES, ANY_MODE, ROLES and their texts are
    macros that take a macro.
    """
    names = {**MODES, **DEAD_MODES}
    modes = ", ".join(f"{name.upper()} = {1 << place}" for place, name in enumerate(names))
    return "\n".join(
        [
            "/* Written by the build from ndob_fmu/interface/fmi_rules.py. */",
            "#ifndef NDOB_FMI2_RULES_H",
            "#define NDOB_FMI2_RULES_H",
            f"typedef enum {{ {modes} }} Mode;",
            f"#define ANY_MODE ((unsigned)({_set(MODES)}))",
            f"#define MODES(F) {' '.join(f'F({name.upper()}, {_quoted(text)})' for name, text in names.items())}",
            *(f"#define MODES_OF_fmi2{call} ((unsigned)({_set(allowed)}))" for call, allowed in CALLS.items()),
            "/* F(letter in front.txt, modes in which it may be set, expected and received where it may not) */",
            "#define ROLES(F) " + " ".join(_role(name, allowed) for name, allowed in SETTABLE.items()),
            "#endif",
            "",
        ]
    )


def _role(name: str, allowed: Iterable[str]) -> str:
    expected, received = NOT_SETTABLE.get(name, ("", ""))
    return f"F('{ROLE_LETTERS[name]}', ({_set(allowed)}), {_quoted(expected)}, {_quoted(received)})"


def _set(modes: Iterable[str]) -> str:
    return " | ".join(mode.upper() for mode in modes) or "0"


def _quoted(text: str) -> str:
    return '"' + text.replace("\\", "\\\\").replace('"', '\\"') + '"'
