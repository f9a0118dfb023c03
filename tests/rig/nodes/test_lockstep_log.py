"""The log of the plant node: when a tick begins in it, and what it takes in after the end."""

from __future__ import annotations

from collections import deque
from pathlib import Path

import can
import pytest

from can_rig.assessment.resolve import load
from can_rig.frames.endpoints import Transmitter
from can_rig.nodes.bus_access import StopRequest, Timeouts, Watchdog
from can_rig.nodes.lockstep import PlantNode
from can_rig.nodes.recording import Recorder
from can_rig.scenario.build import network_of
from tests.clock import TurnedClock

SCENARIO = load("thesis-step", ["duration_s=0.02"])
NETWORK = network_of(SCENARIO)


def test_each_tick_begins_in_the_log_at_its_own_time(tmp_path: Path) -> None:
    path = tmp_path / "a.log"
    with Recorder(path, SCENARIO.tick_ns) as recorder:
        node = PlantNode(SCENARIO, NETWORK, lambda message: None, recorder)
        for tick in (0, 1, 7):
            node.offer(tick)
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


QUIET_S = 0.02  # with nothing on the bus for so long, nothing is on its way any more
QUIET_AMONG_OTHERS_S = 0.25  # where others send, one of them may wait for its processor
UNREAD_S = 10.0  # and no longer, whatever the time stamps say


def rest_of(path: Path, stamps_s: list[float], error: bool = False) -> tuple[int, float]:
    """How many of the frames that were waiting are in the log, and how long that took [s]."""
    clock = TurnedClock(5_000_000_000)
    with Recorder(path, SCENARIO.tick_ns) as recorder:
        node = PlantNode(SCENARIO, NETWORK, lambda message: None, recorder)
        node.offer(0)
        node.record_the_rest(Late(clock, stamps_s, error), clock)
    lines = [line for line in path.read_text().splitlines() if " 700#" in line]
    assert all(line.endswith(" R") for line in lines)
    return len(lines), clock.now_s - 5.0


def after_a_tick_among_others(recorder: Recorder) -> PlantNode:
    """Of which a command is missing, and in which a frame of another came."""
    bus = deque([can.Message(arbitration_id=0x700, is_extended_id=False)])
    bus += [Transmitter(codec).frame(0.0, 0) for codec in (NETWORK.command_1, NETWORK.status)]

    class Bus:
        def recv(self, timeout: float) -> can.Message:
            return bus.popleft()

    node = PlantNode(SCENARIO, NETWORK, lambda message: None, recorder)
    node.offer(0)
    node.collect(0, Watchdog(Bus(), "controller", Timeouts(1.0, 1.0), StopRequest()))
    return node


def test_what_others_sent_by_the_end_is_in_the_log_and_nothing_later(tmp_path: Path) -> None:
    found, took_s = rest_of(tmp_path / "a.log", [4.0, 4.9, 5.0, 5.001, 4.5])
    assert found == 3
    assert took_s == pytest.approx(4 * QUIET_S / 4)


def test_a_quiet_or_a_failing_bus_ends_the_wait(tmp_path: Path) -> None:
    assert rest_of(tmp_path / "a.log", [4.0]) == (1, pytest.approx(1.25 * QUIET_S))
    assert rest_of(tmp_path / "b.log", [4.0], error=True) == (1, pytest.approx(0.25 * QUIET_S))


def test_among_others_the_wait_is_longer(tmp_path: Path) -> None:
    """Before the end one of them sent, so a frame of the run may still wait to be sent."""
    clock = TurnedClock(5_000_000_000)
    with Recorder(tmp_path / "a.log", SCENARIO.tick_ns) as recorder:
        node = after_a_tick_among_others(recorder)
        node.record_the_rest(Late(clock, []), clock)
    assert clock.now_s - 5.0 == pytest.approx(QUIET_AMONG_OTHERS_S)


def test_a_bus_whose_stamps_say_nothing_is_not_read_for_ever(tmp_path: Path) -> None:
    found, took_s = rest_of(tmp_path / "a.log", [0.0] * 3000)
    assert took_s == pytest.approx(UNREAD_S)
    assert found == UNREAD_S / (QUIET_S / 4)


def test_without_a_log_nothing_is_read() -> None:
    clock = TurnedClock()
    PlantNode(SCENARIO, NETWORK, lambda message: None).record_the_rest(Late(clock, [0.0]), clock)
    assert clock.ns == 0


def test_every_frame_of_a_tick_is_in_the_log_with_who_sent_it(tmp_path: Path) -> None:
    """Those of others too, and of no use."""
    path = tmp_path / "a.log"
    with Recorder(path, SCENARIO.tick_ns) as recorder:
        after_a_tick_among_others(recorder)
    words = [line.split() for line in path.read_text().splitlines()]
    sent = [(frame.partition("#")[0], by) for _, _, frame, by in words]
    assert sent == [("100", "T"), ("101", "T"), ("700", "R"), ("110", "R"), ("120", "R")]
