"""Which modules of the runtime must translate, and what of them does not yet: this list may only become shorter."""

from __future__ import annotations

_NUMERICS = "exponential hold integrate kalman phi riccati stiff transition units zeros"
_STEP = """
    adaptive_noise converged_step delayed_outputs error_columns faulty_samples filter_model filter_state fixed_lag
    jump_bank layout measurement_update order_zero prediction preparation reconsider sampled_step sensor_memory
    start_memory time_update tracking_step tuned
"""
MODULES = [
    f"ndob_fmu.runtime.{folder}.{name}"
    for folder, names in (("numerics", _NUMERICS), ("step", _STEP))
    for name in names.split()
]

# Written by hand in C; the tests call these beside their twins too.
BY_HAND = {"numerics.kalman.triangular"}

NOT_YET = {
    "step.preparation._output": "ranges by name",
    "step.preparation.linearised": "as operating_point.tangent",
    "step.preparation.prepared": "as _output",
    "step.preparation.PreparedObserver.design": "as StepDesigns.at",
    "step.tuned.tune": "as StepDesigns.at",
    "design.intensity_law.tuned_law": "an object that remembers",
    "design.minimum_phase.require_zeros_left_of": "a complex number in a message",
    "design.operating_point.tangent": "ranges by name",
    "design.step_designs.StepDesigns._tuned": "as tuned_intensities",
    "design.step_designs.StepDesigns.at": "`or` of None",
    "design.step_designs.StepDesigns.intensities": "as tuned_intensities",
    "design.step_designs.StepDesigns.law": "as tuned_law",
    "design.tuning.tuned_intensities": "an object that remembers",
    "equations.Equations.linear_part": "a function or None",
}
