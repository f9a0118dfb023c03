"""Both nodes in lockstep without a bus between them, for the tests of either."""

from collections import deque
from collections.abc import Callable
from functools import partial

import can

from can_rig.controllers.our_law import PYTHON
from can_rig.frames.codec import tick_on
from can_rig.nodes.bus_access import StopRequest, Timeouts, Watchdog
from can_rig.nodes.lockstep import ControllerNode, PlantNode
from can_rig.nodes.ticks import drive
from can_rig.scenario.build import network_of
from can_rig.scenario.loading import load
from tests.clock import TurnedClock

TICKS = 20
SCENARIO = load("thesis-step", [f"duration_s={TICKS * 0.001}"])
SINE = load("thesis-step", [f"duration_s={TICKS * 0.001}", "fault.kind=none",
                            "reference.kind=sine", "reference.frequency_rad_per_s=60"])  # fmt: skip
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
        self.controller = ControllerNode(SCENARIO, NETWORK, self.from_controller, PYTHON)
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
        return self.drive(self.controller, self.watchdog(self.next_offer, "plant"))

    def run_plant(self) -> int:
        return self.drive(self.plant, self.watchdog(self.next_answer, "controller"))

    def drive(self, node: PlantNode | ControllerNode, watchdog: Watchdog) -> int:
        return drive(partial(node.carry, watchdog), node.ticks, self.on_tick)

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
