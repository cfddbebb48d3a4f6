"""FMI 2.0's rules for a co-simulation slave: which call is allowed in which mode, and when a variable may be set.

This table is the only copy. The build writes it as a C header for the shell (`fmu/rules_header.py`); the slave,
which also runs where an FMU has no front, reads it as it is. What breaks a rule is refused with fmi2Error and changes
nothing.
"""

from __future__ import annotations

from ndob_fmu.interface.variables import Variable

# The modes of FMI's state machine, and how a message names an instance in each.
MODES = {
    "instantiated": "instantiated",
    "initialization": "in initialization mode",
    "stepping": "in step mode",
    "terminated": "terminated",
}
# Modes that FMI does not have: such an instance can only be freed.
DEAD_MODES = {
    "lost": "lost after a fatal error",
    "orphaned": "inherited from a process that forked while a thread was calling an FMU",
}

_ANY = tuple(MODES)
_BEFORE_THE_END = ("instantiated", "initialization", "stepping")
_TYPES = ("Real", "Integer", "Boolean", "String")

# The modes in which each function may be called, by its name without "fmi2".
CALLS = {
    "SetDebugLogging": _ANY,
    "FreeInstance": (*MODES, *DEAD_MODES),
    "Reset": _ANY,
    "SetupExperiment": ("instantiated",),
    "EnterInitializationMode": ("instantiated",),
    "ExitInitializationMode": ("initialization",),
    "DoStep": ("stepping",),
    "Terminate": ("stepping",),
    **{f"Get{kind}": _ANY for kind in _TYPES},
    **{f"Set{kind}": _BEFORE_THE_END for kind in _TYPES},
    "GetFMUstate": _ANY,
    "SetFMUstate": _ANY,
    "FreeFMUstate": _ANY,
    "SerializedFMUstateSize": _ANY,
    "SerializeFMUstate": _ANY,
    "DeSerializeFMUstate": _ANY,
    "GetRealStatus": ("stepping", "terminated"),
    "GetBooleanStatus": ("stepping", "terminated"),
}
# Functions that the model description says these FMUs do not have: refused in every mode.
UNSUPPORTED = (
    "GetStatus",
    "GetIntegerStatus",
    "GetStringStatus",
    "CancelStep",
    "SetRealInputDerivatives",
    "GetRealOutputDerivatives",
    "GetDirectionalDerivative",
)
# The modes in which a variable may be set, by its role.
SETTABLE = {
    "input": _BEFORE_THE_END,
    "fixed": ("instantiated", "initialization"),
    "tunable": _BEFORE_THE_END,
    "calculated": (),
}
# What a message says was expected and received where a variable of a role may not be set.
NOT_SETTABLE = {
    "fixed": ("a fixed parameter's value before the end of initialization", "one in step mode"),
    "calculated": ("an input or a parameter", "what the FMU calculates"),
}


def role(variable: Variable) -> str:
    """Return what the rules for setting go by: "input", "fixed", "tunable" (parameters) or "calculated"."""
    if variable.causality == "parameter":
        return "tunable" if variable.variability == "tunable" else "fixed"
    return "input" if variable.causality == "input" else "calculated"
