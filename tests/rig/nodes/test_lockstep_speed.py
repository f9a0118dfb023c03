"""What the controller node in lockstep makes of the frames of the speed, and of commands."""

from __future__ import annotations

import math

import can
import pytest

from can_rig.assessment.resolve import load
from can_rig.controllers.our_law import OurLaw
from can_rig.controllers.protocol import Answer, InNode, Inputs
from can_rig.frames.codec import Transmitter
from can_rig.frames.operator_frames import Command, taken_message
from can_rig.nodes.lockstep import ControllerNode
from can_rig.scenario.build import network_of
from firmware_model.firmware import PYTHON_LAW

SCENARIO = load("drive-cycle", ["duration_s=0.02"])
NETWORK = network_of(SCENARIO)


@pytest.fixture
def node() -> tuple[ControllerNode, list[float]]:
    """A node, and the speeds that its controller has been told."""
    heard: list[float] = []

    class Listening(OurLaw):
        def step(self, inputs: Inputs) -> Answer:
            if not math.isnan(inputs.speed_mps):
                heard.append(inputs.speed_mps)
            return super().step(inputs)

    controller = InNode(lambda scenario, network: Listening(scenario, network, PYTHON_LAW))
    return ControllerNode(SCENARIO, NETWORK, lambda _message: None, controller), heard


def test_the_firmware_is_told_every_speed_that_is_intact_the_first_too(
    node: tuple[ControllerNode, list[float]],
) -> None:
    controller, heard = node
    assert NETWORK.speed is not None
    ends = [Transmitter(codec) for codec in (NETWORK.speed, NETWORK.reference, NETWORK.feedback)]

    def answered(tick: int, speed_mps: float, damage: int = 0) -> list[bool]:
        frames: list[can.Message] = [
            end.frame(value, tick) for end, value in zip(ends, (speed_mps, 0.0, 0.0), strict=True)
        ]
        frames[0].data[5] ^= damage
        return [controller.take(frame) for frame in frames]

    assert answered(0, 8.0) == [False, False, True]  # the first contact
    assert heard == [8.0]
    assert answered(1, 9.0) == [False, False, True]
    assert answered(2, 10.0, damage=1) == [False, False, True]
    assert answered(3, 11.0) == [False, False, True]
    assert heard == [8.0, 9.0, 11.0]


def test_a_command_of_the_operator_answers_no_tick(
    node: tuple[ControllerNode, list[float]],
) -> None:
    controller, _ = node
    said = taken_message(Command("INJECT", "frames-missing", "torque", None, 0.1), 5)
    assert controller.take(said) is False
    assert controller.expected is None
