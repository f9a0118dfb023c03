"""A controller as one object: what a node, a replay or a unit test holds."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from firmware_model import controller
from firmware_model.layout import Record


class Answer(NamedTuple):
    """What one tick answers: commands in the actuators' units, d̂ in the measurement's unit."""

    command_1: float
    command_2: float
    fault_estimate: float
    mode: int
    fault_state: int


class Firmware:
    """A table and a state of its own; ``step`` and ``reset`` are those of ``controller``.

    Args:
        table: from ``tables.build``.
    """

    def __init__(self, table: Record) -> None:
        self._tables = np.zeros(1, table.dtype)
        self._tables[0] = table
        self._states = controller.init(table)

    def step(self, reference: float, measurement: float) -> Answer:
        """One tick; see ``controller.step``."""
        command_1, command_2, estimate, mode, fault_state = controller.step_first(
            self._tables, self._states, reference, measurement
        )
        return Answer(
            float(command_1), float(command_2), float(estimate), int(mode), int(fault_state)
        )

    def reset(self, reference: float) -> None:
        """Start from the settled healthy loop at ``reference``; see ``controller.reset``."""
        controller.reset(self._tables[0], self._states[0], reference)
