"""Calls of Python's own functions and of the methods of arrays and lists, and texts of messages."""

from __future__ import annotations

import ast

from ndob_fmu.native.translate.kinds import (
    ARRAY,
    BOOL,
    FLOAT,
    INT,
    NUMBERS,
    SLICE,
    TEXT,
    Array,
    ComplexArray,
    Kind,
    Listing,
    Maybe,
    Pack,
    c_type,
    element_of,
    is_nd,
    is_number,
    is_numbers,
)
from ndob_fmu.native.translate.library import REDUCTIONS
from ndob_fmu.native.translate.numpy_calls import Named, NumpyCalls
from ndob_fmu.native.translate.values import Value


def _escaped(text: str) -> str:
    return text.replace("\\", "\\\\").replace('"', '\\"').replace("%", "%%")


class PythonCalls(NumpyCalls):
    """The part of a function's writer that writes calls of what Python has."""

    def _of_map(self, node: ast.Call, _named: Named, want: Kind | None) -> Value:
        return self.comprehension(node, want)

    def _of_float(self, node: ast.Call, _named: Named, _want: Kind | None) -> Value:
        inner = node.args[0]
        if isinstance(inner, ast.Call) and ast.unparse(inner.func) == "round" and len(inner.args) == 1:
            return Value(f"nearbyint({self.number(inner.args[0])})", FLOAT)  # may be no `int`
        return Value(self.number(node.args[0]), FLOAT)

    def _of_int(self, node: ast.Call, _named: Named, _want: Kind | None) -> Value:
        value = self.expression(node.args[0])
        if value.kind == FLOAT:
            return self.called(f"nd_truncated(arena, {value.text})", INT, fails=True)
        return Value(self.as_number(value, INT, node), INT)

    def _of_bool(self, node: ast.Call, _named: Named, _want: Kind | None) -> Value:
        return Value(self.truth(node.args[0]), BOOL)

    def _of_len(self, node: ast.Call, _named: Named, _want: Kind | None) -> Value:
        return Value(self.length(self.expression(node.args[0]), node), INT)

    def _of_slice(self, node: ast.Call, _named: Named, _want: Kind | None) -> Value:
        ends = [self.number(one, INT) for one in node.args]
        start, stop = ends if len(ends) == 2 else ["0", ends[0]]
        return Value(f"(nd_slice){{{start}, {stop}}}", SLICE)

    def _of_round(self, node: ast.Call, _named: Named, _want: Kind | None) -> Value:
        if len(node.args) == 2:
            return Value(f"nd_rounded({self.number(node.args[0])}, {self.number(node.args[1], INT)})", FLOAT)
        return Value(f"(int)nearbyint({self.number(node.args[0])})", INT)

    def _of_math_frexp(self, node: ast.Call, _named: Named, _want: Kind | None) -> Value:
        pack = self.temporary(Pack((FLOAT, INT)))
        self.line(f"{pack}.v0 = 0.0;")
        self.line(f"{pack}.v1 = (int)nd_exponent_of({self.number(node.args[0])});")
        return Value(pack, Pack((FLOAT, INT)))

    def _extreme(self, node: ast.Call, named: Named, short: str) -> Value:
        if len(node.args) == 1:
            if isinstance(node.args[0], ast.GeneratorExp) or "default" in named or self._is_map(node.args[0]):
                return self.loop_value(node, short)
            value = self.certain(self.expression(node.args[0]))
            if is_nd(value.kind):
                element = value.kind.element if isinstance(value.kind, (Listing, Array)) else FLOAT
                text = f"nd_reduced(ND_{REDUCTIONS[short][0]}, {value.text})"
                return Value(f"(int){text}" if element == INT else text, element)
            raise self.no(node, "numbers", str(value.kind))
        values = [self.certain(self.expression(one)) for one in node.args]
        integers = all(value.kind == INT for value in values)
        kind = INT if integers else FLOAT
        text = self.as_number(values[0], kind, node)
        for value in values[1:]:
            text = f"nd_{'i' if integers else ''}{short}2({text}, {self.as_number(value, kind, node)})"
        return Value(text, kind)

    def _is_map(self, node: ast.expr) -> bool:
        return isinstance(node, ast.Call) and ast.unparse(node.func) == "map"

    def _of_max(self, node: ast.Call, named: Named, _want: Kind | None) -> Value:
        return self._extreme(node, named, "max")

    def _of_min(self, node: ast.Call, named: Named, _want: Kind | None) -> Value:
        return self._extreme(node, named, "min")

    def _all_or_any(self, node: ast.Call, short: str) -> Value:
        if isinstance(node.args[0], ast.GeneratorExp) or self._is_map(node.args[0]):
            return self.loop_value(node, short)
        return self._reduced(node, short, self.expression(node.args[0]), {}, [])

    def _of_all(self, node: ast.Call, _named: Named, _want: Kind | None) -> Value:
        return self._all_or_any(node, "all")

    def _of_any(self, node: ast.Call, _named: Named, _want: Kind | None) -> Value:
        return self._all_or_any(node, "any")

    def _of_sum(self, node: ast.Call, _named: Named, _want: Kind | None) -> Value:
        if len(node.args) == 1 and not isinstance(node.args[0], ast.GeneratorExp) and not self._is_map(node.args[0]):
            value = self.certain(self.expression(node.args[0]))
            if is_nd(value.kind):
                return Value(f"nd_reduced(ND_SUM, {value.text})", FLOAT)
            if isinstance(value.kind, Pack) and all(map(is_number, value.kind.elements)):
                text = " + ".join(f"{value.text}.v{i}" for i in range(len(value.kind.elements)))
                return Value(f"({text})", FLOAT)
        return self.loop_value(node, "sum")

    def _of_tuple(self, node: ast.Call, _named: Named, want: Kind | None) -> Value:
        if not node.args:
            return self.listed([], want if isinstance(want, Listing) else NUMBERS, node)
        if isinstance(node.args[0], ast.GeneratorExp) or self._is_map(node.args[0]):
            return self.comprehension(node.args[0], want)
        value = self.certain(self.expression(node.args[0]))
        kind = Listing(FLOAT) if isinstance(value.kind, Array) else value.kind
        if not isinstance(kind, Listing):
            raise self.no(node, "a tuple of a list", f"{ast.unparse(node)} of type {value.kind}")
        return Value(value.text, kind, value.fresh)

    def _of_list(self, node: ast.Call, _named: Named, want: Kind | None) -> Value:
        if isinstance(node.args[0], ast.GeneratorExp) or self._is_map(node.args[0]):
            return self.comprehension(node.args[0], want)
        value = self.certain(self.expression(node.args[0]))
        if isinstance(value.kind, Array):
            if isinstance(want, Listing) and want.element in (ARRAY, Maybe(ARRAY)):
                return self._rows_of(value)
            raise self.no(node, "a list whose type is known: .tolist() for numbers, or an annotation")
        if is_nd(value.kind):
            return Value(f"nd_copy(arena, {value.text})", value.kind, fresh=True)
        assert isinstance(value.kind, Listing)
        value, name = self.held_structure(value), self.temporary(value.kind)
        own = c_type(element_of(value.kind))
        self.line(f"{name}.n = {value.text}.n;")
        self.line(f"{name}.p = nd_take_bytes(arena, sizeof({own}) * (size_t)nd_imax2({name}.n, 1));")
        self.line(f"if ({name}.n) memcpy({name}.p, {value.text}.p, sizeof({own}) * (size_t){name}.n);")
        return Value(name, value.kind, fresh=True)

    def _rows_of(self, value: Value) -> Value:
        value, name, i = self.held(value), self.temporary(Listing(ARRAY)), self.temporary(INT)
        self.line(f"{name}.n = nd_len({value.text});")
        self.line(f"{name}.p = nd_take_bytes(arena, sizeof(nd) * (size_t)nd_imax2({name}.n, 1));")
        self.line(f"for ({i} = 0; {i} < {name}.n; {i}++) {name}.p[{i}] = nd_row(arena, {value.text}, {i});")
        return Value(name, Listing(ARRAY))

    def _array_method(self, node: ast.Call, value: Value, name: str, named: Named) -> Value | None:
        if name == "copy":
            return Value(f"nd_copy(arena, {value.text})", value.kind, fresh=True)
        if name == "astype" and ast.unparse(node.args[0]) in ("float", "complex"):
            return Value(value.text, ARRAY, value.fresh)
        if name == "tolist":
            return Value(
                value.text, Listing(value.kind.element) if isinstance(value.kind, Array) else value.kind, value.fresh
            )
        if name == "ravel":
            return Value(f"nd_reshape(arena, {value.text}, 1, (int[]){{-1}})", value.kind)
        if name == "reshape":
            given = node.args[0].elts if isinstance(node.args[0], ast.Tuple) else node.args
            texts = [self.number(one, INT) for one in given]
            lengths = f"{len(texts)}, (int[]){{{', '.join(texts)}}}"
            return Value(f"nd_reshape(arena, {value.text}, {lengths})", value.kind, value.fresh)
        if name == "transpose":
            texts = [self.number(one, INT) for one in node.args]
            return Value(f"nd_permuted(arena, {value.text}, (int[]){{{', '.join(texts)}}})", value.kind)
        if name in REDUCTIONS:
            return self._reduced(node, name, value, named, list(node.args))
        if name in ("argmin", "argmax"):
            return Value(f"nd_{name}({value.text})", INT)
        if name == "searchsorted":
            if ast.unparse(named.get("side", ast.Constant("left"))) != "'right'":
                raise self.no(node, "searchsorted from the right")
            return Value(f"nd_searchsorted_right({value.text}, {self.number(node.args[0])})", INT)
        if name == "index" and is_numbers(value.kind):
            place, sought = self.temporary(INT), self.number(node.args[0])
            there = f"{place} < nd_len({value.text}) && nd_at({value.text}, {place}) != {sought}"
            self.line(f"for ({place} = 0; {there}; {place}++) {{}}")
            return Value(place, INT)
        return None

    def _of_complex(self, node: ast.expr) -> Value | None:
        """Return an entry of complex numbers, if the expression is one."""
        if isinstance(node, ast.Subscript) and isinstance(self.kind_if_known(node.value), ComplexArray):
            return self.expression(node)
        return None

    def message(self, node: ast.expr) -> tuple[str, list[str]]:
        """Return a text with numbers in it as a format of printf and its arguments."""
        if isinstance(node, ast.Constant):
            return _escaped(str(node.value)), []
        if isinstance(node, ast.JoinedStr):
            text, arguments = "", list[str]()
            for part in node.values:
                own, more = self.message(part)
                text, arguments = text + own, arguments + more
            return text, arguments
        if isinstance(node, ast.FormattedValue):
            form = "" if node.format_spec is None else ast.unparse(node.format_spec)[2:-1]
            value = self.certain(self._of_complex(node.value) or self.expression(node.value))
            if isinstance(value.kind, ComplexArray):
                return f"%{form}%+{form}j", [f"nd_item({part.text})" for part in self.parts_of(value)]
            if value.kind == TEXT:
                return "%s", [value.text]
            if value.kind == INT:
                return "%d", [value.text]
            if value.kind == FLOAT or isinstance(value.kind, Array):
                return f"%{form or '.17g'}", [self.as_number(value, FLOAT, node)]
        if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add):
            (left, first), (right, second) = self.message(node.left), self.message(node.right)
            return left + right, first + second
        if isinstance(node, ast.Call) and ast.unparse(node.func) == "str":
            return self.message(ast.FormattedValue(node.args[0], -1, None))
        value = self.expression(node)
        if value.kind == TEXT:
            return "%s", [value.text]
        raise self.no(node, "a text, with numbers in braces")
