"""Many C sources as one: everything in it is static, and only what is used is left."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence

_COMMENT = re.compile(r"(?s)/\*.*?\*/")
# The head of a function at the beginning of a line: a type, a name, and arguments up to a brace or a semicolon.
_HEAD = re.compile(
    r"(?m)^(?!typedef|static const|#|return|else|extern)(?:static )?(?:inline )?"
    r"(?P<type>(?:const )?[A-Za-z_]\w* \**)(?P<name>[A-Za-z_]\w*)\((?P<arguments>[^;{}]*)\)(?P<end>;| \{)"
)

_CONSTANT = re.compile(r"(?m)^static const \w+ \*?(?:const )?(\w+)(?:\[\w*\])* = [^;]*;\n")


def joined(sources: Sequence[str], root: str) -> str:
    """Return the sources, without the functions that neither the text `root` nor a function that is left uses, and
    without declarations of functions that nothing uses before they are defined.

    Each source comes behind those whose declarations it needs. Functions begin at the beginning of a line, and end with
    a brace there.
    """
    text = "\n".join(re.sub(r'(?m)^#include "[^"]*"\n', "", source) for source in sources)
    text = re.sub(r"(?m)^extern const .*\n", "", text)
    text = re.sub(r"(?m)^const (?=[a-z]+ \w+ = )", "static const ", text)
    pieces = _pieces(text)
    bodies = {name: piece for name, piece in pieces if name and piece.rstrip().endswith("}")}
    between = "\n".join(piece for name, piece in pieces if not name)
    kept = _reached(bodies, f"{root}\n{re.sub(_COMMENT, '', between)}")
    pieces = _without_needless_declarations([(name, piece) for name, piece in pieces if not name or name in kept])
    whole = re.sub(r"\n{3,}", "\n\n", "".join(_static(piece) if name else piece for name, piece in pieces))
    return _without_unused_constants(whole, root)


def _without_unused_constants(text: str, root: str) -> str:
    used = re.findall(r"\w+", re.sub(_COMMENT, "", text + root))
    once = {word for word, count in Counter(used).items() if count == 1}
    return re.sub(
        r"(?m)^static const \w+ \*?(?:const )?(\w+)(?:\[\w*\])* = [^;]*;\n",
        lambda found: "" if found[1] in once else found[0],
        text,
    )


def _pieces(text: str) -> list[tuple[str, str]]:
    """Return the text in pieces: functions and their declarations by name, and what is between them without one."""
    found, place = list[tuple[str, str]](), 0
    for head in _HEAD.finditer(text):
        if head.start() < place:
            continue
        found.append(("", text[place : head.start()]))
        if head["end"] == ";":
            place = head.end()
        else:
            line = text[head.start() : text.index("\n", head.start())]
            one_line = line.endswith("}") and line.count("{") == line.count("}")
            place = head.start() + len(line) if one_line else text.index("\n}", head.start()) + 2
        found.append((head["name"], text[head.start() : place]))
    return [*found, ("", text[place:])]


def _without_needless_declarations(pieces: Sequence[tuple[str, str]]) -> list[tuple[str, str]]:
    defined: set[str] = set()
    needed: dict[str, int] = {}  # by function, the declaration that something behind it uses before the definition
    declared: dict[str, int] = {}
    for place, (name, piece) in enumerate(pieces):
        is_declaration = bool(name) and piece.endswith(";")
        if is_declaration:
            declared.setdefault(name, place)
            continue
        for word in set(re.findall(r"[A-Za-z_]\w*", piece)) & declared.keys() - defined - {name}:
            needed.setdefault(word, declared[word])
        if name:
            defined.add(name)
    kept = set(needed.values())
    return [
        (name, piece)
        for place, (name, piece) in enumerate(pieces)
        if not (name and piece.endswith(";")) or place in kept
    ]


def _reached(bodies: dict[str, str], root: str) -> set[str]:
    kept: set[str] = set()
    waiting = [root]
    while waiting:
        for word in set(re.findall(r"[A-Za-z_]\w*", waiting.pop())):
            if word in bodies and word not in kept:
                kept.add(word)
                waiting.append(bodies[word])
    return kept


def _static(piece: str) -> str:
    return piece if piece.startswith("static ") else f"static {piece}"
