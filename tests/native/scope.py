"""Which modules of the runtime must translate, and what of them does not yet: this list may only become shorter."""

from __future__ import annotations

_NUMERICS = "exponential hold integrate kalman phi riccati sliding stiff transition units zeros"
_STEP = """
    adaptive_noise channel_observer converged_step delayed_outputs error_columns faulty_samples filter_model
    filter_state fixed_lag held
    jump_bank layout measurement_update model_error order_zero paper_observer prediction preparation reconsider
    sampled_step sensor_memory start_memory time_update tracking_step tuned
"""
_DESIGN = """
    augmented doubtful gains idle_modes intensity_law like_disturbance longest_step minimum_phase operating_point
    schedule scheduled_gains start_up stationary_design step_designs tuning undriven_noise
"""
MODULES = [
    f"ndob_fmu.runtime.{folder}.{name}"
    for folder, names in (("numerics", _NUMERICS), ("design", _DESIGN), ("step", _STEP))
    for name in names.split()
]

# Written by hand in C; the tests call these beside their twins too.
BY_HAND = {"numerics.kalman.triangular"}

# What only hands on to the observer of the lumped inputs, which a component in C does itself.
_CHANNEL = "ndob_fmu.runtime.step.channel_observer"
WRAPPERS = [
    f"{_CHANNEL}.{name}"
    for name in (
        "read_out",
        "ChannelState.u",
        "ChannelObserver.init",
        "ChannelObserver.possible",
        "ChannelObserver.estimate",
        "ChannelObserver.step",
    )
]

NOT_YET = {
    "design.step_designs.StepDesigns._key": "the key of a cache, which C does not have",
}
