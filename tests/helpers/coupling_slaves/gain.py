from pythonfmu import Fmi2Causality, Fmi2Slave, Fmi2Variability, Real


class Gain(Fmi2Slave):
    """y = k (a + b), at once: also while inputs are exchanged before the first step."""

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.a = 0.0
        self.b = 0.0
        self.k = 2.0
        self.register_variable(Real("a", causality=Fmi2Causality.input))
        self.register_variable(Real("b", causality=Fmi2Causality.input))
        self.register_variable(Real("k", causality=Fmi2Causality.parameter, variability=Fmi2Variability.tunable))
        self.register_variable(
            Real("y", causality=Fmi2Causality.output, getter=lambda: self.k * (self.a + self.b), setter=None)
        )

    def do_step(self, current_time, step_size):
        return True
