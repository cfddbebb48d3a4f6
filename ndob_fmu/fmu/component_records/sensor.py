"""`Sensor`: a sampled, quantised, delayed and sometimes lost measurement of any quantity."""

from __future__ import annotations

from ndob_fmu.fmu.icon import Icon
from ndob_fmu.fmu.record import ComponentRecord
from ndob_fmu.fmu.sampling_variables import sampling_parameters, sampling_signals
from ndob_fmu.interface.variables import parameter

# No variable has a unit but the times, so that the sensor fits any quantity.
_VARIABLES = (
    *sampling_signals("value", "Value"),
    parameter("resolution", 0.0, "A sample is a multiple of it; 0: not rounded", minimum=0.0),
    *sampling_parameters("sensors", "value"),
)

_PAGE = """\
<p>A sampled, quantised, delayed and sometimes lost measurement of any quantity. Value, noise, bias and resolution have
no declared unit: they are in the unit of what the sensor measures.</p>
<h2>Equations</h2>
<pre>sample   resolution round((value(s) + bias + noise_std n) / resolution)</pre>
<p>s is the time of the sample. Without <code>resolution</code> (0) nothing is rounded. n is standard normal, drawn from
<code>seed</code> and the number of the sample (Philox 4x64, Box and Muller). It depends neither on other instances nor
on earlier draws, nor on the communication step if <code>sample_time</code> is above 0. Rounding adds an error with a
standard deviation of resolution/√12.</p>
<p>With <code>sample_time</code> 0 the output at t is the sample of s = t − delay, a new one for each step. With a
sample_time above 0 samples are taken at s = start + k sample_time. A sample is shown from the end of the first step
that ends at s + delay or later. If several become due in one step, the last one is shown.</p>
<p>Neither delay nor sample_time need be a multiple of the step: between two communication points the value is taken
from the line through the values there. Until the first delay is over, the first sample is shown. A sample is lost with
<code>dropout_probability</code>, or because the value is not finite. The first sample is never lost.</p>
<h2>Variables</h2>
{{ variables }}
<h2>Timing</h2>
<p>The value that is set before doStep(t, H) is taken as the value at t + H, the time of the output. In initialization
mode the output follows the value at once. So the sensor adds no delay to <code>delay</code>. What remains depends on
the master. A master that hands over the value of t (Jacobi) adds one step; for a total delay of D ≥ H set delay to
D − H. A master that steps the observer first, then the source of the value, then the sensor (Gauss–Seidel in the order
observer, plant, sensor) adds none.</p>
<h2>Limits</h2>
<p>The line between two communication points errs by at most H²/8 times the largest second derivative of the value. If
delay and sample_time are multiples of the step it does not err. The sensor keeps the values of the last delay + H
seconds. An observer takes every finite value for a new sample. With a sample_time longer than the observer's step let
<code>between_samples</code> be not_a_number, so that the observer coasts in between.</p>
"""

RECORD = ComponentRecord(
    name="Sensor",
    text="Sensor: a sampled, quantised, delayed and sometimes lost measurement of any quantity",
    variables=_VARIABLES,
    page=_PAGE,
    icon=Icon("Sensor", "", into=("$y$",), out=("$y_m$",)),
)
