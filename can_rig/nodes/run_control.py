"""Commands to a running simulation: the plant node obeys, the controller node follows."""

from collections.abc import Callable
from typing import Final

import can

from can_rig.frames import operator_frames
from can_rig.nodes.bus_access import NS_PER_S, Clock, Send, Watchdog
from can_rig.nodes.ends import PlantEnd
from can_rig.nodes.interaction import UNTOUCHED, Interaction
from can_rig.plant.faults.frame_faults import FrameFaults
from can_rig.plant.faults.injection import FAULT_ACTIONS, Injection
from can_rig.scenario.settings import Scenario

TELL_EVERY_NS: Final = NS_PER_S // 20
MOTION_EVERY_NS: Final = NS_PER_S // 50
MOTION: Final = operator_frames.Motion._fields
YAW_RATE: Final = MOTION[0]
LATE_NS: Final = NS_PER_S // 10
"""A tick that is later than this is not caught up with: the pace begins anew."""

PAUSE_S: Final = 0.02
"""How soon a paused node notices what it is told."""


class RunControl:
    """The plant node's side of ``RIG_CONTROL``.

    A command received in a tick acts from the next tick on, so the log fixes the time of the
    command.

    Args:
        interaction: permitted commands.
        scenario: the run.
        end: the plant's end, whose faults and reference the commands change.
        send: sends a frame; no log records these frames.
        clock: the time.
    """

    def __init__(
        self, interaction: Interaction, scenario: Scenario, end: PlantEnd, send: Send, clock: Clock
    ) -> None:
        self._interaction = interaction
        self._injection = Injection(scenario)
        self._tick_ns = scenario.tick_ns
        self._end = end
        self._send = send
        self._clock = clock
        self._touched = interaction != UNTOUCHED
        self._asked: list[tuple[int, operator_frames.Command]] = []  # and not done yet
        self._paused = False
        self._steps = 0
        self._pace = interaction.pace
        self._due_ns = clock.now_ns()
        self._told_ns = 0
        self._counter = 0
        self._ticks = 0  # since the last motion
        self._at_rest = operator_frames.Motion(0.0, 0.0, 0.0, scenario.plant.speed_mps)
        self._next = 0
        self._last_checksum = 0
        self.refused = 0
        """Commands that were not obeyed."""

    def take(self, message: can.Message) -> None:
        """Keep a frame outside the network, which may be a command."""
        if (
            message.is_extended_id
            or message.arbitration_id != operator_frames.identifiers().control
        ):
            return
        command = operator_frames.read_command(message, self._next)
        if command is None or not self._interaction.injectable:
            self.refused += 1
            return
        self._asked.append((self._next, command))
        self._next = (self._next + 1) % operator_frames.SEQUENCES
        self._last_checksum = message.data[0]

    def begin(self, tick: int, watchdog: Watchdog, hear: Callable[[can.Message], None]) -> None:
        """Wait until ``tick`` may begin, then apply the pending commands from ``tick`` on.

        ``hear`` gets the frames received during the wait.

        Raises:
            Interrupted: a stop was requested.
        """
        if not self._touched:
            return
        if self._interaction.injectable:
            self._listen(watchdog, hear, tick)
        self._keep_pace()
        self._tell()

    def applied(self) -> None:
        """Report to viewers what the actuators apply in this tick, and now and then the motion."""
        if not self._interaction.injectable or self._interaction.told:
            return
        plant = self._end.plant
        self._send(operator_frames.applied_message(*plant.applied))
        self._ticks += 1
        if self._ticks * self._tick_ns >= MOTION_EVERY_NS and YAW_RATE in plant.reported:
            self._ticks = 0
            said = {name: plant.reported[name] for name in MOTION if name in plant.reported}
            self._send(operator_frames.motion_message(self._at_rest._replace(**said)))

    def _listen(self, watchdog: Watchdog, hear: Callable[[can.Message], None], tick: int) -> None:
        while True:
            message = watchdog.glance(0.0)
            if message is not None:
                hear(message)
                continue
            self._obey(tick)
            if not self._paused or self._steps or self._interaction.told:
                break
            self._tell()
            message = watchdog.glance(PAUSE_S)
            if message is not None:
                hear(message)
        self._steps = max(self._steps - 1, 0)

    def _obey(self, tick: int) -> None:
        """Obey the pending commands before ``tick``."""
        asked, self._asked = self._asked, []
        for number, command in asked:
            # The controller's frames fail too.
            self._send(operator_frames.taken_message(command, number))
            if not self._does(command, tick):
                self.refused += 1
        if asked:
            self._told_ns = 0

    def _does(self, command: operator_frames.Command, tick: int) -> bool:
        value = command.value
        if command.action in FAULT_ACTIONS:
            if not self._injection.obey(command, tick):
                return False
            self._end.change_faults(self._injection.scenario)
        elif command.action == "PAUSE":
            self._paused, self._steps = True, 0
        elif value is None or (value < 0.0 and command.action != "MOVE_REFERENCE"):
            return False
        elif command.action == "MOVE_REFERENCE":
            if not self._interaction.told:  # the reference of a log has been moved already
                self._end.reference_offset = value
        elif command.action == "PACE":
            self._pace, self._paused = value, False
            self._due_ns = self._clock.now_ns()
        else:
            self._steps = round(value)
        return True

    def _keep_pace(self) -> None:
        if not self._pace or self._paused or self._interaction.told:
            return
        now_ns = self._clock.now_ns()
        self._due_ns += round(self._tick_ns / self._pace)
        if now_ns > self._due_ns + LATE_NS:
            self._due_ns = now_ns
        elif now_ns < self._due_ns:
            self._clock.sleep_until(self._due_ns)

    def _tell(self) -> None:
        """Say now and then how things stand."""
        now_ns = self._clock.now_ns()
        if not self._interaction.injectable or self._interaction.told:
            return
        if now_ns - self._told_ns < TELL_EVERY_NS:
            return
        self._told_ns = now_ns
        state = operator_frames.State(
            True, self._paused, self._next, self._last_checksum, self.refused, self._pace
        )
        self._send(operator_frames.state_message(state, self._counter))
        self._counter += 1


class FollowedFaults:
    """Frame faults, injected and cleared in step with the plant node.

    The plant node announces each obeyed command, in order and before the frames of the command's
    first tick. A damaged frame, or a frame out of sequence, has no effect.
    """

    def __init__(self, scenario: Scenario, faults: FrameFaults) -> None:
        self._injection = Injection(scenario)
        self._faults = faults
        self._frame_id: Final = operator_frames.identifiers().taken
        self._next: int | None = None  # the first may have any number

    def take(self, message: can.Message, tick: int) -> bool:
        """Follow a frame that announces a command of ``tick``; returns False for other frames."""
        if message.arbitration_id != self._frame_id:
            return False
        numbered = operator_frames.read_taken(message)
        if numbered is None or self._next not in (None, numbered[0]):
            return True
        number, command = numbered
        self._next = (number + 1) % operator_frames.SEQUENCES
        if command.action in FAULT_ACTIONS and self._injection.obey(command, tick):
            self._faults.change(self._injection.scenario)
        return True
