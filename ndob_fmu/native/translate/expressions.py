"""Expressions of Python in C.

An expression becomes a text and a type. What has no form inside an expression of C, as a call that can fail or a branch
that must not be evaluated, becomes statements before it, and a variable.
"""

from __future__ import annotations

import ast
from collections.abc import Callable

import numpy as np

from ndob_fmu.native.translate.kinds import (
    ARRAY,
    BOOL,
    FLOAT,
    INT,
    NOTHING,
    NUMBERS,
    SLICE,
    Array,
    ComplexArray,
    Kind,
    Listing,
    Maybe,
    Pack,
    Structure,
    Unknown,
    c_type,
    is_nd,
    is_number,
)
from ndob_fmu.native.translate.operators import Operators
from ndob_fmu.native.translate.values import Value, c_name, in_parentheses, number_text


class Expressions(Operators):
    """The part of a function's writer that writes expressions."""

    def expression(self, node: ast.expr, want: Kind | None = None) -> Value:
        """Return an expression in C. `want`: the type where it is needed; an empty list or None has no own type."""
        match node:
            case ast.Constant():
                return self._constant(node)
            case ast.Name():
                return self._name(node, want)
            case ast.Attribute():
                return self._attribute(node)
            case ast.Subscript():
                return self._subscript(node)
            case ast.UnaryOp():
                return self._unary(node)
            case ast.BinOp():
                return self._binary(node, want)
            case ast.BoolOp():
                return self._boolean(node)
            case ast.Compare():
                return self._compare(node)
            case ast.IfExp():
                return self._choice(node, want)
            case ast.Tuple() | ast.List():
                return self._sequence(node, want)
            case ast.ListComp() | ast.GeneratorExp():
                return self.comprehension(node, want)
            case ast.Call():
                return self.call(node, want)
            case ast.Lambda():
                return self.closure_value(node, want)
        raise self.no(node, "an expression that has a translation")

    def _constant(self, node: ast.Constant) -> Value:
        return self.literal(node.value, node)

    def _name(self, node: ast.Name, want: Kind | None) -> Value:
        if node.id in self.variables:
            self.read_variable(node)
            return Value(self.local.get(node.id, c_name(node.id)), self.variables[node.id])
        if node.id in self.closures:
            return self.closure_value(node, want)
        if self.program.definition(self.module, node.id) is not None:
            return self.function_value(node, want)
        found = self.program.resolve(self.module, node.id)
        if found is not None:
            value = getattr(found[0].live, found[1])
            made = type(value)
            known = None
            if made.__module__.startswith("ndob_fmu."):
                known = self.program.class_of(self.program.module(made.__module__), made.__name__)
            return self.literal(value, node) if known is None else self._instance(value, known, node)
        if self.program.outside(self.module, node.id) in ("math.inf", "math.pi", "math.nan"):
            import math

            return self.literal(getattr(math, node.id), node)
        raise self.no(node, "a name that is known here")

    def _attribute(self, node: ast.Attribute) -> Value:
        constant = {"np.inf": "INFINITY", "np.nan": "NAN", "np.pi": number_text(np.pi)}.get(ast.unparse(node))
        if constant is not None:
            return Value(constant, FLOAT)
        if ast.unparse(node) in ("np.finfo(float).eps", "np.finfo(float).tiny"):
            return Value(number_text(float(getattr(np.finfo(float), node.attr))), FLOAT)
        value = self.certain(self.expression(node.value))
        if is_nd(value.kind):
            if node.attr == "T":
                return Value(f"nd_transposed(arena, {value.text})", value.kind)
            if node.attr == "size":
                return Value(f"nd_size({value.text})", INT)
            if node.attr == "shape":
                held = self.held(value)
                return Value(f"{held.text}->n", Unknown(f"shape {held.text}"))
        if isinstance(value.kind, ComplexArray) and node.attr in ("real", "imag"):
            return self.parts_of(value)[node.attr == "imag"]
        if value.kind == SLICE and node.attr in ("start", "stop"):
            return Value(f"{value.text}.{node.attr}", INT)
        if isinstance(value.kind, Structure):
            known = self.program.structure(value.kind.name)
            if node.attr in known.fields:
                kind = known.fields[node.attr].kind
                if isinstance(kind, Unknown):
                    raise self.no(node, "a field whose type has a translation", f"{node.attr}: {kind.text}")
                base = (
                    value.text[2:-1] + "->"
                    if value.text.startswith("(*") and value.text[2:-1].isidentifier()
                    else f"{value.text}."
                )
                return Value(f"{base}{c_name(node.attr)}", kind)
            if node.attr in known.properties:
                return self.call_method(node, value, node.attr, [], {})
        raise self.no(node, "a field, property, T, shape or size", f"{ast.unparse(node)} of type {value.kind}")

    def _choice(self, node: ast.IfExp, want: Kind | None) -> Value:
        condition = self.truth(node.test)
        kind = self._joined(node, want)
        branches: list[str] = []

        def branch(part: ast.expr) -> Callable[[], None]:
            return lambda: branches.append(self.coerced(self.expression(part, kind), kind, part).text)

        lines = [self.set_aside(branch(part)) for part in (node.body, node.orelse)]
        if not any(lines) and not isinstance(kind, (Structure, Pack)) and not any("arena" in text for text in branches):
            return Value(f"({condition} ? {branches[0]} : {branches[1]})", kind)
        name = self.temporary(kind)
        self.line(f"if {in_parentheses(condition)} {{")
        branch(node.body)()
        self.line(f"{name} = {branches[-1]};")
        self.line("} else {")
        branch(node.orelse)()
        self.line(f"{name} = {branches[-1]};")
        self.line("}")
        return Value(name, kind)

    def _joined(self, node: ast.IfExp, want: Kind | None) -> Kind:
        """Return the type of a choice."""
        if want is not None:
            return want
        found: list[Kind] = []
        tested = ast.unparse(node.test).split(" is ")  # mypy knows that it is not None in the other branch
        for part, rest in ((node.body, node.orelse), (node.orelse, node.body)):
            if isinstance(part, (ast.List, ast.Tuple)) and not part.elts:
                kind = self.kind_if_known(rest)
                return NUMBERS if kind is not None and is_nd(kind) else kind or NUMBERS
        for part in (node.body, node.orelse):

            def look(part: ast.expr = part) -> None:
                value = self.expression(part)
                found.append((self.certain(value) if ast.unparse(part) in tested else value).kind)

            self.set_aside(look)
        first, second = found
        if first == second:
            return first
        if NOTHING in found:
            other = second if first == NOTHING else first
            return other if isinstance(other, Maybe) else Maybe(other)
        for one in found:
            if isinstance(one, Array):
                return one
        if {first, second} <= {FLOAT, INT, BOOL}:
            return FLOAT if FLOAT in found else INT
        if is_nd(first) and is_nd(second):
            return first
        if isinstance(first, Maybe) and first.value == second:
            return first
        raise self.no(node, "the same type on both sides", f"{first} and {second}")

    def _sequence(self, node: ast.Tuple | ast.List, want: Kind | None) -> Value:
        if isinstance(want, Maybe):
            want = want.value
        if any(isinstance(item, ast.Starred) for item in node.elts):
            return self._joined_parts(node)
        if not node.elts:
            if not isinstance(want, Listing):
                if want is not None and is_nd(want):
                    want = NUMBERS
                else:
                    raise self.no(node, "an empty list whose type is known from an annotation")
            return self.listed([], want, node)
        wants: list[Kind | None] = [None] * len(node.elts)
        if isinstance(want, Pack) and len(want.elements) == len(node.elts):
            wants = list(want.elements)
        elif isinstance(want, Listing):
            wants = [want.element] * len(node.elts)
        items = [self.expression(item, own) for item, own in zip(node.elts, wants, strict=True)]
        if isinstance(want, Listing):
            return self.listed(items, want, node)
        if isinstance(want, Pack):
            return self.packed(items, want, node)
        kinds = [item.kind for item in items]
        if isinstance(node, ast.List) or (all(map(is_number, kinds)) and len(set(kinds)) == 1):
            if all(map(is_number, kinds)):
                element: Kind = kinds[0] if len(set(kinds)) == 1 else FLOAT
                return self.listed(items, Listing(element), node)
            if all(is_nd(kind) or is_number(kind) for kind in kinds):
                return self.listed(items, Listing(ARRAY), node)
            return self.listed(items, Listing(kinds[0]), node)
        return self.packed(items, Pack(tuple(kinds)), node)

    def _joined_lists(self, node: ast.Tuple | ast.List, kind: Listing) -> Value:
        """Write [*x, y, …], a list of structures."""
        parts: list[tuple[bool, Value]] = []
        for item in node.elts:
            starred = isinstance(item, ast.Starred)
            value = self.expression(item.value if isinstance(item, ast.Starred) else item)
            wanted = kind if starred else kind.element
            parts.append((starred, self.held_structure(self.coerced(value, wanted, item))))
        name, i, own = self.temporary(kind), self.temporary(INT), c_type(kind.element)
        total = " + ".join(f"{value.text}.n" if starred else "1" for starred, value in parts)
        self.line(f"{name}.p = nd_take_bytes(arena, sizeof({own}) * (size_t)({total}));")
        self.line(f"{name}.n = 0;")
        for starred, value in parts:
            if starred:
                self.line(f"for ({i} = 0; {i} < {value.text}.n; {i}++) {name}.p[{name}.n++] = {value.text}.p[{i}];")
            else:
                self.line(f"{name}.p[{name}.n++] = {value.text};")
        return Value(name, kind, fresh=True)

    def _joined_parts(self, node: ast.Tuple | ast.List) -> Value:
        """Write [*x, y, …], a list of numbers."""
        first = self.kind_if_known(node.elts[0].value if isinstance(node.elts[0], ast.Starred) else node.elts[0])
        if isinstance(first, Listing) and not is_nd(first):
            return self._joined_lists(node, first)
        texts = []
        element: Kind = INT
        for item in node.elts:
            value = self.certain(self.expression(item.value if isinstance(item, ast.Starred) else item))
            if isinstance(item, ast.Starred):
                if not is_nd(value.kind):
                    raise self.no(item, "a list of numbers after *", str(value.kind))
                own = value.kind.element if isinstance(value.kind, (Listing, Array)) else FLOAT
                texts.append(value.text)
            else:
                own = value.kind
                number = self.as_number(value, FLOAT, item)
                texts.append(f"nd_vector(arena, 1, (double[]){{{number}}})")
            element = element if own == element else FLOAT
        return Value(
            f"nd_concatenate(arena, 0, {len(texts)}, (nd[]){{{', '.join(texts)}}})", Listing(element), fresh=True
        )
