"""`TorsionSpring`: pulls two angles together."""

from __future__ import annotations

from ndob_fmu.fmu.icon import Icon
from ndob_fmu.fmu.record import ComponentRecord
from ndob_fmu.interface.variables import Variable, parameter

_ANGLES = ("angle_a", "angle_b")
_VARIABLES = (
    *(Variable(name, "input", "Angle of one end", start=0.0, unit="rad") for name in _ANGLES),
    *(
        Variable(f"torque_{end}", "output", f"Torque on the end of angle_{end}", unit="N.m", depends_on=_ANGLES)
        for end in ("a", "b")
    ),
    parameter("stiffness", 1.0, "Stiffness", unit="N.m/rad", minimum=0.0),
)

_PAGE = """\
<p>A torsion spring between two joints.</p>
<h2>Equations</h2>
<pre>torque_a = stiffness (angle_b − angle_a),   torque_b = −torque_a</pre>
<h2>Variables</h2>
{{ variables }}
<h2>Timing</h2>
<p>The torques that are read after doStep(t, H) are those for the angles that were set before it. With a master that
hands over the angles of t (Jacobi) they are one step late, which takes about stiffness·H from the joints' damping.</p>
"""

RECORD = ComponentRecord(
    name="TorsionSpring",
    text="Torsion spring: pulls two angles together",
    variables=_VARIABLES,
    page=_PAGE,
    icon=Icon("Torsion", "spring", into=(r"$\varphi_a$", r"$\varphi_b$"), out=(r"$\tau_a$", r"$\tau_b$")),
)
