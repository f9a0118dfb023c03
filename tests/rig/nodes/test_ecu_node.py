"""What reaches a whole node in C, and its end; tests/rig/export compares the frames with Python."""

from typing import Any

import can
import pytest

from can_rig.controllers.protocol import WholeNode
from can_rig.frames.codec import CheckStatus
from can_rig.nodes.lockstep import EcuNode, lockstep_controller
from can_rig.scenario.build import network_of
from can_rig.scenario.loading import load

HEALTHY = load("default", ["duration_s=0.03", "fault.kind=none"])
NETWORK = network_of(HEALTHY)
FEEDBACK, COMMAND = NETWORK.feedback.frame_id, NETWORK.command_1.frame_id


class Program:
    """Answers every feedback."""

    def __init__(self) -> None:
        self.taken: list[tuple[int, bytes]] = []
        self.closed = 0

    def take(self, frame_id: int, data: bytes) -> list[tuple[int, bytes]]:
        self.taken.append((frame_id, data))
        return [(COMMAND, bytes(8))] if frame_id == FEEDBACK else []

    def counts(self) -> list[int]:
        return 2 * len(CheckStatus) * [0]

    def close(self) -> None:
        self.closed += 1


def frame(number: int = FEEDBACK, **kind: Any) -> can.Message:
    return can.Message(arbitration_id=number, data=b"12345678", **{"is_extended_id": False, **kind})


@pytest.mark.parametrize(
    "other",
    [frame(is_extended_id=True),
     can.Message(arbitration_id=FEEDBACK, is_extended_id=False, is_remote_frame=True, dlc=8),
     frame(is_error_frame=True), frame(0x700), frame(COMMAND)],
    ids=["extended", "remote", "error", "another", "a command"],
)  # fmt: skip
def test_other_frames_do_not_reach_it(other):
    program, sent = Program(), list[can.Message]()
    node = EcuNode(HEALTHY, NETWORK, sent.append, program)
    assert node.take(other) is False
    assert program.taken == sent == []
    assert node.tick == 0
    assert node.take(frame()) is True
    assert (node.tick, len(sent)) == (1, 1)


def test_what_was_chosen_runs_and_is_ended():
    program = Program()
    application = WholeNode(lambda: program)
    with pytest.raises(RuntimeError), lockstep_controller(
        HEALTHY, NETWORK, list[can.Message]().append, application
    ) as node:  # fmt: skip
        node.take(frame())
        assert (len(program.taken), program.closed) == (1, 0)
        raise RuntimeError
    assert program.closed == 1
