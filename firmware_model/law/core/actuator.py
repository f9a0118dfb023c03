"""A command within the limits of its actuator and the resolution of its frame.

The rounding error of a command is added to the next command (first-order noise shaping), so the
mean of the commands is exact and no error settles below the resolution.
"""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np

from firmware_model.compiled import firmware
from firmware_model.law.precision import real
from firmware_model.law.structs import Struct


class Constants(Struct):
    """Constants."""

    limit: Annotated[float, "command", "largest magnitude of a command"]
    slew: Annotated[float, "command/tick", "largest change of a command in a tick"]
    lsb: Annotated[float, "command", "resolution of the command's frame; 0: none"]


class State(Struct):
    """State."""

    rounded_off: Annotated[float, "command", "rounding error carried to the next command"]


@firmware
def saturate(actuator: Constants, command: float) -> float:
    """``command`` within the actuator's magnitude."""
    saturated: float = min(max(command, -actuator.limit), actuator.limit)
    return saturated


@firmware
def saturate_rate(actuator: Constants, command: float, previous: float) -> float:
    """``command`` within the actuator's magnitude, and within its slew of the ``previous`` one."""
    low = max(-actuator.limit, previous - actuator.slew)
    high = min(actuator.limit, previous + actuator.slew)
    saturated: float = min(max(command, low), high)
    return saturated


@firmware
def quantise(actuator: Constants, state: State, command: float) -> float:
    """Round ``command`` plus the last rounding error to the grid of the frame."""
    if not actuator.lsb > 0.0:
        return command
    wanted = saturate(actuator, command + state.rounded_off)
    rounded: float = saturate(actuator, np.rint(wanted / actuator.lsb) * actuator.lsb)
    left = wanted - rounded
    state.rounded_off = left if math.isfinite(left) else real(0.0, left)
    return rounded
