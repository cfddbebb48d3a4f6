"""The page that an importing tool shows for an FMU: its equations, its variables, what belongs to which instant."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal

import sympy
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup
from sympy.printing.mathml import MathMLPresentationPrinter

from ndob_fmu.interface.variables import Variable
from ndob_fmu.model.model import Model

Part = Literal["Plant", "Observer"]

TEXTS = Path(__file__).parent / "documentation"
_NEEDS = (TEXTS / "externalDependencies.txt").read_text("utf-8")


def manual(model: Model, part: Part, variables: Sequence[Variable], *, needs: str = _NEEDS) -> str:
    """Return the page of a model's plant or observer; `needs`: as in `page`."""
    of_sample = [f"{d}_at_sample" for d in model.disturbances] + ["valid", "consistency"]
    of_sample += [f"{y}{suffix}" for y in model.outputs for suffix in ("_residual", "_residual_std")]
    lagged = [f"{d}{suffix}" for d in model.disturbances for suffix in ("_lagged", "_lagged_std")]
    instants = dict.fromkeys(of_sample, "t") | dict.fromkeys(lagged, "t − lag")
    template = (TEXTS / f"{part.lower()}.html.jinja").read_text("utf-8")
    shown = {"equations": _equations(model), "turns": bool(model.channel_expressions)}
    return page(f"{model.name}{part}", model.description, template, variables, instants=instants, needs=needs, **shown)


def page(
    name: str,
    description: str,
    template: str,
    variables: Sequence[Variable],
    *,
    instants: Mapping[str, str] = MappingProxyType({}),
    needs: str = _NEEDS,
    **shown: Any,
) -> str:
    """Return a page as HTML that needs neither network nor scripts.

    template: what is said of this FMU, in Jinja, with {{ variables }} where their tables go, and {{ names }} of `shown`
    needs: what the FMU needs on the host
    instants: of the outputs that do not belong to t + H, the end of a step
    """
    environment = _environment()
    tables = environment.get_template("tables.html.jinja").render(variables=variables, instants=instants)
    return environment.get_template("page.html.jinja").render(
        name=name,
        description=description,
        part=Markup(environment.from_string(template).render(variables=Markup(tables), **shown)),
        needs=needs,
    )


@cache
def _environment() -> Environment:
    environment = Environment(
        loader=FileSystemLoader(TEXTS),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters.update(number=_number, start=_start, range=_range)
    return environment


# -- equations


class _Printer(MathMLPresentationPrinter):  # type: ignore[misc]
    """MathML with the names of the variables as they are; SymPy takes what follows an underscore for an index."""

    def _print_Symbol(self, symbol: sympy.Symbol, style: str = "plain") -> Any:
        return self._text("mi", symbol.name)

    def _print_Piecewise(self, pieces: sympy.Piecewise) -> Any:
        table = self.dom.createElement("mtable")
        for value, condition in pieces.args:
            row = self.dom.createElement("mtr")
            otherwise = condition == sympy.true
            for entry in (
                self._print(value),
                self._text("mtext", "otherwise" if otherwise else "if"),
                *(() if otherwise else (self._print(condition),)),
            ):
                cell = self.dom.createElement("mtd")
                cell.appendChild(entry)
                row.appendChild(cell)
            table.appendChild(row)
        braced = self.dom.createElement("mrow")
        braced.appendChild(self._text("mo", "{"))
        braced.appendChild(table)
        return braced

    def _text(self, tag: str, text: str) -> Any:
        element = self.dom.createElement(tag)
        element.appendChild(self.dom.createTextNode(text))
        return element


def _equations(model: Model) -> Markup:
    field = model.vector_field
    rates = field.derivatives(
        field.driven_by([sympy.Symbol(f"{name}_total", real=True) for name in model.disturbances])
    )
    sides = [(f"der({state})", _rate(state), rate) for state, rate in zip(model.states, rates, strict=True)]
    sides += [
        (output, f"<mi>{output}</mi>", value)
        for output, value in zip(model.outputs, field.outputs, strict=True)
        if output not in model.states
    ]
    printer = _Printer({"mul_symbol": "dot"})
    shown = [
        {
            "left": Markup(left),
            "right": Markup(printer.doprint(right)),
            "text": f"{name} = {sympy.sstr(right, full_prec=False)}",
        }
        for name, left, right in sides
    ]
    measured = [name for name in model.outputs if name in model.states]
    template = _environment().get_template("equations.html.jinja")
    return Markup(template.render(equations=shown, measured=measured))


def _rate(state: str) -> str:
    above = f"<mrow><mi>d</mi><mspace width='0.2em'/><mi>{state}</mi></mrow>"
    return f"<mfrac>{above}<mrow><mi>d</mi><mi>t</mi></mrow></mfrac>"


# -- variables


def _start(variable: Variable) -> str:
    item = [f" ({name})" for name, value in (variable.items or {}).items() if value == variable.start]
    return "".join([_number(variable.start), *item])


def _range(variable: Variable) -> str:
    if variable.items is not None:
        return ", ".join(f"{value} {item}" for item, value in variable.items.items())
    bounds = [(">" if variable.positive else "≥", variable.minimum), ("≤", variable.maximum)]
    limits = ", ".join(f"{sign} {_number(bound)}" for sign, bound in bounds if bound is not None)
    return limits or ("finite" if variable.type == "Real" else "")


def _number(value: float | int | bool | str | None) -> str:
    if value is None or isinstance(value, str):
        return value or ""
    return str(value).lower() if isinstance(value, bool) else f"{value:g}"
