import os
import signal
import time

from pythonfmu import Fmi2Causality, Fmi2Slave, Fmi2Variability, Real, String
from pythonfmu.enums import Fmi2Status


class Fragile(Fmi2Slave):
    """Fails from `fails_at` on in the way that `how` names; does not start at all as `unlicensed`."""

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        if self.instance_name == "unlicensed":
            raise ValueError("no licence")
        self.how = ""
        self.fails_at = 0.0
        self.x = 0.0
        self.register_variable(String("how", causality=Fmi2Causality.parameter, variability=Fmi2Variability.tunable))
        self.register_variable(Real("fails_at", causality=Fmi2Causality.parameter, variability=Fmi2Variability.tunable))
        self.register_variable(Real("x", causality=Fmi2Causality.output))

    def enter_initialization_mode(self):
        if self.how == "initialization":
            raise ValueError("no equilibrium found")

    def do_step(self, current_time, step_size):
        if current_time >= self.fails_at:
            if self.how == "raise":
                raise ValueError("the bearing has seized")
            if self.how == "discard":
                self.log("step too long for the contact", Fmi2Status.discard)
                return False
            if self.how == "interrupt":
                os.kill(os.getpid(), signal.SIGINT)
            if self.how == "crash":
                os._exit(1)
            if self.how == "slow":
                time.sleep(0.05)
        return True
