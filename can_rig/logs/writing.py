"""Logs written in the formats that `reading` reads, from columns of frames.

    write_log(read_log("runs/demo/bus.log"), Path("demo.blf"))

| suffix            | what it keeps                                                               |
|-------------------|-----------------------------------------------------------------------------|
| `.log`, `.log.gz` | everything; time to 1 µs                                                    |
| `.blf`            | time to 1 ns; of error frames only the payload; buses by number             |
| `.mf4`            | everything, time to 1 ns; buses by number                                   |
| `.asc`            | time to 1 µs, its start to 1 ms; of error frames nothing; buses by number   |
| `.trc`            | time to 1 µs; only classic data frames, others are refused; buses by number |

The number of a bus is that at the end of its name, as python-can has it: 0 for vcan0.
"""

from __future__ import annotations

import gzip
from collections.abc import Callable, Iterable, Iterator
from itertools import chain
from pathlib import Path
from typing import Final

from can import Message
from can.io import ASCWriter, BLFWriter, TRCWriter

from can_rig.errors import LogError
from can_rig.files import atomic, refuse_existing
from can_rig.logs.frames import ERROR, EXTENDED, FD, NS_PER_S, REMOTE, SENT, Frames
from can_rig.logs.reading import Log, format_of

_ERROR_BIT: Final = 1 << 29
_FD_FLAGS: Final = (
    4  # BITRATE_SWITCH, ERROR_STATE: where they are in the flags, as candump has them
)
_HALF_NS: Final = 5e-10
_BLF_SINCE_NS: Final = 631_152_000 * NS_PER_S  # 1990: python-can writes no earlier date


def refuse_log(path: Path, force: bool) -> None:
    """Refuse a log that is there, or whose format is not written.

    Raises:
        LogError: the reason.
    """
    kind = format_of(path)
    if path.suffix.lower() == ".gz" and kind != ".log":
        raise LogError(f"{path}: of compressed logs only .log.gz is written")
    refuse_existing(path, force, "--log")


def write_log(log: Log, path: Path) -> None:
    """Write the frames of ``log`` to ``path``, in the format of its suffix.

    ``path`` is there, whole, when this returns, and not before.

    Raises:
        LogError: the format is not known or cannot hold a frame; a file cannot be read, or written.
    """
    refuse_log(path, force=True)
    kind = format_of(path)
    with atomic(path) as part:
        if kind == ".mf4":
            from can_rig.logs.mf4_writing import write_mf4  # noqa: PLC0415 (asammdf is slow to import)

            write_mf4(log, part)
        else:
            writers: dict[str, Callable[[Log, Path], None]] = {
                ".log": _write_candump,
                ".asc": _write_asc,
                ".blf": _write_blf,
                ".trc": _write_trc,
            }
            writers[kind](log, part)


def _write_candump(log: Log, path: Path) -> None:
    compressed = path.suffix.lower() == ".gz"
    with gzip.GzipFile(path, "wb", mtime=0) if compressed else path.open("wb") as file:
        for frames in log:
            file.write("".join(candump_lines(frames)).encode("ascii"))


def candump_lines(frames: Frames) -> Iterator[str]:
    """The line of each frame as ``candump -L`` writes it, with R or T behind."""
    columns = (frames.time_ns, frames.arbitration_id, frames.flags, frames.channel, frames.length)
    text = frames.data.tobytes().hex().upper()
    width = 2 * frames.data.shape[1]
    rows = zip(*(column.tolist() for column in columns), strict=True)
    for row, (time_ns, identifier, flags, channel, length) in enumerate(rows):
        time_us = (time_ns + 500) // 1000
        if flags & ERROR:
            head = f"{identifier | _ERROR_BIT:08X}#"
        else:
            head = f"{identifier:08X}#" if flags & EXTENDED else f"{identifier:03X}#"
        payload = text[row * width : row * width + 2 * length]
        if flags & REMOTE:
            payload = f"R{length:X}" if length else "R"
        elif flags & FD:
            payload = f"#{flags >> _FD_FLAGS & 3:X}{payload}"
        yield (
            f"({time_us // 1_000_000:010d}.{time_us % 1_000_000:06d}) {frames.channels[channel]} "
            f"{head}{payload} {'T' if flags & SENT else 'R'}\n"
        )


def _write_asc(log: Log, path: Path) -> None:
    with ASCWriter(path) as writer:
        for message in _messages(log):
            writer.on_message_received(message)


def _write_trc(log: Log, path: Path) -> None:
    final = path.with_name(path.name.removeprefix(".part-"))
    with TRCWriter(path) as writer:
        writer.filepath = str(final.absolute())  # its header says what the file is called
        for frames in log:
            other = frames.has(FD | REMOTE | ERROR)
            if other.any():
                raise LogError(
                    f"{final.name}: python-can writes only classic data "
                    f"frames as PEAK logs, and {int(other.sum())} of {log.path} are others; "
                    ".log, .blf or .mf4 is right"
                )
            for message in frames.messages():
                writer.on_message_received(message)


def _write_blf(log: Log, path: Path) -> None:
    with BLFWriter(path) as writer:
        chunks = iter(log)
        first = next(chunks, None)
        if first is None:
            return
        # The header tells the start to the millisecond. Counted from there time stamps stay exact;
        # half a nanosecond more, as the writer cuts off the rest.
        start_ns = int(first.time_ns[0]) // 1_000_000 * 1_000_000
        if start_ns < _BLF_SINCE_NS:
            start_ns = 0  # the time of a simulation, not a date
        writer.start_timestamp = 0.0
        last_s = 0.0
        for frames in chain([first], chunks):
            for message, time_ns in zip(frames.messages(), frames.time_ns.tolist(), strict=True):
                last_s = (time_ns - start_ns) / NS_PER_S
                message.timestamp = last_s + _HALF_NS
                writer.on_message_received(message)
        writer.start_timestamp = start_ns / NS_PER_S
        writer.stop_timestamp = writer.start_timestamp + last_s


def _messages(log: Iterable[Frames]) -> Iterator[Message]:
    for frames in log:
        yield from frames.messages()
