"""Whole functions in C.

A function gives back the memory that it took when it returns. Its result stays (`nd_keep`).
"""

from __future__ import annotations

import ast
import re
from collections.abc import Callable, Sequence
from typing import Any

from ndob_fmu.native.translate.kinds import (
    BOOL,
    FLOAT,
    INT,
    NOTHING,
    Function,
    Kind,
    Unknown,
    by_pointer,
    c_type,
    is_nd,
    is_number,
)
from ndob_fmu.native.translate.places import placed, without_steps_between
from ndob_fmu.native.translate.program import Definition, Parameter
from ndob_fmu.native.translate.statements import GIVE_BACK, Statements
from ndob_fmu.native.translate.values import Value, c_name
from ndob_fmu.native.translate.world import World


class Writer(Statements):
    """Writes one function."""

    def __init__(self, world: World, definition: Definition, outer: Writer | None = None) -> None:
        self.world, self.program, self.module = world, world.program, definition.module
        self.definition, self.outer = definition, outer
        self.variables: dict[str, Kind] = {}
        self.local: dict[str, str] = {}
        self.closures: dict[str, ast.FunctionDef] = {}
        self.lines: list[str] = []
        self.declared: dict[str, Kind] = {}
        self.environments: list[tuple[str, str]] = []
        self.lifted: dict[str, str] = {}
        self.pending: dict[str, tuple[int, str]] = {}
        self.growing: set[str] = set()
        self.fresh: set[str] = set()
        self.zeroed: set[str] = set()
        self.loops: list[int] = []
        self.opened: dict[int, tuple[set[str], int]] = {}
        self.handlers: list[str] = []
        self.jumps: set[str] = set()
        self.count = 0
        self.need, self.fails, self.use = world.need, world.fails, world.use

    def line(self, text: str) -> None:
        """Write a line of C."""
        self.lines.append(text)

    def temporary(self, kind: Kind) -> str:
        """Declare a variable without a name in Python."""
        self.count += 1
        name = f"t{self.count}_"
        self.declared[name] = kind
        self.use(kind)
        return name

    def set_aside(self, write: Callable[[], Any]) -> list[str]:
        """Return the lines that something writes, and forget them."""
        kept = self.lines, self.count, dict(self.declared), list(self.environments), set(self.jumps)
        variables, local = dict(self.variables), dict(self.local)
        self.lines = []
        try:
            write()
            return self.lines
        finally:
            self.lines, self.count, self.declared, self.environments, self.jumps = kept
            self.variables.clear()
            self.variables.update(variables)
            self.local.clear()
            self.local.update(local)

    def check(self) -> None:
        """Look at the error of the call before."""
        label = self.handlers[-1] if self.handlers else "failed_"
        self.jumps.add(label)
        self.line(f"if (arena->error) goto {label};")

    def read_variable(self, node: ast.Name) -> None:
        """Refuse a list whose type is not known yet."""
        if node.id in self.pending:
            raise self.no(node, "an annotation of an empty list or None", f"{node.id} before its type is known")

    def function_value(self, node: ast.Name, _want: Kind | None) -> Value:
        """Return a function of a module as a value."""
        definition = self.program.definition(self.module, node.id)
        assert definition is not None
        self.need(definition)
        self.world.values[definition.name] = definition
        kind = Function(tuple(one.kind for one in definition.parameters), definition.result)
        self.use(kind)
        name = self.temporary(kind)
        self.line(f"{name}.call = {definition.name}_value;")
        self.line(f"{name}.env = NULL;")
        return Value(name, kind)

    def closure_value(self, node: ast.expr, want: Kind | None) -> Value:
        """Return a function inside this one as a value, with what it captures now."""
        if not isinstance(node, ast.Name):
            raise self.no(node, "a function with a name")
        inner = self.closures[node.id]
        captured = self._captured(inner)
        parameters = []
        for argument in inner.args.args:
            kind = self.program.kind_of(self.module, argument.annotation)
            if isinstance(kind, Unknown) or kind == NOTHING:
                raise self.no(inner, f"a type of {argument.arg} that has a translation", str(kind))
            parameters.append(Parameter(argument.arg, kind, None))
        result = self.program.kind_of(self.module, inner.returns)
        name = f"{self.definition.name}__{node.id.lstrip('_')}"
        definition = Definition(name, self.module, inner, None, tuple(parameters), result)
        kinds = {one: value.kind for one, value in captured.items()}
        if name not in self.lifted:
            self.lifted[name] = ""
            self.lifted[name] = Writer(self.world, definition, self).closure(kinds)
        kind = Function(tuple(one.kind for one in parameters), result)
        self.use(kind)
        value = self.temporary(kind)
        environment = f"env{self.count}_"
        self.environments.append((f"{name}_env", environment))
        for one, own in captured.items():
            text = self.address(own) if by_pointer(own.kind) else own.text
            self.line(f"{environment}.{c_name(one)} = {text};")
        if not captured:
            self.line(f"{environment}.nothing = 0;")
        self.line(f"{value}.call = {name};")
        self.line(f"{value}.env = &{environment};")
        return Value(value, kind)

    def _captured(self, inner: ast.FunctionDef) -> dict[str, Value]:
        own = {argument.arg for argument in inner.args.args}
        own |= {one.id for one in ast.walk(inner) if isinstance(one, ast.Name) and isinstance(one.ctx, ast.Store)}
        found: dict[str, Value] = {}
        for one in ast.walk(inner):
            if not (isinstance(one, ast.Name) and isinstance(one.ctx, ast.Load)) or one.id in own or one.id in found:
                continue
            if one.id in self.variables or (one.id in self.closures and self.closures[one.id] is not inner):
                value = self.expression(ast.copy_location(ast.Name(one.id, ast.Load()), one))
                found[one.id] = self.held_structure(value) if by_pointer(value.kind) else value
        return found

    def head(self) -> str:
        """Return the head of the function."""
        return f"{self._type(self.definition.result)} {self.definition.name}({', '.join(self._parameters())})"

    def _type(self, kind: Kind) -> str:
        if isinstance(kind, Unknown):
            raise self.no(self.definition.node, "types that have a translation", kind.text)
        return c_type(kind)

    def _parameters(self) -> list[str]:
        texts = ["nd_arena *arena"]
        for one in self.definition.parameters:
            own = self._type(one.kind)
            texts.append(f"const {own} *{self._own(one)}" if by_pointer(one.kind) else f"{own} {self._own(one)}")
        return texts

    def _own(self, one: Parameter) -> str:
        return f"{c_name(one.name)}_given" if by_pointer(one.kind) and one.name in self._stored() else c_name(one.name)

    def _stored(self) -> set[str]:
        return {
            node.id
            for node in ast.walk(self.definition.node)
            if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)
        }

    def _take_parameters(self) -> None:
        for one in self.definition.parameters:
            self._type(one.kind)
            self.variables[one.name] = one.kind
            self.use(one.kind)
            if not by_pointer(one.kind):
                continue
            if one.name in self._stored():
                self.declared[c_name(one.name)] = one.kind
                self.line(f"{c_name(one.name)} = *{self._own(one)};")
            else:
                self.local[one.name] = f"(*{c_name(one.name)})"
        self.use(self.definition.result)

    def function(self) -> str:
        """Return the function in C, with the functions inside it before it."""
        self._take_parameters()
        self.statements(self.definition.node.body)
        if self.pending:
            raise self.no(self.definition.node, "lists whose type is known", ", ".join(self.pending))
        return "\n".join([*self.lifted.values(), f"{self.head()} {{", *self._body(), "}", ""])

    def closure(self, captured: dict[str, Kind]) -> str:
        """Return a function inside another in C, with the structure of what it captures before it."""
        name = self.definition.name
        fields = [
            f"const {self._type(kind)} *{c_name(one)};" if by_pointer(kind) else f"{self._type(kind)} {c_name(one)};"
            for one, kind in captured.items()
        ]
        for one, kind in captured.items():
            self.variables[one] = kind
            self.use(kind)
            self.local[one] = f"(*env->{c_name(one)})" if by_pointer(kind) else f"env->{c_name(one)}"
        self._take_parameters()
        if isinstance(self.definition.node.body, list):
            self.statements(self.definition.node.body)
        first, *others = self._parameters()
        head = (
            f"static {self._type(self.definition.result)} {name}({', '.join([first, 'const void *env_', *others])}) {{"
        )
        got = [f"const {name}_env *env = env_;" if captured else "(void)env_;"]
        structure = f"typedef struct {{ {' '.join(fields) or 'int nothing;'} }} {name}_env;"
        return "\n".join([*self.lifted.values(), structure, head, *got, *self._body(), "}", ""])

    def _body(self) -> list[str]:
        kind, lines = self.definition.result, self.lines
        if kind == NOTHING:
            lines.append(GIVE_BACK)
        lines = _without_needless_keeping(without_steps_between(lines))
        if not any("arena" in line for line in lines if line != GIVE_BACK):
            lines = ["(void)arena;", *(line for line in lines if line != GIVE_BACK)]
        words = {word for line in lines for word in re.findall(r"\w+", line)}
        unread = [own for one in self.definition.parameters if (own := self._own(one)) not in words]
        lines = [*(f"(void){own};" for own in unread), *lines]
        result = ["size_t mark_ = arena->used;"] if "mark_" in words else []
        result += [f"{environment} {name};" for environment, name in self.environments]
        result += [f"(void){name};" for name in self.declared if name in words and _only_written(name, lines)]
        movable = [name for name in self.declared if name in words and name not in self.zeroed]
        there = placed([*result, *lines], {name: self._c_type_of(name) for name in movable})
        left = {*there.left, *self.zeroed}
        result = [*self._declarations([name for name in self.declared if name in words & left]), *there.lines]
        if "failed_" in self.jumps:
            result.append("failed_:")
        if "failed_" in self.jumps or not lines[-1].startswith("return"):
            result += self._failure(kind)
        return result

    def _c_type_of(self, name: str) -> str:
        kind = self.declared[name]
        return kind.text if isinstance(kind, Unknown) else c_type(kind)

    def _declarations(self, names: Sequence[str]) -> list[str]:
        """Return the declarations of variables, one for each type."""
        found: dict[str, list[str]] = {}
        for name in names:
            kind, own = self.declared[name], self._c_type_of(name)
            first = "NULL" if is_nd(kind) else _FIRST_VALUES.get(kind)
            found.setdefault(own, []).append(f"{name} = {first}" if first else name)
        zeroed = [
            f"memset(&{name}, 0, sizeof {name});"
            for name in names
            if name in self.zeroed and not (is_nd(self.declared[name]) or is_number(self.declared[name]))
        ]
        return [f"{own} {', '.join(listed)};" for own, listed in found.items()] + zeroed

    def _failure(self, kind: Kind) -> list[str]:
        if kind == NOTHING:
            return ["return;"]
        if is_nd(kind):
            return ["return NULL;"]
        if is_number(kind):
            return [f"return {({FLOAT: 'NAN', INT: '0', BOOL: 'false'})[kind]};"]  # type: ignore[index]
        return [f"{{ {c_type(kind)} none_; memset(&none_, 0, sizeof none_); return none_; }}"]


_KEPT = re.compile(r"(?<=^return )nd_keep\(arena, mark_, (.*)\)(?=;$)")
# Of variables; compilers would warn of some that are always written before they are read.
_FIRST_VALUES: dict[Kind, str] = {FLOAT: "0.0", INT: "0", BOOL: "false"}


def _without_needless_keeping(lines: list[str]) -> list[str]:
    """Return the lines of a function that takes no memory without the care for it."""
    bare = [_KEPT.sub(r"\1", line) for line in lines if not line.startswith("nd_keep_parts(")]
    return lines if any(re.search(r"\barena\b(?!->error)", line) for line in bare) else bare


def _only_written(name: str, lines: Sequence[str]) -> bool:
    """Return whether no line reads a variable, as that of a key of a cache."""
    pattern = re.compile(rf"\b{name}\b")
    return not any(pattern.search(line.removeprefix(f"{name} = ")) for line in lines)
