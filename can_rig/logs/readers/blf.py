"""Vector binary logs, through python-can's reader."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from itertools import islice

from can import Message
from can.io import BLFReader

from can_rig.errors import LogError
from can_rig.logs.frames import Frames, from_messages
from can_rig.logs.log import Log
from can_rig.logs.readers.python_can import PIECE_MESSAGES, one_line_errors


def read_blf(log: Log) -> Iterator[Frames]:
    """Chunks of a Vector binary log.

    Raises:
        LogError: it is not such a log, or is damaged.
    """
    size = log.path.stat().st_size
    if not size:
        raise LogError(f"{log.path}: is empty, and so not a Vector binary log")
    with one_line_errors(lambda: f"{log.path}: byte 0"):
        reader = BLFReader(log.path)
    log.start_ns = round(reader.start_timestamp * 1e3) * 1_000_000
    reader.start_timestamp = 0.0  # so that time stamps stay exact: nanoseconds since the start
    frames = 0

    def offset() -> int:
        return size if reader.file.closed else reader.file.tell()

    with reader:
        messages = iter(reader)
        try:
            while piece := _piece(messages, lambda: f"{log.path}: byte {offset()}"):
                frames += len(piece)
                log.fraction = offset() / size
                yield from_messages(piece, log.start_ns)
        except _CutOffError:
            pass
    if size < reader.file_size:
        log.notice = (
            f"{log.path}: is cut off after {size} of {reader.file_size} bytes; "
            "its last frames are missing"
        )
    elif not reader.object_count and frames:
        log.notice = f"{log.path}: was never closed by its recorder; its last frames are missing"


class _CutOffError(Exception):
    """The file ends within an object."""


def _piece(messages: Iterator[Message], place: Callable[[], str]) -> list[Message]:
    """The next messages; also those just before the point where the file is cut off."""
    found: list[Message] = []
    with one_line_errors(place):
        try:
            for message in islice(messages, PIECE_MESSAGES):
                found.append(message)
        except struct.error:
            if not found:
                raise _CutOffError from None
    return found
