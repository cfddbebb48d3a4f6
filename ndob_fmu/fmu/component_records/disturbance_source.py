"""`DisturbanceSource`: a disturbance as a function of time."""

from __future__ import annotations

from ndob_fmu.fmu.icon import Icon
from ndob_fmu.fmu.record import ComponentRecord
from ndob_fmu.interface.model_variables import DISTURBANCE_KIND
from ndob_fmu.interface.variables import Enumeration, Variable, parameter
from ndob_fmu.runtime.blocks.disturbance_source import INTERPOLATIONS, SOURCE_KINDS

_KIND = Enumeration(
    "SourceKind",
    SOURCE_KINDS,
    {
        **DISTURBANCE_KIND.texts,
        "noise": "Gaussian noise of standard deviation amplitude, flat up to frequency and none above",
        "profile": "the rows of a file",
    },
)
_INTERPOLATION = Enumeration(
    "Interpolation", INTERPOLATIONS, {"linear": "on the line through the rows", "held": "the value before"}
)

# The output has no unit, so that it fits any disturbance.
_VARIABLES = (
    Variable("disturbance", "output", "Disturbance at the end of the step, in the unit of what it drives"),
    parameter("disturbance.kind", 1, "Signal", enumeration=_KIND),
    parameter(
        "disturbance.amplitude",
        1.0,
        "Amplitude; of a ramp the rise per second, of noise the standard deviation, of a profile a factor",
    ),
    parameter(
        "disturbance.frequency",
        1.0,
        "Frequency of the sine; end frequency of the chirp; upper end of the noise's band",
        unit="Hz",
        minimum=0.0,
    ),
    parameter("disturbance.start_time", 0.0, "Time before which all but the constant are 0", unit="s"),
    parameter("disturbance.seed", 0, "Seed of the noise", type="Integer", minimum=0),
    parameter(
        "disturbance.profile",
        "",
        "Path of a CSV file whose first two columns are time since start_time in s, and value",
        type="String",
    ),
    parameter(
        "disturbance.interpolation",
        1,
        "Between two rows of the profile",
        enumeration=_INTERPOLATION,
    ),
)

_PAGE = """\
<p>A disturbance as a function of time, to be connected to a disturbance input of a plant. The output has no unit: it is
in that of the input that it drives.</p>
<h2>Equations</h2>
<p>With τ = t − start_time; all but the constant are 0 before start_time:</p>
<pre>none       0
constant   amplitude, at all times
ramp       amplitude τ
sine       amplitude sin(2π frequency τ)
step       amplitude
chirp      a sine whose frequency rises linearly from 0 to frequency in 10 s and stays there
noise      amplitude √(2/N) Σᵢ cos(2π fᵢ τ + φᵢ),  N = 256,  fᵢ = (i + uᵢ) frequency/N,  i = 0 … N − 1
profile    amplitude × the table at τ</pre>
<p>The seed draws uᵢ, uniform in [0, 1), and φᵢ, uniform in [0, 2π). The noise is Gaussian (to the order of 1/N). Its
standard deviation is amplitude. Its one-sided power spectral density is amplitude²/frequency up to frequency, and 0
above. The same seed gives the same noise at every communication step. Records longer than N/frequency tell its tones
apart.</p>
<p>The table is a CSV file with time (s) and value in its first two columns; a first row without numbers is a heading.
Before the first row the value of the first row holds, after the last row that of the last row.</p>
<h2>Variables</h2>
{{ variables }}
<h2>Timing</h2>
<p>After doStep(t, H) the output is that of t + H. A plant that holds its inputs over a step sees the signal H/2 late on
average. The generator that is built into every plant is continuous inside the step.</p>
<h2>Limits</h2>
<p>The path of a profile is relative to the folder in which the host runs. If there is no such file, or if its times do
not ascend, initialization ends with an error that says so.</p>
"""

RECORD = ComponentRecord(
    name="DisturbanceSource",
    text="Disturbance as a function of time: signals, band-limited noise, or a profile from a file",
    variables=_VARIABLES,
    page=_PAGE,
    icon=Icon("Disturbance", "source", into=(), out=("$d$",)),
)
