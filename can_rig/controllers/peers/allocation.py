"""PI control of a virtual command, allocated to both actuators by a weighted pseudo-inverse.

The demand v of D* is met by u = W Bᵀ (B W Bᵀ)⁻¹ v, B = [(1 - s) G1(0), G2(0)], the least uᵀW⁻¹u
(Durham, J. Guidance 16, 1993; Johansen and Fossen, Automatica 49, 2013). The weights prefer the
steering; the lost share s, from ``LossObserver``, moves the demand to the rear wheels.
"""

import math

from can_rig.controllers.peers.loss_observer import LossObserver
from can_rig.controllers.protocol import Answer, Inputs
from can_rig.controllers.setup import ControllerSetup


class Allocation:
    """Parameters: ``lambda_s`` and ``lag_s`` as of ``Pi``; ``rear``, the share of the rear wheels.

    ``rear`` weighs the force difference against the torque, each as a share of its limit, or of
    ``torque_nm`` and ``force_difference_n`` where a command has no limit.
    """

    def __init__(self, setup: ControllerSetup) -> None:
        time_s = setup.number("lambda_s", 0.3)
        self.kp, self.ki = setup.number("lag_s", 0.2) / time_s, setup.tick_s / time_s
        self.observer, self.limits = LossObserver(setup), setup.limits
        self.gains = setup.plant.g1.dc_gain, setup.plant.g2.dc_gain
        sizes = setup.number("torque_nm", 100.0), setup.number("force_difference_n", 4000.0)
        one, two = (
            limit if math.isfinite(limit) else size
            for limit, size in zip(self.limits, sizes, strict=True)
        )
        self.weights = one**2, (setup.number("rear", 0.05) * two) ** 2
        self.integral = 0.0

    def reset(self, reference: float) -> None:
        """See ``Controller``; the models start at rest."""
        self.integral = 0.0

    def demand(self, error: float) -> float:
        """The virtual command of D* for an error, m/s²."""
        self.integral += self.ki * error
        return self.kp * error + self.integral

    def step(self, inputs: Inputs) -> Answer:
        """See ``Controller``."""
        _, lost = self.observer.observe(inputs.measurement)
        before = self.integral
        demand = self.demand(inputs.reference - inputs.measurement)
        left = (1.0 - self.observer.share) * self.gains[0], self.gains[1]
        effects = [w * b for w, b in zip(self.weights, left, strict=True)]
        scale = sum(effect * b for effect, b in zip(effects, left, strict=True))
        wishes = [effect * demand / scale for effect in effects]
        one, two = (
            min(max(wish, -limit), limit) for wish, limit in zip(wishes, self.limits, strict=True)
        )
        if (one, two) != tuple(wishes):
            self.integral = before  # the integral waits at a limit
        self.observer.advance(one, two)
        return Answer(one, two, lost, fault_state=self.observer.fault_state)
