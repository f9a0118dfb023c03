"""Internal model control with the lost share of channel 1 as a Kalman filter's state.

u1 = U (r - y + G1 u1) and u2 = F̂ s G1 u1: C and F̂ are the thesis's, (3.32) and (3.33); the lost
share s comes from ``LossObserver``.
"""

from can_rig.controllers.peers.loss_observer import LossObserver
from can_rig.controllers.protocol import Answer, Inputs
from can_rig.controllers.setup import ControllerSetup
from can_rig.errors import ScenarioError
from can_rig.scenario.build import continuous_design
from firmware_model.discretisation.filters import discretise


class Kalman:
    """Parameters: ``share_drift`` of ``LossObserver``; ``[design]`` has the time constants."""

    def __init__(self, setup: ControllerSetup) -> None:
        design = continuous_design(setup.scenario)
        tracking = design.tracking
        if tracking is None or tracking.stabiliser is not None or design.compensator is None:
            raise ScenarioError("kalman: must have a stable plant, feedback and compensation")
        self.observer, self.limits = LossObserver(setup), setup.limits
        self.tracking = discretise(tracking.filter, setup.tick_s)
        self.compensator = discretise(design.compensator, setup.tick_s)

    def reset(self, reference: float) -> None:
        """See ``Controller``; the models start at rest."""

    def step(self, inputs: Inputs) -> Answer:
        """See ``Controller``."""
        w, lost = self.observer.observe(inputs.measurement)
        wishes = (
            self.tracking.step(inputs.reference - inputs.measurement + w),
            self.compensator.step(lost),
        )
        one, two = (
            min(max(wish, -limit), limit) for wish, limit in zip(wishes, self.limits, strict=True)
        )
        self.observer.advance(one, two)
        return Answer(one, two, lost, fault_state=self.observer.fault_state)
