"""The types of translated code, and how C names them.

Numbers are `double`, `int` and `bool`. Arrays, and tuples and lists of numbers, are `nd`. Dataclasses and named tuples
are structures, which functions take by pointer. A list of anything else is a pointer and a count; a value that may be
None is a structure with a flag, but for arrays, which are NULL then.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias


@dataclass(frozen=True)
class Simple:
    """A number, a text or nothing, by its name in C."""

    c: str


FLOAT, INT, BOOL, TEXT, NOTHING = (Simple(name) for name in ("double", "int", "bool", "const char *", "void"))
SLICE = Simple("nd_slice")


@dataclass(frozen=True)
class Array:
    """An array of float, bool or int; all are stored as float."""

    element: Simple = FLOAT


@dataclass(frozen=True)
class ComplexArray:
    """A vector of complex numbers: real and imaginary parts."""


@dataclass(frozen=True)
class Structure:
    """A dataclass or a named tuple."""

    name: str


@dataclass(frozen=True)
class Listing:
    """A list or a tuple of any length."""

    element: Kind


@dataclass(frozen=True)
class Table:
    """A mapping from names."""

    value: Kind


@dataclass(frozen=True)
class Pack:
    """A tuple of fixed length."""

    elements: tuple[Kind, ...]


@dataclass(frozen=True)
class Maybe:
    """A value or None."""

    value: Kind


@dataclass(frozen=True)
class Function:
    """A function as a value: a function of C and what it captured."""

    arguments: tuple[Kind, ...]
    result: Kind


@dataclass(frozen=True)
class Unknown:
    """A type that has no translation; only its use is refused."""

    text: str


Kind: TypeAlias = Simple | Array | ComplexArray | Structure | Listing | Table | Pack | Maybe | Function | Unknown

ARRAY = Array()
NUMBERS = Listing(FLOAT)
_NUMBER = (FLOAT, INT, BOOL)


def is_number(kind: Kind) -> bool:
    """Return whether a value is one number."""
    return kind in _NUMBER


def is_numbers(kind: Kind) -> bool:
    """Return whether a value is a list of numbers."""
    return isinstance(kind, Listing) and is_number(kind.element)


def is_nd(kind: Kind) -> bool:
    """Return whether C stores a value as `nd`."""
    if isinstance(kind, Maybe):
        return is_nd(kind.value)
    return isinstance(kind, Array) or is_numbers(kind)


def elements_of(kind: Kind) -> tuple[Kind, ...]:
    """Return the types in a tuple of fixed length."""
    assert isinstance(kind, Pack)
    return kind.elements


def element_of(kind: Kind) -> Kind:
    """Return the type of the entries of a list or an array."""
    assert isinstance(kind, (Array, Listing))
    return kind.element


def by_pointer(kind: Kind) -> bool:
    """Return whether functions take a value by pointer."""
    return isinstance(kind, (Structure, Pack)) or (isinstance(kind, Maybe) and not is_nd(kind))


def word(kind: Kind) -> str:
    """Return a word for a type, for use in the names of other types."""
    match kind:
        case Simple(c):
            return {"const char *": "text", "nd_slice": "slice"}.get(c, c)
        case Structure(name):
            return name
        case Pack(elements):
            return "p" + str(len(elements)) + "_" + "_".join(map(word, elements))
        case Listing(element):
            return "nd" if is_number(element) else f"l_{word(element)}"
        case Table(value):
            return f"table_{word(value)}"
        case Maybe(value):
            return "nd" if is_nd(value) else f"m_{word(value)}"
        case Function(arguments, result):
            return f"f_{'_'.join(map(word, arguments))}_to_{word(result)}"
        case Array():
            return "nd"
        case ComplexArray():
            return "complex"
        case Unknown(text):
            raise TypeError(text)


def c_type(kind: Kind) -> str:
    """Return a type in C."""
    if is_nd(kind):
        return "nd"
    match kind:
        case Simple(c):
            return c
        case Structure(name):
            return name
        case ComplexArray():
            return "nd_two"
        case Listing(element) if is_nd(element):
            return "nd_list"
        case Listing(element) if element == TEXT:
            return "nd_names"
        case Pack(elements) if len(elements) in (2, 3) and all(map(is_nd, elements)):
            return ("nd_two", "nd_three")[len(elements) - 2]
        case Unknown(text):
            raise TypeError(text)
    return word(kind)


def parts(kind: Kind) -> tuple[Kind, ...]:
    """Return the kinds that a kind is made of, without the fields of a structure."""
    match kind:
        case Pack(elements):
            return elements
        case Listing(element):
            return (element,)
        case Maybe(value) | Table(value):
            return (value,)
        case Function(arguments, result):
            return (*arguments, result)
    return ()
