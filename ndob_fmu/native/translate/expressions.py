"""Expressions of Python in C.

An expression becomes a text and a type. What has no form inside an expression of C, as a call that can fail or a branch
that must not be evaluated, becomes statements before it, and a variable.
"""

from __future__ import annotations

import ast
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ndob_fmu.native.translate.kinds import (
    ARRAY,
    BOOL,
    FLOAT,
    INT,
    NOTHING,
    NUMBERS,
    SLICE,
    TEXT,
    Array,
    ComplexArray,
    Function,
    Kind,
    Listing,
    Maybe,
    Pack,
    Simple,
    Structure,
    Table,
    Unknown,
    by_pointer,
    c_type,
    elements_of,
    is_nd,
    is_number,
    is_numbers,
    word,
)
from ndob_fmu.native.translate.program import Class, Module, Program
from ndob_fmu.native.translate.refusal import RefusedError, refused

_RESERVED = {"auto", "break", "case", "char", "const", "default", "do", "double", "enum", "extern", "float", "goto"}
_RESERVED |= {"inline", "int", "long", "register", "short", "signed", "sizeof", "static", "struct", "switch", "union"}
_RESERVED |= {"typedef", "unsigned", "void", "volatile", "arena", "nd", "env", "bool", "true", "false", "exp", "log"}
_ARRAY_OPERATIONS = {ast.Add: "ADD", ast.Sub: "SUB", ast.Mult: "MUL", ast.Div: "DIV", ast.Pow: "POW"}
_ARRAY_OPERATIONS |= {ast.BitAnd: "AND", ast.BitOr: "OR"}
_COMPARISONS = {ast.Lt: ("<", "LT"), ast.LtE: ("<=", "LE"), ast.Gt: (">", "GT"), ast.GtE: (">=", "GE")}
_COMPARISONS |= {ast.Eq: ("==", "EQ"), ast.NotEq: ("!=", "NE")}


@dataclass(frozen=True)
class Value:
    """An expression in C.

    fresh: whether its array belongs to this function alone
    parts: of an item of several iterations at once, which only a tuple of names takes apart
    """

    text: str
    kind: Kind
    fresh: bool = False
    parts: tuple[Value, ...] = ()


def c_name(name: str) -> str:
    """Return the name of a variable in C."""
    return f"{name}_" if name in _RESERVED or name.startswith("_") else name


def number_text(value: float) -> str:
    """Return a constant with all its digits."""
    if np.isnan(value):
        return "NAN"
    if np.isinf(value):
        return "INFINITY" if value > 0 else "(-INFINITY)"
    return repr(float(value)) if value >= 0 and not np.signbit(value) else f"({float(value)!r})"


def entry(text: str, kind: Kind) -> Value:
    """Return an entry of an array, which is stored as float, as a number of its type."""
    return Value(f"(int){text}" if kind == INT else f"({text} != 0.0)" if kind == BOOL else text, kind)


def is_reversal(node: ast.expr) -> bool:
    """Return whether an index is [::-1]."""
    return isinstance(node, ast.Slice) and ast.unparse(node) == "::-1"


class Expressions:
    """The part of a function's writer that writes expressions."""

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

    def no(self, node: ast.AST, expected: str, received: str | None = None) -> RefusedError:
        """Return the refusal of a node."""
        return refused(self.module.file, node, expected, received if received is not None else ast.unparse(node))

    # -- conversions

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
            text = f"nd_item({value.text})"
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
                return Value("nd_none", kind)
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
            self.line(f"{name} = nd_new(arena, 1, (int[]){{{len(items)}}});")
            for i, text in enumerate(texts):
                self.line(f"{name}.p[{i}] = {text};")
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
            return f"(nd_item({value.text}) != 0.0)"
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

    # -- expressions

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

    def literal(self, value: Any, node: ast.AST) -> Value:
        """Return a constant of Python, or of NumPy."""
        if value is None:
            return Value("nd_none", NOTHING)
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
            known = self.program.class_of(found[0], type(value).__name__)
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
                return Value(f"nd_transposed({value.text})", value.kind)
            if node.attr == "size":
                return Value(f"nd_size({value.text})", INT)
            if node.attr == "shape":
                held = self.held(value)
                return Value(f"{held.text}.n", Unknown(f"shape {held.text}"))
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

    # -- indices

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
                return Value(f"{array}.n[{array}.rank - {ast.unparse(node.slice.operand)}]", INT)
            return Value(f"{array}.n[{self.number(node.slice, INT)}]", INT)
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
                return Value(f"nd_get({value.text}, {self.indices(node.slice)})", kind)
            return self._listed_part(node, value, kind)
        if is_numbers(kind):
            return entry(f"nd_at({value.text}, {self.number(node.slice, INT)})", kind.element)
        value = self.held_structure(value)
        if isinstance(node.slice, ast.UnaryOp):
            return Value(f"{value.text}.p[{value.text}.n - {ast.unparse(node.slice.operand)}]", kind.element)
        return Value(f"{value.text}.p[{self.number(node.slice, INT)}]", kind.element)

    def _backwards(self, value: Value, kind: Listing) -> Value:
        if is_numbers(kind):
            return Value(f"nd_reversed({value.text})", kind)
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

    def indices(self, node: ast.expr) -> str:
        """Return a subscript of slices and integers for `nd_get`."""
        texts = []
        for part in self.index_list(node):
            if isinstance(part, ast.Slice):
                if part.step is not None:
                    raise self.no(part, "a slice without a step")
                start = self.number(part.lower, INT) if part.lower else "0"
                stop = self.number(part.upper, INT) if part.upper else "ND_END"
                texts.append(f"{{ND_RANGE, {start}, {stop}}}")
            elif isinstance(part, ast.Constant) and part.value is None:
                texts.append("{ND_NEW, 0, 0}")
            else:
                value = self.expression(part)
                if value.kind == SLICE:
                    value = self.held_structure(value)
                    texts.append(f"{{ND_RANGE, {value.text}.start, {value.text}.stop}}")
                else:
                    texts.append(f"{{ND_AT, {self.as_number(value, INT, part)}, 0}}")
        return f"{len(texts)}, (nd_ix[]){{{', '.join(texts)}}}"

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
            return Value(f"nd_reversed({value.text})", kind)
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
        return Value(f"nd_get({value.text}, {self.indices(node.slice)})", kind)

    def crossed(self, node: ast.expr) -> tuple[str, str] | None:
        """Return the rows and columns of a subscript np.ix_(rows, columns)."""
        if not (isinstance(node, ast.Call) and ast.unparse(node.func) == "np.ix_"):
            return None
        rows, columns = (self.many(one) for one in node.args)
        if rows is None or columns is None:
            raise self.no(node, "arrays of indices or marks in np.ix_")
        return rows, columns

    # -- operators

    def _unary(self, node: ast.UnaryOp) -> Value:
        if isinstance(node.op, ast.Not):
            return Value(f"!{self.truth(node.operand)}", BOOL)
        value = self.certain(self.expression(node.operand))
        if isinstance(value.kind, Array):
            function = "nd_not" if isinstance(node.op, ast.Invert) else "nd_negative"
            return Value(f"nd_map(arena, {function}, {value.text})", value.kind, fresh=True)
        if isinstance(node.op, ast.USub) and is_number(value.kind):
            return Value(f"(-{value.text})", INT if value.kind == BOOL else value.kind)
        raise self.no(node, "- of numbers, ~ of arrays of bool, or not")

    def _binary(self, node: ast.BinOp, want: Kind | None) -> Value:
        repeated = isinstance(node.op, ast.Mult) and isinstance(node.left, (ast.List, ast.Tuple))
        left = self.certain(self.expression(node.left, want if repeated else None))
        right = self.certain(self.expression(node.right))
        return self.operation(node.op, left, right, node)

    def operation(self, operator: ast.operator, left: Value, right: Value, node: ast.AST) -> Value:
        """Return what an operator of arithmetic makes of two values."""
        for one, other in ((left, right), (right, left)):
            if isinstance(one.kind, ComplexArray) and is_number(other.kind) and isinstance(operator, ast.Mult):
                return self._complex([self.operation(operator, part, other, node) for part in self.parts_of(one)])
        if isinstance(operator, ast.MatMult):
            return Value(
                f"nd_matmul(arena, {self.as_array(left, node)}, {self.as_array(right, node)})", ARRAY, fresh=True
            )
        if isinstance(left.kind, Array) or isinstance(right.kind, Array):
            name = _ARRAY_OPERATIONS.get(type(operator))
            if name is None:
                raise self.no(node, "+ - * / ** & | of arrays")
            return self.of_arrays(name, left, right, node)
        if is_number(left.kind) and is_number(right.kind):
            return self._arithmetic(operator, left, right, node)
        if isinstance(operator, ast.Mult) and isinstance(left.kind, Listing) and right.kind == INT:
            return self._repeated(left, right, left.kind)
        if isinstance(operator, ast.Add) and is_nd(left.kind) and is_nd(right.kind):
            return Value(f"nd_concatenate(arena, 0, 2, (nd[]){{{left.text}, {right.text}}})", left.kind, fresh=True)
        raise self.no(node, "an operation on numbers or arrays", f"{ast.unparse(node)} of {left.kind} and {right.kind}")

    def parts_of(self, value: Value) -> list[Value]:
        """Return the real and the imaginary part of complex numbers."""
        value = self.held(value)
        return [Value(f"{value.text}.v0", ARRAY), Value(f"{value.text}.v1", ARRAY)]

    def _complex(self, parts: list[Value]) -> Value:
        name = self.temporary(ComplexArray())
        for i, part in enumerate(parts):
            self.line(f"{name}.v{i} = {part.text};")
        return Value(name, ComplexArray())

    def of_arrays(self, name: str, left: Value, right: Value, node: ast.AST) -> Value:
        """Return an operation entry by entry; `name` as in nd.h."""
        result = Array(BOOL) if name in ("LT", "LE", "GT", "GE", "EQ", "NE", "AND", "OR") else ARRAY
        if is_number(right.kind):
            number = self.as_number(right, FLOAT, node)
            if name == "POW" and right.text == "2":
                return Value(f"nd_map(arena, nd_square, {left.text})", result, fresh=True)
            return Value(f"nd_binary_xn(arena, ND_{name}, {self.as_array(left, node)}, {number})", result, fresh=True)
        if is_number(left.kind):
            number = self.as_number(left, FLOAT, node)
            return Value(f"nd_binary_nx(arena, ND_{name}, {number}, {self.as_array(right, node)})", result, fresh=True)
        both = f"{self.as_array(left, node)}, {self.as_array(right, node)}"
        return Value(f"nd_binary(arena, ND_{name}, {both})", result, fresh=True)

    def _arithmetic(self, operator: ast.operator, left: Value, right: Value, node: ast.AST) -> Value:
        integers = left.kind != FLOAT and right.kind != FLOAT
        if isinstance(operator, (ast.LShift, ast.BitAnd, ast.FloorDiv, ast.Mod)):
            if not integers:
                raise self.no(node, "<<, &, // and % of integers")
            if isinstance(operator, (ast.LShift, ast.BitAnd)):
                sign = "<<" if isinstance(operator, ast.LShift) else "&"
                return Value(f"({left.text} {sign} {right.text})", INT)
            function = "nd_floordiv" if isinstance(operator, ast.FloorDiv) else "nd_mod"
            return Value(f"{function}({left.text}, {right.text})", INT)
        if isinstance(operator, ast.Pow):
            x, y = self.as_number(left, FLOAT, node), self.as_number(right, FLOAT, node)
            return Value(f"pow({x}, {y})", FLOAT)
        sign = {ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/"}.get(type(operator), "")
        if not sign:
            raise self.no(node, "+ - * / ** // % << & of numbers")
        if integers and sign != "/":
            return Value(f"({self.as_number(left, INT, node)} {sign} {self.as_number(right, INT, node)})", INT)
        return Value(f"({self.as_number(left, FLOAT, node)} {sign} {self.as_number(right, FLOAT, node)})", FLOAT)

    def _repeated(self, left: Value, right: Value, kind: Listing) -> Value:
        if is_numbers(kind):
            return Value(f"nd_tile(arena, {left.text}, {right.text})", kind, fresh=True)
        left, name, i = self.held_structure(left), self.temporary(kind), self.temporary(INT)
        self.line(f"{name}.n = {left.text}.n * ({right.text});")
        self.line(f"{name}.p = nd_take_bytes(arena, sizeof({c_type(kind.element)}) * (size_t)nd_imax2({name}.n, 1));")
        self.line(f"for ({i} = 0; {i} < {name}.n; {i}++) {name}.p[{i}] = {left.text}.p[{i} % {left.text}.n];")
        return Value(name, kind, fresh=True)

    def _boolean(self, node: ast.BoolOp) -> Value:
        """Write `and` and `or` of conditions; `a or b` of other values is the first one that counts as true."""
        first = self.kind_if_known(node.values[0])
        if first not in (BOOL, Array(BOOL)):
            if isinstance(node.op, ast.Or):
                return self._or_else(node, self.expression(node.values[0]))
            raise self.no(node, "and of conditions", f"{ast.unparse(node)} of type {first}")
        return Value(self.conditions(node), BOOL)

    def conditions(self, node: ast.BoolOp) -> str:
        """Write conditions; those on the right are evaluated only where Python evaluates them."""
        sign = "&&" if isinstance(node.op, ast.And) else "||"
        text = self.truth(node.values[0])
        for operand in node.values[1:]:
            texts: list[str] = []

            def write(operand: ast.expr = operand, texts: list[str] = texts) -> None:
                texts.append(self.truth(operand))

            if not self.set_aside(write):
                text = f"({text} {sign} {texts[0]})"
                continue
            name = self.temporary(BOOL)
            self.line(f"{name} = {text};")
            self.line(f"if ({'' if sign == '&&' else '!'}{name}) {{")
            write()
            self.line(f"{name} = {texts[-1]};")
            self.line("}")
            text = name
        return text

    def _or_else(self, node: ast.BoolOp, first: Value) -> Value:
        """Write `a or b` where a is a number or a list, and the value counts."""
        if len(node.values) != 2:
            raise self.no(node, "one alternative")
        first = self.held(first)
        condition = self.as_truth(first, node)
        name = self.temporary(first.kind)
        self.line(f"if ({condition}) {name} = {first.text};")
        self.line("else {")
        self.line(f"{name} = {self.coerced(self.expression(node.values[1], first.kind), first.kind, node).text};")
        self.line("}")
        return Value(name, first.kind)

    def _compare(self, node: ast.Compare) -> Value:
        operands = [node.left, *node.comparators]
        if len(node.ops) == 1:
            return self._one_comparison(node, node.ops[0], self.expression(node.left), node.comparators[0])
        texts, left = [], self.expression(operands[0])
        for operator, operand in zip(node.ops, operands[1:], strict=True):
            right = self.held(self.certain(self.expression(operand)))
            texts.append(self.as_truth(self.compared(operator, left, right, node), node))
            left = right
        return Value(f"({' && '.join(texts)})", BOOL)

    def _one_comparison(self, node: ast.Compare, operator: ast.cmpop, left: Value, other: ast.expr) -> Value:
        if isinstance(operator, (ast.Is, ast.IsNot)):
            same = isinstance(operator, ast.Is)
            if isinstance(other, ast.Constant) and other.value is None:
                if not isinstance(left.kind, Maybe):
                    raise self.no(node, "a value that may be None", f"{ast.unparse(node)} of type {left.kind}")
                if is_nd(left.kind):
                    return Value(f"({left.text}.rank {'<' if same else '>='} 0)", BOOL)
                return Value(f"{'!' if same else ''}{left.text}.some", BOOL)
            right = self.expression(other)
            if is_nd(left.kind) and is_nd(right.kind):
                return Value(f"({left.text}.p {'==' if same else '!='} {right.text}.p)", BOOL)
        if isinstance(operator, (ast.In, ast.NotIn)):
            table = self.expression(other) if isinstance(other, (ast.Name, ast.Attribute)) else left
            if isinstance(table.kind, Table):
                place = self.found(self.held_structure(table), left)
                return Value(f"({place} {'>=' if isinstance(operator, ast.In) else '<'} 0)", BOOL)
            if not isinstance(other, (ast.Tuple, ast.List)) or not is_number(left.kind):
                raise self.no(node, "`in` a mapping, or of a number in a tuple that is written out")
            held = self.held(left)
            equal = [self.compared(ast.Eq(), held, self.expression(one), node).text for one in other.elts]
            return Value(f"{'!' if isinstance(operator, ast.NotIn) else ''}({' || '.join(equal)})", BOOL)
        return self.compared(operator, left, self.expression(other), node)

    def found(self, table: Value, name: Value) -> str:
        """Return the place of a name in a mapping, −1 where it is not there."""
        return f"nd_find({table.text}.n, {table.text}.names, {name.text})"

    def compared(self, operator: ast.cmpop, left: Value, right: Value, node: ast.AST) -> Value:
        """Return the comparison of two values."""
        sign, name = _COMPARISONS.get(type(operator), ("", ""))
        left, right = self.certain(left), self.certain(right)
        if not sign:
            raise self.no(node, "a comparison of numbers or arrays")
        if isinstance(left.kind, Array) or isinstance(right.kind, Array):
            return self.of_arrays(name, left, right, node)
        if is_numbers(left.kind) and is_numbers(right.kind) and name in ("EQ", "NE"):
            return Value(f"{'!' if name == 'NE' else ''}nd_equal({left.text}, {right.text})", BOOL)
        if is_number(left.kind) and is_number(right.kind):
            kind = FLOAT if FLOAT in (left.kind, right.kind) else INT
            return Value(f"({self.as_number(left, kind, node)} {sign} {self.as_number(right, kind, node)})", BOOL)
        raise self.no(node, "a comparison of numbers or arrays", f"{left.kind} and {right.kind}")

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
        self.line(f"if ({condition}) {{")
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


__all__ = ["Class", "Expressions", "Function", "Value", "c_name", "number_text", "word"]
