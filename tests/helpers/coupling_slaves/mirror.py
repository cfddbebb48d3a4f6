from pythonfmu import Boolean, Fmi2Causality, Fmi2Slave, Fmi2Variability, Integer, Real, String
from pythonfmu.enums import Fmi2Status

IN, OUT, PARAMETER = Fmi2Causality.input, Fmi2Causality.output, Fmi2Causality.parameter
DISCRETE = {"variability": Fmi2Variability.discrete}


class Mirror(Fmi2Slave):
    """Returns its inputs at each step, one variable of each type; warns if the label says so."""

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.count_in, self.on_in, self.level_in, self.label = 0, False, 0.0, ""
        self.count, self.on, self.level, self.length = 0, False, 0.0, 0
        self.register_variable(Integer("count_in", causality=IN, **DISCRETE))
        self.register_variable(Boolean("on_in", causality=IN, **DISCRETE))
        self.register_variable(Real("level_in", causality=IN))
        self.register_variable(String("label", causality=PARAMETER, variability=Fmi2Variability.tunable))
        self.register_variable(Boolean("on", causality=OUT, **DISCRETE))
        self.register_variable(Integer("count", causality=OUT, **DISCRETE))
        self.register_variable(Real("level", causality=OUT))
        self.register_variable(String("echo", causality=OUT, getter=lambda: self.label, **DISCRETE))
        self.register_variable(Integer("length", causality=OUT, **DISCRETE))

    def do_step(self, current_time, step_size):
        self.count, self.on, self.level, self.length = self.count_in, self.on_in, self.level_in, len(self.label)
        if self.label == "careful":
            self.log("level is only mirrored", Fmi2Status.warning)
        return True
