"""The summary that a node returns at its end."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from firmware_model.target.structs import FloatArray


@dataclass(frozen=True)
class RunColumns:
    """The recorded data of a run without a bus, for callers that skip the log file.

    Attributes:
        frames: contents of the frames by the names of ``frameless.carried``, (ticks,) each.
        plant: the plant's report, by name; None: read the file beside the log.
    """

    frames: dict[str, FloatArray]
    plant: dict[str, FloatArray] | None


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
