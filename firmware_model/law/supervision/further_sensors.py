"""What a controller hears beside the reference and D*: echoes of the actuators, and the witness."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from firmware_model.compiled import firmware
from firmware_model.law.precision import real
from firmware_model.law.structs import Records
from firmware_model.law.supervision.echoes import FORCE, KEPT_TICKS, TORQUE, take_echo
from firmware_model.law.supervision.overflow import is_damaged
from firmware_model.law.supervision.witness import take_sample

if TYPE_CHECKING:
    from firmware_model.law import layout
    from firmware_model.law.layout import Table


@firmware
def hear(table: Table, state: layout.State, sensor: float, value: float, age_ticks: float) -> None:
    """Take in a sample, before the ``step`` of its tick.

    Args:
        table: the constant table.
        state: changed in place.
        sensor: 1 and 2: the echo of actuator 1 or 2; 3: yaw rate; 4: lateral acceleration.
        value: an echo has the unit of the command, a yaw rate rad/s, an acceleration m/s².
        age_ticks: ticks since the sample; below ``KEPT_TICKS``, or the sample is ignored.
    """
    sample, age = real(value, state.command_1), real(age_ticks, state.command_1)
    if not (math.isfinite(sample) and age >= 0.0 and age < real(KEPT_TICKS, age)):
        return
    own = state.supervision
    if is_damaged(state.estimator, own.echoes, own.witness, own.mismatch):
        return
    if sensor == 1.0:
        take_echo(table.echoes, own.echoes, TORQUE, sample, age)
    elif sensor == 2.0:
        take_echo(table.echoes, own.echoes, FORCE, sample, age)
    elif sensor == 3.0:
        take_sample(table, own.witness.yaw_rate, sample, age)
    elif sensor == 4.0:
        take_sample(table, own.witness.acceleration, sample, age)


@firmware
def hear_first(
    tables: Records[Table],
    states: Records[layout.State],
    sensor: float,
    value: float,
    age_ticks: float,
) -> None:
    """``hear`` for the first of the controllers; see ``controller.step_first``."""
    hear(tables[0], states[0], sensor, value, age_ticks)
