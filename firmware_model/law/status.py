"""Inputs and answers of a tick, and the names of modes and fault states."""

from __future__ import annotations

from enum import IntEnum
from typing import Annotated

from firmware_model.law.structs import Struct


class Mode(IntEnum):
    """The mode of the controller, as sent in the status frame."""

    STANDBY = 0
    """No tick has run since ``init`` or ``reset``, or the car is slower than the lowest design: the
    commands go to zero."""
    RUN = 1
    """The last tick was computed from its inputs."""
    BLIND = 2
    """The last tick lacked an input. The model's prediction stood in for the measurement; without a
    reference the commands were held."""
    SAFE_STOP = 3
    """The commands are taken back to zero: until ``reset`` after the loss of both actuators, until
    the next tick with both inputs after a long time without."""


class FaultState(IntEnum):
    """What ``decision`` makes of d̂."""

    CLEAR = 0
    """Nothing speaks for a loss, and the loss of all of channel 1 would show."""
    SUSPECTED = 1
    """d̂ speaks for a loss, not yet clearly enough."""
    CONFIRMED = 2
    """It did clearly enough, and channel 1 has not been seen to work since."""
    CANNOT_TELL = 3
    """Channel 1 contributes so little at present that its loss would not show."""


class Verdict(IntEnum):
    """The verdict of ``hypotheses``: the fault that explains d̂ best, by far."""

    NOTHING = 0
    """Nothing speaks for a fault."""
    TORQUE_LOST = 1
    """Channel 1 is lost, or a part of it."""
    TORQUE_OFFSET = 2
    """Channel 1 does more or less than it is told, by a constant."""
    FORCE_LOST = 3
    """Channel 2 is lost, or a part of it."""
    SENSOR_WRONG = 4
    """The sensor is off: by a constant, or as the witness says."""
    SENSOR_DRIFTING = 5
    """The sensor is off by more and more."""
    SENSOR_FROZEN = 6
    """The sensor says the same, whatever the plant does."""
    ANOTHER_CAR = 7
    """No fault: the plant is not the model, or wind or road moves the plant."""
    BOTH_LOST = 8
    """Channel 2 is lost after channel 1."""
    CANNOT_BE_TOLD = 9
    """There is a fault, and more than one hypothesis that explains it."""
    COMPENSATION_OFF = 10
    """The monitor has taken the force difference away: the car swung."""
    SWINGING = 11
    """The monitor has taken both commands away: the car swung without the force difference too."""
    ASTRAY = 12
    """The monitor has taken both commands away: they drove the car far from the reference."""
    BAD_COMMAND = 13
    """The monitor has taken both commands away: a command was beyond the actuator's abilities."""


class State(Struct):
    """State."""

    reference: Annotated[float, "y", "r of this tick"]
    measurement: Annotated[float, "y", "y (D*) of this tick"]
    command_1: Annotated[float, "u1", "command to channel 1, saturated and quantised"]
    command_2: Annotated[float, "u2", "command to channel 2, saturated and quantised"]
    fault_estimate: Annotated[float, "y", "d̂"]
    mode: Annotated[int, "1", "a Mode"]
    fault_state: Annotated[int, "1", "a FaultState"]
