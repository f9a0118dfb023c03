"""Bus logging in ASAM MDF 4 files → columns.

A file has separate channel groups for data frames, error frames and remote frames of a bus; their
channels have the names of ASAM's "MDF Bus Logging". Groups are read in pieces and merged by time.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from datetime import datetime, timedelta
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from can_rig.errors import LogError
from can_rig.logs.frames import (
    BITRATE_SWITCH,
    CLASSIC_BYTES,
    ERROR,
    ERROR_STATE,
    EXTENDED,
    FD,
    REMOTE,
    SENT,
    Frames,
    UInt8s,
    concatenate,
)
from can_rig.logs.log import Log
from can_rig.logs.readers.binary.mdf_blocks import (
    FINISHED,
    MASTER,
    UNFINISHED,
    VARIABLE,
    VIRTUAL_MASTER,
    Channel,
    ChannelGroup,
    DataGroup,
    MdfError,
    MdfFile,
)
from can_rig.logs.readers.binary.mdf_channels import numbers, payloads, raw, time_ns
from can_rig.logs.readers.binary.mdf_data import records, stream
from can_rig.logs.readers.binary.mdf_values import Values
from can_rig.logs.readers.numbering import numbered

KINDS: Final = {"CAN_DataFrame": 0, "CAN_ErrorFrame": ERROR, "CAN_RemoteFrame": REMOTE}
"""Channel groups by name, and the flag of their frames."""

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
_NS_PER_S: Final = 1_000_000_000


def read_mf4(log: Log) -> Iterator[Frames]:
    """Chunks of the CAN frames of an MDF 4 file.

    Raises:
        LogError: the file is not MDF 4, is damaged, or lacks CAN bus logging.
    """
    try:
        with log.path.open("rb") as opened:
            if opened.read(len(FINISHED)) not in (FINISHED, UNFINISHED):
                raise LogError(f"{log.path}: not an MDF 4 file: it must begin with 'MDF     4'")
            file = MdfFile(opened, log.path.stat().st_size)
            log.start_ns = _start_ns(file)
            groups = [
                _Group(file, log, data, group, kind)
                for data in file.groups
                for group in data.groups
                for kind in KINDS
                if any(channel.name == kind for channel in group.channels)
            ]
            if not groups and file.is_cut:
                raise LogError(
                    f"{log.path}: an MDF 4 file that is cut off: it lacks the description of its "
                    "records, which asammdf writes last and without which none can be read"
                )
            if not groups:
                raise LogError(f"{log.path}: holds no CAN frames (no channel group CAN_DataFrame)")
            total = sum(group.expected for group in groups)
            done = 0
            for frames in _merged(groups):
                done += len(frames)
                log.fraction = done / max(total, done)
                yield frames
            log.fraction = 1.0
    except OSError as error:
        raise LogError(f"{log.path}: cannot be read: {error.strerror}") from None
    except (MdfError, struct.error) as error:
        raise LogError(f"{log.path}: an MDF 4 file that is cut off or damaged: {error}") from None
    missing = sum(group.missing for group in groups)
    if done < total or missing or file.is_cut or any(group.cut_off for group in groups):
        of_all = f" of {total}" if done < total else f" of {done + missing}" if missing else ""
        log.notice = f"{log.path}: is cut off; {done}{of_all} frames are in it"


def _start_ns(file: MdfFile) -> int:
    """Start of the recording [ns]; a local time is taken in this machine's time zone."""
    if file.start_ns >= 1 << 62:
        raise MdfError("a start after the year 2116")
    if not file.is_local_time:
        return file.start_ns
    seconds, rest_ns = divmod(file.start_ns, _NS_PER_S)
    local = datetime(1970, 1, 1) + timedelta(seconds=seconds)
    return int(local.timestamp()) * _NS_PER_S + rest_ns


class _Group:
    """The frames of one channel group, piece by piece."""

    def __init__(
        self, file: MdfFile, log: Log, data: DataGroup, group: ChannelGroup, kind: str
    ) -> None:
        self._file, self._log, self._data, self._group = file, log, data, group
        self._kind = kind
        prefix = f"{kind}."
        self._members = {
            channel.name.removeprefix(prefix): channel
            for channel in group.channels
            if channel.name.startswith(prefix)
        }
        masters = [c for c in group.channels if c.kind in (MASTER, VIRTUAL_MASTER)]
        for name in ("ID", "DLC"):
            if name not in self._members and kind != "CAN_ErrorFrame":
                raise MdfError(f"group {kind} has no channel {prefix}{name}")
        if not masters or not group.record_bytes:
            raise MdfError(f"group {kind} has no time, or records of no bytes")
        self._master = masters[0]
        self.expected = group.records
        """Frames by the file."""
        self.cut_off = False
        """Whether the last record is not whole."""
        self.missing = 0
        """Frames without their payloads."""

    def __iter__(self) -> Iterator[Frames]:
        payload = self._members.get("DataBytes")
        held, of_values = Values(iter(())), None
        if payload is not None and payload.kind == VARIABLE:
            of_values = next((g for g in self._data.groups if g.at == payload.data_at), None)
            if of_values is None:
                held = Values(stream(self._file, payload.data_at))
        pieces = records(self._file, self._data, self._group, of_values, held)
        first = 0
        while True:
            try:
                piece = next(pieces)
            except StopIteration as end:
                self.cut_off = bool(end.value)
                return
            if self._file.is_finished:
                piece = piece[: max(self.expected - first, 0)]
            for begin in range(0, len(piece), self._log.chunk_frames):
                part = piece[begin : begin + self._log.chunk_frames]
                frames = self._frames(np.ascontiguousarray(part), first, held)
                if len(frames):
                    yield frames
                first += len(part)

    def _frames(self, part: UInt8s, first: int, held: Values) -> Frames:
        count = len(part)

        def member(name: str) -> NDArray[Any]:
            channel = self._members.get(name)
            if channel is None:
                return np.zeros(count, np.uint8)
            return numbers(self._file, channel, part, first)

        identifier = member("ID").astype(np.uint32)
        flags = np.full(count, KINDS[self._kind], dtype=np.uint8)
        for name, flag in _MEMBER_FLAGS.items():
            if name in self._members:
                flags |= np.where(member(name) != 0, np.uint8(flag), np.uint8(0))
        flags |= np.where(identifier & np.uint32(_EXTENDED_BIT), np.uint8(EXTENDED), np.uint8(0))
        remote = (flags & REMOTE) != 0
        if remote.any():  # CAN FD lacks remote frames
            flags[remote] &= np.uint8(~(FD | BITRATE_SWITCH | ERROR_STATE) & 0xFF)
        has_length = "DataLength" in self._members and self._kind != "CAN_RemoteFrame"
        length = np.minimum(member("DataLength" if has_length else "DLC"), 64).astype(np.uint8)
        if not (flags & FD).all():
            plain = (flags & (FD | ERROR)) == 0
            length[plain] = np.minimum(length[plain], CLASSIC_BYTES)
        bus = member("BusChannel")
        if count and not 0 <= int(bus.min()) <= int(bus.max()) <= 0xFFFF:
            raise MdfError(f"bus {int(bus.max())}; it must be between 0 and 65535")
        payload, found = self._payload(part, first, length, held)
        self.missing += count - int(found.sum())
        frames = Frames(
            time_ns(self._file, self._master, part, first) + self._log.start_ns,
            identifier & np.uint32(_ID_MASK),
            flags,
            bus.astype(np.uint16),
            length,
            payload,
            (),
        )[found]
        return numbered(frames) if len(frames) else frames

    def _payload(
        self, part: UInt8s, first: int, length: UInt8s, held: Values
    ) -> tuple[UInt8s, NDArray[np.bool_]]:
        """The payloads, and whether the file has each."""
        channel: Channel | None = self._members.get("DataBytes")
        if channel is not None and channel.kind == VARIABLE:
            return held.rows(raw(channel, part, first), length)
        rows = np.zeros((len(part), CLASSIC_BYTES), np.uint8)
        if channel is not None:
            rows = payloads(channel, part, length)
        return rows, np.ones(len(part), np.bool_)


def _merged(groups: Sequence[_Group]) -> Iterator[Frames]:
    """The frames of all groups by time; at equal times in the order of the groups."""
    sources = [iter(group) for group in groups]
    held: list[Frames | None] = [next(source, None) for source in sources]
    while any(frames is not None for frames in held):
        there = [frames for frames in held if frames is not None]
        if len(there) == 1 and len(groups) == 1:
            yield there[0]
            held = [next(sources[0], None)]
            continue
        # Up to the earliest last time stamp of all the pieces no older frame can follow.
        safe = min(int(frames.time_ns[-1]) for frames in there)
        whole = concatenate([frames[frames.time_ns <= safe] for frames in there])
        yield whole[np.argsort(whole.time_ns, kind="stable")]
        for at, frames in enumerate(held):
            if frames is not None:
                left = frames[frames.time_ns > safe]
                held[at] = left if len(left) else next(sources[at], None)
