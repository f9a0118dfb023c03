"""SavvyCAN's own CSV logs (GVRET), plain or gzipped."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Final

from can_rig.errors import LogError
from can_rig.logs.frames import Frames, UInt8s
from can_rig.logs.log import Log
from can_rig.logs.readers.numbering import numbered
from can_rig.logs.readers.text.formats.gvret_lines import parse
from can_rig.logs.readers.text.lines import LineReader, shown

_COLUMNS: Final = re.compile(r"\W*time stamp,id,extended,(dir,)?bus,len(,d\d+)*,?", re.I)
_WHOLE: Final = re.compile(rb",([0-9A-Fa-f]{2})?\s*\Z")


def read_gvret(log: Log) -> Iterator[Frames]:
    """Chunks of a SavvyCAN log, without a date: time stamps come from the recorder's clock.

    Raises:
        LogError: not a SavvyCAN log, or a line is not a frame.
    """
    begun = False
    for frames in _Reader(log).read():
        if not begun:
            log.start_ns = int(frames.time_ns[0])
            begun = True
        yield numbered(frames)


class _Reader(LineReader):
    first_frame = re.compile(rb"\s*\d")

    def __init__(self, log: Log) -> None:
        super().__init__(log, self._parsed)
        self._has_direction = False

    def begin(self) -> None:
        """The columns.

        Raises:
            LogError: the columns are not SavvyCAN's.
        """
        found = _COLUMNS.fullmatch(self.header[-1].replace(" ,", ",")) if self.header else None
        if found is None:
            first = shown(self.header[-1].encode()) if self.header else "nothing"
            raise LogError(
                f"{self.log.path}: not a CAN log: above its first frame is {first}, which must be "
                "SavvyCAN's Time Stamp,ID,Extended,Dir,Bus,LEN,D1,… (Dir may be missing)"
            )
        self._has_direction = found[1] is not None

    def ended(self, line: bytes, frame: Frames) -> bool:
        """A comma after the last cell, or a byte with both its digits."""
        return bool(_WHOLE.search(line))

    def _parsed(self, text: UInt8s, at: int, room: Frames) -> tuple[int, int, int, int]:
        return parse(
            text,
            at,
            self._has_direction,
            room.time_ns,
            room.arbitration_id,
            room.flags,
            room.channel,
            room.length,
            room.data,
        )
