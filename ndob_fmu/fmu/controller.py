"""Build `<Name>Controller.fmu` from a model."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ndob_fmu.analysis.controller_design import design_controller
from ndob_fmu.codegen.compile_model import compile_model
from ndob_fmu.codegen.emit import emit_python
from ndob_fmu.fmu.icon import Icon
from ndob_fmu.fmu.record import ComponentRecord, write_component
from ndob_fmu.interface.controller_variables import controller_variables
from ndob_fmu.model.model import Model
from ndob_fmu.runtime.blocks.controller import Feedback

_PAGE = """\
<p>State feedback on an observer's estimates. It holds the regulated outputs at their references, against the
disturbance that the observer estimates.</p>
<h2>Equations</h2>
<p>For the plant x' = A x + B u + G_f f(x, u) + G_d d, with S x the regulated outputs and r their references:</p>
<pre>0 = A x* + B u* + G_f f(x*, u*) + G_d d̂,   S x* = r        (Newton's method, from the last x*, u*)
u = u* − K (x̂ − x*)                                        limited to ± the limit of each input</pre>
<p>u* holds the plant at its references, gravity included. Without <code>compensation</code> d̂ is taken to be 0. Where d
acts through the inputs' channel, G_d = B Γ, x* does not depend on d̂, and u* contains −Γ d̂, which cancels the
disturbance at any pace. Elsewhere the compensation is exact for the regulated outputs once d is constant. By default, K
is the gain of least effort that puts the poles to the left of a line that was chosen when this FMU was built.</p>
<h2>Variables</h2>
{{ variables }}
<h2>Timing</h2>
<p>The estimates that are set before doStep(t, H) are those for t. The command that is read after it is held from t + H
on. In initialization mode it is the command for the estimates at the start.</p>
<h2>Limits</h2>
<p>Where the plant has no equilibrium at the references, the last equilibrium is kept. Inputs that are not finite are
replaced by their last finite values. The references are taken to be constant. There is no integral action: the observer
estimates only what is constant and enters where d does.</p>
"""


def controller_record(model: Model, feedback: Feedback) -> ComponentRecord:
    """Return the record of a model's controller with this feedback."""
    return ComponentRecord(
        name=f"{model.name}Controller",
        text="State feedback on the observer's estimates, with compensation of the estimated disturbance",
        variables=controller_variables(compile_model(model), feedback),
        page=_PAGE,
        icon=Icon(model.name, "controller", into=("$r$", r"$\hat{x}$", r"$\hat{d}$"), out=("$u$",)),
        experiment=compile_model(model).experiment,
    )


def build_controller(
    model: Model,
    out: str | Path = "build/fmus",
    *,
    regulated: Sequence[str] | None = None,
    pace: float | None = None,
) -> Path:
    """Write `<Name>Controller.fmu` into the folder `out` and return its path.

    Arguments and errors are those of `design_controller`, and UsageError where the folder cannot be written.
    """
    feedback = design_controller(model, regulated=regulated, pace=pace).feedback
    data = f"{emit_python(model)}\n\nfrom {Feedback.__module__} import Feedback\n\nFEEDBACK = {feedback!r}\n"
    return write_component(controller_record(model, feedback), "Controller", data, ("EQUATIONS", "FEEDBACK"), out)
