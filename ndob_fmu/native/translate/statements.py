"""Statements of Python in C, and whole functions.

Memory that a function takes is given back when it returns, and what an iteration of a loop takes when that ends, but
for what is used later (`nd_keep`).
"""

from __future__ import annotations

import ast
import copy
import re
from collections.abc import Callable, Sequence
from typing import Any

from ndob_fmu.native.translate.expressions import Value, c_name
from ndob_fmu.native.translate.kinds import (
    ARRAY,
    BOOL,
    FLOAT,
    INT,
    NOTHING,
    NUMBERS,
    TEXT,
    Array,
    ComplexArray,
    Function,
    Kind,
    Listing,
    Maybe,
    Pack,
    Structure,
    Unknown,
    by_pointer,
    c_type,
    elements_of,
    is_nd,
    is_number,
    is_numbers,
    word,
)
from ndob_fmu.native.translate.library import ERRORS
from ndob_fmu.native.translate.loops import Loops
from ndob_fmu.native.translate.program import Definition, Module, Parameter, Program

_RELEASE = "/* release "
_GIVE_BACK = "arena->used = mark_;"


class World:
    """What the writers of all functions share."""

    def __init__(self, program: Program) -> None:
        self.program = program
        self.wanted: list[Definition] = []
        self.kinds: list[Kind] = []
        self.used: set[str] = set()
        self.values: dict[str, Definition] = {}  # functions that are used as values
        self._fails: dict[str, bool] = {}

    def need(self, definition: Definition) -> None:
        """Have a function translated too, because the one that is being written uses it."""
        self.used.add(definition.where)
        if definition not in self.wanted:
            self.wanted.append(definition)

    def use(self, kind: Kind) -> None:
        """Have a type declared."""
        if kind in self.kinds or isinstance(kind, Unknown):
            return
        self.kinds.append(kind)

    def fails(self, definition: Definition) -> bool:
        """Return whether a function can raise."""
        if definition.name not in self._fails:
            self._fails[definition.name] = False  # no recursion
            self._fails[definition.name] = any(self._node_fails(definition, node) for node in ast.walk(definition.node))
        return self._fails[definition.name]

    def _node_fails(self, definition: Definition, node: ast.AST) -> bool:
        if isinstance(node, ast.Raise):
            return True
        if isinstance(node, ast.Call):
            text = ast.unparse(node.func)
            if (
                text.startswith("np.linalg.")
                and text != "np.linalg.qr"
                and (text != "np.linalg.norm" or len(node.args) > 1)
            ):
                return True
            if isinstance(node.func, ast.Name):
                known = self.program.definition(definition.module, node.func.id)
                if known is not None:
                    return self.fails(known)
                made = self.program.class_of(definition.module, node.func.id)
                if made is not None:
                    return "__post_init__" in made.methods
                return any(isinstance(one.kind, Function) and one.name == node.func.id for one in definition.parameters)
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Load):
            known = self.program.definition(definition.module, node.id)
            return known is not None and known is not definition and self.fails(known)
        if isinstance(node, ast.Attribute):
            return any(self.fails(one) for one in self.program.methods_called(node.attr)) or self.program.has_function(
                node.attr
            )
        return False


class Writer(Loops):
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
        self.handlers: list[str] = []
        self.jumps: set[str] = set()
        self.count = 0
        self.need, self.fails, self.use = world.need, world.fails, world.use

    # -- services to the other parts

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

    # -- functions as values

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

    # -- assignment

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
            self.lines[place] = f"{own} = nd_none;" if is_nd(kind) else f"memset(&{own}, 0, sizeof {own});"
        elif is_numbers(kind):
            self.lines[place] = f"{own} = nd_new(arena, 1, (int[]){{0}});"
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
                self.to_target(one, Value(f"{array}.n[{i}]", INT), node)
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
            items = [Value(f"nd_row({value.text}, {i})", ARRAY) for i in range(len(target.elts))]
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
        place = f"nd_get({array.text}, {self.indices(target.slice)})"
        if is_number(value.kind):
            self.line(f"nd_put_number({place}, {self.as_number(value, FLOAT, target)});")
        else:
            self.line(f"nd_put({place}, {self.as_array(value, target)});")

    # -- statements

    def statements(self, body: Sequence[ast.stmt]) -> None:
        """Write statements."""
        for statement in body:
            self.statement(statement)

    def statement(self, node: ast.stmt) -> None:
        """Write a statement."""
        match node:
            case ast.Expr():
                self._expression_statement(node)
            case ast.Assign():
                self._assignment(node)
            case ast.AnnAssign():
                self._annotated(node)
            case ast.AugAssign():
                self._augmented(node)
            case ast.Return():
                self._return(node)
            case ast.If():
                self._if(node)
            case ast.For():
                self._for(node)
            case ast.While():
                self._while(node)
            case ast.Break():
                self.line("break;")
            case ast.Continue():
                self.line(f"{_RELEASE}{self.loops[-1]} */")
                self.line("continue;")
            case ast.With():
                self._with(node)
            case ast.Try():
                self._try(node.body, node.handlers, node)
                if node.orelse or node.finalbody:
                    raise self.no(node, "try without else and finally", "try")
            case ast.Raise():
                self._raise(node)
            case ast.FunctionDef():
                self.closures[node.name] = node
            case ast.Assert() | ast.Pass():
                pass
            case _:
                raise self.no(node, "a statement that has a translation")

    def _expression_statement(self, node: ast.Expr) -> None:
        call = node.value
        if isinstance(call, ast.Constant):
            return
        if isinstance(call, ast.Call) and isinstance(call.func, ast.Attribute) and call.func.attr == "append":
            self._append(call, call.func)
            return
        value = self.expression(call)
        if value.kind != NOTHING and value.text and not value.text.isidentifier():
            self.line(f"(void){value.text};")

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

    def _if(self, node: ast.If) -> None:
        self.line(f"if ({self.truth(node.test)}) {{")
        self.statements(node.body)
        if node.orelse:
            self.line("} else {")
            self.statements(node.orelse)
        self.line("}")

    def _with(self, node: ast.With) -> None:
        call = node.items[0].context_expr
        text = ast.unparse(call)
        if isinstance(call, ast.Call) and text.startswith("suppress("):
            self._try(node.body, [ast.ExceptHandler(ast.Tuple(list(call.args), ast.Load()), None, [ast.Pass()])], node)
            return
        if not text.startswith("np.errstate("):
            raise self.no(node, "with np.errstate or suppress", text)
        self.statements(node.body)

    def _try(self, body: list[ast.stmt], handlers: list[ast.ExceptHandler], node: ast.AST) -> None:
        self.count += 1
        caught, tried = f"caught{self.count}_", f"tried{self.count}_"
        self.handlers.append(caught)
        self.statements(body)
        self.handlers.pop()
        if caught not in self.jumps:
            return
        self.line(f"goto {tried};")
        self.line(f"{caught}:;")
        if len(handlers) != 1:
            raise self.no(node, "one except", "try")
        kind = handlers[0].type
        names = [ast.unparse(one) for one in (kind.elts if isinstance(kind, ast.Tuple) else [kind] if kind else [])]
        unknown = [name for name in names if name not in ERRORS]
        if unknown or not names:
            raise self.no(node, f"except {', '.join(ERRORS)}", f"except {', '.join(unknown)}")
        codes = sorted({code for name in names for code in ERRORS[name]})
        outer = self.handlers[-1] if self.handlers else "failed_"
        self.jumps.add(outer)
        self.line(f"if ({' && '.join(f'arena->error != {code}' for code in codes)}) goto {outer};")
        self.line("arena->error = ND_NONE;")
        if handlers[0].name:
            self.variables[handlers[0].name] = TEXT
            self.local[handlers[0].name] = "arena->message"
        self.statements(handlers[0].body)
        self.line(f"{tried}:;")

    def _raise(self, node: ast.Raise) -> None:
        error = node.exc
        if error is None:
            raise self.no(node, "an error to raise")
        called = error.func if isinstance(error, ast.Call) else error
        name = ast.unparse(called).removesuffix(".report")
        if name not in ERRORS:
            raise self.no(node, f"one of {', '.join(ERRORS)}", name)
        text, arguments = "", list[str]()
        if isinstance(error, ast.Call) and error.args:
            text, arguments = self.message(error.args[0])
            named = {keyword.arg: keyword.value for keyword in error.keywords}
            for before, part in (
                (": expected ", "expected"),
                (", received ", "received"),
                ("; likely cause: ", "likely"),
            ):
                if part in named:
                    own, more = self.message(named[part])
                    text, arguments = f"{text}{before}{own}", arguments + more
        quoted = f'"{text}"'
        self.line(f"nd_raise({', '.join(['arena', ERRORS[name][0], quoted, *arguments])});")
        label = self.handlers[-1] if self.handlers else "failed_"
        self.jumps.add(label)
        self.line(f"goto {label};")

    # -- loops

    def _for(self, node: ast.For) -> None:
        if node.orelse:
            raise self.no(node, "a loop without else", "for")
        if isinstance(node.iter, ast.Tuple) and self._mixed(node.iter):
            for one in node.iter.elts:
                if any(isinstance(part, (ast.Break, ast.Continue)) for part in ast.walk(node)):
                    raise self.no(node, "a loop over a tuple without break and continue", "for")
                self._assignment(ast.copy_location(ast.Assign([node.target], one), node))
                self.statements(node.body)
            return
        items = self.items(node.iter)
        i = self.temporary(INT)
        self._open(f"for ({i} = 0; {i} < {items.count}; {i}++) {{", node)
        for one, value in self.targets(node.target, items.item(i)):
            self.to_target(one, value, node)
        self._close(node)

    def _mixed(self, node: ast.Tuple) -> bool:
        return any(isinstance(one, ast.Tuple) for one in node.elts)

    def _while(self, node: ast.While) -> None:
        if node.orelse:
            raise self.no(node, "a loop without else", "while")
        endless = isinstance(node.test, ast.Constant) and node.test.value is True
        self._open("for (;;) {", node)
        if not endless:
            self.line(f"if (!{self.truth(node.test)}) break;")
        self._close(node)

    def _open(self, head: str, node: ast.For | ast.While) -> None:
        self.count += 1
        self.loops.append(self.count)
        self.line(f"{_RELEASE}start {self.count} */")
        self.line(head)
        self._before = getattr(self, "_before", {})
        self._before[self.count] = (set(self.variables), len(self.lines))

    def _close(self, node: ast.For | ast.While) -> None:
        self.statements(node.body)
        number = self.loops.pop()
        known, first = self._before.pop(number)
        self.line(f"{_RELEASE}{number} */")
        self.line("}")
        takes = any("arena" in line for line in self.lines[first:])
        kept = self._carried(node, known) if takes else []
        start, again = f"{_RELEASE}start {number} */", f"{_RELEASE}{number} */"
        if takes:
            self.declared[f"mark{number}_"] = Unknown("size_t")
        text = self._keeping(f"mark{number}_", kept) if takes else ""
        for place, line in enumerate(self.lines):
            if line == start:
                self.lines[place] = f"mark{number}_ = arena->used;" if takes else ""
            elif line == again:
                self.lines[place] = text

    def _carried(self, node: ast.For | ast.While, known: set[str]) -> list[str]:
        """Return the variables that an iteration leaves to later ones, or to what follows, and that hold memory."""
        changed: set[str] = set()
        inside = set(map(id, ast.walk(node)))
        for one in ast.walk(node):
            if isinstance(one, ast.Name) and isinstance(one.ctx, ast.Store):
                changed.add(one.id)
            if isinstance(one, ast.Subscript) and isinstance(one.ctx, ast.Store) and isinstance(one.value, ast.Name):
                changed.add(one.value.id)
            if isinstance(one, ast.Call) and isinstance(one.func, ast.Attribute) and one.func.attr == "append":
                changed |= {part.id for part in ast.walk(one.func) if isinstance(part, ast.Name)}
        outside = {
            one.id
            for one in ast.walk(self.definition.node)
            if isinstance(one, ast.Name) and isinstance(one.ctx, ast.Load) and id(one) not in inside
        }
        names = [name for name in sorted(changed) if name in self.variables and (name in known or name in outside)]
        return [name for name in names if self._holds(self.variables[name])]

    def _holds(self, kind: Kind) -> bool:
        return holds_memory(self.program, kind)

    def _keeping(self, mark: str, names: list[str]) -> str:
        """Return the statement that gives back memory but for what variables hold."""
        for name in names:
            self.zeroed.add(c_name(name))
            self.use(self.variables[name])
        owns = [self.local.get(name, c_name(name)) for name in names]
        if not names:
            return f"arena->used = {mark};"
        if len(names) == 1 and is_nd(self.variables[names[0]]):
            return f"{owns[0]} = nd_keep(arena, {mark}, {owns[0]});"
        calls = " ".join(f"{keeper(self.variables[name])}(&k_, &{own});" for name, own in zip(names, owns, strict=True))
        return (
            f"{{ nd_keeping k_ = nd_keep_begin(arena, {mark}); for (; k_.pass <= 2; k_.pass++) {{ {calls} }} "
            "nd_keep_end(&k_); }"
        )

    # -- functions

    def _return(self, node: ast.Return) -> None:
        kind = self.definition.result
        if node.value is None:
            self.line(_GIVE_BACK)
            self.line("return;")
            return
        if isinstance(kind, Function):
            raise self.no(node, "a result that is not a function, which lives no longer than what it captured")
        value = self.coerced(self.expression(node.value, kind), kind, node)
        if is_nd(kind):
            self.line(f"return nd_keep(arena, mark_, {value.text});")
        elif not holds_memory(self.program, kind):
            name = self.temporary(kind)
            self.line(f"{name} = {value.text};")
            self.line(_GIVE_BACK)
            self.line(f"return {name};")
        else:
            self.use(kind)
            self.line(f"return kept_{word(kind)}(arena, mark_, {value.text});")

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
            lines.append(_GIVE_BACK)
        if not any("arena" in line for line in lines if line != _GIVE_BACK):
            lines = ["(void)arena;", *(line for line in lines if line != _GIVE_BACK)]
        words = {word for line in lines for word in re.findall(r"\w+", line)}
        unread = [own for one in self.definition.parameters if (own := self._own(one)) not in words]
        lines = [*(f"(void){own};" for own in unread), *lines]
        result = ["size_t mark_ = arena->used;"] if "mark_" in words else []
        result += [f"{environment} {name};" for environment, name in self.environments]
        result += [self._declaration(name, own) for name, own in self.declared.items() if name in words]
        result += [f"(void){name};" for name in self.declared if name in words and _only_written(name, lines)]
        result += lines
        if "failed_" in self.jumps:
            result.append("failed_:")
        if "failed_" in self.jumps or not lines[-1].startswith("return"):
            result += self._failure(kind)
        return result

    def _declaration(self, name: str, kind: Kind) -> str:
        if isinstance(kind, Unknown):
            return f"{kind.text} {name};"
        own = c_type(kind)
        if is_nd(kind):
            return f"nd {name} = nd_none;"
        if is_number(kind):
            return f"{own} {name} = {({FLOAT: '0.0', INT: '0', BOOL: 'false'})[kind]};"  # type: ignore[index]
        if name in self.zeroed:
            return f"{own} {name}; memset(&{name}, 0, sizeof {name});"
        return f"{own} {name};"

    def _failure(self, kind: Kind) -> list[str]:
        if kind == NOTHING:
            return ["return;"]
        if is_nd(kind):
            return ["return nd_none;"]
        if is_number(kind):
            return [f"return {({FLOAT: 'NAN', INT: '0', BOOL: 'false'})[kind]};"]  # type: ignore[index]
        return [f"{{ {c_type(kind)} none_; memset(&none_, 0, sizeof none_); return none_; }}"]


def _only_written(name: str, lines: Sequence[str]) -> bool:
    """Return whether no line reads a variable, as that of a key of a cache."""
    pattern = re.compile(rf"\b{name}\b")
    return not any(pattern.search(line.removeprefix(f"{name} = ")) for line in lines)


def holds_memory(program: Program, kind: Kind) -> bool:
    """Return whether values of a type point to memory of the block."""
    match kind:
        case Array() | ComplexArray():
            return True
        case Listing(element):
            return element != TEXT
        case Maybe(value):
            return holds_memory(program, value)
        case Pack(elements):
            return any(holds_memory(program, element) for element in elements)
        case Structure(name):
            return any(holds_memory(program, field.kind) for field in program.structure(name).fields.values())
    return False


def keeper(kind: Kind) -> str:
    """Return the name of the function that keeps a value."""
    return "nd_keep_array" if is_nd(kind) else f"keep_{word(kind)}"


__all__ = ["NUMBERS", "Module", "World", "Writer", "holds_memory", "keeper"]
