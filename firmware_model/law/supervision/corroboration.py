"""Corroboration: what d̂ alone says waits for the direct witnesses.

The echo of actuator 1 speaks of the torque, the echo of actuator 2 of the force difference, and the
witness of the sensor. Wind, a bank and a slippery road move D* as a lost torque or a drifting
sensor would. So a finding from d̂ waits while its direct witness denies the fault.

An echo may lie: a drive that hangs repeats its command while the motor is dead. A gust moves D* by
``gust`` at most within a short time, and a dead motor by more: a larger change needs no echo.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

from firmware_model.compiled import firmware
from firmware_model.law.structs import Struct
from firmware_model.law.supervision.echoes import FORCE, TORQUE, confesses, denies
from firmware_model.law.supervision.witness import acquits, agrees_with_sensor, contradicts

if TYPE_CHECKING:
    from firmware_model.law.layout import Table
    from firmware_model.law.supervision import echoes, witness


class Constants(Struct):
    """Constants."""

    gust: Annotated[float, "y", "largest change by which the world moves y within a short time"]
    follow: Annotated[float, "1", "part of the distance per tick of the lag"]


class State(Struct):
    """State."""

    slow: Annotated[float, "y", "d̂ after the lag"]
    sudden: Annotated[float, "y", "d̂ of this tick minus the slow d̂"]


@firmware
def follow_residual(constants: Constants, own: State, residual: float) -> None:
    """Take in d̂ of a tick."""
    own.sudden = residual - own.slow
    own.slow += constants.follow * own.sudden


@firmware
def settle_corroboration(own: State) -> None:
    """The plant is the model, and has been for long."""
    own.slow = own.sudden = 0.0


@firmware
def torque_waits(
    table: Table, own: State, heard: echoes.State, seen: witness.State, test_age: float
) -> bool:
    """Whether a loss of channel 1 has to wait for a direct witness.

    The witness contradicts the sensor; or the echo denies the loss, and D* changes no faster than
    in a gust, or the witness does not show the loss yet, or the echo of actuator 2 shows a fault
    there. ``test_age``: ticks since the onset of the candidate.
    """
    torque, force = table.echoes.actuators[TORQUE], table.echoes.actuators[FORCE]
    denied = denies(torque, heard.actuators[TORQUE])
    told = seen.age < test_age and acquits(table.witness, seen)
    elsewhere = confesses(force, heard.actuators[FORCE])
    gentle = abs(own.sudden) < table.corroboration.gust
    waits: bool = denied and (elsewhere or gentle or (seen.left > 0 and not told))
    return waits or contradicts(table.witness, seen)


@firmware
def sensor_waits(table: Table, seen: witness.State) -> bool:
    """Whether a slow fault of the sensor has to wait: the witness still agrees with the sensor."""
    waits: bool = seen.left > 0 and agrees_with_sensor(table.witness, seen)
    return waits
