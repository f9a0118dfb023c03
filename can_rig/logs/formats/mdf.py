"""ASAM MDF 4 files of bus logging.

A file has separate channel groups for data frames, error frames and remote frames of a bus; their
channels have the names of ASAM's "MDF Bus Logging". Groups are read in pieces and merged by time.

python-can's writer dates every file at the moment of writing and rounds time to 0.2 µs; a file from
here starts when the log does, and its time stamps are exact to the nanosecond.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterable, Iterator, Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, Final

import numpy as np
from can.util import channel2int
from numpy.typing import NDArray

from can_rig.errors import LogError
from can_rig.logs.formats.mdf_blocks import (
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
from can_rig.logs.formats.mdf_channels import numbers, payloads, raw, time_ns
from can_rig.logs.formats.mdf_data import Values, records, stream
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
    UInt8s,
    concatenate,
    numbered,
)
from can_rig.logs.log import Format, Log

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
_DLC: Final = np.array([*range(9), *np.repeat(range(9, 16), [4, 4, 4, 4, 8, 16, 16])], np.uint8)
"""DLC by payload length: 9 for 9 to 12 bytes, …, 15 for 49 to 64."""


def _read(log: Log) -> Iterator[Frames]:
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
    seconds, rest_ns = divmod(file.start_ns, NS_PER_S)
    local = datetime(1970, 1, 1) + timedelta(seconds=seconds)
    return int(local.timestamp()) * NS_PER_S + rest_ns


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


def _write(chunks: Iterable[Frames], path: Path, start_ns: int, _final: Path) -> None:
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


MDF: Final = Format(
    key=".mf4",
    mark=re.compile(rb"MDF     |UnFinMF "),
    read=_read,
    gzipped=False,
    write=_write,
    name="an MDF log",
    start_ns=1,
    since_ns=0,
    order=False,
)
