"""Loops and comprehensions of Python in C: what is iterated becomes a count and a function from an index to an item."""

from __future__ import annotations

import ast
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from ndob_fmu.native.translate.calls import Calls
from ndob_fmu.native.translate.kinds import (
    ARRAY,
    BOOL,
    FLOAT,
    INT,
    Array,
    Kind,
    Listing,
    Maybe,
    Pack,
    c_type,
    elements_of,
    is_nd,
    is_number,
    is_numbers,
)
from ndob_fmu.native.translate.values import Value, entry

_OPERATORS: dict[str, ast.operator] = {"mul": ast.Mult(), "add": ast.Add(), "sub": ast.Sub()}
_RELATIONS: dict[str, ast.cmpop] = {"ge": ast.GtE(), "gt": ast.Gt(), "le": ast.LtE(), "lt": ast.Lt()}


@dataclass(frozen=True)
class Items:
    """What is iterated: how many items, and the item of an index."""

    count: str
    item: Callable[[str], Value]


class Loops(Calls):
    """The part of a function's writer that writes loops inside expressions."""

    hidden: dict[str, tuple[str, Kind]]
    bind: Callable[[str, Value], Any]

    def items(self, node: ast.expr) -> Items:
        """Return what an expression iterates over."""
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
            writer = getattr(self, f"_items_of_{node.func.id}", None)
            if writer is not None and node.func.id not in self.variables:
                found = writer(node)
                assert isinstance(found, Items)
                return found
        value = self.held_structure(self.certain(self.expression(node)))
        if not value.text.replace("->", "").replace(".", "").replace("(*", "").replace(")", "").isidentifier():
            value = self.held(value)
        return self._items_of_value(value, node)

    def _items_of_value(self, value: Value, node: ast.AST) -> Items:
        kind = value.kind
        if isinstance(kind, Array):
            return Items(f"nd_len({value.text})", lambda i: Value(f"nd_row(arena, {value.text}, {i})", kind))
        if is_numbers(kind):
            assert isinstance(kind, Listing)
            element = kind.element

            return Items(f"nd_len({value.text})", lambda i: entry(f"nd_at({value.text}, {i})", element))
        if isinstance(kind, Listing):
            return Items(f"{value.text}.n", lambda i: Value(f"{value.text}.p[{i}]", kind.element))
        if isinstance(kind, Pack) and len(set(kind.elements)) == 1:
            return self._items_of_value(self.held(self.coerced(value, Listing(kind.elements[0]), node)), node)
        raise self.no(node, "something to iterate over", f"{ast.unparse(node)} of type {kind}")

    def _items_of_range(self, node: ast.Call) -> Items:
        ends = [self.held(Value(self.number(one, INT), INT)).text for one in node.args]
        if len(ends) == 3:
            raise self.no(node, "a range without a step")
        if len(ends) == 1:
            return Items(ends[0], lambda i: Value(i, INT))
        return Items(f"({ends[1]} - {ends[0]})", lambda i: Value(f"({ends[0]} + {i})", INT))

    def _items_of_reversed(self, node: ast.Call) -> Items:
        inner = self.items(node.args[0])
        return Items(inner.count, lambda i: inner.item(f"({inner.count} - 1 - {i})"))

    def _items_of_enumerate(self, node: ast.Call) -> Items:
        inner = self.items(node.args[0])
        return Items(inner.count, lambda i: self._together([Value(i, INT), inner.item(i)]))

    def _items_of_zip(self, node: ast.Call) -> Items:
        inner = [self.items(one) for one in node.args]
        return Items(inner[0].count, lambda i: self._together([one.item(i) for one in inner]))

    def _items_of_pairwise(self, node: ast.Call) -> Items:
        inner = self.items(node.args[0])
        return Items(f"({inner.count} - 1)", lambda i: self._together([inner.item(i), inner.item(f"({i} + 1)")]))

    def _items_of_map(self, node: ast.Call) -> Items:
        inner = [self.items(one) for one in node.args[1:]]
        function = node.args[0]

        def item(i: str) -> Value:
            values = [one.item(i) for one in inner]
            name = function.id if isinstance(function, ast.Name) else ""
            if name in _OPERATORS:
                return self.operation(_OPERATORS[name], values[0], values[1], node)
            if name in _RELATIONS:
                return self.compared(_RELATIONS[name], values[0], values[1], node)
            names = []
            for value in values:
                held = self.held(value)
                self.variables[held.text] = held.kind
                names.append(ast.copy_location(ast.Name(held.text, ast.Load()), node))
            call = ast.copy_location(ast.Call(function, list(names), []), node)
            return self.expression(call)

        return Items(inner[0].count, item)

    def _together(self, values: list[Value]) -> Value:
        """Return several values as one item that only a tuple of targets takes apart."""
        return Value("", Pack(tuple(value.kind for value in values)), parts=tuple(values))

    def targets(self, target: ast.expr, value: Value) -> list[tuple[ast.expr, Value]]:
        """Return the names that an item is taken apart into, with their values."""
        if not isinstance(target, ast.Tuple):
            if value.parts:
                assert isinstance(value.kind, Pack)
                value = self.packed(list(value.parts), value.kind, target)
            return [(target, value)]
        if value.parts:
            inner = list(value.parts)
        elif isinstance(value.kind, Pack):
            value = self.held_structure(value)
            inner = [Value(f"{value.text}.v{i}", kind) for i, kind in enumerate(elements_of(value.kind))]
        elif is_nd(value.kind):
            value = self.held(value)
            inner = [Value(f"nd_row(arena, {value.text}, {i})", ARRAY) for i in range(len(target.elts))]
        else:
            raise self.no(target, "a tuple of names for a tuple", str(value.kind))
        found = []
        for one, own in zip(target.elts, inner, strict=True):
            found += self.targets(one, own)
        return found

    def around(self, target: ast.expr, items: Items, body: Callable[[], None]) -> None:
        """Write a loop inside an expression, whose names are known inside only."""
        i = self.temporary(INT)
        before = dict(self.variables), dict(self.local)
        self.line(f"for ({i} = 0; {i} < {items.count}; {i}++) {{")
        for one, value in self.targets(target, items.item(i)):
            if isinstance(one, ast.Name) and one.id != "_":
                held = self.temporary(value.kind)
                self.line(f"{held} = {value.text};")
                self.variables[one.id] = value.kind
                self.local[one.id] = held
        body()
        self.line("}")
        self.variables.clear()
        self.variables.update(before[0])
        self.local.clear()
        self.local.update(before[1])

    def _generator(self, node: ast.expr) -> tuple[ast.expr, ast.expr, list[ast.expr], ast.expr]:
        """Return target, what is iterated, conditions and element of a comprehension or of a map."""
        if isinstance(node, (ast.ListComp, ast.GeneratorExp)):
            if len(node.generators) != 1:
                raise self.no(node, "a comprehension over one thing")
            one = node.generators[0]
            return one.target, one.iter, one.ifs, node.elt
        name = ast.copy_location(ast.Name("mapped_item", ast.Load()), node)
        return name, node, [], name

    def comprehension(self, node: ast.expr, want: Kind | None = None) -> Value:
        """Write a comprehension as a list."""
        target, over, conditions, element = self._generator(node)
        if isinstance(want, Maybe):
            want = want.value
        own = want.element if isinstance(want, Listing) else None
        found: list[Kind] = []

        def look() -> None:
            self.around(target, self.items(over), lambda: found.append(self.expression(element, own).kind))

        self.set_aside(look)
        kind = Listing(own if own is not None else found[0])
        name, count = self.temporary(kind), self.temporary(INT)
        numbers = is_numbers(kind)
        items = self.items(over)
        counted = items.count
        self.use(kind)
        if numbers:
            self.line(f"{name} = nd_filled(arena, {counted}, 0.0);")
        else:
            size = f"sizeof({c_type(kind.element)}) * (size_t)nd_imax2({counted}, 1)"
            self.line(f"{name}.p = nd_take_bytes(arena, {size});")
        self.line(f"{count} = 0;")

        def body() -> None:
            for condition in conditions:
                self.line(f"if (!{self.truth(condition)}) continue;")
            value = self.expression(element, kind.element)
            text = self.as_number(value, FLOAT, element) if numbers else self.coerced(value, kind.element, element).text
            self.line(f"{name}{'->' if numbers else '.'}p[{count}++] = {text};")

        self.around(target, items, body)
        self.line(f"{name}->n[0] = {count};" if numbers else f"{name}.n = {count};")
        return Value(name, kind, fresh=True)

    def loop_value(self, node: ast.Call, short: str) -> Value:
        """Write all, any, sum, max or min of a generator."""
        target, over, conditions, element = self._generator(node.args[0])
        if isinstance(node.args[0], (ast.Name, ast.Attribute)):  # a list, and a default
            name_node = ast.copy_location(ast.Name("mapped_item", ast.Load()), node)
            target, over, conditions, element = name_node, node.args[0], [], name_node
        found: list[Kind] = []
        self.set_aside(
            lambda: self.around(target, self.items(over), lambda: found.append(self.expression(element).kind))
        )
        kind = BOOL if short in ("all", "any") else found[0] if short == "sum" else FLOAT if found[0] != INT else INT
        if short == "sum" and kind == BOOL:
            kind = INT
        name = self.temporary(kind)
        first = self.temporary(BOOL)
        start = {"all": "true", "any": "false"}.get(short)
        if short == "sum":
            start = "0" if is_number(kind) else None
            if len(node.args) > 1:
                start = self.coerced(self.expression(node.args[1], kind), kind, node).text
            if start is None:
                raise self.no(node, "a sum of arrays with a start")
        if start is not None:
            self.line(f"{name} = {start};")
        if short in ("max", "min"):
            self.line(f"{first} = true;")
            default = next((one.value for one in node.keywords if one.arg == "default"), None)
            if default is not None:
                self.line(f"{name} = {self.coerced(self.expression(default), kind, node).text};")

        def body() -> None:
            for condition in conditions:
                self.line(f"if (!{self.truth(condition)}) continue;")
            if short in ("all", "any"):
                self.line(f"if ({'!' if short == 'all' else ''}{self.truth(element)}) {{")
                self.line(f"{name} = {'false' if short == 'all' else 'true'};")
                self.line("break;")
                self.line("}")
                return
            value = self.coerced(self.expression(element), kind, element)
            if short == "sum":
                added = self.operation(ast.Add(), Value(name, kind), value, element)
                self.line(f"{name} = {added.text};")
                return
            value = self.held(value)
            self.line(f"if ({first} || {value.text} {'>' if short == 'max' else '<'} {name}) {name} = {value.text};")
            self.line(f"{first} = false;")

        self.around(target, self.items(over), body)
        return Value(name, kind)


__all__ = ["Items", "Loops"]
