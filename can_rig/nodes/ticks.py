"""The one loop of all runs, and the summary of a run.

A tick is a sample of the plant to the controller, and its commands back. Two processes, one process
with a bus, one process without a bus, and the wall clock are ways to carry a tick; `drive` goes
through the ticks of each.
"""

import gc
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from typing import Any

from can_rig.nodes.bus_access import NS_PER_S, SYSTEM_CLOCK, Interrupted, OnTick, Pace
from firmware_model.law.structs import FloatArray

Carry = Callable[[int], int]
"""Carries a tick, or several from a tick on; returns the number of ticks completed.

Raises ``Interrupted`` after a stop request.
"""


@dataclass(frozen=True)
class RunColumns:
    """The recorded data of a run without a bus, for callers that skip the log file.

    Attributes:
        frames: contents of the frames by the names of ``frameless.carried``, (ticks,) each.
        plant: the plant's report, by name; None: read the file beside the log.
        sensors: what the further sensors say, by column.
        sample_ages: ticks since the sample of each heard sensor, by column.
    """

    frames: dict[str, FloatArray]
    plant: dict[str, FloatArray] | None
    sensors: dict[str, FloatArray]
    sample_ages: dict[str, FloatArray]


@dataclass
class NodeSummary:
    """The summary that a node returns at its end."""

    ticks: int
    """The tick that it has reached: all of them, unless it was started later or stopped."""
    wall_s: float
    rejected_frames: dict[str, dict[str, int]]
    """Of each message, how many were not used, by reason."""
    bus_events: dict[str, dict[str, int]]
    """Of each node, what its bus refused, failed or dropped, and how often; only what occurred."""
    realtime: dict[str, Any] | None = None
    """How deadlines were met and what the system permitted; None in lockstep."""
    columns: RunColumns | None = None
    """What was carried, where it was no bus."""
    ticks_per_s: float = 0.0
    """From its own first tick on, whichever that was."""


def drive(carry: Carry, ticks: int, on_tick: OnTick) -> int:
    """Carry ``ticks`` ticks, or as many as a stop request leaves; returns the number completed.

    Raises:
        RigError: from ``carry``.
    """
    tick = 0
    while tick < ticks:
        try:
            tick = carry(tick)
        except Interrupted:
            break
        on_tick(tick)
    return tick


def timed(
    carry: Carry, ticks: int, on_tick: OnTick, meanwhile: AbstractContextManager[None] | None = None
) -> NodeSummary:
    """``drive`` with its time and rate; ``meanwhile`` is entered during the loop."""
    pace = Pace(SYSTEM_CLOCK, on_tick)
    with meanwhile or without_garbage_pauses():
        start_ns = SYSTEM_CLOCK.now_ns()
        done = drive(carry, ticks, pace)
        wall_s = (SYSTEM_CLOCK.now_ns() - start_ns) / NS_PER_S
        rate = pace.ticks_per_s
    return NodeSummary(done, wall_s, {}, {}, ticks_per_s=rate)


@contextmanager
def without_garbage_pauses() -> Iterator[None]:
    """Exclude objects from before the loop from garbage collection.

    Objects stay excluded if a command has frozen its imports: unfreezing covers all frozen objects
    at once, and a search of the imports takes as long as the import.
    """
    before = gc.get_freeze_count()
    gc.freeze()
    try:
        yield
    finally:
        if before == 0:
            gc.unfreeze()
