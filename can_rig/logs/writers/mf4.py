"""Frames as ASAM MDF 4 bus logging, with the channel names of ASAM's "MDF Bus Logging".

python-can's writer dates every file at the moment of writing and rounds time to 0.2 µs; here the
file starts when the log does, and its time stamps are exact to the nanosecond.
"""

from __future__ import annotations

from collections.abc import Iterable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

import numpy as np
from can.util import channel2int
from numpy.typing import NDArray

from can_rig.logs.frames import (
    BITRATE_SWITCH,
    CLASSIC_BYTES,
    ERROR,
    ERROR_STATE,
    EXTENDED,
    FD,
    FD_BYTES,
    NS_PER_S,
    REMOTE,
    SENT,
    Frames,
)

_DLC: Final = np.array([*range(9), *np.repeat(range(9, 16), [4, 4, 4, 4, 8, 16, 16])], np.uint8)
"""DLC by payload length: 9 for 9 to 12 bytes, …, 15 for 49 to 64."""


def write_mf4(chunks: Iterable[Frames], path: Path, start_ns: int) -> None:
    """Write a log; a channel group for each kind of frame and width of payload that occurs."""
    from asammdf import MDF, Signal, Source  # noqa: PLC0415 (slow to import)

    source = Source("CAN", "", "", Source.SOURCE_BUS, Source.BUS_TYPE_CAN)
    with MDF(version="4.10") as file:
        file.header.start_time = datetime.fromtimestamp(start_ns // NS_PER_S, UTC)
        file.header.abs_time = start_ns
        groups: dict[tuple[str, int], int] = {}
        for frames in chunks:
            for (kind, width), part in _kinds(frames).items():
                time_s = (part.time_ns - start_ns) / NS_PER_S
                records = _records(kind, width, part)
                if (kind, width) in groups:
                    file.extend(groups[kind, width], [(time_s, None), (records, None)])
                else:
                    signal = Signal(records, time_s, name=kind, source=source)
                    groups[kind, width] = file.append(signal, acq_source=source)
        file.save(path, overwrite=True, compression=1)


def _kinds(frames: Frames) -> dict[tuple[str, int], Frames]:
    """The frames of each kind; frames longer than 8 bytes are separate."""
    error, remote = frames.has(ERROR), frames.has(REMOTE)
    long = frames.length > CLASSIC_BYTES
    rows = {
        ("CAN_DataFrame", CLASSIC_BYTES): ~(error | remote | long),
        ("CAN_DataFrame", FD_BYTES): ~(error | remote) & long,
        ("CAN_ErrorFrame", FD_BYTES): error,
        ("CAN_RemoteFrame", 0): remote & ~error,
    }
    return {key: frames[chosen] for key, chosen in rows.items() if chosen.any()}


def _records(kind: str, width: int, frames: Frames) -> NDArray[np.void]:
    numbers = np.array([channel2int(name) or 0 for name in frames.channels] or [0], dtype=np.uint8)
    data = np.pad(frames.data, ((0, 0), (0, max(0, width - frames.data.shape[1]))))[:, :width]
    members: dict[str, NDArray[Any]] = {
        "BusChannel": numbers[frames.channel],
        "ID": frames.arbitration_id,
        "IDE": frames.has(EXTENDED),
        "DLC": np.where(frames.has(FD), _DLC[frames.length], frames.length),
        "DataLength": frames.length,
        "Dir": frames.has(SENT),
        "EDL": frames.has(FD),
        "BRS": frames.has(BITRATE_SWITCH),
        "ESI": frames.has(ERROR_STATE),
    }
    if width:
        members["DataBytes"] = data
    shapes = {"ID": "<u4", "DataBytes": f"({width},)u1"}
    kinds = [(f"{kind}.{name}", shapes.get(name, "<u1")) for name in members]
    records = np.zeros(len(frames), dtype=kinds)
    for name, values in members.items():
        records[f"{kind}.{name}"] = values
    return records
