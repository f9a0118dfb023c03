"""Vector ASCII logs, through python-can's reader."""

from __future__ import annotations

import io
import re
from collections.abc import Iterator, Sequence
from typing import Final

from can.io import ASCReader

from can_rig.errors import LogError
from can_rig.logs.frames import Frames, from_messages
from can_rig.logs.log import Log
from can_rig.logs.readers.text_lines import TextLines

_HEADER: Final = re.compile(r"date\s|base\s|//|begin\s+triggerblock|(no\s+)?internal\s", re.I)
_FRAME: Final = re.compile(r"\d+\.\d+\s+(\d+\s+\S+\s+(Tx|Rx)\b|\d+\s+ErrorFrame|CANFD\s)", re.I)
_BEGIN: Final = re.compile(r"begin\s+triggerblock", re.I)
_END: Final = re.compile(r"end\s+triggerblock", re.I)


def read_asc(log: Log) -> Iterator[Frames]:
    """Chunks of a Vector ASCII log; its date is in the time zone of this machine.

    The file marks its own end, so that one that is cut off is noticed.

    Raises:
        LogError: it is not such a log, or one of its lines is not a frame.
    """
    # python-can's reader takes the line after the header for a part of it: it gets an empty one.
    lines = TextLines(log, _FRAME, after_header="\n", last_line=_END)
    reader = ASCReader(lines.file)
    begun = False
    for messages in lines.messages(reader):
        if not begun:
            log.start_ns = _start_ns(lines.header)
            begun = True
            if reader.timestamps_format == "relative":
                raise LogError(
                    f"{log.path}: each time stamp is relative to the one before it ('timestamps "
                    "relative'); it must be exported with 'timestamps absolute'"
                )
        yield from_messages(messages, log.start_ns)
    if not begun and not any(_HEADER.match(line) for line in lines.header):
        raise LogError(f"{log.path}: not a Vector ASCII log: it has neither a header nor a frame")
    if any(_BEGIN.match(line) for line in lines.header) and not _END.match(lines.last):
        lines.note("has no 'End TriggerBlock': its last frames are missing")


def _start_ns(header: Sequence[str]) -> int:
    """Start of the recording [ns]; 0 if the header has no date that python-can understands."""
    dated = ASCReader(io.StringIO("\n".join([*header, ""])), relative_timestamp=False)
    try:
        list(dated)
    except ValueError:
        return 0
    return round(dated.start_time * 1e6) * 1000
