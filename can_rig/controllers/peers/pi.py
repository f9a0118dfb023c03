"""PI control of the torque, without compensation of a loss.

Lambda tuning of the plant's first-order approximation K/(1 + T s): kp = T/(K λ), ki = 1/(K λ)
(Rivera, Morari and Skogestad, Ind. Eng. Chem. Process Des. Dev. 25, 1986).
"""

from can_rig.controllers.protocol import Inputs
from can_rig.controllers.setup import ControllerSetup


class Pi:
    """Parameters: ``lambda_s``, the time constant of the closed loop, and ``lag_s``, T."""

    def __init__(self, setup: ControllerSetup) -> None:
        gain = setup.plant.g1.dc_gain * setup.number("lambda_s", 0.3)
        self.kp, self.ki = setup.number("lag_s", 0.2) / gain, 1.0 / gain
        self.tick_s, self.limit = setup.tick_s, setup.limits[0]
        self.integral = 0.0

    def reset(self, reference: float) -> None:
        """See ``Controller``; the torque starts at zero."""
        self.integral = 0.0

    def step(self, inputs: Inputs) -> tuple[float, float]:
        """See ``Controller``; the integral waits at the torque's limit."""
        error = inputs.reference - inputs.measurement
        torque = self.kp * error + self.integral + self.ki * self.tick_s * error
        if abs(torque) < self.limit or torque * error < 0.0:
            self.integral += self.ki * self.tick_s * error
        return torque, 0.0
