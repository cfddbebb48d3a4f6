from pythonfmu import Fmi2Causality, Fmi2Slave, Fmi2Variability, Integer, Real


class FlexibleJointObserver(Fmi2Slave):
    """The variables that ssp/open_loop needs of the observer; its outputs are its inputs."""

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.motor_torque = self.motor_angle = self.link_angle = 9.0
        self.method = 2
        for name in ("motor_torque", "motor_angle", "link_angle"):
            self.register_variable(Real(name, causality=Fmi2Causality.input))
            self.register_variable(Real(f"{name}_hat", causality=Fmi2Causality.output, getter=self.reader(name)))
        self.register_variable(Integer("method", causality=Fmi2Causality.parameter, variability=Fmi2Variability.fixed))
        self.register_variable(
            Integer(
                "used",
                causality=Fmi2Causality.output,
                variability=Fmi2Variability.discrete,
                getter=self.reader("method"),
            )
        )

    def reader(self, name):
        return lambda: getattr(self, name)

    def do_step(self, current_time, step_size):
        return True
