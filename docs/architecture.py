"""Draw docs/architecture.svg from the imports in the code: python docs/architecture.py.

With `--figures [REPOSITORY]` it prints counts instead, also of another checkout with another layout.
"""

from __future__ import annotations

import argparse
import ast
import re
import statistics
import textwrap
from collections import defaultdict
from collections.abc import Collection, Iterator, Mapping
from functools import cached_property
from pathlib import Path
from xml.sax.saxutils import escape

HERE = Path(__file__).resolve().parent
PICTURE = HERE / "architecture.svg"
PACKAGE = "ndob_fmu"

# The way of the data, from top to bottom; what is missing here stands at the end.
WAY = [
    "model",
    "analysis",
    "codegen",
    "runtime",
    "interface",
    "fmus",
    "fmu",
    "cosim",
    "results",
    "log",
    "study",
    "report",
    "packages",
    "demo",
    "command_line",
    "cli",
]
# What every folder may import; arrows to these would hide the others.
COMMON = ("errors", "support")
COMMON_MODULES = ("ndob_fmu.runtime.arrays", "ndob_fmu.runtime.base_errors")
COMPONENTS = ("encoder", "torsion")  # words that name one component; "source" and "controller" have other meanings too

Graph = Mapping[str, Collection[str]]


class Code:
    """The Python code of a checkout; every import counts, inside functions and for type checkers too."""

    def __init__(self, root: Path) -> None:
        self.root = root
        paths = [*sorted((root / PACKAGE).rglob("*.py")), *sorted((root / "fmus").glob("**/*.py"))]
        self.trees = {path: ast.parse(path.read_text("utf-8")) for path in paths}
        self.modules = {_module_name(path.relative_to(root)): path for path in paths}

    @cached_property
    def imports(self) -> dict[str, set[str]]:
        """The modules of this code that each module imports."""
        return {
            name: {target for target in self._imported(self.trees[path]) if target in self.modules} - {name}
            for name, path in self.modules.items()
        }

    def _imported(self, tree: ast.AST) -> Iterator[str]:
        for node in ast.walk(tree):
            if isinstance(node, ast.Import):
                yield from (alias.name for alias in node.names)
            elif isinstance(node, ast.ImportFrom) and node.module:
                for alias in node.names:
                    whole = f"{node.module}.{alias.name}"
                    yield whole if whole in self.modules else node.module

    def folder(self, module: str) -> str:
        """The folder or the module directly in the package that a module belongs to; `fmus` for the slaves."""
        parts = module.split(".")
        return parts[1] if parts[0] == PACKAGE and len(parts) > 1 else parts[0]

    def between_folders(self, depth: int = 1) -> dict[str, set[str]]:
        """The imports between folders, or, with depth 2, between what lies directly in them."""

        def place(module: str) -> str:
            parts = self.modules[module].relative_to(self.root).with_suffix("").parts
            return "/".join((parts[1:] if parts[0] == PACKAGE else parts)[:depth])

        found: dict[str, set[str]] = defaultdict(set)
        for module, targets in self.imports.items():
            found[place(module)] |= {place(target) for target in targets} - {place(module)}
        return dict(found)

    def docstring(self, folder: str) -> str:
        """The first line of a folder's or module's docstring, without the full stop."""
        candidates = (
            self.root / PACKAGE / folder / "__init__.py",
            self.root / PACKAGE / f"{folder}.py",
        )
        path = next((path for path in candidates if path in self.trees), None)
        text = (ast.get_docstring(self.trees[path]) or "") if path else ""
        return text.partition("\n")[0].rstrip(".")

    def subfolders(self, folder: str) -> list[str]:
        """The names of the folders inside a folder of the package."""
        return sorted(path.parent.name for path in (self.root / PACKAGE / folder).glob("*/__init__.py"))


def circles(graph: Graph) -> list[list[str]]:
    """Return the groups of nodes that reach one another, sorted."""
    reached = {node: _reachable(graph, node) for node in graph}
    groups = {
        tuple(sorted(other for other in reached[node] if node in reached.get(other, ())))
        for node in graph
        if node in reached[node]
    }
    return [list(group) for group in sorted(groups)]


def _reachable(graph: Graph, start: str) -> set[str]:
    found: set[str] = set()
    waiting = list(graph.get(start, ()))
    while waiting:
        node = waiting.pop()
        if node not in found:
            found.add(node)
            waiting += graph.get(node, ())
    return found


def _module_name(path: Path) -> str:
    parts = path.with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


# The picture

_WIDTH, _LINE, _GAP, _SIDE, _PAD = 620, 17, 26, 130, 9  # px
_INK, _FACE, _EARLIER, _LATER = "#1f4e79", "#eaf2fa", "#1f4e79", "#a04000"
_SLAVES = "The slaves: Python classes that pythonfmu turns into FMUs; they hold no formulas"


def picture(root: Path) -> bytes:
    """Return the SVG: the folders in the order of the data, an arrow from each to those that it imports.

    An arrow is left out where a longer way of arrows says the same, and to what every folder may import.
    """
    code = Code(root)
    edges = _reduced(_edges(code))
    names = [name for name in WAY if name in edges] + sorted(set(edges) - set(WAY))
    top, boxes = 12.0, {}
    drawn: list[str] = []
    for name in names:
        lines = _text(code, name)
        height = len(lines) * _LINE + 2 * _PAD
        boxes[name] = (top, height)
        drawn += _box(top, height, lines)
        top += height + _GAP
    drawn += _box(top, 2 * _LINE + 2 * _PAD, ["errors, support", "Every folder may import these; arrows are left out"])
    total = top + 2 * _LINE + 2 * _PAD + 12
    ports: dict[tuple[str, bool], int] = defaultdict(int)
    for importer in names:
        for imported in sorted(edges[importer], key=names.index):
            drawn.append(_arrow(boxes, names, importer, imported, ports))
    head = (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH + 2 * _SIDE} {total:g}" '
        f'width="{_WIDTH + 2 * _SIDE}" font-family="sans-serif" font-size="13">\n'
        "<title>The folders of ndob_fmu and what they import</title>\n<defs>\n"
    )
    for ink in (_EARLIER, _LATER):
        head += (
            f'<marker id="a{ink[1:]}" viewBox="0 0 10 10" refX="9" refY="5" markerWidth="8" markerHeight="8" '
            f'orient="auto"><path d="M0 0 L10 5 L0 10 z" fill="{ink}"/></marker>\n'
        )
    return (head + "</defs>\n" + "\n".join(drawn) + "\n</svg>\n").encode()


def _edges(code: Code) -> dict[str, set[str]]:
    edges: dict[str, set[str]] = {}
    for module, targets in code.imports.items():
        own = code.folder(module)
        if own in (*COMMON, PACKAGE, "__main__") or (own == "fmus" and "slave" not in module):
            continue  # the tools in fmus/ run beside the package, as tests do
        found = edges.setdefault(own, set())
        for target in targets:
            other = code.folder(target)
            if other not in (own, PACKAGE, *COMMON) and target not in COMMON_MODULES:
                found.add(other)
    return edges


def _reduced(edges: Mapping[str, set[str]]) -> dict[str, set[str]]:
    """Leave out an arrow where a longer way leads to the same folder, unless that way goes round a circle."""
    reached = {name: _reachable(edges, name) for name in edges}
    return {
        name: {
            target
            for target in targets
            if not any(target in reached[other] and name not in reached[other] for other in targets - {target})
        }
        for name, targets in edges.items()
    }


def _text(code: Code, name: str) -> list[str]:
    says = _SLAVES if name == "fmus" else code.docstring(name)
    inside = code.subfolders(name)
    is_module = (code.root / PACKAGE / f"{name}.py").is_file()
    folder = name if is_module else f"{name}/"
    title = folder + (f"    {', '.join(inside)}" if inside else "")
    return [title, *textwrap.wrap(says.replace("`", ""), 88)]


def _box(top: float, height: float, lines: list[str]) -> list[str]:
    drawn = [
        f'<rect x="{_SIDE}" y="{top:g}" width="{_WIDTH}" height="{height:g}" rx="4" fill="{_FACE}" stroke="{_INK}"/>'
    ]
    for index, line in enumerate(lines):
        y = top + _PAD + (index + 0.75) * _LINE
        name, _, rest = line.partition("    ")
        if index:
            drawn.append(f'<text x="{_SIDE + 10}" y="{y:g}">{escape(line)}</text>')
        else:
            inside = f'<tspan dx="14" fill="#555">{escape(rest)}</tspan>' if rest else ""
            drawn.append(
                f'<text x="{_SIDE + 10}" y="{y:g}"><tspan font-weight="bold">{escape(name)}</tspan>{inside}</text>'
            )
    return drawn


def _arrow(
    boxes: Mapping[str, tuple[float, float]],
    names: list[str],
    importer: str,
    imported: str,
    ports: dict[tuple[str, bool], int],
) -> str:
    """Draw on the left to a folder above, on the right to one below."""
    upward = names.index(imported) < names.index(importer)
    x, outward, ink = (_SIDE, -1, _EARLIER) if upward else (_SIDE + _WIDTH, 1, _LATER)

    def port(name: str) -> float:
        top, height = boxes[name]
        ports[name, upward] += 1
        return top + height * (0.2 + 0.17 * (ports[name, upward] - 1) % 0.7)

    start, end = port(importer), port(imported)
    bulge = x + outward * min(_SIDE * 1.25, 34 + 0.22 * abs(end - start))
    return (
        f'<path d="M{x} {start:.1f} C{bulge:.1f} {start:.1f} {bulge:.1f} {end:.1f} {x} {end:.1f}" fill="none" '
        f'stroke="{ink}" stroke-width="1.4" marker-end="url(#a{ink[1:]})"/>'
    )


# The figures


def figures(root: Path) -> str:
    """Return the counts as text: sizes, circles, missing docstrings, and files that know a component by name."""
    code = Code(root)
    lines = [f"{'folder':<24} modules  lines"]
    sizes: dict[str, list[int]] = defaultdict(list)
    for path in code.trees:
        folder = path.relative_to(root).parent.as_posix().removeprefix(f"{PACKAGE}/")
        sizes[folder].append(_length(path))
    for folder, counts in sorted(sizes.items()):
        name = "(the package's root)" if folder == PACKAGE else folder
        lines.append(f"{name:<24} {len(counts):>7}  {sum(counts):>5}")
    counted = {path: _length(path) for path in code.trees}
    largest = max(counted, key=counted.__getitem__)
    bare = sorted(_without_docstring(code))
    in_root = sorted(path.name for path in (root / PACKAGE).glob("*.py"))
    graph = {name: targets for name, targets in code.imports.items() if name.startswith(PACKAGE)}
    lines += [
        "",
        f"modules in all: {len(counted)}, lines: {sum(counted.values())}",
        f"modules in the package's root: {len(in_root)} ({', '.join(in_root)})",
        f"median module: {statistics.median(counted.values()):g} lines",
        f"largest module: {largest.relative_to(root).as_posix()}, {counted[largest]} lines",
        f"README: {_length(root / 'README.md')} lines",
        *_list("circles of imports among modules", [", ".join(group) for group in circles(graph)]),
        *_list("circles among folders", [", ".join(group) for group in circles(code.between_folders())]),
        *_list(
            "circles among sub-folders and the modules beside them",
            [", ".join(group) for group in circles(code.between_folders(2))],
        ),
        *_list("public names without a docstring", bare),
    ]
    for word in COMPONENTS:
        lines += _list(f"files that name the component {word!r}", _files_that_name(root, word))
    return "\n".join(lines)


def _length(path: Path) -> int:
    return len(path.read_text("utf-8").splitlines())


def _list(title: str, entries: list[str]) -> list[str]:
    return [f"{title}: {len(entries)}", *(f"    {entry}" for entry in entries)]


def _without_docstring(code: Code) -> Iterator[str]:
    def visit(node: ast.Module | ast.ClassDef, prefix: str) -> Iterator[str]:
        for child in node.body:
            if not isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
                continue
            if child.name.startswith("_") or any("overload" in ast.unparse(one) for one in child.decorator_list):
                continue
            if ast.get_docstring(child) is None:
                yield f"{prefix}: {child.name}"
            if isinstance(child, ast.ClassDef):
                yield from visit(child, f"{prefix}: {child.name}")

    for name, path in code.modules.items():
        if ast.get_docstring(code.trees[path]) is None:
            yield name
        yield from visit(code.trees[path], name)


def _files_that_name(root: Path, word: str) -> list[str]:
    """The files that name a component in code; systems and benchmarks are left out, because they use components."""
    paths = [path for folder in (PACKAGE, "fmus") for path in sorted((root / folder).rglob("*.py"))]
    paths += [*sorted((root / "docs").glob("*.py")), *sorted(root.glob("*.py"))]
    found = [path.relative_to(root).as_posix() for path in paths if _names(path, word)]
    pages = (root / PACKAGE).rglob("*.html")
    return found + sorted(path.relative_to(root).as_posix() for path in pages if word in path.stem)


def _names(path: Path, word: str) -> bool:
    """Tell whether a file's code, without comments and docstrings, has a word."""
    if path.name == Path(__file__).name:  # which has the words themselves
        return False
    tree = ast.parse(path.read_text("utf-8"))
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef) and ast.get_docstring(node) is not None:
            node.body = node.body[1:] or [ast.Pass()]
    return re.search(word, ast.unparse(tree), re.IGNORECASE) is not None


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--figures", action="store_true", help="print counts instead of drawing")
    parser.add_argument(
        "repository", nargs="?", type=Path, default=HERE.parent, help="the checkout (default: this one)"
    )
    options = parser.parse_args()
    if options.figures:
        print(figures(options.repository.resolve()))
    else:
        PICTURE.write_bytes(picture(options.repository.resolve()))
        print(PICTURE)
