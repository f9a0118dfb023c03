"""Logs of Microchip's CAN BUS Analyzer, and those that SavvyCAN writes like them.

    166064;RX;0x0000027A;7;0x30;0x30;0x0D;0x8C;0x09;0x15;0x00;     time in ms

An identifier of more than 11 bits is extended; there is neither a bus nor a mark of remote frames.

Source: SavvyCAN, `framefileio.cpp` (loadMicrochipFile, saveMicrochipFile).
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Final

from can_rig.logs.frames import Frames
from can_rig.logs.log import Log
from can_rig.logs.readers.text.formats.trc import TraceReader

_BLANKS: Final = bytes.maketrans(b";", b" ")
_WHOLE: Final = re.compile(rb";(0[xX][0-9A-Fa-f]{2})?\s*\Z")


def read_microchip(log: Log) -> Iterator[Frames]:
    """Chunks of a Microchip log, whose time stamps are on a clock of its own.

    Raises:
        LogError: one of its lines is not a frame.
    """
    yield from _Reader(log).started()


class _Reader(TraceReader):
    first_frame = re.compile(rb"[ \t]*\d")
    has_own_clock = True

    def begin(self) -> None:
        """The same columns in every file."""
        self.use("OTilD")

    def ended(self, line: bytes, frame: Frames) -> bool:
        """A byte with both its digits, or what follows one."""
        return bool(_WHOLE.search(line))

    def _whole_lines(self, text: bytes) -> Iterator[Frames]:
        """As a trace has them: parted by blanks, hexadecimal without a mark."""
        plain = text.translate(_BLANKS).replace(b"0x", b"").replace(b"0X", b"")
        yield from super()._whole_lines(plain)
