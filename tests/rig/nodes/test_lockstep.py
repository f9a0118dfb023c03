"""Each node in lockstep: its loop, what it makes of its frames, the plant node's log."""

import math
from collections import deque
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import can
import pytest

from can_rig.controllers.our_law import PYTHON
from can_rig.errors import ScenarioError, SilentNodeError
from can_rig.frames.codec import MessageCodec, Transmitter, tick_on
from can_rig.nodes.bus_access import StopRequest, Timeouts, Watchdog
from can_rig.nodes.lockstep import ControllerNode, PlantNode
from can_rig.nodes.recording import Recorder
from tests.clock import TurnedClock, Wire
from tests.rig.nodes.ends import ANSWER, NETWORK, OFFER, SCENARIO, SINE, TICKS, Ends, order


@pytest.mark.parametrize(("node", "frames"), [("plant", OFFER), ("controller", ANSWER)])
def test_a_node_sends_its_frames_of_every_tick_and_ends(node, frames):
    ends = Ends()
    assert getattr(ends, f"run_{node}")() == TICKS
    assert ends.ticks == list(range(1, TICKS + 1))
    sent = order(getattr(ends, f"sent_by_{node}"))
    assert sent == [(i, tick) for tick in range(TICKS) for i in frames]
    assert not (ends.answers if node == "plant" else ends.offers)
    assert not ends.stop.wanted  # it did not wait for more


@pytest.mark.parametrize("node", ["plant", "controller"])
def test_a_stop_request_ends_a_node_after_the_tick(node):
    ends = Ends()
    ends.stop_after = 7
    assert getattr(ends, f"run_{node}")() == 7
    assert ends.ticks == list(range(1, 8))
    assert tick_on(getattr(ends, f"sent_by_{node}")[-1].data) == 6


def test_a_stop_request_ends_a_controller_that_never_waits():
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
def test_a_stop_request_ends_a_node_that_waits(node):
    ends = Ends()
    ends.silent_from = 5
    assert getattr(ends, f"run_{node}")() == 5
    assert ends.ticks == [1, 2, 3, 4, 5]


@pytest.mark.parametrize("others", [None, can.Message(arbitration_id=0x700, is_extended_id=False)])
@pytest.mark.parametrize(("node", "other"), [("plant", "controller"), ("controller", "plant")])
@pytest.mark.parametrize(("silent_from", "allowed_s"), [(0, 60.0), (3, 1.0)])
def test_a_silent_partner_is_named_whatever_others_send(
    node, other, silent_from, allowed_s, others
):
    """Before it was heard first it is waited for, afterwards not."""
    ends = Ends()
    ends.silent_from, ends.stop_when_silent, ends.others = silent_from, False, others
    with pytest.raises(SilentNodeError, match=rf"the {other} node .* at tick {silent_from}$"):
        getattr(ends, f"run_{node}")()
    assert len(ends.ticks) == silent_from
    assert ends.clock.now_s == pytest.approx(allowed_s, abs=0.1)


def test_an_offer_is_repeated_as_it_was():
    """A late controller hears the same counters: either copy serves."""
    ends = Ends()
    ends.plant.offer(0)
    ends.plant.repeat()
    first, again = ends.sent_by_plant[:2], ends.sent_by_plant[2:]
    assert [bytes(m.data) for m in again] == [bytes(m.data) for m in first]
    assert order(again) == order(first) == [(i, 0) for i in OFFER]


def modes(ends: Ends) -> list[str]:
    """Of the controller's statuses so far."""
    statuses = [m for m in ends.sent_by_controller if m.arbitration_id == ANSWER[-1]]
    return [NETWORK.status.modes[NETWORK.status.decode(m.data).mode] for m in statuses]


def test_a_missed_tick_is_held_and_answered():
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
    assert modes(ends) == ["RUN", "BLIND"]


def test_a_reference_of_another_tick_is_not_used():
    """A lost reference is not replaced by the reference of the tick before."""
    ends = Ends()
    ends.plant.offer(0)
    reference, feedback = ends.offers
    assert not ends.controller.take(reference)
    assert ends.controller.take(feedback)
    ends.offers.clear()
    ends.plant.offer(1)
    assert ends.controller.take(ends.offers[-1])  # without its reference
    assert modes(ends) == ["RUN", "BLIND"]
    ends.plant.offer(2)
    damaged, feedback = list(ends.offers)[-2:]
    damaged.data[5] ^= 1
    assert not ends.controller.take(damaged)
    assert ends.controller.take(feedback)
    ends.plant.offer(3)
    assert [ends.controller.take(message) for message in list(ends.offers)[-2:]] == [False, True]
    assert modes(ends) == ["RUN", "BLIND", "BLIND", "RUN"]
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


def test_only_two_intact_frames_of_one_tick_are_a_first_contact():
    """Of their own identifiers; other frames may come between."""
    ends = Ends()
    ends.plant.offer(0)
    ends.plant.offer(1)
    reference, feedback, _, later = ends.offers
    others = [damaged(reference), damaged(feedback), elsewhere(reference)]
    for heard, is_contact in (
        ([damaged(reference), feedback], False),
        ([reference, damaged(feedback)], False),
        ([reference, elsewhere(feedback)], False),
        ([elsewhere(reference), feedback], False),
        ([reference, later], False),
        ([reference, *others, feedback], True),
    ):
        ends.controller = ControllerNode(SCENARIO, NETWORK, ends.from_controller, PYTHON)
        taken = [ends.controller.take(message) for message in heard]
        assert taken == [False] * (len(heard) - 1) + [is_contact]
        assert ends.controller.expected == (1 if is_contact else None)
        assert bool(ends.sent_by_controller) == is_contact


def values_of(codec: MessageCodec, messages: list[can.Message]) -> list[float]:
    return [codec.decode(m.data).value for m in messages if m.arbitration_id == codec.frame_id]


def test_a_command_that_is_not_available_is_none():
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


def test_frames_without_a_tick_are_refused():
    network: Any = SimpleNamespace(has_ticks=False)
    with pytest.raises(ScenarioError, match=r"network\.tick: must name the signal"):
        PlantNode(SCENARIO, network, lambda message: None)


def test_each_tick_begins_in_the_log_at_its_own_time_and_is_on_disk_when_the_next_begins(tmp_path):
    path = tmp_path / "a.log"
    with Recorder(path) as recorder:
        node = PlantNode(SCENARIO, NETWORK, lambda message: None, recorder)
        for done, tick in enumerate((0, 1, 7)):
            node.offer(tick)
            assert path.read_text().count("\n") == done * len(OFFER)
    times_us = [int(line[1:9].replace(".", "")) for line in path.read_text().splitlines()]
    assert times_us == [0, 1, 1000, 1001, 7000, 7001]


class Late:
    """A bus on which frames of others are still waiting when the run is over."""

    def __init__(self, clock: TurnedClock, stamps_s: list[float], error: bool = False) -> None:
        self.clock, self.error = clock, error
        self.waiting = deque(
            can.Message(timestamp=s, arbitration_id=0x700, is_extended_id=False) for s in stamps_s
        )

    def recv(self, timeout: float) -> can.Message | None:
        if self.waiting:
            self.clock.pass_s(timeout / 4)
            return self.waiting.popleft()
        if self.error:
            raise can.CanOperationError("gone")
        self.clock.pass_s(timeout)
        return None


QUIET_S = 0.02  # after this silence no frame is on its way
QUIET_AMONG_OTHERS_S = 0.25  # a foreign sender may wait for its processor
UNREAD_S = 10.0  # and no longer, whatever the time stamps say


def rest_of(path: Path, stamps_s: list[float], error: bool = False) -> tuple[int, float]:
    """How many of the frames that were waiting are in the log, and how long that took [s]."""
    clock = TurnedClock(5_000_000_000)
    with Recorder(path) as recorder:
        node = PlantNode(SCENARIO, NETWORK, lambda message: None, recorder)
        node.offer(0)
        node.record_the_rest(Late(clock, stamps_s, error), clock)
    lines = [line for line in path.read_text().splitlines() if " 700#" in line]
    assert all(line.endswith(" R") for line in lines)
    return len(lines), clock.now_s - 5.0


def after_a_tick_among_others(recorder: Recorder) -> PlantNode:
    """A command of the tick is missing, and a foreign frame arrived."""
    foreign = can.Message(arbitration_id=0x700, is_extended_id=False)
    own = (Transmitter(codec).frame(0.0, 0) for codec in (NETWORK.command_1, NETWORK.status))
    bus = Wire(TurnedClock(), foreign, *own)
    node = PlantNode(SCENARIO, NETWORK, lambda message: None, recorder)
    node.offer(0)
    node.collect(0, Watchdog(bus, "controller", Timeouts(1.0, 1.0), StopRequest()))
    return node


def test_what_others_sent_by_the_end_is_in_the_log_and_nothing_later(tmp_path):
    found, took_s = rest_of(tmp_path / "a.log", [4.0, 4.9, 5.0, 5.001, 4.5])
    assert found == 3
    assert took_s == pytest.approx(4 * QUIET_S / 4)


def test_a_quiet_or_a_failing_bus_ends_the_wait(tmp_path):
    assert rest_of(tmp_path / "a.log", [4.0]) == (1, pytest.approx(1.25 * QUIET_S))
    assert rest_of(tmp_path / "b.log", [4.0], error=True) == (1, pytest.approx(0.25 * QUIET_S))


def test_among_others_the_wait_is_longer(tmp_path):
    """Before the end one of them sent, so a frame of the run may still wait to be sent."""
    clock = TurnedClock(5_000_000_000)
    with Recorder(tmp_path / "a.log") as recorder:
        node = after_a_tick_among_others(recorder)
        node.record_the_rest(Late(clock, []), clock)
    assert clock.now_s - 5.0 == pytest.approx(QUIET_AMONG_OTHERS_S)


def test_a_bus_whose_stamps_say_nothing_is_not_read_for_ever(tmp_path):
    found, took_s = rest_of(tmp_path / "a.log", [0.0] * 3000)
    assert took_s == pytest.approx(UNREAD_S)
    assert found == UNREAD_S / (QUIET_S / 4)


def test_without_a_log_nothing_is_read():
    clock = TurnedClock()
    PlantNode(SCENARIO, NETWORK, lambda message: None).record_the_rest(Late(clock, [0.0]), clock)
    assert clock.ns == 0
