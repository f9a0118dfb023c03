"""The lines of SavvyCAN's CSV logs → columns, compiled: one pass over the bytes.

    Time Stamp,ID,Extended,Dir,Bus,LEN,D1,D2,D3,D4,D5,D6,D7,D8
    39747828,000005EB,false,Rx,0,8,E8,45,85,4B,4A,28,36,69,       time in µs
    166064000,0000027A,false,0,3,30,30,0D,00,00,00,00,00,         without Dir, as of old

An identifier above 7FF is extended whatever the line says, as in SavvyCAN: some recorders write a
wrong mark. Neither CAN FD nor remote frames have a mark; more than 8 bytes mean CAN FD.

Source: SavvyCAN, `framefileio.cpp` (loadNativeCSVFile, saveNativeCSVFile).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from can_rig.logs.frames import CLASSIC_BYTES, EXTENDED, FD, FD_BYTES, SENT, UInt8s
from can_rig.logs.readers.text.scanning import (
    BAD_LINE,
    DECIMAL,
    DONE,
    HEXADECIMAL,
    LOWER,
    NEWLINE,
    WIDER,
    blanks,
    fixed_point,
    next_line,
    number,
    same_word,
)
from firmware_model.compiled import compiled

_NS_DIGITS_OF_US = 3
_EXTENDED_ID, _STANDARD_ID = (1 << 29) - 1, (1 << 11) - 1
_COMMA, _R, _T = ord(","), ord("r"), ord("t")
_TRUE, _FALSE = np.frombuffer(b"true", np.uint8), np.frombuffer(b"false", np.uint8)


@compiled
def parse(
    text: UInt8s,
    at: int,
    has_direction: bool,
    time_ns: Any,
    arbitration_id: Any,
    flags: UInt8s,
    channel: UInt8s,
    length: UInt8s,
    data: UInt8s,
) -> tuple[int, int, int, int]:
    """Fill the columns from the lines that begin at ``at``; a line ends with a newline.

    ``channel`` gets numbers of buses. Returns the number of frames, of lines, where the next line
    begins, and why it stopped there.
    """
    frames = lines = 0
    while frames < len(time_ns) and at < len(text):
        begin = blanks(text, at)
        if text[begin] != NEWLINE:
            stamp, identifier, bits, bus, size, end = _head(text, begin, has_direction)
            if end < 0:
                return frames, lines, at, BAD_LINE
            if size > data.shape[1]:
                return frames, lines, at, WIDER
            row = data[frames]
            for byte in range(size):
                value, end = number(text, _next_cell(text, end), HEXADECIMAL, 255)
                if end < 0:
                    return frames, lines, at, BAD_LINE
                row[byte] = value
            if _next_cell(text, end) < 0 and text[blanks(text, end)] != NEWLINE:
                return frames, lines, at, BAD_LINE
            row[size:] = 0
            time_ns[frames] = stamp
            arbitration_id[frames] = identifier
            flags[frames] = bits
            channel[frames] = bus
            length[frames] = size
            frames += 1
        at = next_line(text, at)
        lines += 1
    return frames, lines, at, DONE


@compiled
def _head(text: UInt8s, at: int, has_direction: bool) -> tuple[int, int, int, int, int, int]:
    """The fields before the data: time in ns, identifier, flags, bus, length, and where it ends.

    An end of -1: not a frame.
    """
    stamp, at = fixed_point(text, at, _NS_DIGITS_OF_US)
    identifier, at = number(text, _next_cell(text, at), HEXADECIMAL, _EXTENDED_ID)
    at = _next_cell(text, at)
    if at < 0 or stamp < 0:
        return 0, 0, 0, 0, 0, -1
    bits = EXTENDED * (identifier > _STANDARD_ID)
    if same_word(text, at, _TRUE):
        bits = EXTENDED
        at += len(_TRUE)
    elif same_word(text, at, _FALSE):
        at += len(_FALSE)
    else:
        return 0, 0, 0, 0, 0, -1
    if has_direction:
        at = _next_cell(text, at)
        if at < 0 or text[at] | LOWER not in (_R, _T):
            return 0, 0, 0, 0, 0, -1
        bits |= SENT * (text[at] | LOWER == _T)
        at += 1 + (text[at + 1] != _COMMA)  # Rx or R
    bus, at = number(text, _next_cell(text, at), DECIMAL, 255)
    size, at = number(text, _next_cell(text, at), DECIMAL, FD_BYTES)
    return stamp, identifier, bits | FD * (size > CLASSIC_BYTES), bus, size, at


@compiled
def _next_cell(text: UInt8s, at: int) -> int:
    """Where the cell after the comma at ``at`` begins, blanks aside; -1: no comma."""
    if at < 0:
        return -1
    at = blanks(text, at)
    return blanks(text, at + 1) if text[at] == _COMMA else -1
