"""Parts of arrays, lists and tuples."""

from __future__ import annotations

import ast
from typing import NamedTuple

from ndob_fmu.native.translate.constants import Constants
from ndob_fmu.native.translate.kinds import (
    ARRAY,
    BOOL,
    INT,
    SLICE,
    Array,
    ComplexArray,
    Kind,
    Listing,
    Maybe,
    Pack,
    Table,
    Unknown,
    c_type,
    elements_of,
    is_nd,
    is_numbers,
)
from ndob_fmu.native.translate.refusal import RefusedError
from ndob_fmu.native.translate.values import Value, entry


class _Index(NamedTuple):
    """An index of a subscript: how it takes entries of its axis, and the numbers that it says, in C."""

    kind: str
    bounds: tuple[str, ...]


_RANGE, _WHOLE, _AT, _NEW = "range", "whole", "at", "new"
_GENERAL = {_RANGE: "ND_RANGE", _WHOLE: "ND_RANGE", _AT: "ND_AT", _NEW: "ND_NEW"}
_SHORT_CALLS = {
    (_RANGE,): "nd_range",
    (_AT,): "nd_row",
    (_WHOLE, _AT): "nd_column",
    (_WHOLE, _NEW): "nd_upright",
}


def is_reversal(node: ast.expr) -> bool:
    """Return whether an index is [::-1]."""
    return isinstance(node, ast.Slice) and ast.unparse(node) == "::-1"


class Indices(Constants):
    """The part of a function's writer that writes subscripts."""

    def index_list(self, node: ast.expr) -> list[ast.expr]:
        """Return the indices of a subscript."""
        return list(node.elts) if isinstance(node, ast.Tuple) else [node]

    def _subscript(self, node: ast.Subscript) -> Value:
        if isinstance(node.value, ast.Name) and isinstance(node.slice, ast.Constant):
            found = None if node.value.id in self.variables else self.program.resolve(self.module, node.value.id)
            table = None if found is None else getattr(found[0].live, found[1], None)
            if isinstance(table, dict):
                return self.literal(table[node.slice.value], node)
        value = self.certain(self.expression(node.value))
        if isinstance(value.kind, Unknown) and value.kind.text.startswith("shape "):
            array = value.kind.text.split()[1]
            if isinstance(node.slice, ast.UnaryOp):
                return Value(f"{array}->n[{array}->rank - {ast.unparse(node.slice.operand)}]", INT)
            return Value(f"{array}->n[{self.number(node.slice, INT)}]", INT)
        if isinstance(value.kind, Pack) and isinstance(node.slice, ast.Constant):
            i = node.slice.value
            assert isinstance(i, int)
            value = self.held_structure(value)
            return Value(f"{value.text}.v{i}", elements_of(value.kind)[i])
        if isinstance(value.kind, Table):
            kind = value.kind.value
            value = self.held_structure(value)
            return Value(f"{value.text}.p[{self.found(value, self.expression(node.slice))}]", kind)
        if isinstance(value.kind, Listing):
            return self._item(node, value, value.kind)
        if isinstance(value.kind, Array):
            return self._part(node, value, value.kind)
        if isinstance(value.kind, ComplexArray):
            return self._complex([self._part(node, part, ARRAY) for part in self.parts_of(value)])
        raise self.no(node, "an index into an array, list or tuple", f"{ast.unparse(node)} of type {value.kind}")

    def _item(self, node: ast.Subscript, value: Value, kind: Listing) -> Value:
        if is_reversal(node.slice):
            return self._backwards(value, kind)
        whole = isinstance(node.slice, ast.Slice) or self.kind_if_known(node.slice) == SLICE
        if whole:
            if is_numbers(kind):
                return Value(self.part_of(value.text, node.slice), kind)
            return self._listed_part(node, value, kind)
        if is_numbers(kind):
            return entry(f"nd_at({value.text}, {self.number(node.slice, INT)})", kind.element)
        value = self.held_structure(value)
        if isinstance(node.slice, ast.UnaryOp):
            return Value(f"{value.text}.p[{value.text}.n - {ast.unparse(node.slice.operand)}]", kind.element)
        return Value(f"{value.text}.p[{self.number(node.slice, INT)}]", kind.element)

    def _backwards(self, value: Value, kind: Listing) -> Value:
        if is_numbers(kind):
            return Value(f"nd_reversed(arena, {value.text})", kind)
        value, name, i = self.held_structure(value), self.temporary(kind), self.temporary(INT)
        self.line(f"{name}.n = {value.text}.n;")
        self.line(f"{name}.p = nd_take_bytes(arena, sizeof({c_type(kind.element)}) * (size_t)nd_imax2({name}.n, 1));")
        self.line(f"for ({i} = 0; {i} < {name}.n; {i}++) {name}.p[{i}] = {value.text}.p[{name}.n - 1 - {i}];")
        return Value(name, kind, fresh=True)

    def _listed_part(self, node: ast.Subscript, value: Value, kind: Listing) -> Value:
        part = node.slice
        if not isinstance(part, ast.Slice) or part.step is not None:
            raise self.no(node, "a slice without a step")
        value = self.held_structure(value)
        name = self.temporary(kind)
        start = self.number(part.lower, INT) if part.lower else "0"
        stop = f"nd_imin2({self.number(part.upper, INT)}, {value.text}.n)" if part.upper else f"{value.text}.n"
        self.line(f"{name}.n = nd_imax2({stop} - ({start}), 0);")
        self.line(f"{name}.p = {value.text}.p + ({start});")
        return Value(name, kind)

    def kind_if_known(self, node: ast.expr) -> Kind | None:
        """Return the type of an expression; what its evaluation would write is dropped."""
        try:
            kind: Kind | None = None

            def look() -> None:
                nonlocal kind
                kind = self.expression(node).kind

            self.set_aside(look)
        except RefusedError:
            return None
        return kind

    def part_of(self, array: str, node: ast.expr) -> str:
        """Return the part of an array that a subscript of slices and integers names; the usual ones are short calls."""
        indices = [self._index(part) for part in self.index_list(node)]
        own = _SHORT_CALLS.get(tuple(index.kind for index in indices))
        if own is None and all(index.kind in (_RANGE, _WHOLE) for index in indices) and len(indices) == 2:
            own = "nd_block"
        if own is not None:
            bounds = [bound for index in indices for bound in index.bounds if index.kind != _WHOLE or own == "nd_block"]
            return f"{own}({', '.join(['arena', array, *bounds])})"
        listed = ", ".join(f"{{{_GENERAL[one.kind]}, {', '.join((*one.bounds, '0', '0')[:2])}}}" for one in indices)
        return f"nd_get(arena, {array}, {len(indices)}, (nd_ix[]){{{listed}}})"

    def _index(self, part: ast.expr) -> _Index:
        if isinstance(part, ast.Slice):
            if part.step is not None:
                raise self.no(part, "a slice without a step")
            start = self.number(part.lower, INT) if part.lower else "0"
            stop = self.number(part.upper, INT) if part.upper else "ND_END"
            return _Index(_WHOLE if self.whole_axis(part) else _RANGE, (start, stop))
        if isinstance(part, ast.Constant) and part.value is None:
            return _Index(_NEW, ())
        value = self.expression(part)
        if value.kind == SLICE:
            value = self.held_structure(value)
            return _Index(_RANGE, (f"{value.text}.start", f"{value.text}.stop"))
        return _Index(_AT, (self.as_number(value, INT, part),))

    def whole_axis(self, part: ast.expr) -> bool:
        """Return whether an index takes all of an axis."""
        return isinstance(part, ast.Slice) and part.lower is None and part.upper is None and part.step is None

    def many(self, part: ast.expr) -> str | None:
        """Return an index that lists entries, or marks them, as an array of indices."""
        if isinstance(part, (ast.Slice, ast.Constant)):
            return None
        kind = self.kind_if_known(part)
        if kind is None or not is_nd(kind) or isinstance(kind, Maybe):
            return None
        if kind == Array(BOOL):
            return f"nd_indices(arena, {self.array(part)})"
        if kind in (Array(INT), Listing(INT)):
            return self.array(part)
        if isinstance(kind, Listing) and kind.element == BOOL:
            return f"nd_indices(arena, {self.array(part)})"
        return None

    def _part(self, node: ast.Subscript, value: Value, kind: Array) -> Value:
        if is_reversal(node.slice):
            return Value(f"nd_reversed(arena, {value.text})", kind)
        crossed = self.crossed(node.slice)
        if crossed is not None:
            return Value(f"nd_take2(arena, {value.text}, {crossed[0]}, {crossed[1]})", kind, fresh=True)
        parts = self.index_list(node.slice)
        for axis, part in enumerate(parts):
            listed = self.many(part)
            if listed is not None:
                if not all(self.whole_axis(other) for other in parts if other is not part):
                    raise self.no(node, "a list of indices along one axis, and whole other axes")
                return Value(f"nd_take(arena, {value.text}, {listed}, {axis})", kind, fresh=True)
        return Value(self.part_of(value.text, node.slice), kind)

    def crossed(self, node: ast.expr) -> tuple[str, str] | None:
        """Return the rows and columns of a subscript np.ix_(rows, columns)."""
        if not (isinstance(node, ast.Call) and ast.unparse(node.func) == "np.ix_"):
            return None
        rows, columns = (self.many(one) for one in node.args)
        if rows is None or columns is None:
            raise self.no(node, "arrays of indices or marks in np.ix_")
        return rows, columns

    def found(self, table: Value, name: Value) -> str:
        """Return the place of a name in a mapping or among names, −1 where it is not there."""
        names = "names" if isinstance(table.kind, Table) else "p"
        return f"nd_find({table.text}.n, {table.text}.{names}, {name.text})"
