"""Steps and resets of the law on random memory: as orders for `support/trial.c`, and in Python.

If speed blends the designs, a change of speed precedes each step and reset.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from can_rig.export.back_to_back.memories import random_state, random_table, reals
from can_rig.export.back_to_back.speeds import Drive, random_drive
from firmware_model.firmware import PYTHON_LAW, Law
from firmware_model.target.layout import precision_of
from firmware_model.target.structs import FloatArray, Precision, RecordArray


@dataclass(frozen=True)
class Trial:
    """One memory with its inputs.

    Attributes:
        tables: the constant table, shape (1,).
        states: the state before the first tick, shape (1,).
        inputs: reference and measurement of each tick, shape (ticks, 2); the tick in the middle is
            a reset to its reference.
        drive: blends the table before each tick; None: no blending.
    """

    tables: RecordArray
    states: RecordArray
    inputs: FloatArray
    drive: Drive | None = None

    @property
    def answers(self) -> int:
        """Number of answers."""
        return len(self.inputs) * (1 if self.drive is None else 2) + 1

    @property
    def answer_bytes(self) -> int:
        """Size of an answer."""
        blended = () if self.drive is None else (self.tables, self.drive.blendings)
        return sum(each.itemsize for each in (self.states, *blended))


def random_trials(
    precision: Precision, seed: int, memories: int, ticks: int, blends: bool = False
) -> list[Trial]:
    """Trials of any memory and any inputs, the same for the same ``seed``.

    Args:
        precision: of real numbers.
        seed: of the generator.
        memories: how many trials.
        ticks: of each.
        blends: whether the speed of the car changes.
    """
    random, trials = np.random.default_rng(seed), []
    for _ in range(memories):
        even = random.random() < 0.2  # equal operands for comparisons
        tables = random_table(random, precision, even)
        states = random_state(random, tables[0], precision, even)
        inputs = reals(random, (ticks, 2), precision, even)
        drive = random_drive(random, precision, ticks, even) if blends else None
        trials.append(Trial(tables, states, inputs, drive))
    return trials


def encoded(trials: list[Trial]) -> bytes:
    """The trials as orders; each change of the speed and each tick is answered by a state."""
    orders = []
    for trial in trials:
        orders += [b"M", trial.tables.tobytes(), trial.states.tobytes()]
        drive = trial.drive
        if drive is not None:
            orders += [b"B", drive.schedules.tobytes(), drive.blendings.tobytes()]
        for k, inputs in enumerate(trial.inputs):
            if drive is not None:
                orders.append(b"V" + drive.speeds[k].tobytes())
            is_reset = k == len(trial.inputs) // 2
            orders.append(b"Z" + inputs[:1].tobytes() if is_reset else b"S" + inputs.tobytes())
        orders.append(b"I")
    return b"".join(orders)


def states_of(law: Law, trials: list[Trial]) -> Iterator[bytes]:
    """The law's answers to the trials: each state, followed by the blended table, if any."""
    for trial in trials:
        tables, states = copied(trial.tables), copied(trial.states)
        kept, change_speed = [states], None
        if trial.drive is not None:
            schedules, blendings = trial.drive.schedules, copied(trial.drive.blendings)
            kept += [tables, blendings]
            change_speed = law.change_speed_of((schedules, blendings, tables, states))
        step = law.step_of(tables, states)
        for k, (reference, measurement) in enumerate(trial.inputs.astype(float)):
            if change_speed is not None and trial.drive is not None:
                change_speed(float(trial.drive.speeds[k]))
                yield b"".join(each.tobytes() for each in kept)
            if k == len(trial.inputs) // 2:
                law.reset(tables[0], states[0], reference)
            else:
                step(reference, measurement)
            yield b"".join(each.tobytes() for each in kept)
        started = law.init(tables[0]).tobytes()
        yield started + b"".join(each.tobytes() for each in kept[1:])


def copied(memory: RecordArray) -> RecordArray:
    """A copy that includes the padding between fields."""
    copy = memory.copy()
    copy.view(np.uint8)[:] = memory.view(np.uint8)
    return copy


def in_python(trials: list[Trial]) -> bytes:
    """The answers of the law in Python."""
    return b"".join(states_of(PYTHON_LAW, trials))


def different(one: bytes, other: bytes, trials: list[Trial]) -> int:
    """Number of states (with blended tables) that differ in a bit between two rows of answers.

    All not-a-numbers count as equal: their bits depend on the processor.
    """
    dtype, size = precision_of(trials[0].tables[0]), trials[0].answer_bytes
    expected = sum(trial.answers for trial in trials)
    if len(one) != expected * size or len(other) != expected * size:
        return expected
    rows = [np.frombuffer(each, dtype).copy() for each in (one, other)]
    for row in rows:
        row[np.isnan(row)] = np.nan
    same = [row.view(np.uint8).reshape(expected, size) for row in rows]
    return int(np.count_nonzero((same[0] != same[1]).any(axis=1)))
