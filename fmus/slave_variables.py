"""The variables of an instance with their present values. A mistake of the host is returned, not raised."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from math import nan
from typing import Any

from ndob_fmu.interface.fmi_rules import NOT_SETTABLE, SETTABLE, role
from ndob_fmu.interface.variables import Variable, expected_value, is_acceptable
from ndob_fmu.runtime.base_errors import NdobError

# The Python type of each type of FMI, and the range of its Integer.
PYTHON_TYPES = {"Real": float, "Boolean": bool, "Integer": int, "Enumeration": int, "String": str}
_INTEGERS = range(-(2**31), 2**31)
# What a host gets if it asks for values by wrong references. FMI accesses Enumerations as Integers.
NOTHING = {"Real": nan, "Boolean": False, "Integer": 0, "String": ""}
_ACCESSED_AS = {"Enumeration": "Integer"}


class Variables:
    """The variables by value reference, which is a variable's place in the declaration.

    declared: their declarations
    present: their values
    inputs: the references of the inputs
    outputs: the slice of `present` that the outputs are
    parameters: the references of the parameters
    refused: why a parameter's value cannot be used, by its reference; empty if all can
    """

    def __init__(self, declared: Sequence[Variable]) -> None:
        self.declared = tuple(declared)
        self.present: list[Any] = [PYTHON_TYPES[v.type]() if v.start is None else v.start for v in declared]
        self._reference = {variable.name: reference for reference, variable in enumerate(declared)}
        self._of_type = {
            kind: frozenset(i for i, v in enumerate(declared) if _ACCESSED_AS.get(v.type, v.type) == kind)
            for kind in NOTHING
        }
        self.inputs = frozenset(self._with_causality("input"))
        self.parameters = self._with_causality("parameter")
        self.outputs = self.stretch([variable.name for variable in declared if variable.causality == "output"])
        self.refused = self._refusals()

    def values(self, names: Iterable[str]) -> list[Any]:
        """Return the present values of the named variables."""
        return [self.present[self._reference[name]] for name in names]

    def value(self, name: str) -> Any:
        """Return the present value of one variable."""
        return self.present[self._reference[name]]

    def parameter_values(self) -> tuple[Any, ...]:
        """Return the present values of all parameters."""
        return tuple(self.present[reference] for reference in self.parameters)

    def stretch(self, names: Sequence[str]) -> slice:
        """Return the slice of `present` that belongs to variables which are declared one after another."""
        at = slice_of([self._reference[name] for name in names])
        if at is None:
            raise ValueError(f"variables that are not declared one after another: {', '.join(names)}")
        return at

    def reference_fault(self, kind: str, references: Sequence[int]) -> NdobError | None:
        """Return what is wrong with references that should all be of variables of one type."""
        known = self._of_type[kind]
        if known.issuperset(references):
            return None
        unknown = next(reference for reference in references if reference not in known)
        return NdobError.report("value reference", expected=f"one of a {kind} variable", received=str(unknown))

    def set_parameter(self, reference: int, value: Any, mode: str) -> NdobError | None:
        """Set a variable that is not an input, in one of FMI's modes, or return what is wrong with that.

        A parameter keeps also a value that cannot be used: a host that overlooks the status must not run with another
        value than it set.
        """
        variable = self.declared[reference]
        if mode not in SETTABLE[role(variable)]:
            expected, received = NOT_SETTABLE[role(variable)]
            return NdobError.report(variable.name, expected=expected, received=received)
        self.present[reference] = value
        self.refused.pop(reference, None)
        fault = parameter_fault(variable, value)
        if fault:
            self.refused[reference] = str(fault)
        return fault

    def set_parameters(self, values: Sequence[Any]) -> None:
        """Set all parameters in a new list of values, so that the list before can be restored."""
        self.present = list(self.present)
        for reference, value in zip(self.parameters, values, strict=True):
            self.present[reference] = value

    def restore(self, values: Sequence[Any]) -> None:
        """Take these values of all variables."""
        self.present = list(values)
        self.refused = self._refusals()

    def _refusals(self) -> dict[int, str]:
        faults = {i: parameter_fault(self.declared[i], self.present[i]) for i in self.parameters}
        return {reference: str(fault) for reference, fault in faults.items() if fault}

    def _with_causality(self, causality: str) -> list[int]:
        return [reference for reference, variable in enumerate(self.declared) if variable.causality == causality]


def slice_of(references: Sequence[int]) -> slice | None:
    """Return the slice that references form; None where they do not follow one another."""
    at = slice(references[0], references[0] + len(references)) if references else slice(0)
    return at if list(references) == list(range(at.start or 0, at.stop)) else None


def is_declared(variable: Variable, value: Any) -> bool:
    """Return whether a value is of the variable's declared type: exactly what a host can set or get."""
    if type(value) is not PYTHON_TYPES[variable.type]:
        return False
    if isinstance(value, str):
        return "\0" not in value and value.encode("utf-8", "replace").decode() == value
    return isinstance(value, float) or value in _INTEGERS


def parameter_fault(variable: Variable, value: Any) -> NdobError | None:
    """Return what is wrong with the value of a parameter."""
    if is_acceptable(variable, value):
        return None
    return NdobError.report(variable.name, expected=expected_value(variable), received=repr(value))
