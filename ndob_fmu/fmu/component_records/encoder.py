"""`Encoder`: a sampled, quantised, delayed and sometimes lost measurement of an angle."""

from __future__ import annotations

from ndob_fmu.fmu.icon import Icon
from ndob_fmu.fmu.record import ComponentRecord
from ndob_fmu.fmu.sampling_variables import sampling_parameters, sampling_signals
from ndob_fmu.interface.variables import parameter

_VARIABLES = (
    *sampling_signals("angle", "Angle", "rad"),
    parameter("counts_per_revolution", 4096, "Resolution; 4096 is 12 bits, 0 none at all", type="Integer", minimum=0),
    *sampling_parameters("encoders", "angle", "rad"),
)

_PAGE = """\
<p>A sampled, quantised, delayed and sometimes lost measurement of an angle.</p>
<h2>Equations</h2>
<pre>sample   LSB round((angle + bias + noise_std n) / LSB),   LSB = 2π / counts_per_revolution</pre>
<p>n is standard normal, drawn from <code>seed</code> and the number of the sample (Philox 4x64, Box and Muller). It
depends neither on other instances nor on earlier draws. Rounding adds an error with a standard deviation of LSB/√12,
which is 4.4e-4 rad for 4096 counts. If the noise is smaller, take this as the observer's
<code>&lt;output&gt;_noise_std</code>.</p>
<p>Samples are taken at the start and every <code>sample_time</code> after it; with 0, at the end of each step. Where no
step ends at such a time, the sample is taken at the end of the step across it. A sample is shown <code>delay</code>
later, or from the end of the first step after that: the delay is exact if it is a multiple of the step. Until the first
delay is over, the first sample is shown. A sample is lost with <code>dropout_probability</code>, or because the angle
is not finite. The first sample is never lost.</p>
<h2>Variables</h2>
{{ variables }}
<h2>Timing</h2>
<p>The angle that is set before doStep(t, H) is taken as the angle at t + H, the time of the output. A master that hands
over the angle of t (Jacobi) thereby adds a delay of one step. A master that steps the observer first, then the source
of the angle, then the encoder (Gauss–Seidel in the order observer, plant, encoder) adds none.</p>
<h2>Limits</h2>
<p>An observer takes every finite value for a new sample. With a <code>sample_time</code> longer than the observer's
step let <code>between_samples</code> be not_a_number, so that the observer coasts in between.</p>
"""

RECORD = ComponentRecord(
    name="Encoder",
    text="Encoder: a sampled, quantised, delayed and sometimes lost measurement of an angle",
    variables=_VARIABLES,
    page=_PAGE,
    icon=Icon("Encoder", "", into=(r"$\varphi$",), out=(r"$\varphi_m$",)),
)
