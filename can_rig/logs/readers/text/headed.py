"""Text logs with a header: a start that is added to every time stamp, and buses by number."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from typing import Final

from can_rig.errors import LogError
from can_rig.logs.frames import REMOTE, Frames
from can_rig.logs.readers.numbering import numbered
from can_rig.logs.readers.text.lines import LineReader

LAST_NS: Final = (1 << 63) - 1
"""In the year 2262."""
_WHOLE: Final = re.compile(rb"(\s|\s[0-9A-Fa-f]{2})\Z")


class HeadedReader(LineReader):
    """Common base for the logs of Vector and PEAK."""

    first_bus = 0
    """The number of the first bus in the columns."""
    has_own_clock = False
    """Whether the date is missing: then the log starts with its first frame."""

    def ended(self, line: bytes, frame: Frames) -> bool:
        """Whether all announced bytes are present, the last byte with both digits."""
        data = frame.length[-1] > 0 and not frame.flags[-1] & REMOTE
        return bool(_WHOLE.search(line)) and bool(data or line[-1:].isspace())

    def started(self) -> Iterator[Frames]:
        """The chunks, on the clock of the log, with the buses that occur.

        Raises:
            LogError: a line is no frame; a time stamp is later than int64 nanoseconds reach.
        """
        start_ns: int | None = None
        for frames in self.read():
            last_ns = int(frames.time_ns.max())
            if start_ns is None:
                start_ns = self.log.start_ns
                if self.has_own_clock:
                    self.log.start_ns = int(frames.time_ns[0])
            if last_ns > LAST_NS - start_ns:
                raise LogError(
                    f"{self.log.path}: a time stamp of {last_ns / 1e9:.3g} s after the start; "
                    "it must be before the year 2262"
                )
            on_clock = replace(frames, time_ns=frames.time_ns + start_ns)
            yield numbered(on_clock, self.first_bus)
