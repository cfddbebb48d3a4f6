from math import cos

from pythonfmu import Fmi2Causality, Fmi2Slave, Real


class FlexibleJointPlant(Fmi2Slave):
    """The variables that ssp/open_loop needs of the plant, with signals that are known in closed form."""

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.motor_torque = self.load_torque = 9.0
        self.motor_angle, self.link_angle = 1.0, 0.0
        for name in ("motor_torque", "load_torque"):
            self.register_variable(Real(name, causality=Fmi2Causality.input))
        for name in ("motor_angle", "link_angle"):
            self.register_variable(Real(name, causality=Fmi2Causality.output))

    def do_step(self, current_time, step_size):
        self.motor_angle = cos(current_time + step_size)
        self.link_angle = self.motor_torque + 2 * self.load_torque
        return True
