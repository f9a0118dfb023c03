"""Actuators between the bus and the car: held commands, limits, dead times and lags.

An actuator holds the last command from the bus until the next command, limits its magnitude and its
change per tick, and delays the limited command by the dead time. A fault scales the delayed
command; the scaled command enters the lag. A dead actuator therefore fades with its lag, without
waiting for its dead time.
"""

from collections import deque

import numpy as np

from can_rig.scenario.plant_settings import PlantSettings
from firmware_model.analysis.sampled_plant import held_input, split_ticks
from firmware_model.design.actuator_dynamics import Stage
from firmware_model.law.structs import FloatArray


class Actuator:
    """Holds the last valid command for ``hold_ticks`` ticks, then applies zero."""

    def __init__(self, hold_ticks: int) -> None:
        self._hold_ticks = hold_ticks
        self._silent_ticks = 0
        self._command = 0.0

    def hear(self, command: float | None) -> float:
        """The acting command, from this tick's valid command; None: no valid command this tick."""
        if command is not None:
            self._silent_ticks = 0
            self._command = command
        else:
            self._silent_ticks += 1
            if self._silent_ticks > self._hold_ticks:
                self._command = 0.0
        return self._command


def actuator_limits(settings: PlantSettings, tick_s: float) -> FloatArray:
    """A row for each actuator: largest magnitude of a command, largest change in a tick."""
    actuators = settings.torque_actuator, settings.force_difference_actuator
    return np.array([each.limits for each in actuators]) * (1.0, tick_s)


class FollowedCommand:
    """Commands after an actuator's dead time and lag, as means over equal parts of a tick.

    A plant class takes held commands; the mean of each part preserves the actuator's impulse
    exactly.

    Args:
        stage: the actuator's lag and dead time.
        tick_s: the tick, seconds.
        parts: of a tick.
    """

    def __init__(self, stage: Stage, tick_s: float, parts: int) -> None:
        whole, late = split_ticks(stage.dead_time_s / tick_s)
        self._waiting = deque([0.0] * (whole + 1), maxlen=whole + 1)
        self._changes_late = late > 0.0
        lag_a, lag_b, lag_c = stage.realisation
        k = len(lag_a)
        self._lags = k > 0
        self._state = np.zeros(k + 1)  # the last state sums the output
        a, b = np.zeros((k + 1, k + 1)), np.zeros((k + 1, 1))
        a[:k, :k], a[k, :k] = lag_a, lag_c
        b[:k, 0], b[k, 0] = lag_b, 0.0 if k else 1.0
        self._part_s = tick_s / parts
        self.acted = 0.0
        """The acting value just before the tick to which ``follow`` has advanced."""
        self._steps = [
            held_input(a, b, self._part_s, (max(late * parts - part, 0.0),))
            for part in range(parts)
        ]

    def output(self, command: float, left: float) -> float:
        """The acting value right after ``command`` arrived, with the remaining share ``left``."""
        if self._lags:
            return float(self._state[0])
        return left * self._entering(command)[1 if self._changes_late else 0]

    def follow(self, command: float, left: float) -> list[float]:
        """The means over the parts of the tick that begins with the arrival of ``command``."""
        new, old = (left * each for each in self._entering(command))
        self._waiting.append(command)
        means = []
        for phi, gamma, gamma_old in self._steps:
            self._state[-1] = 0.0
            self._state = phi @ self._state + gamma[:, 0] * new + gamma_old[:, 0] * old
            means.append(float(self._state[-1]) / self._part_s)
        self.acted = float(self._state[0]) if self._lags else new
        return means

    def _entering(self, command: float) -> tuple[float, float]:
        """The newer and the older command; the lag's input changes between them in this tick."""
        line = [*self._waiting, command]
        return line[1], line[0]
