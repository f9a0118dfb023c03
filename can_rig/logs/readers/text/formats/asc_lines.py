"""The lines of Vector ASCII logs → columns, compiled: one pass over the bytes.

    1.000000 1  123             Rx   d 2 0A 0B  Length = 0 BitCount = 64 ID = 291
    1.400291 1  12345678x       Tx   r 4                      remote; x: an extended identifier
    1.500000 1  ErrorFrame
    2.000000 CANFD   1 Rx  5A1  Name  1 0 2 2 11 22  130000 130 3000 0 0 0 0 0
                               BRS ESI DLC length bytes, duration, bits, flags, …

The symbolic name is optional. Of the flags bit 4 marks a remote frame, and bit 12 is set in frames
of CAN FD only; without bit 12, a CAN FD controller received a classic frame. Anything else
(statistics, chip status, J1939 transport) is passed over.

Source: Vector, "CAN ASCII Logging Files Format Specification".
"""

from __future__ import annotations

from typing import Any

import numpy as np

from can_rig.logs.frames import (
    BITRATE_SWITCH,
    CLASSIC_BYTES,
    ERROR,
    ERROR_STATE,
    EXTENDED,
    FD,
    FD_BYTES,
    REMOTE,
    SENT,
    UInt8s,
)
from can_rig.logs.readers.text.scanning import (
    BAD_LINE,
    BYTES_OF_DLC,
    DECIMAL,
    DIGIT,
    DONE,
    HEXADECIMAL,
    LOWER,
    SPACE,
    WIDER,
    blanks,
    fixed_point,
    next_line,
    next_word,
    number,
    payload,
    same_word,
    word_end,
)
from firmware_model.compiled import compiled

_NS_DIGITS = 9
_EXTENDED_ID, _STANDARD_ID = (1 << 29) - 1, (1 << 11) - 1
_DATA, _REMOTE, _X = 100, 114, 120
_CANFD = np.frombuffer(b"canfd", np.uint8)
_ERROR_FRAME = np.frombuffer(b"errorframe", np.uint8)
_TX, _RX = np.frombuffer(b"tx", np.uint8), np.frombuffer(b"rx", np.uint8)
_EDL_FLAG, _REMOTE_FLAG = 1 << 12, 1 << 4
_MOST = (1 << 32) - 1

_FRAME, _OTHER, _BAD, _WIDE = 0, 1, 2, 3  # kinds of lines


@compiled
def parse(
    text: UInt8s,
    at: int,
    base: int,
    time_ns: Any,
    arbitration_id: Any,
    flags: UInt8s,
    channel: UInt8s,
    length: UInt8s,
    data: UInt8s,
) -> tuple[int, int, int, int]:
    """Fill the columns from the lines that begin at ``at``; a line ends with a newline.

    ``base`` applies to identifiers, DLCs and bytes; ``channel`` gets numbers of buses, from 0.
    Returns the number of frames, of lines, where the next line begins, and why it stopped there.
    """
    frames = lines = 0
    while frames < len(time_ns) and at < len(text):
        what, stamp, bus, identifier, bits, size = _line(text, at, base, data[frames])
        if what in (_BAD, _WIDE):
            return frames, lines, at, BAD_LINE if what == _BAD else WIDER
        if what == _FRAME:
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
def _line(text: UInt8s, at: int, base: int, row: UInt8s) -> tuple[int, int, int, int, int, int]:
    """The kind of a line, and for a frame: time in ns, bus, identifier, flags, length."""
    at = blanks(text, at)
    stamp, at = fixed_point(text, at, _NS_DIGITS)
    at = next_word(text, at)
    if at < 0:
        return _OTHER, 0, 0, 0, 0, 0
    if same_word(text, at, _CANFD):
        return _fd_frame(text, at + len(_CANFD), base, stamp, row)
    end = word_end(text, at)
    bus, after = number(text, at, DECIMAL, 256)
    name = next_word(text, end)
    if name < 0 or DIGIT[text[at]] >= DECIMAL or (after >= 0 and after != end):
        return _OTHER, 0, 0, 0, 0, 0
    fits = stamp >= 0 and after == end and bus > 0
    if same_word(text, name, _ERROR_FRAME):
        row[:] = 0
        return _FRAME if fits else _BAD, stamp, bus - 1, 0, ERROR, 0
    at = next_word(text, word_end(text, name))
    direction = _direction(text, at)
    if direction < 0:
        return _OTHER, 0, 0, 0, 0, 0
    identifier, bits, end = _identifier(text, name, base)
    at = next_word(text, at + 2)
    if not fits or end < 0 or at < 0:
        return _BAD, 0, 0, 0, 0, 0
    bits |= direction
    kind = text[at] | LOWER
    at = next_word(text, word_end(text, at))
    if kind == _REMOTE:
        row[:] = 0
        size, at = number(text, at, base, _MOST) if at >= 0 and DIGIT[text[at]] < base else (0, at)
        return _FRAME, stamp, bus - 1, identifier, bits | REMOTE, min(size, CLASSIC_BYTES)
    size, at = number(text, at, base, len(BYTES_OF_DLC) - 1)
    size = min(size, CLASSIC_BYTES)
    if kind != _DATA or at < 0 or payload(text, at, base, size, row) < 0:
        return _BAD, 0, 0, 0, 0, 0
    return _FRAME, stamp, bus - 1, identifier, bits, size


@compiled
def _fd_frame(
    text: UInt8s, at: int, base: int, stamp: int, row: UInt8s
) -> tuple[int, int, int, int, int, int]:
    """The words after CANFD."""
    bus, at = number(text, next_word(text, at), DECIMAL, 256)
    at = next_word(text, at)
    direction = _direction(text, at)
    at = next_word(text, at + 2) if direction >= 0 else -1
    if at < 0 or bus < 1 or stamp < 0:
        return _BAD, 0, 0, 0, 0, 0
    if same_word(text, at, _ERROR_FRAME):
        row[:] = 0
        return _FRAME, stamp, bus - 1, 0, ERROR | FD | direction, 0
    identifier, bits, end = _identifier(text, at, base)
    at = next_word(text, end)
    if at >= 0 and number(text, at, DECIMAL, _MOST)[1] != word_end(text, at):
        at = next_word(text, word_end(text, at))  # past the symbolic name
    switch, at = number(text, at, DECIMAL, 1)
    state, at = number(text, next_word(text, at), DECIMAL, 1)
    dlc, at = number(text, next_word(text, at), base, len(BYTES_OF_DLC) - 1)
    size, at = number(text, next_word(text, at), DECIMAL, FD_BYTES)
    if end < 0 or at < 0:
        return _BAD, 0, 0, 0, 0, 0
    if size > len(row):
        return _WIDE, 0, 0, 0, 0, 0
    at = payload(text, at, base, size, row)
    if at < 0:
        return _BAD, 0, 0, 0, 0, 0
    marks = _flags(text, at)
    bits |= direction
    if (marks >= 0 and marks & _REMOTE_FLAG) or (size == 0 and dlc > 0):
        row[:] = 0
        asked = min(int(BYTES_OF_DLC[dlc]), CLASSIC_BYTES)
        return _FRAME, stamp, bus - 1, identifier, bits | REMOTE, asked
    if marks <= 0 or marks & _EDL_FLAG or size > CLASSIC_BYTES or switch or state:
        bits |= FD | BITRATE_SWITCH * switch | ERROR_STATE * state
    return _FRAME, stamp, bus - 1, identifier, bits, size


@compiled
def _flags(text: UInt8s, at: int) -> int:
    """The third number after the payload, hexadecimal; -1: missing."""
    for _ in range(2):
        at = next_word(text, at)
        if at < 0:
            return -1
        at = word_end(text, at)
    found, end = number(text, next_word(text, at), HEXADECIMAL, _MOST)
    return found if end >= 0 and text[end] <= SPACE else -1


@compiled
def _direction(text: UInt8s, at: int) -> int:
    """SENT or 0 for the word Tx or Rx; -1: neither word."""
    if at < 0 or word_end(text, at) != at + 2:
        return -1
    if same_word(text, at, _TX):
        return SENT
    return 0 if same_word(text, at, _RX) else -1


@compiled
def _identifier(text: UInt8s, at: int, base: int) -> tuple[int, int, int]:
    """``123`` or ``12345678x``: identifier, flags, and the position after it; -1: no identifier."""
    value, end = number(text, at, base, _EXTENDED_ID)
    if end < 0:
        return 0, 0, -1
    bits = 0
    if text[end] | LOWER == _X:
        bits = EXTENDED
        end += 1
    elif value > _STANDARD_ID:
        return 0, 0, -1
    return value, bits, end if end == word_end(text, end) else -1
