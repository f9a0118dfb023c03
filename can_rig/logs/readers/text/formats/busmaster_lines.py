"""The lines of BUSMASTER logs → columns, compiled: one pass over the bytes.

    ***START DATE AND TIME 20:11:2013 14:19:9:538***       headings; the last number is in ms
    14:19:11:4184 Tx 1 0x099 s 8 00 00 00 00 00 00 00 00   hours, minutes, seconds, decimals of one
    14:19:11:4192 Rx 2 0x18FEF100 x 8 00 00 …              x: an extended identifier
    14:19:11:4200 Rx 2 0x100 sr 8                          sr, xr: remote
    14:08:20:4009 Tx 1 0021 s 2 000 255                    after ***DEC***

Source: BUSMASTER, `FormatMsgCAN.cpp`, `FormatMsgCommon.cpp`, `LogObjectCAN.cpp`.
"""

from __future__ import annotations

from typing import Any

from can_rig.logs.frames import CLASSIC_BYTES, EXTENDED, FD, FD_BYTES, REMOTE, SENT, UInt8s
from can_rig.logs.readers.text.scanning import (
    BAD_LINE,
    DECIMAL,
    DIGIT,
    DONE,
    HEADING,
    HEXADECIMAL,
    LOWER,
    WIDER,
    blanks,
    next_line,
    next_word,
    number,
    payload,
    word_end,
)
from firmware_model.compiled import compiled

_NS_DIGITS = 9
_MINUTES_S, _HOURS_S = 60, 3600
_MOST_HOURS = 1 << 20
_EXTENDED_ID, _STANDARD_ID = (1 << 29) - 1, (1 << 11) - 1
_STAR, _COLON, _ZERO = ord("*"), ord(":"), ord("0")
_R, _S, _T, _X = ord("r"), ord("s"), ord("t"), ord("x")


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

    ``base`` applies to bytes and to identifiers without ``0x``; ``channel`` gets numbers of buses.
    Returns the number of frames, of lines, where the next line begins, and why it stopped there.
    """
    frames = lines = 0
    while frames < len(time_ns) and at < len(text):
        begin = blanks(text, at)
        if text[begin] == _STAR:
            return frames, lines, at, HEADING
        if DIGIT[text[begin]] < DECIMAL:
            stamp, begin = _time(text, begin)
            bits, bus, identifier, size, begin = _head(text, begin, base)
            if begin < 0:
                return frames, lines, at, BAD_LINE
            if size > data.shape[1]:
                return frames, lines, at, WIDER
            row = data[frames]
            if bits & REMOTE:
                row[:] = 0
            elif payload(text, begin, base, size, row) < 0:
                return frames, lines, at, BAD_LINE
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
def _time(text: UInt8s, at: int) -> tuple[int, int]:
    """``hours:minutes:seconds:decimals`` in ns, and the position after it; -1: no time."""
    hours, at = number(text, at, DECIMAL, _MOST_HOURS)
    if at < 0 or text[at] != _COLON:
        return 0, -1
    minutes, at = number(text, at + 1, DECIMAL, 59)
    if at < 0 or text[at] != _COLON:
        return 0, -1
    seconds, at = number(text, at + 1, DECIMAL, 59)
    if at < 0 or text[at] != _COLON:
        return 0, -1
    value = hours * _HOURS_S + minutes * _MINUTES_S + seconds
    at += 1
    first = at
    for _ in range(_NS_DIGITS):
        value *= DECIMAL
        if DIGIT[text[at]] < DECIMAL:
            value += int(DIGIT[text[at]])
            at += 1
    return value, at if at > first else -1


@compiled
def _head(text: UInt8s, at: int, base: int) -> tuple[int, int, int, int, int]:
    """The fields before the data: flags, bus, identifier, length, and the end; -1: no frame."""
    at = next_word(text, at)
    if at < 0 or word_end(text, at) != at + 2 or text[at + 1] | LOWER != _X:
        return 0, 0, 0, 0, -1
    if text[at] | LOWER not in (_R, _T):
        return 0, 0, 0, 0, -1
    bits = SENT * (text[at] | LOWER == _T)
    bus, at = number(text, next_word(text, at + 2), DECIMAL, 255)
    at = next_word(text, at)
    if at >= 0 and text[at] == _ZERO and text[at + 1] | LOWER == _X:
        at += 2
        base = HEXADECIMAL
    identifier, at = number(text, at, base, _EXTENDED_ID)
    at = next_word(text, at)
    if at < 0:
        return 0, 0, 0, 0, -1
    end = word_end(text, at)
    if text[at] | LOWER == _X:
        bits |= EXTENDED
    elif text[at] | LOWER != _S or identifier > _STANDARD_ID:
        return 0, 0, 0, 0, -1
    if end == at + 2 and text[at + 1] | LOWER == _R:
        bits |= REMOTE
    elif end != at + 1:
        return 0, 0, 0, 0, -1
    size, at = number(text, next_word(text, end), DECIMAL, FD_BYTES)
    if bits & REMOTE:
        size = min(size, CLASSIC_BYTES)
    return bits | FD * (size > CLASSIC_BYTES), bus, identifier, size, at
