"""The bus side of a controller node in C: frames in and frames out."""

from typing import Any

import can
import pytest

from can_rig.assessment.resolve import load
from can_rig.controllers.our_law import in_node
from can_rig.controllers.protocol import WholeNode
from can_rig.errors import ExportError
from can_rig.frames.codec import CheckStatus
from can_rig.frames.network import Network
from can_rig.nodes.lockstep import ControllerNode, EcuNode, in_real_time, lockstep_controller
from can_rig.scenario.build import network_of
from firmware_model.firmware import PythonLaw
from firmware_model.law.layout import State
from firmware_model.law.structs import Records

TICKS = 30
HEALTHY = load("default", [f"duration_s={TICKS * 1e-3}", "fault.kind=none"])
NETWORK: Network = network_of(HEALTHY)
REFERENCE, FEEDBACK = NETWORK.reference.frame_id, NETWORK.feedback.frame_id
COMMANDS = [NETWORK.command_1.frame_id, NETWORK.command_2.frame_id]
ANSWER = [(number, bytes([number & 0xFF, *range(7)])) for number in (*COMMANDS, 0x123)]


class Program:
    """Answers every feedback."""

    def __init__(self, heard: int = 2) -> None:
        self.heard = heard
        self.taken: list[tuple[int, bytes]] = []
        self.closed = 0

    def take(self, frame_id: int, data: bytes) -> list[tuple[int, bytes]]:
        self.taken.append((frame_id, data))
        return list(ANSWER) if frame_id == FEEDBACK else []

    def counts(self) -> list[int]:
        return list(range(10, 10 + self.heard * len(CheckStatus)))

    def close(self) -> None:
        self.closed += 1


def node_of() -> tuple[EcuNode, Program, list[can.Message]]:
    program, sent = Program(), list[can.Message]()
    return EcuNode(HEALTHY, NETWORK, sent.append, program), program, sent


def frame(number: int = FEEDBACK, **kind: Any) -> can.Message:
    return can.Message(arbitration_id=number, data=b"12345678", **{"is_extended_id": False, **kind})


def test_a_feedback_is_answered_with_what_the_program_sends():
    node, program, sent = node_of()
    assert (node.ticks, node.tick) == (TICKS, 0)
    assert node.take(frame(REFERENCE)) is False
    assert (node.tick, sent) == (0, [])
    assert node.take(frame()) is True
    assert node.take(frame()) is True
    assert node.tick == 2
    assert program.taken == [(n, b"12345678") for n in (REFERENCE, FEEDBACK, FEEDBACK)]
    assert [(m.arbitration_id, bytes(m.data)) for m in sent] == 2 * ANSWER
    assert not any(m.is_extended_id or m.timestamp for m in sent)


@pytest.mark.parametrize(
    "other",
    [frame(is_extended_id=True),
     can.Message(arbitration_id=FEEDBACK, is_extended_id=False, is_remote_frame=True, dlc=8),
     frame(is_error_frame=True), frame(0x700), frame(COMMANDS[0])],
    ids=["extended", "remote", "error", "another", "a command"],
)  # fmt: skip
def test_other_frames_do_not_reach_it(other):
    node, program, sent = node_of()
    assert node.take(other) is False
    assert program.taken == sent == []
    assert node.tick == 0


def test_rejected_frames_are_of_the_reference_then_of_the_feedback():
    node, _, _ = node_of()
    counts = node.rejected()
    n = len(CheckStatus)
    for name, first in ((NETWORK.reference.name, 10), (NETWORK.feedback.name, 10 + n)):
        at = {status.name.lower(): first + i for i, status in enumerate(CheckStatus)}
        assert counts[name] == {reason: at[reason] for reason in counts[name]}
        assert "wrong_crc" in counts[name]
        assert "ok" not in counts[name]
    assert counts.keys() == {NETWORK.reference.name, NETWORK.feedback.name}


def test_those_of_the_speed_come_last_where_it_is_heard():
    scenario = load("drive-cycle", ["duration_s=1", "fault.kind=none"])
    network = network_of(scenario)
    counts = EcuNode(scenario, network, list[can.Message]().append, Program(heard=3)).rejected()
    assert list(counts) == [network.reference.name, network.feedback.name, "VEHICLE_SPEED"]
    firsts = [min(each.values()) for each in counts.values()]
    assert [first - firsts[0] for first in firsts] == [0, len(CheckStatus), 2 * len(CheckStatus)]


def test_what_was_chosen_runs_and_is_ended():
    program = Program()
    application = WholeNode(lambda: program)
    with pytest.raises(RuntimeError), lockstep_controller(
        HEALTHY, NETWORK, list[can.Message]().append, application
    ) as node:  # fmt: skip
        assert isinstance(node, EcuNode)
        node.take(frame())
        assert (len(program.taken), program.closed) == (1, 0)
        raise RuntimeError
    assert program.closed == 1


class Counting(PythonLaw):
    """The law, with a count of its starts."""

    def __init__(self) -> None:
        self.started = 0

    def init(self, table: Any) -> Records[State]:
        self.started += 1
        return super().init(table)


def test_a_law_of_ours_runs_in_a_node_of_ours():
    law = Counting()
    controller = in_node(law)
    with lockstep_controller(HEALTHY, NETWORK, lambda message: None, controller) as node:
        assert isinstance(node, ControllerNode)
    assert law.started == 1
    assert in_real_time(controller) is controller
    with pytest.raises(ExportError, match="must be python or c"):
        in_real_time(WholeNode(Program))
