"""What the modules hold that are translated: functions, classes, constants, and the types that annotations name."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from importlib import import_module
from pathlib import Path
from typing import Any

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
    Structure,
    Table,
    Unknown,
    is_nd,
)
from ndob_fmu.native.translate.refusal import RefusedError, refused

_ROOT = Path(__file__).resolve().parents[3]
_SIMPLE: dict[str, Kind] = {
    "float": FLOAT,
    "int": INT,
    "bool": BOOL,
    "str": TEXT,
    "None": NOTHING,
    "slice": SLICE,
    "Array": ARRAY,
    "NDArray[np.float64]": ARRAY,
    "NDArray[np.bool_]": Array(BOOL),
    "NDArray[np.intp]": Array(INT),
    "NDArray[np.complex128]": ComplexArray(),
}


@dataclass(frozen=True)
class Parameter:
    """A parameter of a function, or a field of a class; `default` is None where it has no default."""

    name: str
    kind: Kind
    default: ast.expr | None


@dataclass(frozen=True)
class Definition:
    """A function or a method; `name` is its name in C, `owner` the class of a method."""

    name: str
    module: Module
    node: ast.FunctionDef
    owner: str | None
    parameters: tuple[Parameter, ...]
    result: Kind

    @property
    def where(self) -> str:
        """Its name for people: module and name in Python."""
        return f"{self.module.name}.{f'{self.owner}.' if self.owner else ''}{self.node.name}"


@dataclass
class Class:
    """A dataclass or a named tuple."""

    name: str
    module: Module
    is_tuple: bool
    fields: dict[str, Parameter] = field(default_factory=dict)
    methods: dict[str, Definition] = field(default_factory=dict)
    properties: set[str] = field(default_factory=set)


class Module:
    """A module of the package, as a tree."""

    def __init__(self, name: str) -> None:
        self.name = name
        path = _ROOT / f"{name.replace('.', '/')}.py"
        self.file = path.name
        self.tree = ast.parse(path.read_text("utf-8"))
        self.own: dict[str, ast.stmt] = {}
        self.imported: dict[str, tuple[str, str]] = {}
        for node in self.tree.body:
            if isinstance(node, ast.ImportFrom):
                self.imported |= {alias.asname or alias.name: (node.module or "", alias.name) for alias in node.names}
            self.own |= dict.fromkeys(_defined(node), node)

    @cached_property
    def live(self) -> Any:
        """The imported module, which knows the values of its constants."""
        return import_module(self.name)


def _defined(node: ast.stmt) -> Iterator[str]:
    if isinstance(node, (ast.FunctionDef, ast.ClassDef)):
        yield node.name
    elif isinstance(node, ast.Assign):
        for target in node.targets:
            yield from (part.id for part in ast.walk(target) if isinstance(part, ast.Name))
    elif isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
        yield node.target.id


class Program:
    """All modules that were asked for or that these use."""

    def __init__(self) -> None:
        self._modules: dict[str, Module] = {}
        self._classes: dict[str, Class] = {}
        self._definitions: dict[tuple[str, str], Definition] = {}

    def module(self, name: str) -> Module:
        """Return a module of the package by its full name."""
        if name not in self._modules:
            self._modules[name] = Module(name)
        return self._modules[name]

    def resolve(self, module: Module, name: str) -> tuple[Module, str] | None:
        """Return the module of the package that defines what a module knows by a name, and its name there."""
        while name not in module.own:
            if name not in module.imported:
                return None
            source, name = module.imported[name]
            if not source.startswith("ndob_fmu."):
                return None
            module = self.module(source)
        return module, name

    def outside(self, module: Module, name: str) -> str | None:
        """Return the full name of what a module imports from outside the package."""
        source, own = module.imported.get(name, (None, ""))
        return None if source is None or source.startswith("ndob_fmu.") else f"{source}.{own}"

    def definition(self, module: Module, name: str) -> Definition | None:
        """Return the function that a module knows by a name."""
        found = self.resolve(module, name)
        if found is None or not isinstance(found[0].own[found[1]], ast.FunctionDef):
            return None
        module, name = found
        if (module.name, name) not in self._definitions:
            node = module.own[name]
            assert isinstance(node, ast.FunctionDef)
            own = f"{module.name.rpartition('.')[2]}_{name}"
            self._definitions[module.name, name] = self._read(own, module, node, None)
        return self._definitions[module.name, name]

    def class_of(self, module: Module, name: str) -> Class | None:
        """Return the class that a module knows by a name, where it is a dataclass or a named tuple."""
        found = self.resolve(module, name)
        if found is None:
            return None
        node = found[0].own[found[1]]
        if not isinstance(node, ast.ClassDef):
            return None
        is_tuple = any(ast.unparse(base) == "NamedTuple" for base in node.bases)
        if not is_tuple and not any("dataclass" in ast.unparse(one) for one in node.decorator_list):
            return None
        known = self._classes.get(node.name)
        if known is None:
            known = self._classes[node.name] = Class(node.name, found[0], is_tuple)
            self._fill(known, node)
        elif known.module is not found[0]:
            raise refused(found[0].file, node, "one class of each name", f"a second {node.name}")
        return known

    def methods_called(self, name: str) -> list[Definition]:
        """Return all methods of a name, of the classes that are known already."""
        return [known.methods[name] for known in self._classes.values() if name in known.methods]

    def has_function(self, name: str) -> bool:
        """Return whether a class that is known already has a field of this name that is a function."""
        return any(name in one.fields and isinstance(one.fields[name].kind, Function) for one in self._classes.values())

    def structure(self, name: str) -> Class:
        """Return a class that is known already."""
        return self._classes[name]

    def _fill(self, known: Class, node: ast.ClassDef) -> None:
        for base in node.bases:
            parent = self.class_of(known.module, base.id) if isinstance(base, ast.Name) else None
            if parent is not None:
                known.fields |= parent.fields
                known.methods |= parent.methods
                known.properties |= parent.properties
        for item in node.body:
            if isinstance(item, ast.AnnAssign) and isinstance(item.target, ast.Name):
                default = None if item.value is None or _is_field_without_default(item.value) else item.value
                kind = self.kind_of(known.module, item.annotation)
                known.fields[item.target.id] = Parameter(item.target.id, kind, default)
        for item in node.body:
            if isinstance(item, ast.FunctionDef):
                known.methods[item.name] = self._read(f"{known.name}_{item.name}", known.module, item, known.name)
                if {ast.unparse(one) for one in item.decorator_list} & {"property", "cached_property"}:
                    known.properties.add(item.name)

    def _read(self, name: str, module: Module, node: ast.FunctionDef, owner: str | None) -> Definition:
        given = node.args
        defaults: dict[str, ast.expr | None] = {}
        for argument, default in zip(given.args[::-1], given.defaults[::-1], strict=False):
            defaults[argument.arg] = default
        defaults |= {
            argument.arg: default for argument, default in zip(given.kwonlyargs, given.kw_defaults, strict=True)
        }
        parameters = []
        for place, argument in enumerate([*given.args, *given.kwonlyargs]):
            own = place == 0 and owner is not None
            kind = Structure(owner) if own and owner else self.kind_of(module, argument.annotation)
            parameters.append(Parameter(argument.arg, kind, defaults.get(argument.arg)))
        if given.vararg or given.kwarg:
            parameters.append(Parameter("*", Unknown("* or **"), None))
        return Definition(name, module, node, owner, tuple(parameters), self.kind_of(module, node.returns))

    def kind_of(self, module: Module, annotation: ast.expr | None) -> Kind:
        """Return the type that an annotation names; `Unknown` where there is no translation of it."""
        if annotation is None:
            return NOTHING
        text = ast.unparse(annotation)
        if text in _SIMPLE:
            return _SIMPLE[text]
        if isinstance(annotation, ast.Constant) and isinstance(annotation.value, str):
            return self.kind_of(module, ast.parse(annotation.value, mode="eval").body)
        if isinstance(annotation, ast.BinOp):
            return self._either(module, annotation)
        if isinstance(annotation, ast.Subscript):
            return self._with_arguments(module, annotation)
        if isinstance(annotation, ast.Name):
            if self.class_of(module, annotation.id) is not None:
                return Structure(annotation.id)
            found = self.resolve(module, annotation.id)
            node = None if found is None else found[0].own[found[1]]
            if found is not None and isinstance(node, (ast.Assign, ast.AnnAssign)) and node.value is not None:
                if isinstance(node.value, ast.Call) and ast.unparse(node.value).startswith("TypeVar("):
                    return ARRAY if len(node.value.args) + len(node.value.keywords) == 1 else Unknown(text)
                return self.kind_of(found[0], node.value)
        return Unknown(text)

    def _either(self, module: Module, node: ast.BinOp) -> Kind:
        left, right = self.kind_of(module, node.left), self.kind_of(module, node.right)
        if right == NOTHING and not isinstance(left, Unknown):
            return Maybe(left)
        if is_nd(left) and is_nd(right):
            return NUMBERS
        return Unknown(ast.unparse(node))

    def _with_arguments(self, module: Module, node: ast.Subscript) -> Kind:
        name = ast.unparse(node.value)
        inner = node.slice.elts if isinstance(node.slice, ast.Tuple) else [node.slice]
        if name == "Callable" and isinstance(inner[0], ast.List):
            kinds = [self.kind_of(module, one) for one in [*inner[0].elts, inner[1]]]
            if not any(isinstance(kind, Unknown) for kind in kinds):
                return Function(tuple(kinds[:-1]), kinds[-1])
        if isinstance(node.value, ast.Name) and self.resolve(module, name) is not None:
            return self.kind_of(module, node.value)  # a generic type, whose variable stands for an array
        if name in ("list", "Sequence") or (name == "tuple" and ast.unparse(inner[-1]) == "..."):
            element = self.kind_of(module, inner[0])
            return Unknown(ast.unparse(node)) if isinstance(element, Unknown) else Listing(element)
        if name == "Mapping" and ast.unparse(inner[0]) == "str":
            value = self.kind_of(module, inner[1])
            return Unknown(ast.unparse(node)) if isinstance(value, Unknown) else Table(value)
        if name == "tuple":
            elements = tuple(self.kind_of(module, one) for one in inner)
            if not any(isinstance(element, Unknown) for element in elements):
                return Pack(elements)
        return Unknown(ast.unparse(node))


def _is_field_without_default(value: ast.expr) -> bool:
    return isinstance(value, ast.Call) and ast.unparse(value.func) == "field" and "default" not in ast.unparse(value)


__all__ = ["Class", "Definition", "Module", "Parameter", "Program", "RefusedError"]
