"""What the writers of all functions share: what has to be translated, which types, and which functions can raise."""

from __future__ import annotations

import ast

from ndob_fmu.native.translate.kinds import (
    ARRAY,
    BOOL,
    FLOAT,
    INT,
    SLICE,
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
    is_nd,
    word,
)
from ndob_fmu.native.translate.program import Definition, Program


class World:
    """What the writers of all functions share."""

    def __init__(self, program: Program, unmoved: frozenset[str]) -> None:
        self.program = program
        self.unmoved = unmoved
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

    def _kind(self, definition: Definition, node: ast.expr) -> Kind | None:
        """Return the type of a parameter, or of a field or property of one; None where it takes more to find out."""
        if isinstance(node, ast.Name):
            return next((one.kind for one in definition.parameters if one.name == node.id), None)
        of = self._kind(definition, node.value) if isinstance(node, ast.Attribute) else None
        if not (isinstance(of, Structure) and isinstance(node, ast.Attribute)):
            return None
        own = self.program.structure(of.name)
        if node.attr in own.properties:
            return own.methods[node.attr].result
        return own.fields[node.attr].kind if node.attr in own.fields else None

    def _node_fails(self, definition: Definition, node: ast.AST) -> bool:
        if isinstance(node, ast.Raise):
            return True
        if isinstance(node, ast.Call):
            text = ast.unparse(node.func)
            if text == "int":  # of a number that is not finite
                given = node.args[0]
                whole = given.value if isinstance(given, ast.Attribute) else given
                return self._kind(definition, whole) not in (INT, BOOL, SLICE)
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
            of: Kind | None = self._kind(definition, node.value)
            if of in (FLOAT, INT, BOOL, SLICE, ARRAY):
                return False
            if isinstance(of, Structure):
                own = self.program.structure(of.name)
                if node.attr in own.methods:
                    return self.fails(own.methods[node.attr])
                if node.attr in own.fields:
                    return isinstance(own.fields[node.attr].kind, (Function, Maybe, Unknown))
            return any(self.fails(one) for one in self.program.methods_called(node.attr)) or self.program.has_function(
                node.attr
            )
        return False


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
