"""How values move in memory, and how they become numbers.

A function's result moves to where its memory began (`keep_…`); what lasts is copied into a block of its own
(`copied_…`). A state that a host saves becomes numbers, one after the other, without pointers (`write_…`), and is read
into a value whose arrays have their shapes already (`form_of_…`, `read_…`): the shapes follow from the parameters
alone, and the arrays show the numbers where they lie.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from ndob_fmu.native.translate.kinds import (
    ARRAY,
    BOOL,
    INT,
    ComplexArray,
    Function,
    Kind,
    Listing,
    Maybe,
    Pack,
    Structure,
    Table,
    Unknown,
    c_type,
    is_nd,
    is_number,
    parts,
    word,
)
from ndob_fmu.native.translate.program import Program
from ndob_fmu.native.translate.refusal import RefusedError
from ndob_fmu.native.translate.values import c_name
from ndob_fmu.native.translate.world import holds_memory, keeper


def movers(
    program: Program, kinds: Sequence[Kind], body: str, copied: Sequence[str], stored: Sequence[str]
) -> list[str]:
    """Return the functions that keep or copy values of the types, as far as the functions call them."""
    by_word = {word(kind): kind for kind in kinds if holds_memory(program, kind)}
    needed: list[str] = []

    def visit(kind: Kind) -> None:
        if is_nd(kind) or not holds_memory(program, kind) or word(kind) in needed:
            return
        inner = (
            [one.kind for one in program.structure(kind.name).fields.values()]
            if isinstance(kind, Structure)
            else parts(kind)
        )
        for one in inner:
            visit(one)
        needed.append(word(kind))

    for one in [*copied, *stored, *re.findall(r"\bkeep_(\w+)", body)]:
        if one in by_word:
            visit(by_word[one])
    texts = [_keep(program, by_word[one]) for one in needed]
    return texts + [
        f"{head} {{\n    nd_keeping k = nd_{'copy' if head in copy_heads(copied) else 'forms'}_begin(to);\n"
        f"    keep_{head.split()[0]}(&k, &x);\n    return x;\n}}\n"
        for head in [*copy_heads(copied), *form_heads(stored)]
    ]


def copy_heads(copied: Sequence[str]) -> list[str]:
    """Return the heads of the functions that copy."""
    return [f"{name} copied_{name}(nd_arena *to, {name} x)" for name in copied]


def form_heads(stored: Sequence[str]) -> list[str]:
    """Return the heads of the functions that make a value of the same form, whose arrays show no numbers yet."""
    return [f"{name} form_of_{name}(nd_arena *to, {name} x)" for name in stored]


def _keep(program: Program, kind: Kind) -> str:
    head = f"static void keep_{word(kind)}(nd_keeping *k, void *place) {{\n    {c_type(kind)} *x = place;"
    if isinstance(kind, Listing):
        own = c_type(kind.element)
        each = ""
        if holds_memory(program, kind.element):
            each = f"    for (int i = 0; i < x->n; i++) {keeper(kind.element)}(k, &x->p[i]);\n"
        return (
            f"{head}\n    void *p = x->p;\n"
            f"    nd_keep_block(k, &p, sizeof({own}) * (size_t)x->n);\n    x->p = p;\n"
            f"{each}    nd_keep_shift(k, &p);\n    x->p = p;\n}}\n"
        )
    match kind:
        case Structure(name):
            fields = [(c_name(one.name), one.kind) for one in program.structure(name).fields.values()]
        case Pack(elements):
            fields = [(f"v{i}", one) for i, one in enumerate(elements)]
        case Maybe(value):
            fields = [("value", value)]
        case ComplexArray():
            fields = [("v0", ARRAY), ("v1", ARRAY)]
        case _:
            raise AssertionError(kind)
    lines = [f"    {keeper(own)}(k, &x->{one});" for one, own in fields if holds_memory(program, own)]
    if isinstance(kind, Maybe):
        lines.insert(0, "    if (!x->some) return;")
    return "\n".join([head, *lines, "}", ""])


@dataclass(frozen=True)
class Storage:
    """The heads and the texts of functions of C."""

    heads: list[str]
    texts: list[str]


def storage(program: Program, stored: Sequence[str]) -> Storage:
    """Return the functions that write and read values of classes as numbers. Raises RefusedError for other types."""
    names: list[str] = []

    def visit(kind: Kind) -> None:
        if isinstance(kind, Listing) and not is_nd(kind):
            visit(kind.element)
        if isinstance(kind, Structure) and kind.name not in names:
            for field in program.structure(kind.name).fields.values():
                visit(field.kind)
            names.append(kind.name)

    for name in stored:
        visit(Structure(name))
    texts = [text for name in names for text in _as_numbers(program, name)]
    heads = [f"double *write_{name}(double *to, const {name} *x);" for name in stored]
    heads += [f"const double *read_{name}(const double *from, {name} *x);" for name in stored]
    public = [text if text.split("(")[0].split("_", 1)[1] in stored else f"static {text}" for text in texts]
    return Storage(heads, public)


def _as_numbers(program: Program, name: str) -> tuple[str, str]:
    writes, reads = [], []
    for field in program.structure(name).fields.values():
        if isinstance(field.kind, (Unknown, Function, Table)):
            raise RefusedError(f"{name}.{field.name}: expected what can be stored as numbers, received {field.kind}")
        place = f"x->{c_name(field.name)}"
        write, read = _one(field.kind, place)
        writes.append(write)
        reads.append(read)
    return (
        "\n    ".join([f"double *write_{name}(double *to, const {name} *x) {{", *writes, "return to;\n}\n"]),
        "\n    ".join([f"const double *read_{name}(const double *from, {name} *x) {{", *reads, "return from;\n}\n"]),
    )


def _one(kind: Kind, place: str) -> tuple[str, str]:
    if is_nd(kind):
        return f"to = nd_write(to, {place});", f"from = nd_read(from, {place});"
    if is_number(kind):
        read = "nd_integer(*from++)" if kind == INT else "*from++ != 0.0" if kind == BOOL else "*from++"
        return f"*to++ = {place};", f"{place} = {read};"
    if isinstance(kind, Structure):
        return f"to = write_{kind.name}(to, &{place});", f"from = read_{kind.name}(from, &{place});"
    if isinstance(kind, Listing):
        write, read = _one(kind.element, f"{place}.p[i]")
        loop = f"for (int i = 0; i < {place}.n; i++) "
        return loop + write, loop + read
    raise RefusedError(f"{place}: expected what can be stored as numbers, received {kind}")
