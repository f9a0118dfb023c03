"""``can-rig replay --bus``: a log onto a bus, for other programs to see."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict
from fractions import Fraction
from pathlib import Path

import click

from can_rig.buses.bus import open_bus
from can_rig.cli.output import json_line, note, tell
from can_rig.cli.progress import reading
from can_rig.errors import INTERRUPTED
from can_rig.logs.frames import NS_PER_S
from can_rig.logs.log import Window
from can_rig.logs.reading import read_log
from can_rig.nodes.bus_access import StopRequest
from can_rig.replay.pace import Paced, Pacer
from can_rig.results.source import log_path, only_channel

CHUNK_FRAMES = 256
"""Small, so that the bar moves while a slow log is played."""


def speed_of(text: str) -> Fraction | None:
    """A factor above zero, exact; None for ``max``."""
    if text == "max":
        return None
    try:
        speed = Fraction(text)
    except (ValueError, ZeroDivisionError):
        speed = Fraction(0)
    if speed <= 0:
        raise click.UsageError(f"--speed {text}: must be a number above 0, as in 0.5, or max")
    return speed


def pace(
    path: Path,
    bus_name: str,
    speed: Fraction | None,
    channel: str | None,
    window: Window,
    as_json: bool,
) -> int:
    """Put every frame of the log on the bus; returns the exit status.

    Raises:
        LogError: the log cannot be read.
        BusError: the bus is absent, or refuses frames.
    """
    log = read_log(log_path(path), CHUNK_FRAMES, window)
    stop = StopRequest().on_signals()
    with open_bus(bus_name) as bus:
        pacer = Pacer(bus, speed, stop)
        result = pacer.send_all(only_channel(reading(log, f"to {bus_name}"), channel, log.path))
    if as_json:
        json_line(log=str(log.path), **asdict(result), notice=log.notice)
    else:
        tell(*_lines(result, speed))
        note(log.notice)
    return INTERRUPTED if stop.wanted else 0


def _lines(result: Paced, speed: Fraction | None) -> Iterator[str]:
    log_s, wall_s = result.log_ns / NS_PER_S, result.wall_ns / NS_PER_S
    pace = f", {log_s / wall_s:.3g} x its own pace" if wall_s and log_s else ""
    yield f"{result.sent} frames sent: {log_s:.6f} s of the log in {wall_s:.6f} s{pace}"
    if speed is not None:
        yield f"the most that a frame was late: {result.late_ns / 1e6:.3f} ms"
    if result.fd_frames:
        yield (
            f"{result.fd_frames} CAN FD frames not sent, the bus is a classic one; "
            "?fd=true behind its name opens one that is not"
        )
    if result.error_frames:
        yield f"{result.error_frames} error frames not sent: only a bus itself makes them"
