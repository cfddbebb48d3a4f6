"""How a value of one type becomes one of another."""

from __future__ import annotations

import ast
from collections.abc import Callable
from typing import Any

from ndob_fmu.native.translate.kinds import (
    BOOL,
    FLOAT,
    INT,
    NOTHING,
    Array,
    Function,
    Kind,
    Listing,
    Maybe,
    Pack,
    Simple,
    Table,
    by_pointer,
    c_type,
    elements_of,
    is_nd,
    is_number,
    is_numbers,
)
from ndob_fmu.native.translate.program import Definition, Module, Program
from ndob_fmu.native.translate.refusal import RefusedError, refused
from ndob_fmu.native.translate.values import Value


def _first_entry(array: str) -> str:
    row = "nd_row(arena, "
    return f"nd_at({array.removeprefix(row)}" if array.startswith(row) else f"nd_item({array})"


class Conversions:
    """The part of a function's writer that converts values."""

    program: Program
    module: Module
    variables: dict[str, Kind]
    local: dict[str, Any]
    closures: dict[str, Any]

    # -- of the other parts
    line: Callable[[str], None]
    temporary: Callable[[Kind], str]
    use: Callable[[Kind], None]
    call: Callable[[ast.Call, Kind | None], Value]
    call_method: Callable[..., Value]
    comprehension: Callable[..., Value]
    closure_value: Callable[..., Value]
    function_value: Callable[..., Value]
    set_aside: Callable[..., list[str]]
    read_variable: Callable[[ast.Name], None]
    check: Callable[[], None]
    need: Callable[[Definition], None]
    fails: Callable[[Definition], bool]
    called: Callable[..., Value]
    loop_value: Callable[[ast.Call, str], Value]
    expression: Callable[..., Value]
    kind_if_known: Callable[[ast.expr], Kind | None]
    conditions: Callable[[ast.BoolOp], str]
    indices: Callable[[ast.expr], str]
    found: Callable[[Value, Value], str]

    def no(self, node: ast.AST, expected: str, received: str | None = None) -> RefusedError:
        """Return the refusal of a node."""
        return refused(self.module.file, node, expected, received if received is not None else ast.unparse(node))

    def held(self, value: Value) -> Value:
        """Return a value as a variable, so that it is evaluated once and here."""
        if value.text.isidentifier():
            return value
        name = self.temporary(value.kind)
        self.line(f"{name} = {value.text};")
        return Value(name, value.kind, value.fresh)

    def certain(self, value: Value) -> Value:
        """Return a value that may be None as one that is not."""
        if not isinstance(value.kind, Maybe):
            return value
        text = value.text if is_nd(value.kind) else f"{value.text}.value"
        return Value(text, value.kind.value)

    def number(self, node: ast.expr, kind: Simple = FLOAT) -> str:
        """Return an expression as a number of a type."""
        return self.as_number(self.expression(node, kind), kind, node)

    def as_number(self, value: Value, kind: Simple, node: ast.AST) -> str:
        """Return a value as a number of a type."""
        value = self.certain(value)
        if isinstance(value.kind, Array):
            text = _first_entry(value.text)
            return text if kind == FLOAT else f"(int){text}" if kind == INT else f"({text} != 0.0)"
        if not is_number(value.kind):
            raise self.no(node, "a number", f"{ast.unparse(node)} of type {value.kind}")
        if value.kind == kind:
            return value.text
        if kind == BOOL:
            return f"({value.text} != 0)" if value.kind == INT else f"({value.text} != 0.0)"
        if kind == INT and value.kind == FLOAT:
            raise self.no(node, "an integer")
        return f"(double)({value.text})" if kind == FLOAT else f"(int)({value.text})"

    def array(self, node: ast.expr) -> str:
        """Return an expression as an array."""
        return self.as_array(self.expression(node), node)

    def as_array(self, value: Value, node: ast.AST) -> str:
        """Return a value as an array."""
        value = self.certain(value)
        if is_nd(value.kind):
            return value.text
        if is_number(value.kind):
            return f"nd_scalar(arena, {self.as_number(value, FLOAT, node)})"
        if isinstance(value.kind, Listing) and is_nd(value.kind.element):
            value = self.held(value)
            return f"nd_stack(arena, {value.text}.n, {value.text}.p)"
        raise self.no(node, "an array", f"{ast.unparse(node)} of type {value.kind}")

    def coerced(self, value: Value, kind: Kind, node: ast.AST) -> Value:
        """Return a value as one of a type."""
        if value.kind == kind or (is_nd(value.kind) and is_nd(kind)):
            return Value(value.text, kind, value.fresh)
        if isinstance(kind, Maybe):
            return self._maybe(value, kind, node)
        value = self.certain(value)
        if value.kind == kind or (is_nd(value.kind) and is_nd(kind)):
            return Value(value.text, kind, value.fresh)
        if isinstance(kind, Simple) and is_number(kind):
            return Value(self.as_number(value, kind, node), kind)
        if isinstance(kind, Array):
            return Value(self.as_array(value, node), kind, fresh=is_number(value.kind))
        if isinstance(kind, Listing) and isinstance(value.kind, Listing) and c_type(kind) == c_type(value.kind):
            return Value(value.text, kind, value.fresh)
        if is_numbers(kind) and isinstance(value.kind, Listing) and is_nd(value.kind.element):
            return Value(self.as_array(value, node), kind, fresh=True)  # mypy knows that the entries are numbers
        if isinstance(kind, Pack) and isinstance(value.kind, Pack) and len(kind.elements) == len(value.kind.elements):
            value = self.held(value)
            items = [Value(f"{value.text}.v{i}", own) for i, own in enumerate(elements_of(value.kind))]
            return self.packed(items, kind, node)
        if isinstance(kind, Listing) and isinstance(value.kind, Pack):
            value = self.held(value)
            items = [Value(f"{value.text}.v{i}", own) for i, own in enumerate(elements_of(value.kind))]
            return self.listed(items, kind, node)
        if isinstance(kind, Function) and isinstance(value.kind, Function) and c_type(kind) == c_type(value.kind):
            return Value(value.text, kind)
        raise self.no(node, f"a value of type {kind}", f"{ast.unparse(node)} of type {value.kind}")

    def _maybe(self, value: Value, kind: Maybe, node: ast.AST) -> Value:
        if value.kind == NOTHING:
            if is_nd(kind):
                return Value("NULL", kind)
            name = self.temporary(kind)
            self.line(f"memset(&{name}, 0, sizeof {name});")
            return Value(name, kind)
        inner = self.coerced(value, kind.value, node)
        if is_nd(kind):
            return Value(inner.text, kind, inner.fresh)
        name = self.temporary(kind)
        self.line(f"{name}.some = true;")
        self.line(f"{name}.value = {inner.text};")
        return Value(name, kind)

    def packed(self, items: list[Value], kind: Pack, node: ast.AST) -> Value:
        """Return a tuple of fixed length."""
        texts = [self.coerced(item, own, node).text for item, own in zip(items, kind.elements, strict=True)]
        name = self.temporary(kind)
        for i, text in enumerate(texts):
            self.line(f"{name}.v{i} = {text};")
        return Value(name, kind, fresh=all(item.fresh for item in items))

    def listed(self, items: list[Value], kind: Listing, node: ast.AST) -> Value:
        """Return a list of these items."""
        name = self.temporary(kind)
        if is_numbers(kind):
            texts = [self.as_number(item, FLOAT, node) for item in items]
            if len(texts) == 1:
                self.line(f"{name} = nd_filled(arena, 1, {texts[0]});")
            elif texts:
                self.line(f"{name} = nd_vector(arena, {len(texts)}, (const double[]){{{', '.join(texts)}}});")
            else:
                self.line(f"{name} = nd_filled(arena, 0, 0.0);")
        else:
            texts = [self.coerced(item, kind.element, node).text for item in items]
            self.line(f"{name}.n = {len(items)};")
            own = c_type(kind.element)
            self.line(f"{name}.p = nd_take_bytes(arena, sizeof({own}) * {max(len(items), 1)});")
            for i, text in enumerate(texts):
                self.line(f"{name}.p[{i}] = {text};")
        return Value(name, kind, fresh=True)

    def address(self, value: Value) -> str:
        """Return the address of a structure."""
        text = value.text
        return text[2:-1] if text.startswith("(*") and text.endswith(")") else f"&{text}"

    def argument(self, node: ast.expr, kind: Kind) -> str:
        """Return an expression as the argument of a function of C."""
        value = self.coerced(self.expression(node, kind), kind, node)
        return self.address(self.held_structure(value)) if by_pointer(kind) else value.text

    def held_structure(self, value: Value) -> Value:
        """Return a structure as something that has an address."""
        plain = (
            value.text.replace("(*", "")
            .replace(")", "")
            .replace(".", "")
            .replace("[", "")
            .replace("]", "")
            .replace("->", "")
        )
        return value if plain.isidentifier() else self.held(value)

    def truth(self, node: ast.expr) -> str:
        """Return an expression as a condition."""
        if isinstance(node, ast.BoolOp):
            return self.conditions(node)
        value = self.expression(node)
        if isinstance(value.kind, Maybe) and is_nd(value.kind):
            raise self.no(node, "a condition")
        return self.as_truth(value, node)

    def as_truth(self, value: Value, node: ast.AST) -> str:
        """Return a value as a condition, as Python judges it."""
        if is_number(value.kind):
            return self.as_number(value, BOOL, node)
        if isinstance(value.kind, Array):
            return f"({_first_entry(value.text)} != 0.0)"
        if isinstance(value.kind, Table):
            return f"({value.text}.n != 0)"
        if isinstance(value.kind, Listing):
            return f"({self.length(value, node)} != 0)"
        raise self.no(node, "a condition", f"{ast.unparse(node)} of type {value.kind}")

    def length(self, value: Value, node: ast.AST) -> str:
        """Return the length of a value."""
        value = self.certain(value)
        if is_nd(value.kind):
            return f"nd_len({value.text})"
        if isinstance(value.kind, Listing):
            return f"{value.text}.n"
        if isinstance(value.kind, Pack):
            return str(len(value.kind.elements))
        raise self.no(node, "something that has a length")
