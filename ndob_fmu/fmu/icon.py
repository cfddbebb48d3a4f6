"""The icon of an FMU: a block with its name, what goes in on the left and what comes out on the right."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import matplotlib
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch
from PIL import Image, ImageColor

from ndob_fmu.fmu.manual import Part
from ndob_fmu.model.model import Model

_SIZE, _DPI = 200, 100  # pixels; FMI recommends at least 100
_SHADES = 8  # from the ink to each of the grounds; few make a file a third as large
_COLOURS = {"Plant": ("#1f4e79", "#eaf2fa"), "Observer": ("#7a3e00", "#fdf1e3")}


@dataclass(frozen=True)
class Icon:
    """A block with a title and the symbols of its signals.

    title: in the block, broken into two lines where it is long
    label: below the title, smaller
    into: symbols at the arrows that lead into the block, as Matplotlib's mathtext
    out: the same for the arrows that lead out of it
    ink: colour of lines and text
    face: colour of the block
    """

    title: str
    label: str
    into: Sequence[str]
    out: Sequence[str]
    ink: str = "#2d5a27"
    face: str = "#edf5ea"


def model_icon(model: Model, part: Part) -> Icon:
    """Return the icon of a model's plant or observer."""
    return Icon(model.name, part.lower(), *_signals(model, part), *_COLOURS[part])


def draw_icon(icon: Icon) -> bytes:
    """Return the icon as PNG. The same icon gives the same bytes, whatever style the user has set for figures."""
    ink = icon.ink
    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        figure = Figure(figsize=(_SIZE / _DPI, _SIZE / _DPI), dpi=_DPI)
        axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
        axes.set(xlim=(0.0, 1.0), ylim=(0.0, 1.0))
        axes.set_axis_off()
        block = FancyBboxPatch(
            (0.2, 0.16), 0.6, 0.68, boxstyle="round,pad=0,rounding_size=0.04", fc=icon.face, ec=ink, lw=2.0
        )
        axes.add_patch(block)
        for x, symbols in ((0.02, icon.into), (0.8, icon.out)):
            for k, symbol in enumerate(symbols):
                y = 0.84 - 0.68 * (k + 1) / (len(symbols) + 1)
                axes.annotate(
                    "",
                    (x + 0.18, y),
                    (x, y),
                    arrowprops={"arrowstyle": "-|>", "color": ink, "shrinkA": 0, "shrinkB": 0},
                )
                axes.text(x + 0.07, y + 0.03, symbol, ha="center", va="bottom", size=11, color=ink)
        axes.text(0.5, 0.6, _broken(icon.title), ha="center", va="center", size=_fitting(icon.title), color=ink)
        axes.text(0.5, 0.33, icon.label, ha="center", va="center", size=9, style="italic", color=ink)
        png = io.BytesIO()
        figure.savefig(png, format="png", metadata={"Software": None})
    few = io.BytesIO()
    drawn = Image.open(png).convert("RGB")
    drawn.quantize(palette=_palette(icon), dither=Image.Dither.NONE).save(few, format="png", optimize=True)
    return few.getvalue()


def _palette(icon: Icon) -> Image.Image:
    """Return the colours of an icon, and those between its ink and its grounds, which smooth lines have."""
    dark, *grounds = (ImageColor.getrgb(colour)[:3] for colour in (icon.ink, icon.face, "white"))
    palette = Image.new("P", (1, 1))
    palette.putpalette(
        [
            round(a + (b - a) * k / (_SHADES - 1))
            for ground in grounds
            for k in range(_SHADES)
            for a, b in zip(dark, ground, strict=True)
        ]
    )
    return palette


def _signals(model: Model, part: Part) -> tuple[list[str], list[str]]:
    u = ["$u$"] if model.inputs else []
    if part == "Plant":
        return [*u, "$d$"], ["$y$", "$x$"]
    return [*u, "$y$"], [r"$\hat{x}$", r"$\hat{d}$"]


def _broken(name: str) -> str:
    """Return a long name in two lines, broken where a word in it begins nearest to the middle."""
    starts = [i for i, (a, b) in enumerate(pairwise(name), start=1) if a == "_" or (b.isupper() and not a.isupper())]
    if len(name) <= 8 or not starts:
        return name
    middle = min(starts, key=lambda i: abs(2 * i - len(name)))
    return f"{name[:middle]}\n{name[middle:]}"


def _fitting(name: str) -> float:
    longest = max(map(len, _broken(name).split("\n")))
    return min(13.0, 13.0 * 8.5 / longest)
