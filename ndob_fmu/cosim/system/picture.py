"""A system as a picture: its components on the diagonal, and what goes from one to another where row and column meet.

That is the N² chart of systems engineering: it needs no layout, never grows ambiguous, and shows feedback below the
diagonal. What enters at the boundary has a row above, what leaves it a column on the right.
"""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path

from lxml import etree

from ndob_fmu.cosim.system.ports import AS_IT_IS, Connection
from ndob_fmu.cosim.system.system import System
from ndob_fmu.errors import UsageError
from ndob_fmu.support.files import atomic_path

_LINE, _LETTER, _PAD = 15.0, 7.2, 14.0  # px: between lines of text, the width of a letter, around it
_SVG = "http://www.w3.org/2000/svg"
_INK, _FACE, _SIGNAL = "#1f4e79", "#eaf2fa", "#7a3e00"


def write_picture(path: str | Path, system: System, title: str) -> Path:
    """Write the picture as SVG and return its path.

    Raises UsageError for another kind of file, or one that cannot be written.
    """
    path = Path(path)
    if path.suffix != ".svg":
        raise UsageError.report("picture", expected="the path of an .svg", received=repr(str(path)))
    with atomic_path(path) as temporary:
        temporary.write_bytes(draw_system(system, title))
    return path


def draw_system(system: System, title: str) -> bytes:
    """Return the picture as SVG; the same system gives the same bytes."""
    cells = _signals(system)
    names = list(system.components)
    outside = ([""] if any(system.inputs.values()) else []) + names + (["*"] if system.outputs else [])
    place = {name: index for index, name in enumerate(outside)}
    widths = [0.0] * len(outside)
    heights = [2.0 * _LINE + 2.0 * _PAD] * len(outside)
    for name in names:
        widths[place[name]] = _width([name, _kind(system, name)])
    for (source, target), lines in cells.items():
        widths[place[target]] = max(widths[place[target]], _width(lines))
        heights[place[source]] = max(heights[place[source]], len(lines) * _LINE + 2.0 * _PAD)
    chart = _Chart(title, widths, heights)
    for source, target in cells:
        chart.arrow(place[source], place[target])
    for name in names:
        chart.block(place[name], [name, _kind(system, name)])
    for (source, target), lines in cells.items():  # last, so that no line goes through a text
        chart.label(place[source], place[target], lines)
    return chart.text()


def _signals(system: System) -> dict[tuple[str, str], list[str]]:
    """Return the lines of each cell: (source, target) → what goes there; "" and "*" are the boundary."""
    cells: dict[tuple[str, str], list[str]] = defaultdict(list)
    for name, links in system.inputs.items():
        for (component, variable), factor, offset in links:
            cells["", component].append(_line(name, variable, factor, offset))
    for connection in system.connections:
        cells[connection.source.component, connection.target.component].append(_named(connection))
    for name, ((component, variable), factor, offset) in system.outputs.items():
        cells[component, "*"].append(_line(variable, name, factor, offset))
    return cells


def _named(connection: Connection) -> str:
    source, target, factor, offset, _ = connection
    return _line(source.variable, target.variable, factor, offset)


def _line(source: str, target: str, factor: float, offset: float) -> str:
    text = source if source == target else f"{source} → {target}"
    if (factor, offset) == AS_IT_IS:
        return text
    return f"{text} (· {factor:g}{f' {offset:+g}' if offset else ''})"


def _kind(system: System, name: str) -> str:
    component = system.components[name]
    text = getattr(component, "model_identifier", type(component).__name__)
    ratio = system.step_ratios.get(name, 1)
    return text if ratio == 1 else f"{text}, every {ratio} steps"


def _width(lines: list[str]) -> float:
    return _LETTER * max(map(len, lines)) + 2.0 * _PAD


class _Chart:
    """The SVG, with cells of these widths and heights (px)."""

    def __init__(self, title: str, widths: list[float], heights: list[float]) -> None:
        gap = 2.0 * _PAD
        self._widths, self._heights = widths, heights
        self._left = [gap + sum(widths[:i]) + gap * i for i in range(len(widths))]
        self._top = [gap + 1.5 * _LINE + sum(heights[:i]) + gap * i for i in range(len(heights))]
        width = max(sum(widths) + gap * (len(widths) + 1), _width([title]))
        height = self._top[-1] + heights[-1] + gap if heights else 4.0 * _LINE
        size = {"width": f"{width:.0f}", "height": f"{height:.0f}", "viewBox": f"0 0 {width:.0f} {height:.0f}"}
        style = {"font-family": "sans-serif", "font-size": "12", "role": "img"}
        self._root = etree.Element(f"{{{_SVG}}}svg", {**size, **style}, nsmap={None: _SVG})
        self._add("title", {}, title)
        self._add("rect", {"width": "100%", "height": "100%", "fill": "white"})
        self._words(_PAD, _PAD + _LINE, [title], _INK, weight="bold", anchor="start")

    def block(self, index: int, lines: list[str]) -> None:
        """Draw a component on the diagonal."""
        x, y, width, height = self._left[index], self._top[index], self._widths[index], self._heights[index]
        box = {"x": x, "y": y, "width": width, "height": height, "rx": 6.0}
        self._add("rect", {**_px(box), "fill": _FACE, "stroke": _INK, "stroke-width": "1.5"})
        self._words(x + width / 2, y + height / 2, lines[:1], _INK, weight="bold")
        self._words(x + width / 2, y + height / 2 + _LINE, lines[1:], _INK)

    def arrow(self, source: int, target: int) -> None:
        """Draw the way from one to another: along the source's row, then along the target's column."""
        x, y = self._crossing(source, target)
        forward = target > source
        begin = self._left[source] + (self._widths[source] if forward else 0.0)
        end = self._top[target] + (0.0 if forward else self._heights[target])
        if source == target:  # what a component tells itself stays inside it
            return
        back = -6.0 if forward else 6.0
        points = f"{begin:.1f},{y:.1f} {x:.1f},{y:.1f} {x:.1f},{end + back:.1f}"
        self._add("polyline", {"points": points, "fill": "none", "stroke": _SIGNAL, "stroke-width": "1"})
        head = f"{x:.1f},{end:.1f} {x - 4:.1f},{end + 1.5 * back:.1f} {x + 4:.1f},{end + 1.5 * back:.1f}"
        self._add("polygon", {"points": head, "fill": _SIGNAL})

    def label(self, source: int, target: int, lines: list[str]) -> None:
        """Write what goes from one to another where its way turns."""
        x, y = self._crossing(source, target)
        height = _LINE * len(lines)
        if source == target:
            y = self._top[source] + height / 2
        box = {
            "x": x - _width(lines) / 2 + _PAD / 2,
            "y": y - height / 2,
            "width": _width(lines) - _PAD,
            "height": height,
        }
        self._add("rect", {**_px(box), "fill": "white"})
        self._words(x, y - height / 2 + 0.8 * _LINE, lines, _SIGNAL)

    def _crossing(self, source: int, target: int) -> tuple[float, float]:
        return self._left[target] + self._widths[target] / 2, self._top[source] + self._heights[source] / 2

    def text(self) -> bytes:
        """Return the file."""
        etree.indent(self._root)
        return bytes(etree.tostring(self._root, encoding="UTF-8", xml_declaration=True)) + b"\n"

    def _words(
        self, x: float, y: float, lines: list[str], ink: str, *, weight: str = "normal", anchor: str = "middle"
    ) -> None:
        for k, line in enumerate(lines):
            place = _px({"x": x, "y": y + k * _LINE})
            self._add("text", {**place, "text-anchor": anchor, "font-weight": weight, "fill": ink}, line)

    def _add(self, tag: str, attributes: dict[str, str], text: str = "") -> None:
        element = etree.SubElement(self._root, f"{{{_SVG}}}{tag}", attributes)
        element.text = text or None


def _px(values: dict[str, float]) -> dict[str, str]:
    return {name: f"{value:.1f}" for name, value in values.items()}
