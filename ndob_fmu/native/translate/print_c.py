"""All functions of some modules, and the types they need, as a header and a source of C99."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass

from ndob_fmu.native.translate.functions import Writer
from ndob_fmu.native.translate.kinds import (
    NOTHING,
    TEXT,
    Array,
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
    is_nd,
    is_number,
    parts,
    word,
)
from ndob_fmu.native.translate.program import Definition, Program
from ndob_fmu.native.translate.refusal import RefusedError
from ndob_fmu.native.translate.storage import copy_heads, form_heads, movers, storage
from ndob_fmu.native.translate.values import c_name
from ndob_fmu.native.translate.world import World

_PREDEFINED = ("nd", "nd_two", "nd_three", "nd_list", "nd_names", "nd_slice")


@dataclass(frozen=True)
class Translation:
    """What a program became.

    header, source: in C; the source includes the header by the name that `translate` was told
    definitions: the functions that were translated
    refused: for each function that was not, by module and name, why
    program: the modules
    """

    header: str
    source: str
    definitions: tuple[Definition, ...]
    refused: Mapping[str, str]
    program: Program


def translate(
    modules: Sequence[str],
    name: str,
    *,
    leave_out: Collection[str] = (),
    only: Collection[str] | None = None,
    copied: Sequence[str] = (),
    stored: Sequence[str] = (),
    unmoved: Collection[str] = (),
) -> Translation:
    """Return the functions and methods of modules, and all that these use, in C.

    leave_out: functions, by module and name, that are not tried unless others use them
    only: the functions, by module and name, that are tried besides those that they use; None: all
    copied: the classes with a function `copied_…`, which copies a value into another block of memory
    stored: the classes with functions `write_…`, `form_of_…` and `read_…`, for a value as numbers; see `storage`
    unmoved: the functions, by module and name, that leave it to their callers to give back the memory they took
    """
    program = Program()
    world = World(program, frozenset(unmoved))
    for one in modules:
        module = program.module(one)
        for own in module.own:
            definition = program.definition(module, own)
            if definition is not None:
                world.need(definition)
            known = program.class_of(module, own)
            if known is not None and known.module is module:
                for method in known.methods.values():
                    world.need(method)
    world.wanted = [one for one in world.wanted if one.where not in leave_out and (only is None or one.where in only)]
    texts, uses, refused = _texts(world)
    _without_dependents(texts, uses, refused)
    kinds = [kind for one in texts.values() for kind in one[1]]
    definitions = tuple(one for one in world.wanted if one.where in texts)
    header, source = _files(
        world, kinds, definitions, {key: text for key, (text, _) in texts.items()}, uses, name, copied, stored
    )
    return Translation(header, source, definitions, refused, program)


Texts = dict[str, tuple[str, list[Kind]]]


def _texts(world: World) -> tuple[Texts, dict[str, set[str]], dict[str, str]]:
    """Return the text and the kinds of each function, whom it uses, and which were refused."""
    texts: Texts = {}
    uses: dict[str, set[str]] = {}
    refused: dict[str, str] = {}
    place = 0
    while place < len(world.wanted):
        definition = world.wanted[place]
        place += 1
        world.kinds, world.used = [], set()
        writer = Writer(world, definition)
        try:
            text = writer.function()
        except RefusedError as error:
            refused[definition.where] = str(error)
            continue
        texts[definition.where] = text, world.kinds
        uses[definition.where] = world.used
    return texts, uses, refused


def _without_dependents(texts: Texts, uses: Mapping[str, set[str]], refused: dict[str, str]) -> None:
    """Take out the functions that use one that was refused."""
    while True:
        found = {one: missing for one in texts if (missing := sorted(uses[one] & refused.keys()))}
        if not found:
            return
        for one, missing in found.items():
            del texts[one]
            refused[one] = f"{one} uses {missing[0]}"


def _files(
    world: World,
    kinds: Iterable[Kind],
    definitions: Sequence[Definition],
    texts: Mapping[str, str],
    uses: Mapping[str, set[str]],
    name: str,
    copied: Sequence[str],
    stored: Sequence[str],
) -> tuple[str, str]:
    declared = _ordered(world.program, kinds)
    heads = [Writer(world, one).head() + ";" for one in definitions]
    thunks = [_thunk(one) for one in world.values.values() if one.where in texts]
    body = "\n".join([*thunks, *(_indented(texts[one]) for one in _callees_first(texts, uses))])
    guard = f"NDOB_{name.upper()}_H"
    header = [
        f"/* Translated from the runtime; do not edit. */\n#ifndef {guard}",
        f"#define {guard}",
        '#include "nd.h"',
        "",
    ]
    header += [f"typedef struct {c_type(kind)} {c_type(kind)};" for kind in declared if _is_struct(kind)]
    header += [text for kind in declared if (text := _declaration(world.program, kind))]
    of_storage = storage(world.program, stored)
    header += ["", *heads, *(f"{head};" for head in [*copy_heads(copied), *form_heads(stored)])]
    header += [*of_storage.heads, "", "#endif", ""]
    source = [f'/* Translated from the runtime; do not edit. */\n#include "{name}.h"', ""]
    source += ["#if !defined __GNUC__ || defined __clang__", "#pragma STDC FP_CONTRACT OFF", "#endif", ""]
    source += movers(world.program, declared, body, copied, stored)
    return "\n".join(header), "\n".join([*source, *of_storage.texts, body])


def _callees_first(texts: Mapping[str, str], uses: Mapping[str, set[str]]) -> list[str]:
    """Return the functions, each one behind those that it calls."""
    found: dict[str, None] = {}

    def visit(one: str) -> None:
        for used in sorted(uses[one]):
            if used != one and used in texts and used not in found:
                visit(used)
        found[one] = None

    for one in texts:
        if one not in found:
            visit(one)
    return list(found)


def _is_struct(kind: Kind) -> bool:
    return not isinstance(kind, Simple) and c_type(kind) not in _PREDEFINED


def _ordered(program: Program, kinds: Iterable[Kind]) -> list[Kind]:
    """Return all types, each one behind those that it contains."""
    found: list[Kind] = []
    open_: set[str] = set()

    def visit(kind: Kind) -> None:
        if isinstance(kind, Unknown) or is_nd(kind) or kind in found:
            return
        own = word(kind)
        if own in open_:
            return
        open_.add(own)
        inner = (
            [one.kind for one in program.structure(kind.name).fields.values()]
            if isinstance(kind, Structure)
            else parts(kind)
        )
        pointed = isinstance(kind, (Listing, Table, Function))
        if not pointed:
            for one in inner:
                visit(one)
        found.append(kind)
        if pointed:
            for one in inner:
                visit(one)

    for kind in kinds:
        visit(kind)
    unique: dict[str, Kind] = {}
    for kind in found:
        unique.setdefault(word(kind), kind)
    return list(unique.values())


def _declaration(program: Program, kind: Kind) -> str:
    if not _is_struct(kind):
        return ""
    own = c_type(kind)
    match kind:
        case Structure(name):
            fields = [one for one in program.structure(name).fields.values() if not isinstance(one.kind, Unknown)]
            inner = " ".join(f"{c_type(one.kind)} {c_name(one.name)};" for one in fields) or "int nothing;"
        case Pack(elements):
            inner = " ".join(f"{c_type(one)} v{i};" for i, one in enumerate(elements))
        case Table(value):
            inner = f"int n; const char *const *names; {c_type(value)} *p;"
        case Listing(element):
            inner = f"int n; {c_type(element)} *p;"
        case Maybe(value):
            inner = f"bool some; {c_type(value)} value;"
        case Function(arguments, result):
            given = ["nd_arena *", "const void *"]
            given += [f"const {c_type(one)} *" if by_pointer(one) else c_type(one) for one in arguments]
            inner = f"{c_type(result)} (*call)({', '.join(given)}); const void *env;"
        case _:
            raise AssertionError(kind)
    return f"struct {own} {{ {inner} }};"


def _thunk(definition: Definition) -> str:
    """Return a function of a module in the form of a function that is a value."""
    given = [
        f"const {c_type(one.kind)} *a{i}" if by_pointer(one.kind) else f"{c_type(one.kind)} a{i}"
        for i, one in enumerate(definition.parameters)
    ]
    names = ", ".join(["arena", *(f"a{i}" for i in range(len(given)))])
    result = "" if definition.result == NOTHING else "return "
    return (
        f"static {c_type(definition.result)} {definition.name}_value"
        f"({', '.join(['nd_arena *arena, const void *env', *given])}) {{\n"
        f"    (void)env;\n    {result}{definition.name}({names});\n}}\n"
    )


def _indented(text: str) -> str:
    """Return the text with its lines indented by their braces."""
    depth, lines = 0, []
    for line in text.splitlines():
        if not line:
            continue
        depth -= line.startswith("}")
        lines.append("    " * depth + line)
        depth += line.count("{") - line.count("}") + line.startswith("}")
    return "\n".join(lines) + "\n"


__all__ = ["TEXT", "Array", "Translation", "is_number", "translate"]
