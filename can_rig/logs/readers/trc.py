"""PEAK trace files, through python-can's reader."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Final

from can.io import TRCReader

from can_rig.errors import LogError
from can_rig.logs.frames import Frames, from_messages
from can_rig.logs.log import Log
from can_rig.logs.readers.text_lines import TextLines

_FRAME: Final = re.compile(
    r"\d+\)\s+[\d.]+\s+(\d+\s+)?[RT]x\s"  # versions 1.1 and 1.3
    r"|\d+\)\s+\d+\s+(?!FFFFFFFF)\S{4,8}\s+\d"  # 1.0, whose FFFFFFFF is the state of the bus
    r"|\d+\s+[\d.]+\s+(DT|F[DBE]|BI|RR)\s"  # 2.0 and 2.1
)


def read_trc(log: Log) -> Iterator[Frames]:
    """Chunks of a PEAK trace; its time stamps are whole microseconds.

    Raises:
        LogError: it is not such a trace, or one of its lines is not a frame.
    """
    lines = TextLines(log, _FRAME)
    reader = TRCReader(lines.file)
    begun = False
    start_s = 0.0
    for messages in lines.messages(reader):
        if not begun and reader.start_time is not None:
            start_s = reader.start_time.timestamp()
            log.start_ns = round(start_s * 1e6) * 1000
        begun = True
        for message in messages:  # python-can has added the start, which blurs float seconds
            message.timestamp = round((message.timestamp - start_s) * 1e6) * 1e-6
        yield from_messages(messages, log.start_ns)
    if not begun and not any(line.startswith(";") for line in lines.header):
        raise LogError(f"{log.path}: not a PEAK trace: it has neither a header nor a frame")
