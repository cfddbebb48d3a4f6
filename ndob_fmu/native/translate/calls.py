"""Calls: of functions of the runtime, of NumPy, and of Python's own functions and methods."""

from __future__ import annotations

import ast
from collections.abc import Callable

from ndob_fmu.native.translate.expressions import Expressions, Value, c_name, entry
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
    Unknown,
    by_pointer,
    c_type,
    element_of,
    is_nd,
    is_number,
    is_numbers,
    word,
)
from ndob_fmu.native.translate.library import BY_HAND, FUNCTIONS, OF_NUMBERS, OF_TWO, REDUCTIONS, STACKS, Known
from ndob_fmu.native.translate.program import Class, Definition, Module, Parameter

Named = dict[str, ast.expr]
_IDENTITY = ("numbers", "np.asarray", "np.ascontiguousarray")
_FORMATS = {"g": "%g"}


class Calls(Expressions):
    """The part of a function's writer that writes calls."""

    check: Callable[[], None]
    need: Callable[[Definition], None]
    fails: Callable[[Definition], bool]
    loop_value: Callable[[ast.Call, str], Value]

    def call(self, node: ast.Call, want: Kind | None = None) -> Value:
        """Write a call."""
        named = {keyword.arg or "**": keyword.value for keyword in node.keywords}
        name = self._full_name(node.func)
        if len(node.args) == 2 and self._is_cache(node.func):
            return self._computed(node.args[1])
        if isinstance(node.func, ast.Name):
            known = self.variables.get(node.func.id)
            if isinstance(known, Function):
                return self._call_value(node, self.expression(node.func), known)
            if isinstance(known, Structure) and "__call__" in self.program.structure(known.name).methods:
                return self.call_method(node, self.expression(node.func), "__call__", list(node.args), named)
            if node.func.id in self.closures:
                value = self.closure_value(node.func, None)
                assert isinstance(value.kind, Function)
                return self._call_value(node, value, value.kind)
            found = self.program.resolve(self.module, node.func.id)
            by_hand = None if found is None else BY_HAND.get((found[0].name, found[1]))
            if by_hand is not None:
                return self._call_known(node, by_hand)
            if node.func.id != "numbers":
                definition = self.program.definition(self.module, node.func.id)
                if definition is not None:
                    return self._call_definition(node, definition, list(node.args), named)
                known_class = self.program.class_of(self.module, node.func.id)
                if known_class is not None:
                    return self._make(node, known_class, named)
        if name in FUNCTIONS:
            return self._call_known(node, FUNCTIONS[name])
        writer = getattr(self, f"_of_{name.replace('.', '_')}", None)
        if writer is not None:
            result = writer(node, named, want)
            assert isinstance(result, Value)
            return result
        short = name.removeprefix("np.").removeprefix("math.")
        if name in _IDENTITY:
            return self._same(node, want)
        if short in OF_NUMBERS and len(node.args) == 1:
            return self._of_each(node, short, name)
        if name.startswith("np.") and short in OF_TWO:
            left, right = (self.certain(self.expression(one)) for one in node.args)
            return self._of_two(OF_TWO[short], left, right, node)
        if name.startswith("np.") and short in REDUCTIONS:
            return self._reduced(node, short, self.expression(node.args[0]), named, node.args[1:])
        if name.startswith("np.") and short in STACKS:
            return Value(f"{STACKS[short]}(arena, {self.several(node.args[0])})", ARRAY, fresh=True)
        if isinstance(node.func, ast.Attribute) and ("(" in name or not name.startswith("np.")):
            return self._method(node, node.func, named)
        raise self.no(node, "a function that has a translation", f"{ast.unparse(node.func)}")

    def _full_name(self, node: ast.expr) -> str:
        if isinstance(node, ast.Name):
            outside = self.program.outside(self.module, node.id)
            if outside is not None and outside.startswith(("math.", "dataclasses.")):
                return outside.removeprefix("dataclasses.")
            return node.id
        return ast.unparse(node)

    def _is_cache(self, node: ast.expr) -> bool:
        """Return whether an expression is a cache of `runtime.memo`."""
        if isinstance(node, ast.Attribute):
            value = self.kind_if_known(node.value)
            if isinstance(value, Structure):
                field = self.program.structure(value.name).fields.get(node.attr)
                return field is not None and isinstance(field.kind, Unknown) and "Result" in field.kind.text
        if isinstance(node, ast.Name) and node.id not in self.variables:
            found = self.program.resolve(self.module, node.id)
            return found is not None and type(getattr(found[0].live, found[1], None)).__name__ == "SharedResults"
        return False

    def _computed(self, node: ast.expr) -> Value:
        """Write what a cache would compute: a cache holds pure results, so that it changes nothing but the time."""
        if isinstance(node, ast.Lambda):
            return self.expression(node.body)
        return self.call(ast.copy_location(ast.Call(node, [], []), node))

    # -- functions of the runtime

    def _matched(
        self,
        node: ast.AST,
        name: str,
        parameters: tuple[Parameter, ...],
        module: Module,
        given: list[ast.expr],
        named: Named,
    ) -> list[ast.expr]:
        """Return the arguments of a call in the order of the parameters, defaults included."""
        if "**" in named:
            raise self.no(node, "a call without **")
        given = self._without_stars(given, len(parameters) - len(named))
        values = dict(zip([one.name for one in parameters], given, strict=False)) | named
        found = []
        for one in parameters:
            if one.name in values:
                found.append(values[one.name])
            elif one.default is not None:
                found.append(self._default(one.default, module))
            else:
                raise self.no(node, f"an argument {one.name} of {name}", "none")
        return found

    def _default(self, default: ast.expr, module: Module) -> ast.expr:
        """Return a default as a constant; it means what it means where the function or the class is."""
        if isinstance(default, ast.Call):  # of a field that has no translation
            return default
        code = compile(ast.Expression(default), module.file, "eval")
        return ast.copy_location(ast.Constant(eval(code, vars(module.live))), default)

    def _without_stars(self, given: list[ast.expr], count: int) -> list[ast.expr]:
        """Return arguments with a name in place of each item of `*value`, as many as the function takes."""
        found: list[ast.expr] = []
        for one in given:
            if not isinstance(one, ast.Starred):
                found.append(one)
                continue
            value = self.held(self.certain(self.expression(one.value)))
            if isinstance(value.kind, Pack):
                items = [Value(f"{value.text}.v{i}", kind) for i, kind in enumerate(value.kind.elements)]
            elif is_numbers(value.kind):
                room = count - (len(given) - 1)
                items = [entry(f"nd_at({value.text}, {i})", element_of(value.kind)) for i in range(room)]
            else:
                raise self.no(one, "a tuple or numbers after *", str(value.kind))
            for item in items:
                held = self.held(item)
                self.variables[held.text] = held.kind
                self.local[held.text] = held.text
                found.append(ast.copy_location(ast.Name(held.text, ast.Load()), one))
        return found

    def _call_definition(
        self, node: ast.AST, definition: Definition, given: list[ast.expr], named: Named, own: Value | None = None
    ) -> Value:
        parameters = definition.parameters[1:] if own is not None else definition.parameters
        values = self._matched(node, definition.where, parameters, definition.module, given, named)
        for one in definition.parameters:
            if isinstance(one.kind, Unknown):
                raise self.no(
                    node, f"{definition.where} with types that have a translation", f"{one.name}: {one.kind.text}"
                )
        if isinstance(definition.result, Unknown):
            raise self.no(node, f"{definition.where} with a result that has a translation", definition.result.text)
        texts = [] if own is None else [self.address(self.held_structure(own))]
        for one, value in zip(parameters, values, strict=True):
            texts.append(self.argument(value, one.kind))
        self.need(definition)
        text = f"{definition.name}({', '.join(['arena', *texts])})"
        return self.called(text, definition.result, fails=self.fails(definition))

    def called(self, text: str, kind: Kind, *, fails: bool) -> Value:
        """Return the result of a call, which is a statement of its own: what fails is looked at after it."""
        self.use(kind)
        if kind == NOTHING:
            self.line(f"{text};")
            if fails:
                self.check()
            return Value("", NOTHING)
        name = self.temporary(kind)
        self.line(f"{name} = {text};")
        if fails:
            self.check()
        return Value(name, kind, fresh=True)

    def call_method(self, node: ast.AST, value: Value, name: str, given: list[ast.expr], named: Named) -> Value:
        """Write a call of a method or property of a structure."""
        assert isinstance(value.kind, Structure)
        definition = self.program.structure(value.kind.name).methods[name]
        return self._call_definition(node, definition, given, named, own=value)

    def _call_value(self, node: ast.Call, value: Value, kind: Function) -> Value:
        value = self.held_structure(value)
        texts = [self.argument(given, one) for given, one in zip(node.args, kind.arguments, strict=True)]
        text = f"{value.text}.call({', '.join(['arena', f'{value.text}.env', *texts])})"
        return self.called(text, kind.result, fails=True)

    def _make(self, node: ast.Call, known: Class, named: Named) -> Value:
        kind = Structure(known.name)
        self.use(kind)
        fields = [one for one in known.fields.values() if not isinstance(one.kind, Unknown)]
        given = self._matched(node, known.name, tuple(known.fields.values()), known.module, list(node.args), named)
        values = dict(zip(known.fields, given, strict=True))
        texts = [self.coerced(self.expression(values[one.name], one.kind), one.kind, node).text for one in fields]
        name = self.temporary(kind)
        for one, text in zip(fields, texts, strict=True):
            self.line(f"{name}.{c_name(one.name)} = {text};")
        if "__post_init__" in known.methods:
            self.call_method(node, Value(name, kind), "__post_init__", [], {})
        return Value(name, kind, fresh=True)

    def _changed(self, node: ast.Call, value: Value, named: Named) -> Value:
        """Write replace(value, field=…)."""
        if not isinstance(value.kind, Structure):
            raise self.no(node, "replace of a dataclass or named tuple")
        known = self.program.structure(value.kind.name)
        texts = {}
        for field, given in named.items():
            kind = known.fields[field].kind
            texts[field] = self.coerced(self.expression(given, kind), kind, node).text
        name = self.temporary(value.kind)
        self.line(f"{name} = {value.text};")
        for field, text in texts.items():
            self.line(f"{name}.{c_name(field)} = {text};")
        return Value(name, value.kind)

    def _of_replace(self, node: ast.Call, named: Named, _want: Kind | None) -> Value:
        return self._changed(node, self.certain(self.expression(node.args[0])), named)

    # -- NumPy

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
        self.line(f"{pack}.v1 = nd_none;")
        self.check()
        return Value(pack, Pack((ARRAY, ARRAY)), fresh=True)

    def _of_np_linalg_qr(self, node: ast.Call, named: Named, _want: Kind | None) -> Value:
        if named:
            raise self.no(node, "qr without a mode")
        pack = self.temporary(Pack((ARRAY, ARRAY)))
        self.line(f"{pack}.v0 = nd_qr_q(arena, {self.array(node.args[0])});")
        self.line(f"{pack}.v1 = nd_none;")
        return Value(pack, Pack((ARRAY, ARRAY)), fresh=True)

    def _of_np_linalg_eigvals(self, node: ast.Call, _named: Named, _want: Kind | None) -> Value:
        return self.called(f"nd_eigvals(arena, {self.array(node.args[0])})", ComplexArray(), fails=True)

    def _of_np_lexsort(self, node: ast.Call, _named: Named, _want: Kind | None) -> Value:
        then, first = node.args[0].elts if isinstance(node.args[0], ast.Tuple) else node.args
        text = f"nd_lexsort(arena, {self.array(then)}, {self.array(first)})"
        return Value(text, Array(INT), fresh=True)

    def _of_np_frexp(self, node: ast.Call, _named: Named, _want: Kind | None) -> Value:
        pack = self.temporary(Pack((ARRAY, ARRAY)))
        self.line(f"{pack}.v0 = nd_none;")
        self.line(f"{pack}.v1 = nd_map(arena, nd_exponent_of, {self.array(node.args[0])});")
        return Value(pack, Pack((ARRAY, ARRAY)), fresh=True)

    def _of_map(self, node: ast.Call, _named: Named, want: Kind | None) -> Value:
        return self.comprehension(node, want)

    def shape(self, node: ast.expr) -> str:
        """Return a shape as `rank, lengths` for nd.h."""
        if isinstance(node, ast.Tuple):
            texts = [self.number(one, INT) for one in node.elts]
            return f"{len(texts)}, (int[]){{{', '.join(texts)}}}"
        value = self.expression(node)
        if isinstance(value.kind, Unknown) and value.kind.text.startswith("shape "):
            array = value.kind.text.split()[1]
            return f"{array}.rank, {array}.n"
        return f"1, (int[]){{{self.as_number(value, INT, node)}}}"

    def _filled(self, node: ast.Call, value: str) -> Value:
        return Value(f"nd_full(arena, {self.shape(node.args[0])}, {value})", ARRAY, fresh=True)

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
        return Value(f"nd_concatenate(arena, {axis}, {self.several(node.args[0])})", ARRAY, fresh=True)

    def _of_np_append(self, node: ast.Call, _named: Named, _want: Kind | None) -> Value:
        more = self.certain(self.expression(node.args[1]))
        text = (
            f"nd_vector(arena, 1, (double[]){{{self.as_number(more, FLOAT, node)}}})"
            if is_number(more.kind)
            else more.text
        )
        return Value(f"nd_concatenate(arena, 0, 2, (nd[]){{{self.array(node.args[0])}, {text}}})", ARRAY, fresh=True)

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

    # -- Python's own functions

    def _of_float(self, node: ast.Call, _named: Named, _want: Kind | None) -> Value:
        inner = node.args[0]
        if isinstance(inner, ast.Call) and ast.unparse(inner.func) == "round" and len(inner.args) == 1:
            return Value(f"nearbyint({self.number(inner.args[0])})", FLOAT)  # may be no `int`
        return Value(self.number(node.args[0]), FLOAT)

    def _of_int(self, node: ast.Call, _named: Named, _want: Kind | None) -> Value:
        value = self.expression(node.args[0])
        return Value(
            f"(int)({self.as_number(value, FLOAT, node)})" if value.kind == FLOAT else self.as_number(value, INT, node),
            INT,
        )

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
        self.line(f"for ({i} = 0; {i} < {name}.n; {i}++) {name}.p[{i}] = nd_row({value.text}, {i});")
        return Value(name, Listing(ARRAY))

    # -- methods

    def _method(self, node: ast.Call, function: ast.Attribute, named: Named) -> Value:
        value = self.certain(self.expression(function.value))
        name = function.attr
        if isinstance(value.kind, Structure):
            known = self.program.structure(value.kind.name)
            if name == "_replace":
                return self._changed(node, value, named)
            if name in known.fields and isinstance(known.fields[name].kind, (Function, Maybe)):
                field = self.certain(self.expression(function))
                assert isinstance(field.kind, Function)
                return self._call_value(node, field, field.kind)
            if name in known.methods:
                return self.call_method(node, value, name, list(node.args), named)
        if is_nd(value.kind):
            found = self._array_method(node, value, name, named)
            if found is not None:
                return found
        if isinstance(value.kind, ComplexArray) and name == "astype":
            return value
        if value.kind == INT and name in ("bit_count", "bit_length"):
            return Value(f"nd_{'bits' if name == 'bit_count' else name}({value.text})", INT)
        raise self.no(node, "a method that has a translation", f".{name} of type {value.kind}")

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
            return Value(f"nd_permuted({value.text}, (int[]){{{', '.join(texts)}}})", value.kind)
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

    # -- messages

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


def _escaped(text: str) -> str:
    return text.replace("\\", "\\\\").replace('"', '\\"').replace("%", "%%")


def _is_empty(node: ast.expr) -> bool:
    return isinstance(node, (ast.List, ast.Tuple)) and not node.elts


__all__ = ["Calls", "Simple", "by_pointer", "word"]
