"""Calls of NumPy's functions."""

from __future__ import annotations

import ast

from ndob_fmu.native.translate.expressions import Expressions
from ndob_fmu.native.translate.kinds import (
    ARRAY,
    BOOL,
    FLOAT,
    INT,
    NOTHING,
    NUMBERS,
    Array,
    ComplexArray,
    Kind,
    Listing,
    Pack,
    Unknown,
    is_nd,
    is_number,
)
from ndob_fmu.native.translate.library import OF_NUMBERS, REDUCTIONS, Known
from ndob_fmu.native.translate.values import Value

Named = dict[str, ast.expr]


_IDENTITY = ("numbers", "np.asarray", "np.ascontiguousarray")


_TWO = "2, (nd[]){"


def _in_braces(text: str) -> str:
    return text[text.index("{") + 1 : text.rindex("}")]


def _is_empty(node: ast.expr) -> bool:
    return isinstance(node, (ast.List, ast.Tuple)) and not node.elts


class NumpyCalls(Expressions):
    """The part of a function's writer that writes calls of NumPy."""

    def _call_known(self, node: ast.Call, known: Known) -> Value:
        texts = [self.argument(given, kind) for given, kind in zip(node.args, known.arguments, strict=True)]
        text = f"{known.c}({', '.join([*(['arena'] if known.memory else []), *texts])})"
        self.use(known.result)
        if known.fails or isinstance(known.result, Pack):
            value = self.called(text, known.result, fails=known.fails)
            return Value(value.text, value.kind, fresh=True)
        return Value(text, known.result, fresh=known.memory and known.c != "nd_diag")

    def _same(self, node: ast.Call, want: Kind | None) -> Value:
        value = self.certain(self.expression(node.args[0], want))
        if isinstance(value.kind, ComplexArray):
            return value
        if ast.unparse(node.func) == "numbers":
            return Value(value.text, NUMBERS, value.fresh)
        return Value(self.as_array(value, node), value.kind if isinstance(value.kind, Array) else ARRAY, value.fresh)

    def _of_each(self, node: ast.Call, short: str, name: str) -> Value:
        of_one, of_entry, kind = OF_NUMBERS[short]
        value = self.certain(self.expression(node.args[0]))
        if isinstance(value.kind, ComplexArray) and short == "abs":
            real, imaginary = self.parts_of(value)
            return self._of_two("HYPOT", real, imaginary, node)
        if is_nd(value.kind) and name != f"math.{short}":
            result = Array(BOOL) if kind == BOOL else ARRAY
            return Value(f"nd_map(arena, {of_entry}, {value.text})", result, fresh=True)
        text = f"{of_one}({self.as_number(value, FLOAT, node)})"
        if short == "abs" and value.kind == INT:
            return Value(f"abs({value.text})", INT)
        if name == "math.ceil":
            return Value(f"(int){text}", INT)
        return Value(f"({text} != 0.0)" if kind == BOOL else text, kind)

    def _of_abs(self, node: ast.Call, _named: Named, _want: Kind | None) -> Value:
        return self._of_each(node, "abs", "abs")

    def _of_two(self, name: str, left: Value, right: Value, node: ast.AST) -> Value:
        if is_number(left.kind) and is_number(right.kind):
            x, y = self.as_number(left, FLOAT, node), self.as_number(right, FLOAT, node)
            return Value(
                f"{ {'MAX': 'nd_max2', 'MIN': 'nd_min2', 'HYPOT': 'hypot', 'COPYSIGN': 'copysign'}[name] }({x}, {y})",
                FLOAT,
            )
        return self.of_arrays(name, left, right, node)

    def _reduced(self, node: ast.AST, short: str, value: Value, named: Named, more: list[ast.expr]) -> Value:
        operation, kind = REDUCTIONS[short]
        text = self.as_array(value, node)
        axis = named.get("axis", more[0] if more else None)
        if axis is not None:
            result = Array(kind) if kind == BOOL else ARRAY
            return Value(f"nd_reduce(arena, ND_{operation}, {text}, {self.number(axis, INT)})", result, fresh=True)
        text = f"nd_reduced(ND_{operation}, {text})"
        if "initial" in named:
            function = {"max": "nd_max2", "min": "nd_min2"}[short]
            text = f"{function}({self.number(named['initial'])}, {text})"
        return Value(f"({text} != 0.0)" if kind == BOOL else text, kind)

    def _of_np_linalg_norm(self, node: ast.Call, named: Named, _want: Kind | None) -> Value:
        text = self.array(node.args[0])
        if "axis" in named:
            return Value(f"nd_reduce(arena, ND_NORM, {text}, {self.number(named['axis'], INT)})", ARRAY, fresh=True)
        if len(node.args) == 1:
            return Value(f"nd_reduced(ND_NORM, {text})", FLOAT)
        if ast.unparse(node.args[1]) == "1":
            return Value(f"nd_norm1({text})", FLOAT)
        if ast.unparse(node.args[1]) == "2":
            return self.called(f"nd_norm2(arena, {text})", FLOAT, fails=True)
        raise self.no(node, "the norm 1, 2 or that of Frobenius")

    def _of_np_linalg_svd(self, node: ast.Call, named: Named, _want: Kind | None) -> Value:
        thin = "full_matrices" in named and ast.unparse(named["full_matrices"]) == "False"
        text = f"nd_svd(arena, {self.array(node.args[0])}, {'false' if thin else 'true'})"
        return self.called(text, Pack((ARRAY, ARRAY, ARRAY)), fails=True)

    def _of_np_linalg_lstsq(self, node: ast.Call, named: Named, _want: Kind | None) -> Value:
        if "rcond" not in named or ast.unparse(named["rcond"]) != "None":
            raise self.no(node, "lstsq with rcond=None")
        pack = self.temporary(Pack((ARRAY, ARRAY)))
        self.line(f"{pack}.v0 = nd_lstsq(arena, {self.array(node.args[0])}, {self.array(node.args[1])});")
        self.line(f"{pack}.v1 = NULL;")
        self.check()
        return Value(pack, Pack((ARRAY, ARRAY)), fresh=True)

    def _of_np_linalg_qr(self, node: ast.Call, named: Named, _want: Kind | None) -> Value:
        if named:
            raise self.no(node, "qr without a mode")
        pack = self.temporary(Pack((ARRAY, ARRAY)))
        self.line(f"{pack}.v0 = nd_qr_q(arena, {self.array(node.args[0])});")
        self.line(f"{pack}.v1 = NULL;")
        return Value(pack, Pack((ARRAY, ARRAY)), fresh=True)

    def _of_np_linalg_eigvals(self, node: ast.Call, _named: Named, _want: Kind | None) -> Value:
        return self.called(f"nd_eigvals(arena, {self.array(node.args[0])})", ComplexArray(), fails=True)

    def _of_np_lexsort(self, node: ast.Call, _named: Named, _want: Kind | None) -> Value:
        then, first = node.args[0].elts if isinstance(node.args[0], ast.Tuple) else node.args
        text = f"nd_lexsort(arena, {self.array(then)}, {self.array(first)})"
        return Value(text, Array(INT), fresh=True)

    def _of_np_frexp(self, node: ast.Call, _named: Named, _want: Kind | None) -> Value:
        pack = self.temporary(Pack((ARRAY, ARRAY)))
        self.line(f"{pack}.v0 = NULL;")
        self.line(f"{pack}.v1 = nd_map(arena, nd_exponent_of, {self.array(node.args[0])});")
        return Value(pack, Pack((ARRAY, ARRAY)), fresh=True)

    def shape(self, node: ast.expr) -> str:
        """Return a shape as `rank, lengths` for nd.h."""
        if isinstance(node, ast.Tuple):
            texts = [self.number(one, INT) for one in node.elts]
            return f"{len(texts)}, (int[]){{{', '.join(texts)}}}"
        value = self.expression(node)
        if isinstance(value.kind, Unknown) and value.kind.text.startswith("shape "):
            array = value.kind.text.split()[1]
            return f"{array}->rank, {array}->n"
        return f"1, (int[]){{{self.as_number(value, INT, node)}}}"

    def _filled(self, node: ast.Call, value: str) -> Value:
        shape = self.shape(node.args[0])
        if shape.startswith("2, (int[]){"):
            return Value(f"nd_filled2(arena, {_in_braces(shape)}, {value})", ARRAY, fresh=True)
        if shape.startswith("1, (int[]){"):
            return Value(f"nd_filled(arena, {_in_braces(shape)}, {value})", ARRAY, fresh=True)
        return Value(f"nd_full(arena, {shape}, {value})", ARRAY, fresh=True)

    def _of_np_zeros(self, node: ast.Call, named: Named, _want: Kind | None) -> Value:
        if "dtype" in named and ast.unparse(named["dtype"]) == "complex":
            name = self.temporary(ComplexArray())
            for part in ("v0", "v1"):
                self.line(f"{name}.{part} = {self._filled(node, '0.0').text};")
            return Value(name, ComplexArray())
        return self._filled(node, "0.0")

    _of_np_empty = _of_np_zeros  # nothing reads what was not written

    def _of_np_ones(self, node: ast.Call, _named: Named, _want: Kind | None) -> Value:
        return self._filled(node, "1.0")

    def _of_np_full(self, node: ast.Call, _named: Named, _want: Kind | None) -> Value:
        return self._filled(node, self.number(node.args[1]))

    def _like(self, node: ast.Call, value: str) -> Value:
        return Value(f"nd_full_like(arena, {self.array(node.args[0])}, {value})", ARRAY, fresh=True)

    def _of_np_zeros_like(self, node: ast.Call, _named: Named, _want: Kind | None) -> Value:
        return self._like(node, "0.0")

    _of_np_empty_like = _of_np_zeros_like

    def _of_np_full_like(self, node: ast.Call, _named: Named, _want: Kind | None) -> Value:
        return self._like(node, self.number(node.args[1]))

    def _of_np_eye(self, node: ast.Call, named: Named, _want: Kind | None) -> Value:
        rows = self.number(node.args[0], INT)
        columns = self.number(node.args[1], INT) if len(node.args) > 1 else rows
        k = self.number(named["k"], INT) if "k" in named else "0"
        return Value(f"nd_eye(arena, {rows}, {columns}, {k})", ARRAY, fresh=True)

    def _of_np_array(self, node: ast.Call, _named: Named, _want: Kind | None) -> Value:
        value = self.certain(self.expression(node.args[0], NUMBERS if _is_empty(node.args[0]) else None))
        if isinstance(value.kind, Pack):
            value = self.coerced(value, Listing(value.kind.elements[0]), node)
        if value.kind == Listing(NUMBERS):
            value = Value(value.text, Listing(ARRAY))
        if value.kind == Listing(ARRAY) or is_number(value.kind):
            return Value(self.as_array(value, node), ARRAY, fresh=True)
        text = self.as_array(value, node)
        return Value(text if value.fresh else f"nd_copy(arena, {text})", ARRAY, fresh=True)

    def several(self, node: ast.expr) -> str:
        """Return a list of arrays as `count, arrays` for nd.h."""
        if isinstance(node, (ast.List, ast.Tuple)) and not any(isinstance(one, ast.Starred) for one in node.elts):
            texts = [self.array(one) for one in node.elts]
            return f"{len(texts)}, (nd[]){{{', '.join(texts)}}}"
        if isinstance(node, (ast.List, ast.Tuple)):
            return self._several_starred(node)
        value = self.held(self.certain(self.expression(node)))
        if value.kind != Listing(ARRAY):
            raise self.no(node, "a list of arrays", f"{ast.unparse(node)} of type {value.kind}")
        return f"{value.text}.n, {value.text}.p"

    def _several_starred(self, node: ast.List | ast.Tuple) -> str:
        name = self.temporary(Listing(ARRAY))
        parts: list[tuple[bool, Value]] = []
        for one in node.elts:
            starred = isinstance(one, ast.Starred)
            value = self.held(self.certain(self.expression(one.value if isinstance(one, ast.Starred) else one)))
            if starred and value.kind != Listing(ARRAY):
                raise self.no(one, "a list of arrays after *", str(value.kind))
            parts.append((starred, value))
        total = " + ".join(f"{value.text}.n" if starred else "1" for starred, value in parts)
        self.line(f"{name}.p = nd_take_bytes(arena, sizeof(nd) * (size_t)({total}));")
        self.line(f"{name}.n = 0;")
        for starred, value in parts:
            if starred:
                i = self.temporary(INT)
                self.line(f"for ({i} = 0; {i} < {value.text}.n; {i}++) {name}.p[{name}.n++] = {value.text}.p[{i}];")
            else:
                self.line(f"{name}.p[{name}.n++] = {self.as_array(value, node)};")
        return f"{name}.n, {name}.p"

    def _of_np_concatenate(self, node: ast.Call, named: Named, _want: Kind | None) -> Value:
        axis = self.number(named["axis"], INT) if "axis" in named else "0"
        parts = self.several(node.args[0])
        if parts.startswith(_TWO):
            return Value(f"nd_joined(arena, {axis}, {_in_braces(parts)})", ARRAY, fresh=True)
        return Value(f"nd_concatenate(arena, {axis}, {parts})", ARRAY, fresh=True)

    def _of_np_hstack(self, node: ast.Call, _named: Named, _want: Kind | None) -> Value:
        parts = self.several(node.args[0])
        if parts.startswith(_TWO):
            return Value(f"nd_beside(arena, {_in_braces(parts)})", ARRAY, fresh=True)
        return Value(f"nd_hstack(arena, {parts})", ARRAY, fresh=True)

    def _of_np_append(self, node: ast.Call, _named: Named, _want: Kind | None) -> Value:
        more = self.certain(self.expression(node.args[1]))
        text = (
            f"nd_vector(arena, 1, (double[]){{{self.as_number(more, FLOAT, node)}}})"
            if is_number(more.kind)
            else more.text
        )
        return Value(f"nd_joined(arena, 0, {self.array(node.args[0])}, {text})", ARRAY, fresh=True)

    def _of_np_block(self, node: ast.Call, _named: Named, _want: Kind | None) -> Value:
        rows = node.args[0].elts if isinstance(node.args[0], ast.List) else []
        texts = []
        for row in rows:
            if not isinstance(row, ast.List):
                raise self.no(node, "rows of blocks")
            count = self.several(row)
            texts.append(f"nd_hstack(arena, {count})")
        return Value(f"nd_concatenate(arena, 0, {len(texts)}, (nd[]){{{', '.join(texts)}}})", ARRAY, fresh=True)

    def _of_np_tile(self, node: ast.Call, _named: Named, _want: Kind | None) -> Value:
        times = node.args[1]
        if isinstance(times, ast.Tuple):
            if any(ast.unparse(one) != "1" for one in times.elts[1:]):
                raise self.no(node, "a tile along the first axis")
            times = times.elts[0]
        return Value(f"nd_tile(arena, {self.array(node.args[0])}, {self.number(times, INT)})", ARRAY, fresh=True)

    def _of_np_where(self, node: ast.Call, _named: Named, _want: Kind | None) -> Value:
        texts = [self.array(one) for one in node.args]
        return Value(f"nd_where(arena, {', '.join(texts)})", ARRAY, fresh=True)

    def _of_np_arange(self, node: ast.Call, _named: Named, _want: Kind | None) -> Value:
        return Value(f"nd_arange(arena, 0, {self.number(node.args[0], INT)})", Array(INT), fresh=True)

    def _of_np_tensordot(self, node: ast.Call, named: Named, _want: Kind | None) -> Value:
        if ast.unparse(named["axes"]) != "1":
            raise self.no(node, "tensordot along one axis")
        texts = ", ".join(self.array(one) for one in node.args)
        return Value(f"nd_tensordot1(arena, {texts})", ARRAY, fresh=True)

    def _of_np_einsum(self, node: ast.Call, _named: Named, _want: Kind | None) -> Value:
        if ast.unparse(node.args[0]) != "'rhk,hkj->rhj'":
            raise self.no(node, "the sum rhk,hkj->rhj")
        return Value(f"nd_rhk_hkj(arena, {self.array(node.args[1])}, {self.array(node.args[2])})", ARRAY, fresh=True)

    def _of_np_fill_diagonal(self, node: ast.Call, _named: Named, _want: Kind | None) -> Value:
        self.line(f"nd_fill_diagonal({self.array(node.args[0])}, {self.array(node.args[1])});")
        return Value("", NOTHING)
