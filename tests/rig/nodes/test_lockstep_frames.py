"""What each node in lockstep makes of its frames, also of damaged, missing and untimely ones."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import can
import numpy as np
import pytest

from can_rig.errors import ScenarioError
from can_rig.frames.codec import MessageCodec, tick_on
from can_rig.frames.endpoints import Transmitter
from can_rig.nodes.lockstep import ControllerNode, PlantNode
from can_rig.plant.simulated import SimulatedPlant
from firmware_model.firmware import Firmware
from tests.rig.nodes.ends import ANSWER, NETWORK, SCENARIO, SINE, TICKS, Ends, order


def test_a_missed_tick_is_held_and_answered() -> None:
    """Whoever knows that the plant went on says so; it is a tick without any input."""
    ends = Ends()
    assert ends.controller.expected is None
    ends.plant.offer(0)
    for message in list(ends.offers):
        ends.controller.take(message)
    assert ends.controller.expected == 1
    ends.controller.miss()
    assert ends.controller.expected == 2
    assert order(ends.sent_by_controller) == [(i, tick) for tick in range(2) for i in ANSWER]
    modes = [
        NETWORK.status.modes[NETWORK.status.decode(m.data).mode]
        for m in ends.sent_by_controller
        if m.arbitration_id == NETWORK.status.frame_id
    ]
    assert modes == ["RUN", "HOLD"]


def test_a_reference_of_another_tick_is_not_used() -> None:
    """The reference of a tick may be lost; that of the tick before does not stand in for it."""
    ends = Ends()
    ends.plant.offer(0)
    reference, feedback = ends.offers
    assert not ends.controller.take(reference)
    assert ends.controller.take(feedback)
    ends.offers.clear()
    ends.plant.offer(1)
    assert ends.controller.take(ends.offers[-1])  # without its reference
    statuses = [m for m in ends.sent_by_controller if m.arbitration_id == ANSWER[-1]]
    words = [NETWORK.status.modes[NETWORK.status.decode(m.data).mode] for m in statuses]
    assert words == ["RUN", "HOLD"]
    ends.plant.offer(2)
    damaged, feedback = list(ends.offers)[-2:]
    damaged.data[5] ^= 1
    assert not ends.controller.take(damaged)
    assert ends.controller.take(feedback)
    ends.plant.offer(3)
    assert [ends.controller.take(message) for message in list(ends.offers)[-2:]] == [False, True]
    statuses = [m for m in ends.sent_by_controller if m.arbitration_id == ANSWER[-1]]
    words = [NETWORK.status.modes[NETWORK.status.decode(m.data).mode] for m in statuses]
    assert words == ["RUN", "HOLD", "HOLD", "RUN"]
    rejected = {"DSTAR_REFERENCE": {"no_new_data": 1, "wrong_crc": 1}, "DSTAR_FEEDBACK": {}}
    assert ends.controller.rejected() == rejected


def test_frames_of_two_ticks_are_no_first_contact() -> None:
    ends = Ends()
    ends.plant.offer(0)
    reference, _ = ends.offers
    ends.plant.offer(1)
    assert [ends.controller.take(message) for message in (reference, ends.offers[-1])] == [
        False
    ] * 2
    assert ends.controller.expected is None


def damaged(message: can.Message) -> can.Message:
    changed = can.Message(
        arbitration_id=message.arbitration_id, is_extended_id=False, data=bytes(message.data)
    )
    changed.data[5] ^= 1
    return changed


def elsewhere(message: can.Message) -> can.Message:
    return can.Message(arbitration_id=0x700, is_extended_id=False, data=bytes(message.data))


def test_only_two_intact_frames_of_their_own_identifiers_are_a_first_contact() -> None:
    ends = Ends()
    ends.plant.offer(0)
    reference, feedback = ends.offers
    for pair in (
        (damaged(reference), feedback),
        (reference, damaged(feedback)),
        (reference, elsewhere(feedback)),
        (elsewhere(reference), feedback),
    ):
        ends.controller = ControllerNode(SCENARIO, NETWORK, ends.from_controller)
        assert [ends.controller.take(message) for message in pair] == [False, False]
        assert ends.controller.expected is None
    assert ends.sent_by_controller == []


def test_the_tick_goes_on_where_its_sixteen_bits_wrap() -> None:
    ends, inputs = Ends(), [Transmitter(NETWORK.reference), Transmitter(NETWORK.feedback)]
    for tick in range(65_530, 65_545):
        taken = [ends.controller.take(transmitter.frame(0.0, tick)) for transmitter in inputs]
        assert taken == [False, True]
    statuses = [m for m in ends.sent_by_controller if m.arbitration_id == ANSWER[-1]]
    assert {NETWORK.status.modes[NETWORK.status.decode(m.data).mode] for m in statuses} == {"RUN"}
    assert [tick_on(m.data) for m in statuses] == [*range(65_530, 65_536), *range(9)]


class Recorded:
    """A replay in which one tick was not answered."""

    def __init__(self, unanswered: int) -> None:
        self.unanswered = unanswered
        self.begun: list[int] = []
        self.sent: list[tuple[int, tuple[float, float]]] = []

    def begin(self, tick: int, firmware: Firmware) -> bool:
        self.begun.append(tick)
        return tick != self.unanswered

    def send(self, tick: int, commands: tuple[float, float]) -> None:
        self.sent.append((tick, commands))


def test_a_replay_holds_where_the_recorded_controller_did_not_answer() -> None:
    ends, actuation = Ends(), Recorded(3)
    ends.controller = ControllerNode(SCENARIO, NETWORK, ends.from_controller, actuation)
    ends.silent_from = 6
    assert ends.run_controller() == 6
    assert actuation.begun == [0, 1, 2, 3, 4, 5]
    statuses = [m for m in ends.sent_by_controller if m.arbitration_id == ANSWER[-1]]
    words = [NETWORK.status.modes[NETWORK.status.decode(m.data).mode] for m in statuses]
    assert words == ["RUN", "RUN", "RUN", "HOLD", "RUN", "RUN"]
    assert [tick for tick, _ in actuation.sent] == [0, 1, 2, 3, 4, 5]
    for at, codec in enumerate((NETWORK.command_1, NETWORK.command_2)):
        commands = [codec.quantise(pair[at]) for _, pair in actuation.sent]
        assert values_of(codec, ends.sent_by_controller) == commands
    assert actuation.sent[3][1] == actuation.sent[2][1]


def values_of(codec: MessageCodec, messages: list[can.Message]) -> list[float]:
    return [codec.decode(m.data).value for m in messages if m.arbitration_id == codec.frame_id]


@pytest.mark.parametrize("channel", [0, 1])
def test_the_plant_takes_the_commands_of_each_tick_and_counts_those_it_misses(channel: int) -> None:
    """Both before their status; a tick without one of them is a tick without that."""
    ends = Ends()
    ends.plant = PlantNode(SINE, NETWORK, ends.from_plant)
    missed = range(12, 15)
    take = ends.controller.take

    def without(message: can.Message) -> bool:
        answered = take(message)
        if answered and tick_on(message.data) in missed:
            del ends.answers[channel - 3]
        return answered

    ends.controller.take = without
    assert ends.run_plant() == TICKS
    codecs = NETWORK.command_1, NETWORK.command_2
    sent = [values_of(codec, ends.sent_by_controller) for codec in codecs]
    car, expected = SimulatedPlant(SINE), []
    for tick, pair in enumerate(zip(*sent, strict=True)):
        expected.append(NETWORK.feedback.quantise(car.measure()))
        came = [None if tick in missed and at == channel else u for at, u in enumerate(pair)]
        car.advance(tick, *came)
    assert values_of(NETWORK.feedback, ends.sent_by_plant) == expected
    assert np.ptp(expected) > 1e-3
    counts = {codec.name: {} for codec in (*codecs, NETWORK.status)}
    counts[codecs[channel].name] = {"no_new_data": 3}
    assert ends.plant.rejected() == counts


def test_a_command_that_is_not_available_is_none() -> None:
    ends = Ends()
    ends.plant = PlantNode(SINE, NETWORK, ends.from_plant)
    for codec in (NETWORK.command_1, NETWORK.command_2):
        sender = Transmitter(codec)
        ends.answers.append(sender.frame(math.nan, 0))
    ends.answers.append(Transmitter(NETWORK.status).frame(0.0, 0))
    ends.plant.offer(0)
    ends.plant.collect(0, ends.watchdog(lambda: ends.answers, "controller"))
    ends.plant.offer(1)
    assert values_of(NETWORK.feedback, ends.sent_by_plant) == [0.0, 0.0]


def test_frames_without_a_tick_are_refused() -> None:
    network: Any = SimpleNamespace(has_ticks=False)
    with pytest.raises(ScenarioError, match=r"network\.tick: must name the signal"):
        PlantNode(SCENARIO, network, lambda message: None)
