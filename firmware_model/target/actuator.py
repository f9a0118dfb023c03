"""A command as its actuator can follow it and its frame can carry it."""

from __future__ import annotations

import numpy as np

from firmware_model.compiled import firmware
from firmware_model.target.structs import Field, Record

CONSTANTS = (
    Field("limit", "command", "largest magnitude of a command"),
    Field("slew", "command/tick", "largest change of a command in a tick"),
    Field("lsb", "command", "resolution of the command's frame; 0: none"),
)


@firmware
def saturate(actuator: Record, command: float) -> float:
    """``command`` within the actuator's magnitude."""
    saturated: float = min(max(command, -actuator.limit), actuator.limit)
    return saturated


@firmware
def saturate_rate(actuator: Record, command: float, previous: float) -> float:
    """``command`` within the actuator's magnitude, and within its slew of the ``previous`` one."""
    low = max(-actuator.limit, previous - actuator.slew)
    high = min(actuator.limit, previous + actuator.slew)
    saturated: float = min(max(command, low), high)
    return saturated


@firmware
def quantise(actuator: Record, command: float) -> float:
    """``command`` rounded to the resolution of its frame."""
    if actuator.lsb > 0.0:
        command = np.rint(command / actuator.lsb) * actuator.lsb
    return command
