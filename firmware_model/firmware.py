"""A controller as one object: what a node, a replay or a unit test holds."""

from __future__ import annotations

import zlib
from collections.abc import Callable
from functools import partial
from typing import Final, NamedTuple, Protocol

import numpy as np

from firmware_model.law import controller, schedule
from firmware_model.law.core import biquad
from firmware_model.law.layout import State, Table, precision_of
from firmware_model.law.structs import Records, copied, fields_of, values, zeroed
from firmware_model.law.supervision import further_sensors, verdict
from firmware_model.law.supervision.echoes import FORCE, TORQUE
from firmware_model.law.supervision.knowledge import Saved, saved_in
from firmware_model.law.supervision.lost_commands import act_first
from firmware_model.law.supervision.takeover import AT_REST, UNKNOWN


class Answer(NamedTuple):
    """What one tick answers: commands in the actuators' units, d̂ in the measurement's unit."""

    command_1: float
    command_2: float
    fault_estimate: float
    mode: int
    fault_state: int
    verdict: int


Step = Callable[[float, float], tuple[float, float, float, int, int, int]]
"""From reference and measurement to what ``controller.step_first`` answers."""

Memories = tuple[
    "Records[schedule.Constants]", "Records[schedule.State]", "Records[Table]", "Records[State]"
]
"""Constants and state of ``schedule``, table and state of ``controller``, each in an array."""

Hear = Callable[[float, float, float], None]
"""Takes sensor, value and age in ticks; see ``further_sensors.hear``."""

ChangeSpeed = Callable[[float], None]

CRC_BYTES: Final = 4
"""Size of the CRC of a saved state, before the bytes that the CRC guards."""


class Law(Protocol):
    """The runnable control law."""

    def init(self, table: Table) -> Records[State]:
        """One state at rest, shape (1,); see ``controller.init``."""

    def step_of(self, tables: Records[Table], states: Records[State]) -> Step:
        """Run ``controller.step`` on the first table and the first state of the arrays."""

    def hear_of(self, tables: Records[Table], states: Records[State]) -> Hear:
        """``further_sensors.hear`` for the first table and the first state of the arrays."""

    def reset(self, table: Table, state: State, reference: float) -> None:
        """See ``controller.reset``."""

    def change_speed_of(self, memories: Memories) -> ChangeSpeed:
        """``schedule.change_speed`` for the first of each array."""


class PythonLaw:
    """The lines of ``controller`` themselves, interpreted or compiled by numba."""

    def init(self, table: Table) -> Records[State]:
        """See ``Law``."""
        return controller.init(table)

    def step_of(self, tables: Records[Table], states: Records[State]) -> Step:
        """See ``Law``."""
        return partial(controller.step_first, tables, states)

    def hear_of(self, tables: Records[Table], states: Records[State]) -> Hear:
        """See ``Law``."""
        return partial(further_sensors.hear_first, tables, states)

    def reset(self, table: Table, state: State, reference: float) -> None:
        """See ``Law``."""
        controller.reset(table, state, reference)

    def change_speed_of(self, memories: Memories) -> ChangeSpeed:
        """See ``Law``."""
        return partial(schedule.change_first_speed, *memories)


PYTHON_LAW = PythonLaw()


def fingerprint(table: Table, speeds: schedule.Constants | None = None) -> int:
    """CRC-32 of the constants and of the layout of ``Saved``, as a signed number; never 0."""
    layout = ", ".join(f"{each.name} {each.kind} {each.shape}" for each in fields_of(Saved))
    constants = values(Table, table)
    if speeds is not None:
        constants += values(schedule.Constants, speeds)
    return signed(zlib.crc32(constants, zlib.crc32(layout.encode())) or 1)


def signed(crc: int) -> int:
    """The signed number with these 32 bits."""
    return crc - (crc >> 31 << 32)


class Firmware:
    """A controller with a table and a private state; ``step`` and ``reset`` call the law.

    Args:
        table: from ``tables.build``.
        law: the compiled functions.
        speeds: the schedule of a car with changing speed, from ``schedules.schedule``; None for a
            constant speed: then ``change_speed`` has no effect.
    """

    def __init__(
        self, table: Table, law: Law = PYTHON_LAW, speeds: schedule.Constants | None = None
    ) -> None:
        self._law = law
        self._tables = copied(table)
        self._states = law.init(self._tables[0])
        self._first = self._states.view(np.uint8).copy()
        self._step = law.step_of(self._tables, self._states)
        self._hear = law.hear_of(self._tables, self._states)
        self._motions = zeroed(biquad.State, precision_of(table))
        self._fingerprint = fingerprint(table, speeds)
        self._change_speed: ChangeSpeed | None = None
        if speeds is not None:
            blending = zeroed(schedule.State, precision_of(table))
            constants = copied(speeds)
            self._memories = (constants, blending, self._tables, self._states)  # C has addresses
            self._change_speed = law.change_speed_of(self._memories)

    def step(self, reference: float, measurement: float) -> Answer:
        """One tick; see ``controller.step``."""
        command_1, command_2, estimate, *codes = self._step(reference, measurement)
        mode, fault_state, verdict = map(int, codes)
        return Answer(
            float(command_1), float(command_2), float(estimate), mode, fault_state, verdict
        )

    def hear(self, sensor: int, value: float, age_ticks: float = 0.0) -> None:
        """Before the ``step`` of a tick: a further sensor; see ``further_sensors.hear``."""
        self._hear(sensor, value, age_ticks)

    def begin(self, at_rest: bool = False) -> None:
        """Start as after power-up: a plant that moves is taken over; see ``supervision.takeover``.

        ``at_rest``: whether the actuators are known to be at rest.
        """
        self._states.view(np.uint8)[...] = self._first
        self._states[0].supervision.takeover.pending = AT_REST if at_rest else UNKNOWN

    def saved(self) -> bytes:
        """What is known of the car and of lost actuators, for ``restore`` after a restart."""
        saved = saved_in(self._states[0])
        saved.fingerprint = self._fingerprint
        saved.crc = signed(zlib.crc32(saved.tobytes()[CRC_BYTES:]))
        return saved.tobytes()

    def restore(self, saved: bytes) -> bool:
        """Right after ``begin``: begin with what ``saved`` of an earlier controller said.

        Returns:
            Whether ``saved`` is intact and of a controller with the same constants; otherwise
            nothing changes.
        """
        own = self._states[0].supervision.saved
        if len(saved) != own.nbytes:
            return False
        found = np.frombuffer(saved, own.dtype)[0]
        crc = signed(zlib.crc32(saved[CRC_BYTES:]))
        if found.fingerprint != self._fingerprint or found.crc != crc:
            return False
        self._states[0].supervision.saved = found
        return True

    def reset(self, reference: float) -> None:
        """Start from the settled healthy loop at ``reference``; see ``controller.reset``."""
        self._law.reset(self._tables[0], self._states[0], reference)

    def change_speed(self, speed: float) -> None:
        """Before the ``step`` of a tick: the speed of the car, m/s; not a number: as it was."""
        if self._change_speed is not None:
            self._change_speed(speed)

    def act(self, command_1: float, command_2: float) -> None:
        """Set the commands that act from the next ``step`` on, after a loss of the sent commands.

        F1 and the decision go on with the acting commands; the law makes up for the lost commands.
        The latency must be at least one tick: without latency no command comes late.
        """
        act_first(self._tables, self._states, self._motions, command_1, command_2)

    def drive_with(self, input_1: float, input_2: float) -> None:
        """Set the plant's inputs from the next ``step`` on, as measured in a recorded drive.

        F1 and the decision work on these inputs instead of the controller's commands. Unlike after
        ``act``, the law makes up for nothing. The latency must be at least one tick.
        """
        state = self._states[0]
        memories = (
            state.shortfall_1.accumulators,
            state.shortfall_2.accumulators,
            state.tracking.delay,
        )
        before = [memory.copy() for memory in memories]
        self.act(input_1, input_2)
        for memory, kept in zip(memories, before, strict=True):
            memory[...] = kept

    @property
    def hypotheses(self) -> verdict.State:
        """What ``hypotheses`` makes of d̂, now and after any further ``step``; read only."""
        hypotheses: verdict.State = self._states[0].supervision.hypotheses
        return hypotheses

    @property
    def echo_errors(self) -> tuple[float, float]:
        """Modelled less reported output of both actuators; 0 without an echo; see ``echoes``."""
        heard = self._states[0].supervision.echoes
        return float(heard.actuators[TORQUE].error), float(heard.actuators[FORCE].error)

    @property
    def commands(self) -> tuple[float, float]:
        """The last commands, computed, held or settled."""
        state = self._states[0]
        return float(state.command_1), float(state.command_2)
