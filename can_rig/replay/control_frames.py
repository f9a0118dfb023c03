"""What was done to a run while it went on, as its log has it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from can_rig.frames.beside import control
from can_rig.frames.network import Network
from can_rig.logs.frames import EXTENDED, Frames
from can_rig.nodes.operator.operated_bus import Touch
from can_rig.plant.faults.injection import FAULT_ACTIONS, Injection
from can_rig.scenario.settings import Scenario


def touches(chunks: Iterable[Frames], network: Network) -> list[Touch]:
    """The commands in a log, in their order."""
    frame_id, _, _ = control.identifiers()
    feedback = network.feedback.frame_id
    its = np.array([each.frame_id for each in network.by_role])
    found: list[Touch] = []
    frames, tick = 0, 0
    for chunk in chunks:
        ours = chunk[~chunk.has(EXTENDED) & np.isin(chunk.arbitration_id, [*its, frame_id])]
        if not (ours.arbitration_id == frame_id).any():
            frames += len(ours)
            tick += int((ours.arbitration_id == feedback).sum())
            continue
        for message in ours.messages():
            if message.arbitration_id == frame_id:
                found.append(Touch(frames, tick, message))
                continue
            frames += 1
            tick += message.arbitration_id == feedback
    return found


@dataclass(frozen=True)
class Done:
    """A scenario with what was done to a run of it.

    ``moved`` says whether the reference was moved, which no fault of a scenario does.
    """

    scenario: Scenario
    moved: bool


def done(scenario: Scenario, told: Iterable[Touch]) -> Done:
    """The scenario whose scheduled faults are its own and those that were injected."""
    injection, moved, sequence = Injection(scenario), False, 0
    for touch in told:
        command = control.read_command(touch.message, sequence)
        if command is None:  # it was refused
            continue
        sequence = (sequence + 1) % control.SEQUENCES
        if command.action in FAULT_ACTIONS:
            injection.obey(command, touch.tick)
        moved |= command.action == "MOVE_REFERENCE"
    return Done(injection.scenario, moved)
