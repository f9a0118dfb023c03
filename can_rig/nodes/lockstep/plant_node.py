"""The plant node in lockstep: owns virtual time, and writes the log."""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import suppress
from typing import Final

import can

from can_rig.errors import ScenarioError
from can_rig.frames.network import Network
from can_rig.nodes.bus_access import NodeBus, Send
from can_rig.nodes.clock import NS_PER_S, SYSTEM_CLOCK, Clock
from can_rig.nodes.operator.interaction import UNTOUCHED, Interaction
from can_rig.nodes.operator.run_control import RunControl
from can_rig.nodes.plant_end import COMMANDS, PlantEnd
from can_rig.nodes.recording.plant_recorder import PlantRecorder
from can_rig.nodes.recording.recorder import Recorder
from can_rig.nodes.watchdog import Interrupted, Watchdog
from can_rig.scenario.settings import Scenario

CONTROL: Final = "RIG_CONTROL"

QUIET_S: Final = 0.02
"""When nothing has come for so long after the end, nothing is on its way."""

QUIET_AMONG_OTHERS_S: Final = 0.25
"""The same where others have sent too, whose queues a busy machine may be slow to empty."""

UNREAD_S: Final = 10.0
"""The longest wait for it, on a bus whose time stamps do not say what was sent before the end."""


class PlantNode:
    """Sends reference and feedback, waits for the status, applies the received commands.

    Args:
        scenario: the run.
        network: the frames of the run.
        send: sends a frame.
        recorder: gets every frame sent or received; None records nothing.
        reports: gets the plant's report of every tick; None records nothing.
        interaction: permitted commands during the run.
        clock: the time, for a run with interaction.

    Raises:
        ScenarioError: a reference beyond the range of its frame, an invalid plant, frames
            without a tick.
    """

    def __init__(
        self,
        scenario: Scenario,
        network: Network,
        send: Send,
        recorder: Recorder | None = None,
        reports: PlantRecorder | None = None,
        interaction: Interaction = UNTOUCHED,
        clock: Clock = SYSTEM_CLOCK,
    ) -> None:
        require_ticks(scenario, network)
        self.ticks: Final = scenario.ticks
        self._recorder = recorder
        self._others_send = False
        self._end = PlantEnd(scenario, network, send, recorder, reports, interaction.injectable)
        self._control = RunControl(interaction, scenario, self._end, send, clock)

    def run(self, watchdog: Watchdog, on_tick: Callable[[int], None]) -> int:
        """Run to the end or to a stop request; the number of ticks completed.

        Raises:
            SilentNodeError: the controller node is silent.
            BusLostError: the bus carries nothing any more.
        """
        for tick in range(self.ticks):
            try:
                if watchdog.stop.wanted:
                    return tick
                self.begin(tick, watchdog)
                self.offer(tick)
                self.collect(tick, watchdog)
            except Interrupted:
                return tick
            on_tick(tick + 1)
        return self.ticks

    def begin(self, tick: int, watchdog: Watchdog) -> None:
        """Wait until ``tick`` may begin, where the run is held or paused.

        Raises:
            Interrupted: a stop was requested.
        """
        self._control.begin(tick, watchdog, self._overhear)

    def offer(self, tick: int) -> None:
        """Start ``tick``: sample D*, send the reference and the feedback."""
        if self._recorder is not None:
            self._recorder.begin_tick(tick)
        self._end.sample(tick)
        self._end.send_sample()

    def repeat(self) -> None:
        """Send the offer again, for a controller that starts late; the log has one copy."""
        self._end.repeat()

    def collect(self, tick: int, watchdog: Watchdog) -> None:
        """Finish ``tick``: take the commands up to its status frame and advance the plant.

        Raises:
            SilentNodeError, BusLostError, Interrupted: see ``Watchdog.receive``.
        """
        commands: list[float | None] = [None, None]
        while True:
            message = watchdog.receive(tick)
            if self._recorder is not None:
                self._recorder.record(message, sent=False)
            judged = self._end.judge(message, tick)
            if judged is None:
                self._others_send = True
                self._control.take(message)
                watchdog.go_on_waiting(tick)
                continue
            at, record = judged
            if at == COMMANDS:
                watchdog.hear()
                break
            if math.isfinite(record.value):
                commands[at] = record.value
        self._end.end_tick()
        self._end.advance(tick, *commands)
        self._control.applied()

    def _overhear(self, message: can.Message) -> None:
        """Note a frame that comes between two ticks."""
        self._others_send = True
        if self._recorder is not None:
            self._recorder.record(message, sent=False)
        self._control.take(message)

    def record_the_rest(self, bus: NodeBus, clock: Clock) -> None:
        """Record unread frames of other senders at the end of the run."""
        if self._recorder is None:
            return
        quiet_s = QUIET_AMONG_OTHERS_S if self._others_send else QUIET_S
        end_s, deadline_ns = clock.stamp_s(), clock.now_ns() + round(UNREAD_S * NS_PER_S)
        with suppress(can.CanError):
            while clock.now_ns() < deadline_ns:
                message = bus.recv(quiet_s)
                if message is None or message.timestamp > end_s:
                    return
                self._recorder.record(message, sent=False)

    def rejected(self) -> dict[str, dict[str, int]]:
        """Per message, how many frames were not used and why."""
        refused = self._control.refused
        return self._end.rejected() | ({CONTROL: {"refused": refused}} if refused else {})


def require_ticks(scenario: Scenario, network: Network) -> None:
    """Refuse frames without a tick signal.

    Raises:
        ScenarioError: a frame without a tick signal.
    """
    if not network.has_ticks:
        raise ScenarioError(
            f"scenario {scenario.name}: network.tick: must name the signal that counts the "
            "ticks in every message, or the run be in real time (can-rig run --realtime): in "
            "lockstep a frame must say which tick it is of"
        )
