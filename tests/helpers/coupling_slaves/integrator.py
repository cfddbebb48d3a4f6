from pythonfmu import Boolean, DefaultExperiment, Fmi2Causality, Fmi2Initial, Fmi2Slave, Fmi2Variability, Real

EXACT = {"initial": Fmi2Initial.exact, "variability": Fmi2Variability.continuous}


class Integrator(Fmi2Slave):
    """y' = u, exact for an input held over the step; a sum of steps that ever failed raises."""

    default_experiment = DefaultExperiment(start_time=0.5, stop_time=1.5, step_size=0.25)

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.u = 0.0
        self.y = 0.0
        self.half = 0.0
        self.positive = False
        self.register_variable(Real("u", causality=Fmi2Causality.input))
        self.register_variable(Real("y", causality=Fmi2Causality.output, **EXACT))
        self.register_variable(Real("half", causality=Fmi2Causality.output))
        self.register_variable(Boolean("positive", causality=Fmi2Causality.output))

    def exit_initialization_mode(self):
        self.half, self.positive = self.y / 2, self.y > 0

    def do_step(self, current_time, step_size):
        self.y += step_size * self.u
        self.half, self.positive = self.y / 2, self.y > 0
        return True
