"""The page: sliders for the settings, and what the linearised filter says with them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from math import ceil, floor, log10
from pathlib import Path
from threading import Lock
from typing import Any
from uuid import uuid4

from dash import Dash, Input, Output, State, dcc, html, no_update
from dash.exceptions import PreventUpdate

from ndob_fmu.errors import NdobError
from ndob_fmu.log.tune.figures import correlation_figure, disturbance_figure, residual_figure
from ndob_fmu.log.tune.settings import Settings, noise_names, rate_names, save
from ndob_fmu.log.tune.workbench import Shown, Workbench
from ndob_fmu.results.shown_time import shown_time
from ndob_fmu.runtime.equations import HIGHEST_ORDER

# A slider reaches so many powers of ten below and above what was told.
_DECADES = 2
_STEPS_OF_DECADE = 40
# Of a place on a slider, which rounds to as many.
_DIGITS = 3
# The lag's slider ends at so many rows, or at twice the lag that was told.
_LAG_ROWS = 100
# Work of so many milliseconds shows no sign: a page that flickers at every change distracts.
_PATIENCE = 250
# Requests may come to the server in another order than that of the changes.
_NUMBERED = "(...places) => [(window.change = (window.change || 0) + 1), ...places]"
_STYLE = """
body { font: 15px system-ui, sans-serif; color: #1c2530; margin: 1rem 1.5rem; }
h1 { font-size: 1.3rem; margin: 0 0 .3rem; }
.columns { display: flex; gap: 1.5rem; align-items: flex-start; }
.settings { flex: 0 0 21rem; position: sticky; top: 1rem; }
.shown { flex: 1 1 auto; min-width: 0; }
.setting { margin-bottom: .9rem; }
.value { float: right; font-variant-numeric: tabular-nums; }
.error { color: #b3361e; }
table { border-collapse: collapse; }
td, th { padding: .2rem .7rem; text-align: left; border-bottom: 1px solid #e4e8ec; }
button { margin-right: .6rem; padding: .4rem .8rem; }
"""


def page(workbench: Workbench, title: str, folder: Path) -> Dash:
    """Return the page as an application, which saves `fit.json` into a folder."""
    app = Dash(
        __name__,
        title=f"ndob-fmu tune {title}",
        serve_locally=True,
        include_assets_files=False,
        update_title="",
        add_log_handler=False,
    )
    # The loopback address under another name is another page's way to this one.
    app.server.config["TRUSTED_HOSTS"] = ["127.0.0.1", "localhost"]
    app.index_string = app.index_string.replace("</head>", f"<style>{_STYLE}</style></head>")
    controls = _Controls(workbench)
    turns = _Turns()
    app.layout = lambda: html.Div(
        [
            dcc.Store(id="page", data=uuid4().hex),
            dcc.Store(id="change"),
            html.H1(f"Settings for {title}"),
            html.P(
                "The curves are those of the linearised filter over this log, with the jumps and outliers that are "
                "known. ndob-fmu estimate runs the real observer."
            ),
            html.Ul([html.Li(f"warning: {line}") for line in workbench.warnings], className="error"),
            html.Div(
                [html.Div(controls.layout(), className="settings"), html.Div(_working(_results()), className="shown")],
                className="columns",
            ),
        ]
    )
    outputs = [Output(name, "figure") for name in ("disturbance", "residuals", "correlation")]
    outputs += [Output(name, "children") for name in ("diagnoses", "error", *controls.texts)]

    changed = [*controls.inputs(Input), Input("found", "data")]
    app.clientside_callback(_NUMBERED, Output("change", "data"), changed)  # type: ignore[no-untyped-call]

    @app.callback(outputs, Input("change", "data"), State("page", "data"))
    def _(change: list[Any], here: str) -> list[Any]:
        number, *places, _ = change
        settings = controls.settings(places)
        texts = controls.values(settings)
        try:
            with turns.turn(here, number):
                shown = workbench.shown(settings)
        except NdobError as error:
            return [no_update] * 4 + [str(error), *texts]
        eq, time = workbench.equations, workbench.stretch.log.time
        read = shown_time(float(time[0]), workbench.stretch.usual)
        figures = [
            disturbance_figure(eq, time, shown, read),
            residual_figure(eq, time, shown, read),
            correlation_figure(eq, shown),
        ]
        return [*figures, _diagnoses(shown), "", *texts]

    @app.callback(Output("found", "data"), Input("find", "n_clicks"), controls.inputs(State), prevent_initial_call=True)
    def _(clicks: int, *places: Any) -> int:
        # What is wrong with the settings is told where they are shown.
        with turns.alone(), suppress(NdobError):
            workbench.find_jumps(controls.settings(places))
        return clicks

    @app.callback(
        Output("saved", "children"), Input("save", "n_clicks"), controls.inputs(State), prevent_initial_call=True
    )
    def _(_: int, *values: Any) -> str:
        try:
            path = save(folder, workbench.start_values(controls.settings(values)))
        except NdobError as error:
            return str(error)
        return f"saved: --start-values-file {path}"

    return app


class _Turns:
    """One change after another; of those that wait on a page, the latest alone is taken."""

    def __init__(self) -> None:
        self._lock, self._latest = Lock(), dict[str, int]()

    @contextmanager
    def turn(self, here: str, number: int) -> Iterator[None]:
        """Wait for the turn of a page's change; end the callback where a later one came in the meantime."""
        self._latest[here] = max(number, self._latest.get(here, 0))
        with self._lock:
            if number < self._latest[here]:
                raise PreventUpdate
            yield

    def alone(self) -> AbstractContextManager[Any]:
        """Return the lock of what is not a change."""
        return self._lock


class _Controls:
    """The sliders, and the settings of their places.

    A rate of order r stands as the pace (rate / bound)^(1/r) in 1/s, so that it stays as fast when r changes.
    """

    def __init__(self, workbench: Workbench) -> None:
        eq, told = workbench.equations, workbench.told
        self._told, self._bound, self._equations = told, workbench.bound, eq
        self._noise = [f"noise-{i}" for i in range(len(eq.outputs))]
        self._rate = [f"rate-{j}" for j in range(len(eq.disturbances))]
        self._most_lag = max(_LAG_ROWS * workbench.stretch.usual, 2.0 * told.lag)
        self._lag_step = workbench.stretch.usual
        self.texts = [f"{name}-value" for name in (*self._noise, *self._rate, "lag")]

    def inputs(self, kind: type) -> list[Any]:
        """Return the places of all controls as inputs or states of a callback."""
        return [kind(name, "value") for name in (*self._noise, *self._rate, "lag", "order", "adapt_noise")]

    def settings(self, values: Sequence[Any]) -> Settings:
        """Return the settings of the places; a slider that was not moved has the value that was told."""
        p, order = len(self._noise), int(values[-2])
        noise, paces, lag = values[:p], values[p:-3], float(values[-3])
        told, starts = self._told, self._starts()
        return Settings(
            noise_std=tuple(
                own if place == start else 10.0**place
                for own, place, start in zip(told.noise_std, noise, starts[:p], strict=True)
            ),
            order=order,
            rate=tuple(
                own if place == start and order == told.order else bound * 10.0 ** (place * order)
                for own, place, start, bound in zip(told.rate, paces, starts[p:], self._bound, strict=True)
            ),
            lag=lag,
            adapt_noise=bool(values[-1]),
        )

    def values(self, settings: Settings) -> list[str]:
        """Return the values that stand beside the sliders."""
        eq = self._equations
        noise = [f"{v:.3g} {eq.units.get(y, '')}" for v, y in zip(settings.noise_std, eq.outputs, strict=True)]
        per = "/s" if settings.order == 1 else f"/s^{settings.order}"
        rate = [f"{v:.3g} {eq.units.get(d, '')}{per}" for v, d in zip(settings.rate, eq.disturbances, strict=True)]
        return [*noise, *rate, f"{settings.lag:.3g} s"]

    def layout(self) -> list[Any]:
        """Return the controls with their names."""
        eq, told, starts = self._equations, self._told, self._starts()
        names = [*noise_names(eq), *rate_names(eq)]
        logs = [
            _setting(name, label, _log_slider(name, start))
            for name, label, start in zip((*self._noise, *self._rate), names, starts, strict=True)
        ]
        lag = dcc.Slider(
            min=0.0, max=self._most_lag, step=self._lag_step, value=told.lag, marks=None, id="lag", **_PLAIN
        )
        order = dcc.RadioItems(
            options=[{"label": f" {r} ", "value": r} for r in range(1, HIGHEST_ORDER + 1)],
            value=told.order,
            inline=True,
            id="order",
        )
        adapt = dcc.Checklist(
            options=[{"label": " adapt_noise: the noise follows the residuals", "value": 1}],
            value=[1] if told.adapt_noise else [],
            id="adapt_noise",
        )
        p = len(self._noise)
        return [
            *logs[:p],
            html.Div(adapt, className="setting"),
            html.Div([html.Label("disturbance_order"), order], className="setting"),
            *logs[p:],
            _setting("lag", "lag", lag),
            html.Button("Find jumps", id="find"),
            html.Button("Save fit.json", id="save"),
            html.P(id="saved"),
            html.P(id="error", className="error"),
        ]

    def _starts(self) -> list[float]:
        """Return the places of what was told."""
        told = self._told
        paces = [log10(rate / bound) / told.order for rate, bound in zip(told.rate, self._bound, strict=True)]
        return [round(place, _DIGITS) for place in (*map(log10, told.noise_std), *paces)]


_PLAIN: dict[str, Any] = {"updatemode": "drag", "allow_direct_input": False}


def _log_slider(name: str, start: float) -> dcc.Slider:
    low, high = start - _DECADES, start + _DECADES
    marks = {k: f"1e{k}" for k in range(ceil(low), floor(high) + 1)}
    # Without marks of its own the slider of a rate has none: its scale is the pace's.
    shown = marks if name.startswith("noise") else None
    return dcc.Slider(min=low, max=high, step=1 / _STEPS_OF_DECADE, value=start, marks=shown, id=name, **_PLAIN)


def _setting(name: str, label: str, slider: dcc.Slider) -> html.Div:
    value = html.Span(id=f"{name}-value", className="value")
    return html.Div([html.Label(label), value, slider], className="setting")


def _working(results: list[Any]) -> dcc.Loading:
    """Return results that turn pale, with a circle on them, while they are computed anew."""
    pale = {"visibility": "visible", "opacity": 0.4}
    return dcc.Loading(results, id="working", type="circle", delay_show=_PATIENCE, overlay_style=pale)


def _results() -> list[Any]:
    """Return what shows the settings' effect; `found` is there because a search for jumps counts as work on it."""
    graphs: list[Any] = []
    for name, text in (
        ("disturbance", "Disturbance"),
        ("residuals", "Residuals: samples less their predictions"),
        ("correlation", "Correlation of the residuals"),
    ):
        graphs += [html.H2(text, style={"fontSize": "1rem"}), dcc.Graph(id=name, config={"displaylogo": False})]
    return [dcc.Store(id="found"), html.Div(id="diagnoses"), *graphs]


def _diagnoses(shown: Shown) -> list[Any]:
    head = ("output", "residuals² over their variance", "correlation, one sample apart", "refused")
    rows = [
        (
            name,
            f"{one.size:.3g} (1 ± {one.size_band:.2g})",
            f"{one.correlation[0]:.2f} (0 ± {one.correlation_band:.2g})",
            f"{100.0 * one.refused:.2g} %",
        )
        for name, one in shown.diagnoses.items()
    ]
    table = html.Table([html.Tr(list(map(html.Th, head))), *(html.Tr(list(map(html.Td, row))) for row in rows)])
    verdicts = [html.Li(line) for line in shown.verdicts] or [html.Li("the settings fit the log")]
    known = html.P(f"{shown.jumps} jumps and {shown.outliers} outliers are known.")
    return [table, html.Ul(verdicts), known]
