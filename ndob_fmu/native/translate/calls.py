"""Calls: of functions and methods of the runtime, and of what makes its structures."""

from __future__ import annotations

import ast

from ndob_fmu.native.translate.kinds import (
    ARRAY,
    INT,
    NOTHING,
    TEXT,
    ComplexArray,
    Function,
    Kind,
    Listing,
    Maybe,
    Pack,
    Structure,
    Unknown,
    element_of,
    is_nd,
    is_numbers,
)
from ndob_fmu.native.translate.library import BY_HAND, FUNCTIONS, OF_NUMBERS, OF_TWO, REDUCTIONS, STACKS
from ndob_fmu.native.translate.numpy_calls import Named
from ndob_fmu.native.translate.program import Class, Definition, Module, Parameter
from ndob_fmu.native.translate.python_calls import PythonCalls
from ndob_fmu.native.translate.values import Value, c_name, entry

_IDENTITY = ("numbers", "np.asarray", "np.ascontiguousarray")


class Calls(PythonCalls):
    """The part of a function's writer that writes calls."""

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
        if value.kind == Listing(TEXT) and name == "index":
            return Value(self.found(self.held_structure(value), self.expression(node.args[0])), INT)
        if isinstance(value.kind, ComplexArray) and name == "astype":
            return value
        if value.kind == INT and name in ("bit_count", "bit_length"):
            return Value(f"nd_{'bits' if name == 'bit_count' else name}({value.text})", INT)
        raise self.no(node, "a method that has a translation", f".{name} of type {value.kind}")
