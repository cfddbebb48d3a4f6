from pythonfmu import Fmi2Causality, Fmi2Slave, Fmi2Variability, Real


class MassSpring(Fmi2Slave):
    """m x'' = F - c x, one symplectic Euler step per communication step."""

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.force = 0.0
        self.position = 1.0
        self.velocity = 0.0
        self.energy = 0.5
        self.mass = 1.0
        self.stiffness = 1.0
        self.register_variable(Real("force", causality=Fmi2Causality.input))
        for name in ("position", "velocity", "energy"):
            self.register_variable(Real(name, causality=Fmi2Causality.output))
        for name in ("mass", "stiffness"):
            self.register_variable(Real(name, causality=Fmi2Causality.parameter, variability=Fmi2Variability.tunable))

    def do_step(self, current_time, step_size):
        self.velocity += step_size * (self.force - self.stiffness * self.position) / self.mass
        self.position += step_size * self.velocity
        self.energy = (self.mass * self.velocity**2 + self.stiffness * self.position**2) / 2
        return True
