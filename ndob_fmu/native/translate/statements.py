"""Statements of Python in C.

An iteration of a loop gives back the memory that it took when it ends. What is used later stays (`nd_keep`).
"""

from __future__ import annotations

import ast
import re
from collections.abc import Sequence

from ndob_fmu.native.translate.assignments import Assignments
from ndob_fmu.native.translate.kinds import (
    INT,
    NOTHING,
    TEXT,
    Function,
    Kind,
    Unknown,
    is_nd,
    word,
)
from ndob_fmu.native.translate.library import ERRORS
from ndob_fmu.native.translate.values import c_name, in_parentheses
from ndob_fmu.native.translate.world import World, holds_memory, keeper

_RELEASE = "/* release "
GIVE_BACK = "arena->used = mark_;"


class Statements(Assignments):
    """The part of a function's writer that writes statements."""

    world: World
    opened: dict[int, tuple[set[str], int]]  # by loop: the variables before it, and the line where it begins

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

    def _if(self, node: ast.If) -> None:
        self.line(f"if {in_parentheses(self.truth(node.test))} {{")
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
        self.opened[self.count] = (set(self.variables), len(self.lines))

    def _close(self, node: ast.For | ast.While) -> None:
        self.statements(node.body)
        number = self.loops.pop()
        known, first = self.opened.pop(number)
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
        return f"for (nd_keeping k_ = nd_keep_begin(arena, {mark}); nd_keep_pass(&k_);) {{ {calls} }}"

    def _return(self, node: ast.Return) -> None:
        kind = self.definition.result
        if node.value is None:
            self.line(GIVE_BACK)
            self.line("return;")
            return
        if isinstance(kind, Function):
            raise self.no(node, "a result that is not a function, which lives no longer than what it captured")
        value = self.coerced(self.expression(node.value, kind), kind, node)
        if self.definition.where in self.world.unmoved:
            self.line(f"return {value.text};")
        elif is_nd(kind):
            self.line(f"return nd_keep(arena, mark_, {value.text});")
        elif not holds_memory(self.program, kind):
            name = self.temporary(kind)
            self.line(f"{name} = {value.text};")
            self.line(GIVE_BACK)
            self.line(f"return {name};")
        else:
            self.use(kind)
            self._leave_as_returned(value.text)
            name = value.text
            if name not in self.declared:
                name = self.temporary(kind)
                self.line(f"{name} = {value.text};")
            self.line(f"nd_keep_parts(arena, mark_, &{name}, keep_{word(kind)});")
            self.line(f"return {name};")

    def _leave_as_returned(self, name: str) -> None:
        """Hand a result of another function on without a copy where little was taken before that was called."""
        place = len(self.lines) - 1
        while place >= 0 and self.lines[place].startswith("if (arena->error)"):
            place -= 1
        if place >= 0 and name.isidentifier() and re.fullmatch(rf"{name} = \w+\(arena, .*\);", self.lines[place]):
            self.declared["before_"] = Unknown("size_t")
            self.lines.insert(place, "before_ = arena->used;")
            self.line(f"if (before_ - mark_ <= arena->size / 32) return {name};")

    def _holds(self, kind: Kind) -> bool:
        return holds_memory(self.program, kind)
