"""Assignments: to names, to entries of arrays and lists, and to several at once."""

from __future__ import annotations

import ast
import copy

from ndob_fmu.native.translate.kinds import (
    ARRAY,
    FLOAT,
    INT,
    NOTHING,
    Array,
    Kind,
    Listing,
    Maybe,
    Pack,
    Structure,
    Unknown,
    c_type,
    elements_of,
    is_nd,
    is_number,
    is_numbers,
)
from ndob_fmu.native.translate.loops import Loops
from ndob_fmu.native.translate.program import Definition
from ndob_fmu.native.translate.values import Value, c_name


class Assignments(Loops):
    """The part of a function's writer that writes assignments."""

    definition: Definition
    lines: list[str]
    declared: dict[str, Kind]
    pending: dict[str, tuple[int, str]]
    growing: set[str]
    fresh: set[str]
    zeroed: set[str]
    loops: list[int]
    handlers: list[str]
    jumps: set[str]
    count: int

    def declare(self, name: str, kind: Kind, node: ast.AST) -> None:
        """Declare a variable with a name in Python."""
        if isinstance(kind, Unknown):
            raise self.no(node, "a value whose type has a translation", kind.text)
        self.variables[name] = kind
        self.declared[c_name(name)] = kind
        self.use(kind)

    def assign(self, name: str, value: Value, node: ast.AST) -> None:
        """Write name = value."""
        if name == "_":
            return
        if name in self.pending:
            self._settle(name, value.kind if isinstance(value.kind, Maybe) else Maybe(value.kind), node)
        if name in self.variables:
            known = self.variables[name]
            if value.kind == NOTHING and is_nd(known) and not isinstance(known, Maybe):
                known = self.variables[name] = Maybe(known)
            arrays = isinstance(value.kind, (Maybe, Array)) and is_nd(value.kind)
            if arrays and (isinstance(known, Array) or (isinstance(value.kind, Maybe) and is_nd(known))):
                self.variables[name] = value.kind
            else:
                value = self.coerced(value, known, node)
        else:
            self.declare(name, value.kind, node)
        self.line(f"{self.local.get(name, c_name(name))} = {value.text};")
        (self.fresh.add if value.fresh else self.fresh.discard)(name)

    def _later(self, name: str, node: ast.AST, start: str) -> None:
        """Remember a variable that begins as [] or None; its type follows from its first use."""
        self.pending[name] = (len(self.lines), start)
        self.variables[name] = NOTHING
        self.line("")

    def _settle(self, name: str, kind: Kind, node: ast.AST) -> None:
        place, start = self.pending.pop(name)
        del self.variables[name]
        self.declare(name, kind, node)
        own = c_name(name)
        if start == "None":
            self.lines[place] = f"{own} = NULL;" if is_nd(kind) else f"memset(&{own}, 0, sizeof {own});"
        elif is_numbers(kind):
            self.lines[place] = f"{own} = nd_filled(arena, 0, 0.0);"
        else:
            self.lines[place] = f"{own}.n = 0, {own}.p = NULL;"

    def to_target(self, target: ast.expr, value: Value, node: ast.AST) -> None:
        """Write target = value for any target."""
        if isinstance(target, ast.Name):
            self.assign(target.id, value, node)
        elif isinstance(target, ast.Subscript):
            self._put(target, value)
        elif isinstance(target, ast.Tuple):
            self._take_apart(target, value, node)
        else:
            raise self.no(node, "a name, an entry or a tuple of these on the left")

    def _take_apart(self, target: ast.Tuple, value: Value, node: ast.AST) -> None:
        value = self.certain(value)
        if isinstance(value.kind, Unknown) and value.kind.text.startswith("shape "):
            array = value.kind.text.split()[1]
            for i, one in enumerate(target.elts):
                self.to_target(one, Value(f"{array}->n[{i}]", INT), node)
            return
        if isinstance(value.kind, Structure) and self.program.structure(value.kind.name).is_tuple:
            value = self.held(value)
            fields = self.program.structure(value.kind.name).fields.values()  # type: ignore[union-attr]
            items = [Value(f"{value.text}.{c_name(one.name)}", one.kind) for one in fields]
        elif isinstance(value.kind, Pack):
            value = self.held(value)
            items = [Value(f"{value.text}.v{i}", kind, value.fresh) for i, kind in enumerate(elements_of(value.kind))]
        elif isinstance(value.kind, Listing):
            value = self.held(value)
            numbers = is_numbers(value.kind)
            texts = [
                f"nd_at({value.text}, {i})" if numbers else f"{value.text}.p[{i}]" for i in range(len(target.elts))
            ]
            items = [self._as_element(text, value.kind, numbers) for text in texts]
        elif isinstance(value.kind, Array):
            value = self.held(value)
            items = [Value(f"nd_row(arena, {value.text}, {i})", ARRAY) for i in range(len(target.elts))]
        else:
            raise self.no(node, "a tuple on the right", str(value.kind))
        for one, item in zip(target.elts, items, strict=True):
            self.to_target(one, item, node)

    def _as_element(self, text: str, kind: Kind, numbers: bool) -> Value:
        assert isinstance(kind, Listing)
        if numbers and kind.element != FLOAT:
            return Value(f"(int){text}" if kind.element == INT else f"({text} != 0.0)", kind.element)
        return Value(text, kind.element)

    def _put(self, target: ast.Subscript, value: Value) -> None:
        base = target.value
        if not isinstance(base, ast.Name) or base.id not in self.fresh:
            raise self.no(target, "an entry of an array or list that this function made")
        array = self.expression(base)
        if isinstance(array.kind, Listing) and not is_numbers(array.kind):
            item = self.coerced(value, array.kind.element, target)
            self.line(f"{array.text}.p[{self.number(target.slice, INT)}] = {item.text};")
            return
        if (
            isinstance(array.kind, Listing)
            and not isinstance(target.slice, ast.Slice)
            and self.kind_if_known(target.slice) == INT
        ):
            self.line(
                f"nd_set({array.text}, {self.number(target.slice, INT)}, {self.as_number(value, FLOAT, target)});"
            )
            return
        crossed = self.crossed(target.slice)
        if crossed is not None:
            self.line(f"nd_put2({array.text}, {crossed[0]}, {crossed[1]}, {self.as_array(value, target)});")
            return
        parts = self.index_list(target.slice)
        listed = self.many(parts[0])
        if listed is not None and len(parts) == 1:
            self.line(f"nd_put_rows({array.text}, {listed}, {self.as_array(value, target)});")
            return
        if any(self.many(part) is not None for part in parts):
            raise self.no(target, "a list of indices along the first axis")
        place = self.part_of(array.text, target.slice)
        if is_number(value.kind):
            self.line(f"nd_put_number({place}, {self.as_number(value, FLOAT, target)});")
        else:
            self.line(f"nd_put({place}, {self.as_array(value, target)});")

    def _append(self, call: ast.Call, function: ast.Attribute) -> None:
        name = function.value.id if isinstance(function.value, ast.Name) else ""
        if name in self.pending:
            found: list[Kind] = []
            self.set_aside(lambda: found.append(self.expression(call.args[0]).kind))
            self._settle(name, Listing(found[0]), call)
            self.growing.add(name)
            self.fresh.add(name)
        known = self.variables.get(name)
        if name not in self.growing or not isinstance(known, Listing):
            raise self.no(call, "a list that began as [] in this function")
        value = self.coerced(self.expression(call.args[0], known.element), known.element, call)
        own = c_name(name)
        if is_numbers(known):
            self.line(f"nd_append(arena, &{own}, {self.as_number(value, FLOAT, call)});")
            return
        element = c_type(known.element)
        self.line(f"{own}.p = nd_room(arena, {own}.p, {own}.n, sizeof({element}));")
        self.line(f"{own}.p[{own}.n++] = {value.text};")

    def _assignment(self, node: ast.Assign) -> None:
        target = node.targets[0]
        if (
            isinstance(target, ast.Tuple)
            and isinstance(node.value, ast.Tuple)
            and len(target.elts) == len(node.value.elts)
        ):
            self._several(target, node.value, node)
            return
        if isinstance(target, ast.Name) and target.id not in self.variables and len(node.targets) == 1:
            empty = isinstance(node.value, ast.List) and not node.value.elts
            if empty or (isinstance(node.value, ast.Constant) and node.value.value is None):
                self._later(target.id, node, "[]" if empty else "None")
                return
        if isinstance(target, ast.Name) and isinstance(node.value, ast.List) and len(node.value.elts) == 1:
            self.growing.add(target.id)
        want = self.variables.get(target.id) if isinstance(target, ast.Name) and target.id not in self.pending else None
        value = self.expression(node.value, want)
        if len(node.targets) > 1:
            value = self.held(value)
        for one in node.targets[::-1]:
            self.to_target(one, value, node)

    def _several(self, target: ast.Tuple, right: ast.Tuple, node: ast.Assign) -> None:
        """Write a, b = x, y: all of the right side before any of the left."""
        simple = all(isinstance(one, ast.Name) for one in target.elts)
        read = {one.id for one in ast.walk(right) if isinstance(one, ast.Name)}
        if simple and not read & {one.id for one in target.elts if isinstance(one, ast.Name)}:
            for one, part in zip(target.elts, right.elts, strict=True):
                self._assignment(ast.copy_location(ast.Assign([one], part), node))
            return
        values = []
        for one, given in zip(target.elts, right.elts, strict=True):
            want = self.variables.get(one.id) if isinstance(one, ast.Name) else None
            value = self.expression(given, want)
            name = self.temporary(value.kind)
            self.line(f"{name} = {value.text};")
            values.append(Value(name, value.kind, value.fresh))
        for one, value in zip(target.elts, values, strict=True):
            self.to_target(one, value, node)

    def _annotated(self, node: ast.AnnAssign) -> None:
        if not isinstance(node.target, ast.Name):
            raise self.no(node, "a name that is annotated")
        kind = self.program.kind_of(self.module, node.annotation)
        if node.target.id not in self.variables:
            self.declare(node.target.id, kind, node)
        if node.value is not None:
            value = self.coerced(self.expression(node.value, kind), kind, node)
            if isinstance(node.value, ast.List) and not node.value.elts:
                self.growing.add(node.target.id)
            self.assign(node.target.id, value, node)

    def _augmented(self, node: ast.AugAssign) -> None:
        left = copy.copy(node.target)
        left.ctx = ast.Load()
        operation = ast.copy_location(ast.BinOp(left, node.op, node.value), node)
        self.to_target(node.target, self.expression(operation), node)
