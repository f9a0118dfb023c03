"""The rig's own control law as a controller of a node."""

import math

from can_rig.controllers.protocol import Answer, InNode, Inputs, samples_in
from can_rig.frames.network import Network
from can_rig.scenario.controls import controls
from can_rig.scenario.settings import Scenario
from firmware_model.firmware import PYTHON_LAW, Firmware, Law


class OurLaw:
    """``Firmware`` of a scenario at rest; see ``NodeController``.

    Raises:
        ScenarioError: the design fails.
    """

    def __init__(self, scenario: Scenario, network: Network, law: Law) -> None:
        of = controls(scenario, network)
        self.firmware = Firmware(of.table, law, of.schedule)
        self.firmware.step(math.nan, math.nan)  # compiled before the first tick
        self.firmware.begin()
        self.reset, self.act = self.firmware.reset, self.firmware.act
        self.saved, self.restore = self.firmware.saved, self.firmware.restore

    def step(self, inputs: Inputs) -> Answer:
        """See ``Controller``."""
        reference, measurement, speed, heard = inputs
        if not math.isnan(speed):
            self.firmware.change_speed(speed)
        for sample in samples_in(heard):
            self.firmware.hear(*sample)
        return Answer(*self.firmware.step(reference, measurement))

    @property
    def commands(self) -> tuple[float, float]:
        """See ``NodeController``."""
        return self.firmware.commands

    def take_over(self, inputs: Inputs, at_rest: bool) -> None:
        """See ``NodeController``."""
        known = self.firmware.saved()
        self.firmware.begin(at_rest)
        self.firmware.restore(known)


def in_node(law: Law, without_frames: bool = False) -> InNode:
    """The control law by ``law``, in a node of the rig; see ``InNode``."""
    return InNode(lambda scenario, network: OurLaw(scenario, network, law), without_frames)


PYTHON = in_node(PYTHON_LAW, without_frames=True)
