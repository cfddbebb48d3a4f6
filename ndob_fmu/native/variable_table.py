"""The variables of an FMU as the C table that the shell reads (`shell/fmu.h`)."""

from __future__ import annotations

from collections.abc import Sequence
from math import inf

from ndob_fmu.fmu.rules_header import ROLE_LETTERS
from ndob_fmu.interface.fmi_rules import role
from ndob_fmu.interface.variables import Variable, expected_value

_TYPES = {"Real": "R", "Integer": "I", "Enumeration": "E", "Boolean": "B", "String": "S"}


def variable_table(variables: Sequence[Variable]) -> str:
    """Return the C text that defines the variables, by value reference, and the references of the parameters.

    variables: the outputs are declared one after another
    """
    parameters = [i for i, variable in enumerate(variables) if variable.causality == "parameter"]
    lines = ",\n".join(f"    {_entry(variable)}" for variable in variables)
    references = ", ".join(map(str, parameters)) or "0"
    return (
        f"static const Variable variables[] = {{\n{lines},\n}};\n\n"
        f"static const uint32_t parameters[] = {{{references}}};\n"
    )


def counts(variables: Sequence[Variable]) -> str:
    """Return the C text of the members of `Fmu` that count variables."""
    causalities = [variable.causality for variable in variables]
    first = causalities.index("output") if "output" in causalities else 0
    members = {
        "variables": "variables",
        "count": len(variables),
        "first_output": first,
        "output_count": causalities.count("output"),
        "parameters": "parameters",
        "parameter_count": causalities.count("parameter"),
        "text_count": sum(variable.type == "String" for variable in variables),
    }
    return ", ".join(f".{name} = {value}" for name, value in members.items())


def _entry(variable: Variable) -> str:
    """Return the initialiser of a `Variable`."""
    least, most = _limits(variable)
    expected = expected_value(variable) if variable.causality == "parameter" else ""
    fields = (
        quoted(variable.name),
        f"'{_TYPES[variable.type]}'",
        f"'{ROLE_LETTERS[role(variable)]}'",
        number(least),
        number(most),
        "true" if variable.positive else "false",
        quoted(expected) if expected else "NULL",
    )
    return f"{{{', '.join(fields)}}}"


def _limits(variable: Variable) -> tuple[float, float]:
    if variable.items is not None:
        values = sorted(variable.items.values())
        if values != list(range(values[0], values[-1] + 1)):
            raise ValueError(f"{variable.name}: expected values without a gap, received {values}")
        return values[0], values[-1]
    return (
        -inf if variable.minimum is None else variable.minimum,
        inf if variable.maximum is None else variable.maximum,
    )


def number(value: float) -> str:
    """Return a double as C writes it, with all its digits."""
    if abs(value) == inf:
        return "HUGE_VAL" if value > 0 else "-HUGE_VAL"
    return repr(float(value))


def quoted(text: str) -> str:
    """Return a text as a C string; what is not ASCII as the bytes of its UTF-8."""
    escaped = "".join(
        chr(byte) if 32 <= byte < 127 and chr(byte) not in '"\\?' else f"\\{byte:03o}" for byte in text.encode()
    )
    return f'"{escaped}"'
