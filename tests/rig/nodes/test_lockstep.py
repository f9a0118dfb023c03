"""The loop of each node in lockstep: to the end, or to a stop request, and no frame further."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

import can
import pytest

from can_rig.assessment.resolve import load
from can_rig.errors import SilentNodeError
from can_rig.frames.wire_tick import tick_on
from can_rig.nodes.lockstep.controller_node import ControllerNode
from can_rig.nodes.lockstep.plant_node import PlantNode
from can_rig.nodes.watchdog import StopRequest, Timeouts, Watchdog
from can_rig.scenario.build import network_of
from tests.clock import TurnedClock

TICKS = 20
SCENARIO = load("thesis-step", [f"duration_s={TICKS * 0.001}"])
NETWORK = network_of(SCENARIO)
ANSWER = [NETWORK.command_1.frame_id, NETWORK.command_2.frame_id, NETWORK.status.frame_id]
OFFER = [NETWORK.reference.frame_id, NETWORK.feedback.frame_id]


class Ends:
    """Both nodes, one of which runs; the other acts within the calls that the first makes."""

    def __init__(self) -> None:
        self.stop = StopRequest()
        self.offers, self.answers = deque(), deque()
        self.sent_by_plant, self.sent_by_controller, self.ticks = [], [], []
        self.plant = PlantNode(SCENARIO, NETWORK, self.from_plant)
        self.controller = ControllerNode(SCENARIO, NETWORK, self.from_controller)
        self.offered = 0
        self.silent_from = TICKS
        """The tick from which the partner says nothing any more."""
        self.stop_after = 0
        """The tick after which a stop is requested."""
        self.stop_when_silent = True
        self.clock = TurnedClock()
        self.others: can.Message | None = None
        """What comes again and again where the partner is silent."""

    def from_plant(self, message: can.Message) -> None:
        self.sent_by_plant.append(message)
        self.offers.append(message)

    def from_controller(self, message: can.Message) -> None:
        self.sent_by_controller.append(message)
        self.answers.append(message)

    def run_controller(self) -> int:
        return self.controller.run(self.watchdog(self.next_offer, "plant"), self.on_tick)

    def run_plant(self) -> int:
        return self.plant.run(self.watchdog(self.next_answer, "controller"), self.on_tick)

    def next_offer(self) -> deque[can.Message]:
        if not self.offers and self.offered < self.silent_from:
            self.plant.offer(self.offered)
            self.offered += 1
        return self.offers

    def next_answer(self) -> deque[can.Message]:
        while self.offers and tick_on(self.offers[0].data) < self.silent_from:
            self.controller.take(self.offers.popleft())
        return self.answers

    def watchdog(self, queue: Callable[[], deque[can.Message]], other: str) -> Watchdog:
        ends = self

        class Bus:
            def recv(self, timeout: float) -> can.Message | None:
                if waiting := queue():
                    return waiting.popleft()
                ends.stop.wanted |= ends.stop_when_silent  # as by Ctrl-C while the node waits
                ends.clock.pass_s(timeout / 2)
                return ends.others

        return Watchdog(Bus(), other, Timeouts(60.0, 1.0), self.stop, clock=self.clock)

    def on_tick(self, tick: int) -> None:
        self.ticks.append(tick)
        self.stop.wanted |= tick == self.stop_after


def order(messages: list[can.Message]) -> list[tuple[int, int]]:
    return [(message.arbitration_id, tick_on(message.data)) for message in messages]


def test_the_controller_answers_every_tick_and_ends() -> None:
    ends = Ends()
    assert ends.run_controller() == TICKS
    assert ends.ticks == list(range(1, TICKS + 1))
    assert order(ends.sent_by_controller) == [(i, tick) for tick in range(TICKS) for i in ANSWER]
    assert not ends.offers
    assert not ends.stop.wanted  # it did not wait for more


def test_the_plant_offers_every_tick_and_ends() -> None:
    ends = Ends()
    assert ends.run_plant() == TICKS
    assert ends.ticks == list(range(1, TICKS + 1))
    assert order(ends.sent_by_plant) == [(i, tick) for tick in range(TICKS) for i in OFFER]
    assert not ends.answers
    assert not ends.stop.wanted


@pytest.mark.parametrize("node", ["plant", "controller"])
def test_a_stop_request_ends_a_node_after_the_tick(node: str) -> None:
    ends = Ends()
    ends.stop_after = 7
    assert getattr(ends, f"run_{node}")() == 7
    assert ends.ticks == list(range(1, 8))
    assert tick_on(getattr(ends, f"sent_by_{node}")[-1].data) == 6


def test_a_stop_request_ends_a_controller_that_never_waits() -> None:
    """Each feedback comes at once and no reference before it, so nothing but the tick is new."""
    ends = Ends()
    ends.stop_after = 7
    plant_s = ends.plant.offer

    def feedback_alone(tick: int) -> None:
        plant_s(tick)
        if tick > 0:  # the first contact needs both
            del ends.offers[-2]

    ends.plant.offer = feedback_alone
    assert ends.run_controller() == 7


@pytest.mark.parametrize("node", ["plant", "controller"])
def test_a_stop_request_ends_a_node_that_waits(node: str) -> None:
    ends = Ends()
    ends.silent_from = 5
    assert getattr(ends, f"run_{node}")() == 5
    assert ends.ticks == [1, 2, 3, 4, 5]


@pytest.mark.parametrize("others", [None, can.Message(arbitration_id=0x700, is_extended_id=False)])
@pytest.mark.parametrize(("node", "other"), [("plant", "controller"), ("controller", "plant")])
@pytest.mark.parametrize(("silent_from", "allowed_s"), [(0, 60.0), (3, 1.0)])
def test_a_silent_partner_is_named_whatever_others_send(
    node: str, other: str, silent_from: int, allowed_s: float, others: can.Message | None
) -> None:
    """Before it was heard first it is waited for, afterwards not."""
    ends = Ends()
    ends.silent_from, ends.stop_when_silent, ends.others = silent_from, False, others
    with pytest.raises(SilentNodeError, match=rf"the {other} node .* at tick {silent_from}$"):
        getattr(ends, f"run_{node}")()
    assert len(ends.ticks) == silent_from
    assert ends.clock.now_s == pytest.approx(allowed_s, abs=0.1)


def test_an_offer_is_repeated_as_it_was() -> None:
    """To a controller that was not there yet: the same counters, so that either copy will do."""
    ends = Ends()
    ends.plant.offer(0)
    ends.plant.repeat()
    first, again = ends.sent_by_plant[:2], ends.sent_by_plant[2:]
    assert [bytes(m.data) for m in again] == [bytes(m.data) for m in first]
    assert order(again) == order(first) == [(i, 0) for i in OFFER]


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
