"""Many CAN frames as columns: what the readers of logs give and the decoder takes."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any, Final, NamedTuple

import numpy as np
from can import Message
from numpy.typing import NDArray

from can_rig.errors import LogError

# Bits of Frames.flags.
EXTENDED: Final = 1
REMOTE: Final = 2
ERROR: Final = 4
FD: Final = 8
BITRATE_SWITCH: Final = 16
ERROR_STATE: Final = 32
SENT: Final = 64

CLASSIC_BYTES: Final = 8
FD_BYTES: Final = 64
NS_PER_S: Final = 1_000_000_000
MAX_BUSES: Final = 255
"""In a log, so that a byte holds the index of a bus."""

UInt8s = NDArray[np.uint8]


@dataclass(frozen=True)
class Frames:
    """``n`` frames, one a row, in the order of their source."""

    time_ns: NDArray[np.int64]
    """(n,) time stamps as the source has them [ns]: see `can_rig.logs.reading.Log.start_ns`."""
    arbitration_id: NDArray[np.uint32]
    """(n,) identifiers, of 11 or 29 bits; an error frame has Linux's error class."""
    flags: UInt8s
    """(n,) EXTENDED, REMOTE, ERROR, FD, BITRATE_SWITCH, ERROR_STATE, SENT (else received)."""
    channel: UInt8s
    """(n,) indices into ``channels``."""
    length: NDArray[Any]
    """(n,) payload lengths [byte], uint8; for a remote frame, the requested length."""
    data: UInt8s
    """(n, 8) or, where a frame is longer, (n, 64) payloads; zero behind their ends."""
    channels: tuple[str, ...]
    """Names of the buses."""

    def __len__(self) -> int:
        return len(self.time_ns)

    def __getitem__(self, rows: slice | NDArray[Any]) -> Frames:
        """Selected frames: a slice, a mask, or row numbers."""
        return Frames(
            self.time_ns[rows],
            self.arbitration_id[rows],
            self.flags[rows],
            self.channel[rows],
            self.length[rows],
            self.data[rows],
            self.channels,
        )

    def has(self, flag: int) -> NDArray[np.bool_]:
        """(n,) whether a frame has at least one of the flags."""
        found: NDArray[np.bool_] = (self.flags & flag) != 0
        return found

    def rows(self) -> Iterator[tuple[int, int, int, int, int]]:
        """Each frame's time stamp, identifier, flags, channel and length."""
        columns = (self.time_ns, self.arbitration_id, self.flags, self.channel, self.length)
        return zip(*(column.tolist() for column in columns), strict=True)

    def messages(self, since_ns: int = 0) -> Iterator[Message]:
        """Yield each frame as a python-can message; time stamps in float seconds after a time."""
        for row, data in zip(self.rows(), self.data, strict=True):
            time_ns, arbitration_id, flags, channel, length = row
            bare = flags & REMOTE
            yield Message(
                timestamp=(time_ns - since_ns) / NS_PER_S,
                arbitration_id=arbitration_id,
                is_extended_id=bool(flags & EXTENDED),
                is_remote_frame=bool(bare),
                is_error_frame=bool(flags & ERROR),
                channel=self.channels[channel],
                dlc=length,
                data=None if bare else bytearray(data[:length]),
                is_fd=bool(flags & FD),
                is_rx=not flags & SENT,
                bitrate_switch=bool(flags & BITRATE_SWITCH),
                error_state_indicator=bool(flags & ERROR_STATE),
            )


def concatenate(parts: Iterable[Frames]) -> Frames:
    """The parts joined in order; payloads as wide as the widest, channels by their names."""
    parts = list(parts)
    names = list(dict.fromkeys(name for part in parts for name in part.channels))
    width = max((part.data.shape[1] for part in parts), default=CLASSIC_BYTES)
    channels, payloads = [], [np.zeros((0, width), np.uint8)]
    for part in parts:
        renumber = np.array([names.index(name) for name in part.channels] or [0], dtype=np.uint8)
        channels.append(renumber[part.channel])
        payloads.append(np.pad(part.data, ((0, 0), (0, width - part.data.shape[1]))))

    def joined(name: str, kind: type[Any]) -> NDArray[Any]:
        return np.concatenate([np.zeros(0, kind), *(getattr(part, name) for part in parts)])

    return Frames(
        joined("time_ns", np.int64),
        joined("arbitration_id", np.uint32),
        joined("flags", np.uint8),
        np.concatenate([np.zeros(0, np.uint8), *channels]),
        joined("length", np.uint8),
        np.concatenate(payloads),
        tuple(names),
    )


class Columns(NamedTuple):
    """Room for frames, which compiled readers fill: the columns of `Frames`."""

    time_ns: NDArray[np.int64]
    arbitration_id: NDArray[np.uint32]
    flags: UInt8s
    channel: NDArray[Any]
    length: UInt8s
    data: UInt8s

    def frames(self, count: int, names: tuple[str, ...] = ()) -> Frames:
        """The first ``count`` frames."""
        every = Frames(
            self.time_ns,
            self.arbitration_id,
            self.flags,
            self.channel,
            self.length,
            self.data,
            names,
        )
        return every[:count]


def empty_columns(rows: int, width: int, bus: type[np.unsignedinteger[Any]] = np.uint8) -> Columns:
    """Room for frames with ``width`` bytes; ``bus`` is the type of the buses' numbers."""
    return Columns(
        np.empty(rows, np.int64),
        np.empty(rows, np.uint32),
        np.empty(rows, np.uint8),
        np.empty(rows, bus),
        np.empty(rows, np.uint8),
        np.empty((rows, width), np.uint8),
    )


def numbered(frames: Frames, first: int = 0) -> Frames:
    """Frames with the bus number as ``channel``, indexed over the buses present.

    Args:
        frames: at least one frame.
        first: the format's number of the first bus; the result counts from 0, as python-can does.

    Raises:
        LogError: more buses than an index can hold.
    """
    found = np.flatnonzero(np.bincount(frames.channel))
    if len(found) > MAX_BUSES:
        raise LogError(f"{len(found)} buses; there must be at most {MAX_BUSES} in a log")
    names = tuple(str(number - first) for number in found.tolist())
    if len(found) == 1:
        return replace(frames, channel=np.zeros(len(frames), np.uint8), channels=names)
    index = np.zeros(int(found[-1]) + 1, np.uint8)
    index[found] = np.arange(len(found))
    return replace(frames, channel=index[frames.channel], channels=names)
