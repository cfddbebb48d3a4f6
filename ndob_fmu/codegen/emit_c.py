"""The functions of a model in C, for those that the caller names."""

from __future__ import annotations

from collections.abc import Iterable

from ndob_fmu.codegen.build_definitions import build_definitions
from ndob_fmu.codegen.build_step import build_steps
from ndob_fmu.codegen.print_c import print_function
from ndob_fmu.model.model import Model

# As in `codegen.emit`: the plant with a channel is the one with lumped inputs w, driven by w = n(x, u) d.
_PLANT_WITH_CHANNEL = """\
static int derivatives(const double *_x, const double *_u, const double *_d, const double *_p, double *_result) {{
    double _w[{k}];
    int _fault = direction(_x, _u, _p, _w);
    for (int _i = 0; _i < {k}; _i++) _w[_i] *= _d[0];
    return _fault ? _fault : lumped_derivatives(_x, _u, _w, _p, _result);
}}
"""
_NEEDS = {"derivatives": ("direction", "lumped_derivatives")}


def emit_c(model: Model, names: Iterable[str]) -> str:
    """Return the C text of the model's functions of these names, in an order in which each knows those it calls.

    Raises ModelError for an expression that has no C form.
    """
    field = model.vector_field
    limits = {symbol.name: model.ranges[symbol.name] for symbol in field.not_linear if symbol.name in model.ranges}
    builders = {**build_definitions(field), **build_steps(field, limits)}
    wanted = list(dict.fromkeys(names))
    if field.direction and "derivatives" in wanted:
        wanted = list(dict.fromkeys([*_NEEDS["derivatives"], *wanted]))
    return "\n".join(
        print_function(builders[name]()) if name in builders else _PLANT_WITH_CHANNEL.format(k=len(field.direction))
        for name in wanted
    )
