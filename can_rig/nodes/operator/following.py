"""The controller node's side of a touched run: its frames fail as the plant node says."""

from __future__ import annotations

from typing import Final

import can

from can_rig.frames.beside import control
from can_rig.plant.faults.frame_faults import FrameFaults
from can_rig.plant.faults.injection import FAULT_ACTIONS, Injection
from can_rig.scenario.settings import Scenario


class FollowedFaults:
    """Frame faults, injected and cleared in step with the plant node.

    The plant node announces each obeyed command, in order and before the frames of the command's
    first tick. A damaged frame, or a frame out of sequence, has no effect.

    Args:
        scenario: the run.
        faults: the faults to update.
    """

    def __init__(self, scenario: Scenario, faults: FrameFaults) -> None:
        self._injection = Injection(scenario)
        self._faults = faults
        self._frame_id: Final = control.identifiers().taken
        self._next: int | None = None  # the first may have any number

    def take(self, message: can.Message, tick: int) -> bool:
        """Follow a frame that announces a command of ``tick``; returns False for other frames."""
        if message.arbitration_id != self._frame_id:
            return False
        numbered = control.read_taken(message)
        if numbered is None or self._next not in (None, numbered[0]):
            return True
        number, command = numbered
        self._next = (number + 1) % control.SEQUENCES
        if command.action in FAULT_ACTIONS and self._injection.obey(command, tick):
            self._faults.change(self._injection.scenario)
        return True
