"""Steps and resets of the law on random memory: as orders for `support/trial.c`, and in Python."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from can_rig.export.back_to_back.memories import random_state, random_table, reals
from firmware_model.firmware import PYTHON_LAW, Law
from firmware_model.target.layout import precision_of
from firmware_model.target.structs import FloatArray, Precision, RecordArray


@dataclass(frozen=True)
class Trial:
    """One memory and what comes in.

    Attributes:
        tables: the constant table, shape (1,).
        states: the state before the first tick, shape (1,).
        inputs: reference and measurement of each tick, shape (ticks, 2); the tick in the middle is
            a reset to its reference.
    """

    tables: RecordArray
    states: RecordArray
    inputs: FloatArray


def random_trials(precision: Precision, seed: int, memories: int, ticks: int) -> list[Trial]:
    """Trials of any memory and any inputs, the same for the same ``seed``."""
    random, trials = np.random.default_rng(seed), []
    for _ in range(memories):
        even = random.random() < 0.2  # where one number is compared with another that it equals
        tables = random_table(random, precision, even)
        states = random_state(random, tables[0], precision, even)
        trials.append(Trial(tables, states, reals(random, (ticks, 2), precision, even)))
    return trials


def encoded(trials: list[Trial]) -> bytes:
    """The trials as orders; each tick is answered by a state."""
    orders = []
    for trial in trials:
        orders += [b"M", trial.tables.tobytes(), trial.states.tobytes()]
        for k, inputs in enumerate(trial.inputs):
            is_reset = k == len(trial.inputs) // 2
            orders.append(b"Z" + inputs[:1].tobytes() if is_reset else b"S" + inputs.tobytes())
        orders.append(b"I")
    return b"".join(orders)


def states_of(law: Law, trials: list[Trial]) -> Iterator[bytes]:
    """What the law makes of them, a state for each answer."""
    for trial in trials:
        states = trial.states.copy()
        states.view(np.uint8)[:] = trial.states.view(np.uint8)  # with what is between the fields
        step = law.step_of(trial.tables, states)
        for k, (reference, measurement) in enumerate(trial.inputs.astype(float)):
            if k == len(trial.inputs) // 2:
                law.reset(trial.tables[0], states[0], reference)
            else:
                step(reference, measurement)
            yield states.tobytes()
        yield law.init(trial.tables[0]).tobytes()


def in_python(trials: list[Trial]) -> bytes:
    """The answers of the law in Python."""
    return b"".join(states_of(PYTHON_LAW, trials))


def different(one: bytes, other: bytes, trials: list[Trial]) -> int:
    """Of two rows of answers, how many states differ in a bit.

    Any not-a-number is like any other: which one comes out is the processor's.
    """
    dtype, size = precision_of(trials[0].tables[0]), trials[0].states.itemsize
    expected = sum(len(trial.inputs) + 1 for trial in trials)
    if len(one) != expected * size or len(other) != expected * size:
        return expected
    rows = [np.frombuffer(each, dtype).copy() for each in (one, other)]
    for row in rows:
        row[np.isnan(row)] = np.nan
    same = [row.view(np.uint8).reshape(expected, size) for row in rows]
    return int(np.count_nonzero((same[0] != same[1]).any(axis=1)))
