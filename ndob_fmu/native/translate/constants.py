"""Constants of Python and NumPy, and complex numbers, as values in C."""

from __future__ import annotations

import ast
from typing import Any

import numpy as np

from ndob_fmu.native.translate.conversions import Conversions
from ndob_fmu.native.translate.kinds import (
    ARRAY,
    BOOL,
    FLOAT,
    INT,
    NOTHING,
    NUMBERS,
    TEXT,
    Array,
    ComplexArray,
    Listing,
    Pack,
    Structure,
    Unknown,
)
from ndob_fmu.native.translate.program import Class
from ndob_fmu.native.translate.values import Value, c_name, number_text


class Constants(Conversions):
    """The part of a function's writer that writes constants, and takes complex numbers apart."""

    def literal(self, value: Any, node: ast.AST) -> Value:
        """Return a constant of Python, or of NumPy."""
        if value is None:
            return Value("NULL", NOTHING)
        if isinstance(value, (bool, np.bool_)):
            return Value("true" if value else "false", BOOL)
        if isinstance(value, (int, np.integer)):
            return Value(f"{value}" if value >= 0 else f"({value})", INT)
        if isinstance(value, (float, np.floating)):
            return Value(number_text(float(value)), FLOAT)
        if isinstance(value, str):
            return Value('"' + value.replace("\\", "\\\\").replace('"', '\\"') + '"', TEXT)
        if isinstance(value, np.ndarray) and value.ndim <= 4:
            return self._constant_array(value)
        if isinstance(value, (tuple, list)):
            items = [self.literal(item, node) for item in value]
            kinds = {item.kind for item in items}
            if len(kinds) == 1:
                return self.listed(items, Listing(kinds.pop()), node)
            if kinds <= {FLOAT, INT, BOOL}:
                return self.listed(items, NUMBERS, node)
            return self.packed(items, Pack(tuple(item.kind for item in items)), node)
        raise self.no(node, "a constant number, array or tuple", repr(type(value)))

    def _instance(self, value: Any, known: Class, node: ast.AST) -> Value:
        """Return a constant that is a dataclass or a named tuple."""
        kind = Structure(known.name)
        name = self.temporary(kind)
        for one in known.fields.values():
            if not isinstance(one.kind, Unknown):
                field = self.coerced(self.literal(getattr(value, one.name), node), one.kind, node)
                self.line(f"{name}.{c_name(one.name)} = {field.text};")
        return Value(name, kind)

    def _constant_array(self, value: np.ndarray[Any, Any]) -> Value:
        flat = ", ".join(number_text(float(entry)) for entry in value.ravel()) or "0.0"
        vector = f"nd_vector(arena, {value.size}, (const double[]){{{flat}}})"
        if value.ndim != 1:
            lengths = ", ".join(map(str, value.shape))
            vector = f"nd_reshape(arena, {vector}, {value.ndim}, (int[]){{{lengths or 1}}})"
        element = {"b": BOOL, "i": INT}.get(value.dtype.kind, FLOAT)
        return Value(vector, Array(element), fresh=True)

    def parts_of(self, value: Value) -> list[Value]:
        """Return the real and the imaginary part of complex numbers."""
        value = self.held(value)
        return [Value(f"{value.text}.v0", ARRAY), Value(f"{value.text}.v1", ARRAY)]

    def _complex(self, parts: list[Value]) -> Value:
        name = self.temporary(ComplexArray())
        for i, part in enumerate(parts):
            self.line(f"{name}.v{i} = {part.text};")
        return Value(name, ComplexArray())
