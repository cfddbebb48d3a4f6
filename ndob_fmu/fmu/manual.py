"""The page that an importing tool shows for an FMU: its equations, its variables, what belongs to which instant."""

from __future__ import annotations

from collections.abc import Iterable, Sequence, Set
from html import escape
from pathlib import Path
from string import Template
from typing import Any, Literal

import sympy
from sympy.printing.mathml import MathMLPresentationPrinter

from ndob_fmu.interface.model_variables import Variable
from ndob_fmu.model.model import Model

Part = Literal["Plant", "Observer"]

TEXTS = Path(__file__).parent / "documentation"

_DIRECTION = (
    "<p>Here d acts as n(x, u) d. The observer estimates the products n_j d; d̂ is their least-squares fit along "
    "n(x̂, u), and <code>valid</code> is false also where n vanishes.</p>"
)


def manual(model: Model, part: Part, variables: Sequence[Variable]) -> str:
    """Return the page as HTML that needs neither network nor scripts."""
    at_sample = {f"{d}_at_sample" for d in model.disturbances} | {"valid"}
    at_sample |= {f"{y}{suffix}" for y in model.outputs for suffix in ("_residual", "_residual_std")}
    own = _template(part.lower()).substitute(
        equations=_equations(model),
        variables=_tables(variables, at_sample),
        **({"direction": _DIRECTION if model.channel_expressions else ""} if part == "Observer" else {}),
    )
    return _page(f"{model.name}{part}", model.description, own)


def component_manual(name: str, description: str, template: str, variables: Sequence[Variable]) -> str:
    """Return the page of a component other than these; `template` is the name of its text."""
    return _page(name, description, _template(template).substitute(variables=_tables(variables, set())))


def _page(name: str, description: str, own: str) -> str:
    return _template("page").substitute(
        name=name,
        description=escape(description),
        part=own,
        dependencies=escape((TEXTS / "externalDependencies.txt").read_text("utf-8")),
    )


def _template(name: str) -> Template:
    return Template((TEXTS / f"{name}.html").read_text("utf-8"))


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


def _equations(model: Model) -> str:
    x, u = (sympy.Matrix([model.symbols[name] for name in names]) for names in (model.states, model.inputs))
    d = [sympy.Symbol(f"{name}_total", real=True) for name in model.disturbances]
    w = [n * d[0] for n in model.channel_expressions] or d
    rates = model.A * x + model.G_d * sympy.Matrix(w)
    if model.inputs:
        rates += model.B * u
    if model.f_expressions:
        rates += model.G_f * sympy.Matrix(model.f_expressions)
    sides = [(f"der({state})", _rate(state), rate) for state, rate in zip(model.states, rates, strict=True)]
    sides += [
        (output, f"<mi>{output}</mi>", value)
        for output, value in zip(model.outputs, model.C * x, strict=True)
        if output not in model.states
    ]
    printer = _Printer({"mul_symbol": "dot"})
    shown = "\n".join(
        f'<p><math display="block">{left}<mo>=</mo>{printer.doprint(right)}</math></p>' for _, left, right in sides
    )
    text = "\n".join(f"{left} = {sympy.sstr(right, full_prec=False)}" for left, _, right in sides)
    measured = [name for name in model.outputs if name in model.states]
    also = f"<p>Measured as they are: {_codes(measured)}.</p>\n" if measured else ""
    return f"{shown}\n{also}<details><summary>As text</summary><pre>{escape(text)}</pre></details>"


def _rate(state: str) -> str:
    above = f"<mrow><mi>d</mi><mspace width='0.2em'/><mi>{state}</mi></mrow>"
    return f"<mfrac>{above}<mrow><mi>d</mi><mi>t</mi></mrow></mfrac>"


# -- variables


def _tables(variables: Sequence[Variable], at_sample: Set[str]) -> str:
    groups = {c: [v for v in variables if v.causality == c] for c in ("input", "output", "parameter")}
    tables = [
        ("Inputs", ["Unit", "Start", "Value at"], [[v.unit, _number(v.start), "t"] for v in groups["input"]], "input"),
        (
            "Outputs",
            ["Unit", "Value at"],
            [[v.unit, "t" if v.name in at_sample else "t + H"] for v in groups["output"]],
            "output",
        ),
        (
            "Parameters, fixed when initialization ends",
            ["Unit", "Start", "Range"],
            [[v.unit, _start(v), _range(v)] for v in groups["parameter"]],
            "parameter",
        ),
    ]
    return "\n".join(
        f"<h3>{title}</h3>\n{_table(['Name', *heads, 'Description'], _rows(groups[causality], cells))}"
        for title, heads, cells, causality in tables
    )


def _rows(variables: Sequence[Variable], cells: Sequence[Sequence[str]]) -> list[list[str]]:
    return [
        [f"<code>{variable.name}</code>", *map(escape, own), escape(variable.description)]
        for variable, own in zip(variables, cells, strict=True)
    ]


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = ["".join(f"<th>{cell}</th>" for cell in head)]
    lines += ["".join(f"<td>{cell}</td>" for cell in row) for row in rows]
    return "<table>\n" + "".join(f"<tr>{line}</tr>\n" for line in lines) + "</table>"


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


def _codes(names: Iterable[str]) -> str:
    return ", ".join(f"<code>{name}</code>" for name in names)
