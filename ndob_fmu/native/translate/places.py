"""Where variables of C are declared: where they are first written, if nothing outside that block uses them."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

_TEXT = re.compile(r'"(?:[^"\\]|\\.)*"')
_LOOP = re.compile(r"for \((\w+) = ")
_WRITTEN = re.compile(r"(\w+) = ")
_NAME = re.compile(r"(?<![.>])\b[A-Za-z_]\w*")  # not a field
_HANDED_ON = re.compile(r"\w+ = (t\d+_);")
_CHECK = "if (arena->error) goto failed_;"

Block = tuple[int, ...]


@dataclass(frozen=True)
class Placed:
    """A function's lines with the declarations that have a place among them, and the names that still need one."""

    lines: list[str]
    left: list[str]


def without_steps_between(lines: Sequence[str]) -> list[str]:
    """Return the lines with `name = value;` in place of `t1_ = value; name = t1_;`, where nothing else uses t1_."""
    result: list[str] = []
    count = Counter(name for line in lines for name in re.findall(r"\bt\d+_", line))
    for line in lines:
        handed = _HANDED_ON.fullmatch(line)
        place = len(result) - 1
        while place >= 0 and result[place] == _CHECK:
            place -= 1
        if handed and count[handed[1]] == 2 and place >= 0 and result[place].startswith(f"{handed[1]} = "):
            result[place] = line.removesuffix(f"{handed[1]};") + result[place].removeprefix(f"{handed[1]} = ")
        else:
            result.append(line)
    return result


def placed(lines: Sequence[str], types: Mapping[str, str]) -> Placed:
    """Return the lines with declarations of the variables, which `types` names with their types in C."""
    uses: dict[str, list[tuple[int, Block]]] = {}
    inside: list[Block] = []  # behind the last brace of each line
    block: Block = ()
    opened = 0
    for place, line in enumerate(lines):
        bare = _TEXT.sub('""', line)
        ends = len(bare) - len(bare.lstrip("}"))
        block = block[: len(block) - ends]
        for name in types.keys() & set(_NAME.findall(bare)):
            uses.setdefault(name, []).append((place, block))
        change = bare[ends:].count("{") - bare[ends:].count("}")
        for _ in range(change):
            opened += 1
            block = (*block, opened)
        inside.append(block)
    result = list(lines)
    left = []
    for name in types:
        (first, own), *others = uses.get(name, [(-1, ())])
        if first >= 0 and _may_stand(name, lines[first], own, inside[first], [block for _, block in others]):
            result[first] = result[first].replace(f"{name} = ", f"{types[name]} {name} = ", 1)
        else:
            left.append(name)
    return Placed(result, left)


def _may_stand(name: str, line: str, own: Block, inside: Block, others: Sequence[Block]) -> bool:
    """Return whether a variable can be declared in the line that uses it first, in a block `own`."""
    found = _LOOP.match(line)
    within = inside if found else own
    if any(block[: len(within)] != within for block in others):
        return False
    if found:
        return found[1] == name and len(inside) > len(own)
    written = _WRITTEN.match(line)
    return bool(written and written[1] == name and line.endswith(";") and _NAME.findall(line).count(name) == 1)
