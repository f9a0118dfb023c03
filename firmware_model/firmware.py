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
        self._table = table
        self._state = controller.init(table)
        # One-element arrays that share the records' memory: numba takes them faster than records.
        self._tables = np.ndarray(1, table.dtype, table.tobytes())
        self._states = np.ndarray(1, self._state.dtype, self._state)
        self._inputs = np.zeros((2, 1))
        self._answer = [self._states[name] for name in Answer._fields]

    def step(self, reference: float, measurement: float) -> Answer:
        """One tick; see ``controller.step``."""
        inputs = self._inputs
        inputs[0, 0] = reference
        inputs[1, 0] = measurement
        controller.step_many(self._tables, self._states, inputs[0], inputs[1])
        return Answer(*[field.item() for field in self._answer])

    def reset(self, reference: float) -> None:
        """Start from the settled healthy loop at ``reference``; see ``controller.reset``."""
        controller.reset(self._table, self._state, reference)
