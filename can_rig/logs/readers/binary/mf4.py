"""Bus logging in ASAM MDF 4 files → columns, through asammdf.

A file has one channel group for the data frames of a bus, one for its error frames, one for its
remote frames; their channels have the names of ASAM's "MDF Bus Logging". Groups are read in pieces
and merged by time.
"""

from __future__ import annotations

import gc
import logging
import sys
import traceback
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from can_rig.errors import LogError, one_line, require
from can_rig.logs.frames import (
    BITRATE_SWITCH,
    CLASSIC_BYTES,
    ERROR,
    ERROR_STATE,
    EXTENDED,
    FD,
    FD_BYTES,
    REMOTE,
    SENT,
    Frames,
    UInt8s,
    concatenate,
)
from can_rig.logs.log import Log

KINDS: Final = {"CAN_DataFrame": 0, "CAN_ErrorFrame": ERROR, "CAN_RemoteFrame": REMOTE}
"""Channel groups by name, and the flag of their frames."""

_MDF_4: Final = b"MDF     4."
"""The first bytes of a file: what it is, and its version."""

_ID_MASK: Final = (1 << 29) - 1
_EXTENDED_BIT: Final = 1 << 31
_MEMBER_FLAGS: Final = {
    "IDE": EXTENDED,
    "EDL": FD,
    "BRS": BITRATE_SWITCH,
    "ESI": ERROR_STATE,
    "Dir": SENT,
    "RTR": REMOTE,
}


def read_mf4(log: Log) -> Iterator[Frames]:
    """Chunks of the CAN frames of an MDF 4 file.

    Raises:
        LogError: asammdf cannot read it, or it has no CAN bus logging.
    """
    require("asammdf", extra="logs")
    import asammdf  # noqa: PLC0415 (slow to import)

    logging.getLogger("asammdf").setLevel(logging.CRITICAL)  # its reason is in our error
    # asammdf's own survey of the identifiers would read and unpack the file once more.
    with _one_line_errors(_reason_unreadable(log)):
        file = asammdf.MDF(log.path, process_bus_logging=False)  # type: ignore[call-arg]
    with file:
        groups = [_Group(file, log, index) for index in _can_groups(file)]
        if not groups:
            raise LogError(f"{log.path}: holds no CAN frames (no channel group CAN_DataFrame)")
        log.start_ns = _start_ns(file)
        total = sum(group.frames for group in groups) or 1
        done = 0
        for frames in _merged(groups):
            done += len(frames)
            log.fraction = done / total
            yield frames


def _reason_unreadable(log: Log) -> str:
    """What is wrong with a file that asammdf does not open."""
    try:
        with log.path.open("rb") as file:
            start = file.read(len(_MDF_4))
    except OSError:
        start = b""  # the reason is in the error of asammdf
    if start == _MDF_4:
        return (
            f"{log.path}: an MDF 4 file that is cut off or damaged, so that no frame of it can be "
            "read"
        )
    return f"{log.path}: not an MDF file that asammdf can read"


def _can_groups(file: Any) -> list[int]:
    if not file.version.startswith("4"):
        return []
    return [
        index
        for index, group in enumerate(file.groups)
        if any(channel.name in KINDS for channel in group.channels)
    ]


def _start_ns(file: Any) -> int:
    """Start of the recording [ns]; a local time is one of this machine's time zone."""
    header = file.header
    if header.start_time.tzinfo is not None:
        return int(header.abs_time)
    local_s: float = header.start_time.timestamp()
    return int(local_s) * 10**9 + int(header.abs_time) % 10**9


class _Group:
    """The frames of one channel group, piece by piece."""

    def __init__(self, file: Any, log: Log, index: int) -> None:
        self._file, self._log, self._index = file, log, index
        group = file.groups[index]
        names = {channel.name for channel in group.channels}
        self._kind = next(kind for kind in KINDS if kind in names)
        self._members = {name.split(".")[1] for name in names if name.startswith(self._kind + ".")}
        self.frames = int(group.channel_group.cycles_nr)

    def __iter__(self) -> Iterator[Frames]:
        for first in range(0, self.frames, self._log.chunk_frames):
            where = f"{self._log.path}: {self._kind} from record {first}"
            with _one_line_errors(f"{where}: cannot be read by asammdf"):
                piece = self._read(first, min(self._log.chunk_frames, self.frames - first))
            yield piece

    def _read(self, first: int, count: int) -> Frames:
        piece = {"group": self._index, "record_offset": first, "record_count": count, "raw": True}
        whole = self._file.get(self._kind, **piece)
        time_s: NDArray[np.float64] = whole.timestamps
        records: NDArray[Any] = whole.samples
        if len(time_s) < count:
            raise ValueError(f"{count - len(time_s)} of {count} records are missing")

        def member(name: str) -> NDArray[Any]:
            path = f"{self._kind}.{name}"
            if records.dtype.names and path in records.dtype.names:
                found: NDArray[Any] = records[path]  # read once, and unpacked once, for all
            elif name in self._members:
                found = self._file.get(path, **piece, samples_only=True)[0]
            else:
                found = np.zeros(count, dtype=np.uint8)
            return found

        identifier = member("ID").astype(np.uint32)
        flags = np.full(count, KINDS[self._kind], dtype=np.uint8)
        for name, flag in _MEMBER_FLAGS.items():
            values = member(name)
            is_set = values.astype("U2") == "Tx" if values.dtype.kind in "SU" else values != 0
            flags |= np.where(is_set, np.uint8(flag), np.uint8(0))
        flags |= np.where(identifier & np.uint32(_EXTENDED_BIT), np.uint8(EXTENDED), np.uint8(0))
        has_length = "DataLength" in self._members and self._kind != "CAN_RemoteFrame"
        length = member("DataLength" if has_length else "DLC").astype(np.uint8)
        data = _payloads(member("DataBytes"), count, int(length.max(initial=0)))
        bus = member("BusChannel").astype(np.int64)
        one = bus.min(initial=0) == bus.max(initial=0) or (bus == bus[0]).all()
        numbers, channel = (
            (bus[:1], np.zeros(count)) if one else np.unique(bus, return_inverse=True)
        )
        return Frames(
            np.round(time_s * 1e9).astype(np.int64) + _start_ns(self._file),
            identifier & np.uint32(_ID_MASK),
            flags,
            channel.astype(np.uint8),
            length,
            data,
            tuple(map(str, numbers.tolist())),
        )


def _payloads(data: NDArray[Any], count: int, longest: int) -> UInt8s:
    """(n, 8) or, where frames are longer, (n, 64) bytes of whatever width asammdf gives."""
    rows = np.zeros((count, CLASSIC_BYTES if longest <= CLASSIC_BYTES else FD_BYTES), np.uint8)
    if data.ndim == 1 and data.dtype.kind == "S":  # of varying length
        data = data.view(np.uint8).reshape(count, -1)
    if data.ndim == 2:
        used = min(data.shape[1], rows.shape[1])
        rows[:, :used] = data[:, :used]
    return rows


def _merged(groups: Sequence[_Group]) -> Iterator[Frames]:
    """The frames of all groups by time; at equal times in the order of the groups."""
    sources = [iter(group) for group in groups if group.frames]
    if len(sources) == 1:
        yield from sources[0]
        return
    held = [next(source) for source in sources]
    while held:
        # Up to the earliest last time stamp of all the pieces no older frame can follow.
        safe = min(int(frames.time_ns[-1]) for frames in held)
        ready = [frames[frames.time_ns <= safe] for frames in held]
        whole = concatenate(ready)
        yield whole[np.argsort(whole.time_ns, kind="stable")]
        left = [frames[frames.time_ns > safe] for frames in held]
        held, going = [], []
        for frames, source in zip(left, sources, strict=True):
            more = frames if len(frames) else next(source, None)
            if more is not None:
                held.append(more)
                going.append(source)
        sources = going


@contextmanager
def _one_line_errors(what: str) -> Iterator[None]:
    """Whatever asammdf raises about a damaged file, as one line.

    Its half-built objects raise again when they are collected, which would be printed.
    """
    hook, sys.unraisablehook = sys.unraisablehook, lambda _: None
    try:
        yield
    except Exception as error:
        traceback.clear_frames(error.__traceback__)
        gc.collect()
        raise LogError(f"{what}: {one_line(error)}") from None
    finally:
        sys.unraisablehook = hook
