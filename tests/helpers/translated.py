"""Translated functions, compiled as one library and called beside their twins in Python.

Arguments come from runs of the twins: `Recorder` keeps the arguments and results of calls while something runs.
"""

from __future__ import annotations

import copy
import ctypes
import re
import shutil
import subprocess
import sys
from collections import defaultdict
from collections.abc import Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ndob_fmu.native.runtime_code import ARRAY_FILES
from ndob_fmu.native.translate import kinds
from ndob_fmu.native.translate.kinds import c_type, is_nd, is_numbers
from ndob_fmu.native.translate.print_c import Translation
from ndob_fmu.native.translate.program import Definition
from ndob_fmu.native.translate.values import c_name
from ndob_fmu.runtime import base_errors
from ndob_fmu.runtime.memo import SharedResults

SOURCES = ARRAY_FILES[0].parent
FLAGS = ("-std=c99", "-O2", "-ffp-contract=off", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Werror")
MEMORY = 1 << 26
ERRORS = (
    None,
    np.linalg.LinAlgError,
    base_errors.DesignError,
    base_errors.AssumptionError,
    base_errors.IntegrationError,
    ArithmeticError,
)
_SIMPLE = {"double": ctypes.c_double, "int": ctypes.c_int, "bool": ctypes.c_bool, "const char *": ctypes.c_char_p}


class Nd(ctypes.Structure):
    _fields_ = [
        ("p", ctypes.POINTER(ctypes.c_double)),
        ("n", ctypes.c_int * 3),
        ("s", ctypes.c_int16 * 3),
        ("rank", ctypes.c_int16),
    ]


class Slice(ctypes.Structure):
    _fields_ = [("start", ctypes.c_int), ("stop", ctypes.c_int)]


class Arena(ctypes.Structure):
    _fields_ = [
        ("base", ctypes.c_void_p),
        ("size", ctypes.c_size_t),
        ("used", ctypes.c_size_t),
        ("full", ctypes.c_void_p),
        ("error", ctypes.c_int),
        ("message", ctypes.c_char_p),
    ]


CALLBACK = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.POINTER(ctypes.c_void_p), ctypes.c_void_p)


def compiler() -> str:
    found = shutil.which("gcc") or shutil.which("cc")
    assert found, "no C compiler"
    return found


class Library:
    """A translation as a shared library."""

    def __init__(self, translation: Translation, folder: Path) -> None:
        self.translation, self.program = translation, translation.program
        self._types: dict[str, Any] = {"nd": ctypes.POINTER(Nd), "nd_slice": Slice}
        self._alive: list[Any] = []
        functions = self._function_kinds()
        (folder / "translated.h").write_text(translation.header, "utf-8")
        (folder / "translated.c").write_text(translation.source, "utf-8")
        (folder / "bridge.c").write_text(bridge(functions), "utf-8")
        sources = [folder / "translated.c", folder / "bridge.c", *ARRAY_FILES]
        command = [
            compiler(),
            *FLAGS,
            "-shared",
            "-fPIC",
            f"-I{SOURCES}",
            f"-I{folder}",
            *map(str, sources),
            "-lm",
            "-o",
            str(folder / "t.so"),
        ]
        subprocess.run(command, check=True)
        self.library = ctypes.CDLL(str(folder / "t.so"))
        self.block = ctypes.create_string_buffer(MEMORY)
        self.message = ctypes.create_string_buffer(300)
        self.arena = Arena()

    def _function_kinds(self) -> list[kinds.Function]:
        names = set(re.findall(r"struct (f_\w+) \{", self.translation.header))
        found: dict[str, kinds.Function] = {}

        def visit(kind: Any) -> None:
            if isinstance(kind, kinds.Function) and c_type(kind) in names:
                found[c_type(kind)] = kind
            if isinstance(kind, kinds.Structure):
                if kind.name not in seen:
                    seen.add(kind.name)
                    for field in self.program.structure(kind.name).fields.values():
                        visit(field.kind)
            else:
                for part in kinds.parts(kind):
                    visit(part)

        seen: set[str] = set()
        for one in self.translation.definitions:
            for parameter in one.parameters:
                visit(parameter.kind)
        return list(found.values())

    def type_of(self, kind: Any) -> Any:
        name = c_type(kind)
        if name in _SIMPLE:
            return _SIMPLE[name]
        if name not in self._types:
            made = type(name, (ctypes.Structure,), {})
            self._types[name] = made
            if isinstance(kind, kinds.Listing):
                made._fields_ = [("n", ctypes.c_int), ("p", ctypes.POINTER(self.type_of(kind.element)))]
                return made
            if isinstance(kind, kinds.Table):
                pointer = ctypes.POINTER(self.type_of(kind.value))
                made._fields_ = [("n", ctypes.c_int), ("names", ctypes.POINTER(ctypes.c_char_p)), ("p", pointer)]
                return made
            made._fields_ = [(c_name(field), self.type_of(own)) for field, own in self._fields(kind)]
        return self._types[name]

    def _fields(self, kind: Any) -> list[tuple[str, Any]]:
        match kind:
            case kinds.Structure(name):
                fields = self.program.structure(name).fields.values()
                return [(one.name, one.kind) for one in fields if not isinstance(one.kind, kinds.Unknown)]
            case kinds.Pack(elements):
                return [(f"v{i}", one) for i, one in enumerate(elements)]
            case kinds.ComplexArray():
                return [("v0", kinds.ARRAY), ("v1", kinds.ARRAY)]
            case kinds.Maybe(value):
                return [("some", kinds.BOOL), ("value", value)]
            case kinds.Function():
                return [("call", kinds.TEXT), ("env", kinds.TEXT)]
        raise AssertionError(kind)

    def to_c(self, value: Any, kind: Any) -> Any:
        """Return a value of Python as one of C; its memory stays alive until the next call."""
        if is_nd(kind):
            return self._nd(value)
        if isinstance(kind, kinds.Maybe):
            made = self.type_of(kind)()
            made.some = value is not None
            if value is not None:
                made.value = self.to_c(value, kind.value)
            return made
        if kind == kinds.SLICE:
            return Slice(value.start, value.stop)
        if kind == kinds.TEXT:
            return value.encode()
        if isinstance(kind, kinds.Simple):
            return value
        if isinstance(kind, kinds.Listing):
            return self._list(value, kind)
        if isinstance(kind, kinds.Function):
            return self._function(value, kind)
        if isinstance(kind, kinds.Table):
            return self._table(value, kind)
        made = self.type_of(kind)()
        if isinstance(kind, kinds.ComplexArray):
            value = (np.real(value), np.imag(value))
        for i, (name, own) in enumerate(self._fields(kind)):
            item = value[i] if isinstance(kind, (kinds.Pack, kinds.ComplexArray)) else getattr(value, name)
            setattr(made, c_name(name) if isinstance(kind, kinds.Structure) else name, self.to_c(item, own))
        return made

    def _nd(self, value: Any) -> Any:
        if value is None:
            return None
        array = np.ascontiguousarray(np.array(value, dtype=float))
        self._alive.append(array)
        lengths, strides = [*array.shape, 1, 1, 1][:3], [*(s // 8 for s in array.strides), 1, 1, 1][:3]
        pointer = array.ctypes.data_as(ctypes.POINTER(ctypes.c_double))
        made = Nd(pointer, (ctypes.c_int * 3)(*lengths), (ctypes.c_int16 * 3)(*strides), array.ndim)
        self._alive.append(made)
        return ctypes.pointer(made)

    def _list(self, value: Any, kind: kinds.Listing) -> Any:
        element = self.type_of(kind.element)
        items = (element * max(len(value), 1))(*(self.to_c(item, kind.element) for item in value))
        self._alive.append(items)
        return self.type_of(kind)(len(value), ctypes.cast(items, ctypes.POINTER(element)))

    def _table(self, value: Any, kind: kinds.Table) -> Any:
        names = (ctypes.c_char_p * max(len(value), 1))(*(name.encode() for name in value))
        self._alive.append(names)
        made, element = self.type_of(kind)(), self.type_of(kind.value)
        values = (element * max(len(value), 1))(*(self.to_c(item, kind.value) for item in value.values()))
        self._alive.append(values)
        made.n, made.p = len(value), ctypes.cast(values, ctypes.POINTER(element))
        made.names = ctypes.cast(names, ctypes.POINTER(ctypes.c_char_p))
        return made

    def _function(self, value: Any, kind: kinds.Function) -> Any:
        def call(arguments: Any, result: int) -> int:
            given = [
                self.from_c(ctypes.cast(arguments[i], ctypes.POINTER(self.type_of(one)))[0], one)
                for i, one in enumerate(kind.arguments)
            ]
            given = [objects(self.program, one, own) for one, own in zip(given, kind.arguments, strict=True)]
            try:
                made = self.to_c(value(*given), kind.result)
            except (ArithmeticError, ValueError):
                return 0
            ctypes.cast(result, ctypes.POINTER(self.type_of(kind.result)))[0] = made
            return 1

        callback = CALLBACK(call)
        self._alive.append(callback)
        made = self.type_of(kind)()
        made.call = ctypes.cast(getattr(self.library, f"bridge_{c_type(kind)}"), ctypes.c_char_p)
        pointer = ctypes.cast(callback, ctypes.c_void_p)
        ctypes.memmove(
            ctypes.addressof(made),
            ctypes.byref(ctypes.cast(getattr(self.library, f"bridge_{c_type(kind)}"), ctypes.c_void_p)),
            8,
        )
        ctypes.memmove(ctypes.addressof(made) + 8, ctypes.byref(pointer), 8)
        return made

    def from_c(self, value: Any, kind: Any) -> Any:
        """Return a value of C as numbers, arrays, lists, and dictionaries for structures."""
        if is_nd(kind):
            return self._array(value, kind)
        if isinstance(kind, kinds.Maybe):
            return self.from_c(value.value, kind.value) if value.some else None
        if kind == kinds.SLICE:
            return slice(value.start, value.stop)
        if isinstance(kind, kinds.Simple):
            return value
        if isinstance(kind, kinds.Listing):
            return [self.from_c(value.p[i], kind.element) for i in range(value.n)]
        if isinstance(kind, (kinds.Function, kinds.Table)):
            return None
        if isinstance(kind, kinds.ComplexArray):
            return self.from_c(value.v0, kinds.ARRAY) + 1j * self.from_c(value.v1, kinds.ARRAY)
        named = {
            name: self.from_c(getattr(value, c_name(name) if isinstance(kind, kinds.Structure) else name), own)
            for name, own in self._fields(kind)
        }
        return list(named.values()) if isinstance(kind, kinds.Pack) else named

    def _array(self, pointer: Any, kind: Any) -> Any:
        if not pointer:
            return None
        value = pointer.contents
        shape, strides = value.n[: value.rank], [8 * s for s in value.s[: value.rank]]
        if 0 in shape:
            array = np.zeros(shape)
        else:
            reach = 1 + sum((n - 1) * s // 8 for n, s in zip(shape, strides, strict=True))
            flat = np.ctypeslib.as_array(value.p, shape=(reach,))
            array = np.lib.stride_tricks.as_strided(flat, shape, strides).copy()
        return array

    def call(self, definition: Definition, arguments: Sequence[Any]) -> Any:
        """Call a translated function. Raises what its twin raises."""
        self._alive.clear()
        function = getattr(self.library, definition.name)
        self.library.nd_start(ctypes.byref(self.arena), self.block, ctypes.c_size_t(MEMORY))
        self.arena.message = ctypes.cast(self.message, ctypes.c_char_p)
        given: list[Any] = [ctypes.byref(self.arena)]
        types: list[Any] = [ctypes.c_void_p]
        for value, parameter in zip(arguments, definition.parameters, strict=True):
            own = self.to_c(value, parameter.kind)
            if kinds.by_pointer(parameter.kind):
                self._alive.append(own)
                given.append(ctypes.byref(own))
                types.append(ctypes.c_void_p)
            else:
                given.append(own)
                types.append(self.type_of(parameter.kind))
        function.argtypes = types
        nothing = definition.result == kinds.NOTHING
        function.restype = None if nothing else self.type_of(definition.result)
        result = function(*given)
        if self.arena.error:
            raise ERRORS[self.arena.error](self.arena.message.decode())
        return None if nothing else self.from_c(result, definition.result)


def bridge(functions: Sequence[kinds.Function]) -> str:
    """Return C that calls functions of Python: arguments and result go by address."""
    lines = ['#include "translated.h"', "typedef int (*callback)(const void **, void *);"]
    for kind in functions:
        given = [
            f"const {c_type(one)} *a{i}" if kinds.by_pointer(one) else f"{c_type(one)} a{i}"
            for i, one in enumerate(kind.arguments)
        ]
        places = [f"a{i}" if kinds.by_pointer(one) else f"&a{i}" for i, one in enumerate(kind.arguments)]
        own = c_type(kind.result)
        head = f"{own} bridge_{c_type(kind)}({', '.join(['nd_arena *arena', 'const void *env', *given])})"
        lines.append(f"{head};")
        lines.append(
            f"{head} {{ {own} r; const void *at[] = {{{', '.join(places)}}}; callback f; memset(&r, 0, sizeof r); "
            f'memcpy(&f, &env, sizeof f); if (!f(at, &r)) nd_raise(arena, ND_ARITHMETIC, "no value"); return r; }}'
        )
    return "\n".join(lines) + "\n"


def objects(program: Any, value: Any, kind: Any) -> Any:
    """Return a value from C in the form in which a function of Python takes it."""
    if isinstance(kind, kinds.Structure):
        known = program.structure(kind.name)
        made = getattr(known.module.live, kind.name)
        return made(**{name: objects(program, value[name], known.fields[name].kind) for name in value})
    if is_numbers(kind) and value is not None:
        return tuple(value.tolist())
    if isinstance(kind, kinds.Maybe) and value is not None:
        return objects(program, value, kind.value)
    if isinstance(kind, kinds.Listing) and not is_nd(kind):
        return [objects(program, one, kind.element) for one in value]
    if isinstance(kind, kinds.Pack):
        return tuple(objects(program, one, own) for one, own in zip(value, kind.elements, strict=True))
    return value


@dataclass(frozen=True)
class Recorded:
    """A call of a function of Python: its arguments, and its result or what it raised."""

    arguments: tuple[Any, ...]
    result: Any
    error: type[BaseException] | None = None


class Recorder:
    """Records some calls of the twins of translated functions in each run: `KEPT`, counted from 1."""

    KEPT = frozenset({1, 2, 4, 9, 31, 42, 52, 56, 65, 79, 88, 100})

    def __init__(self, definitions: Sequence[Definition]) -> None:
        self._by_code = {code_of(one): one for one in definitions}
        self.calls: dict[str, list[Recorded]] = defaultdict(list)
        self._seen: dict[str, int] = defaultdict(int)
        self._open: dict[int, tuple[Definition, tuple[Any, ...]]] = {}

    @contextmanager
    def running(self):
        self._seen.clear()
        sys.setprofile(self._event)
        try:
            yield
        finally:
            sys.setprofile(None)

    def _event(self, frame: Any, event: str, argument: Any) -> None:
        definition = self._by_code.get(frame.f_code)
        if definition is None:
            return
        where = definition.where
        if event == "call":
            self._seen[where] += 1
            if self._seen[where] in self.KEPT:
                given = tuple(copied(frame.f_locals[one.name]) for one in definition.parameters)
                self._open[id(frame)] = definition, given
        elif event == "return" and id(frame) in self._open:
            _, given = self._open.pop(id(frame))
            self.calls[where].append(Recorded(given, copied(argument)))


def forget_results(definitions: Sequence[Definition]) -> None:
    """Empty all caches, so that runs call what others have called before."""
    for module in {one.module.name: one.module.live for one in definitions}.values():
        for value in vars(module).values():
            if isinstance(value, SharedResults):
                value._answer.cache_clear()
            elif hasattr(value, "cache_clear"):
                value.cache_clear()


def copied(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return value.copy()
    if isinstance(value, list):
        return [copied(item) for item in value]
    return copy.copy(value) if type(value).__name__ == "ndarray" else value


def code_of(definition: Definition) -> Any:
    """Return the code of a function's twin."""
    live = definition.module.live
    found = (
        vars(getattr(live, definition.owner))[definition.node.name]
        if definition.owner
        else getattr(live, definition.node.name)
    )
    for name in ("fget", "func", "__wrapped__"):
        found = getattr(found, name, found)
    while hasattr(found, "__wrapped__"):
        found = found.__wrapped__
    return found.__code__


def difference(twin: Any, own: Any) -> float:
    """Return the largest difference of two results, over the largest number in the same array; ∞ for other forms."""
    if twin is None or own is None:
        return 0.0 if twin is None and own is None else np.inf
    if isinstance(own, dict):
        return max(
            (
                difference(getattr(twin, name), value)
                for name, value in own.items()
                if not callable(getattr(twin, name)) and not isinstance(getattr(twin, name), Mapping)
            ),
            default=0.0,
        )
    if isinstance(twin, slice):
        return 0.0 if (twin.start, twin.stop) == (own.start, own.stop) else np.inf
    if isinstance(own, list):
        return max((difference(one, other) for one, other in zip(twin, own, strict=True)), default=0.0)
    if isinstance(twin, (str, bytes)):
        return 0.0
    if isinstance(own, np.ndarray) and own.dtype.kind == "c":
        return difference([twin.real, twin.imag], [own.real, own.imag])
    one, other = np.asarray(twin, dtype=float), np.asarray(own, dtype=float)
    if one.shape != other.shape:
        return np.inf
    if np.array_equal(one, other, equal_nan=True):
        return 0.0
    finite = np.isfinite(one)
    if not np.array_equal(finite, np.isfinite(other)) or not np.array_equal(
        one[~finite], other[~finite], equal_nan=True
    ):
        return np.inf
    one, other = one[finite], other[finite]
    return float(np.max(np.abs(one - other)) / max(np.max(np.abs(one)), 1e-300))
