"""What the actuators did with the commands of a run: recorded, or as far as its log tells."""

from __future__ import annotations

import math

import numpy as np

from can_rig.logs.columns import APPLIED
from can_rig.plant.actuators import Actuator
from can_rig.plant.faults.plant_faults import PlantFaults
from can_rig.results.signals import Signals
from can_rig.scenario.settings import Scenario
from firmware_model.analysis.hardware import LATE, distorted
from firmware_model.target.structs import FloatArray


def applied_commands(scenario: Scenario, signals: Signals) -> tuple[FloatArray, FloatArray]:
    """Both inputs of the plant from each tick to the next, (ticks,) each, in the commands' units.

    The plant's own report where there is one. Of a log alone, for actuators that follow at once: a
    command acts ``latency_ticks`` after its tick; one that is not on record is held for
    ``actuator.hold_s`` and is zero from then on; of a dead actuator's effect ``fault.left`` is
    left. nan at the start of a log that starts late, where the command that acts is not in it.
    """
    if all(name in signals.plant for name in APPLIED):
        torque_nm, force_difference_n = (signals.plant[name] for name in APPLIED)
        return torque_nm, force_difference_n
    first = round(float(signals.time_s[0]) / scenario.tick_s) if len(signals) else 0
    hold_ticks = round(scenario.actuator.hold_s / scenario.tick_s)
    faults, ticks = PlantFaults(scenario), range(first, first + len(signals))
    left, rows = faults.left(ticks), faults.rows(ticks)
    before = np.full(scenario.latency_ticks, 0.0 if first == 0 else math.nan)
    commands = signals.torque_nm, signals.force_difference_n
    one, two = (
        left[:, channel]
        * _reached(np.concatenate([before, _held(command, hold_ticks)]), ticks, rows[:, channel])
        for channel, command in enumerate(commands)
    )
    return one, two


def _reached(acting: FloatArray, ticks: range, faults: FloatArray) -> FloatArray:
    """What reaches an actuator, with ``faults`` (ticks, ...) or without any."""
    reached = acting[: len(ticks)].copy()
    previous = 0.0
    for k, fault in enumerate(faults):
        late = k - int(fault[LATE])
        reached[k] = previous = distorted(acting[late] if late >= 0 else 0.0, previous, fault)
    return reached


def _held(command: FloatArray, hold_ticks: int) -> FloatArray:
    actuator = Actuator(hold_ticks)
    heard = (None if math.isnan(value) else value for value in command.tolist())
    return np.array([actuator.hear(value) for value in heard], dtype=np.float64)
