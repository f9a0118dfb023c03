"""The lines of ``candump -L`` → columns, compiled: one pass over the bytes.

    (1436509052.249713) vcan2 123#1122334455667788 R    a frame, received; T: sent; or neither
    (1436509052.249714) vcan2 12345678#                 eight digits: an extended identifier
    (1436509052.249715) vcan2 123##1112233              FD, then its flags: 1 BRS, 2 ESI
    (1436509052.249716) vcan2 123#R8                    a remote frame that asks for 8 bytes
    (1436509052.249717) vcan2 20000080#0000000000000000 bit 29: an error frame, its classes
    (1436509052.249718) vcan2 123#1122334455667788_9    a raw DLC above 8; the payload stays 8 bytes

Source: can-utils, `lib.h` (parse_canframe, sprint_canframe) and `candump.c`.
"""

from __future__ import annotations

from typing import Any

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
    DIGIT,
    DONE,
    LOWER,
    NEW_CHANNEL,
    NEWLINE,
    NOT_A_DIGIT,
    WIDER,
    blanks,
    fixed_point,
    is_blank,
    next_word,
    word_end,
)
from firmware_model.compiled import compiled

_ERROR_BIT, _REMOTE_BIT, _ID_MASK = 1 << 29, 1 << 30, (1 << 29) - 1
_NS_DIGITS = 9
_HASH, _UNDERSCORE, _OPEN, _CLOSE = 35, 95, 40, 41
_R, _T = 114, 116


@compiled
def parse(
    text: UInt8s,
    at: int,
    names: UInt8s,
    name_ends: Any,
    time_ns: Any,
    arbitration_id: Any,
    flags: UInt8s,
    channel: UInt8s,
    length: UInt8s,
    data: UInt8s,
) -> tuple[int, int, int, int]:
    """Fill the columns from the lines that begin at ``at``; a line ends with a newline.

    ``names`` holds the known channels in a row, ``name_ends`` where each of them ends. Returns the
    number of frames, the number of lines, where the next line begins, and why it stopped there.
    """
    frames = lines = 0
    room, width = data.shape
    end = len(text)
    while frames < room and at < end:
        line = at
        at = blanks(text, at)
        if text[at] == NEWLINE:
            at += 1
            lines += 1
            continue
        stamp, at = _stamp(text, at)
        name, at = _word(text, at)
        if at < 0:
            return frames, lines, line, BAD_LINE
        known = _find(text, name, at, names, name_ends)
        bits, identifier, at = _identifier(text, blanks(text, at))
        if at < 0:
            return frames, lines, line, BAD_LINE
        bits, size, at = _payload(text, at, bits, data[frames])
        if at < 0:
            return frames, lines, line, WIDER if size > width else BAD_LINE
        if is_blank(text[at]):
            at = blanks(text, at)
            if text[at] | LOWER == _T:
                bits |= SENT
                at = blanks(text, at + 1)
            elif text[at] | LOWER == _R:
                at = blanks(text, at + 1)
        if text[at] != NEWLINE:
            return frames, lines, line, BAD_LINE
        if known < 0:
            return frames, lines, line, NEW_CHANNEL
        at += 1
        time_ns[frames] = stamp
        arbitration_id[frames] = identifier
        flags[frames] = bits
        channel[frames] = known
        length[frames] = size
        frames += 1
        lines += 1
    return frames, lines, at, DONE


@compiled
def _stamp(text: UInt8s, at: int) -> tuple[int, int]:
    """``(seconds.fraction)`` in ns, finer digits cut off, and position after it; -1: none."""
    if text[at] != _OPEN:
        return 0, -1
    value, at = fixed_point(text, at + 1, _NS_DIGITS)
    if at < 0 or value < 0 or text[at] != _CLOSE:
        return 0, -1
    return value, at + 1


@compiled
def _word(text: UInt8s, at: int) -> tuple[int, int]:
    """Begin and end of the word after some blanks; an end of -1: no blanks or no word."""
    start = next_word(text, at)
    if start < 0:
        return 0, -1
    end = word_end(text, start)
    return start, end if is_blank(text[end]) else -1


@compiled
def _find(text: UInt8s, start: int, stop: int, names: UInt8s, name_ends: Any) -> int:
    """Index of ``text[start:stop]`` among the names; -1: no match."""
    begin = 0
    for index in range(len(name_ends)):
        end = name_ends[index]
        if end - begin == stop - start:
            same = True
            for offset in range(stop - start):
                same &= text[start + offset] == names[begin + offset]
            if same:
                return index
        begin = end
    return -1


@compiled
def _identifier(text: UInt8s, at: int) -> tuple[int, int, int]:
    """``123#`` or ``12345678#``: flags, identifier, position after it; -1: no identifier."""
    first = at
    value = 0
    while DIGIT[text[at]] != NOT_A_DIGIT and at - first < 9:
        value = value << 4 | int(DIGIT[text[at]])
        at += 1
    digits = at - first
    if text[at] != _HASH or not 0 < digits <= 8 or (digits <= 3 and value > 0x7FF):
        return 0, 0, -1
    bits = 0
    if value & _ERROR_BIT:
        bits = ERROR
    elif digits > 3:
        bits = EXTENDED
    if value & _REMOTE_BIT:
        bits |= REMOTE
    return bits, value & _ID_MASK, at + 1


@compiled
def _payload(text: UInt8s, at: int, bits: int, row: UInt8s) -> tuple[int, int, int]:
    """The text behind the first ``#``, into ``row``: flags, length, and the position after it.

    The position is -1 where it is not a payload, or where ``row`` is shorter than the length.
    """
    max_bytes = CLASSIC_BYTES
    if text[at] == _HASH:
        kind = DIGIT[text[at + 1]]
        if kind == NOT_A_DIGIT:
            return 0, 0, -1
        max_bytes = FD_BYTES
        bits |= FD | BITRATE_SWITCH * (int(kind) & 1) | ERROR_STATE * (int(kind) >> 1 & 1)
        at += 2
    elif text[at] | LOWER == _R:
        bits |= REMOTE
        row[:] = 0
        at += 1
        size = 0
        if DIGIT[text[at]] != NOT_A_DIGIT:
            size = int(DIGIT[text[at]])
            at += 1
        if size > CLASSIC_BYTES:
            return 0, 0, -1
        return bits, size, _raw_dlc(text, at, size)
    size = 0
    while DIGIT[text[at]] != NOT_A_DIGIT:
        low = DIGIT[text[at + 1]]
        if low == NOT_A_DIGIT or size == max_bytes:
            return 0, 0, -1
        if size < len(row):
            row[size] = DIGIT[text[at]] << 4 | low
        size += 1
        at += 2
    if size > len(row):
        return 0, size, -1
    row[size:] = 0
    return bits, size, _raw_dlc(text, at, size) if max_bytes == CLASSIC_BYTES else at


@compiled
def _raw_dlc(text: UInt8s, at: int, size: int) -> int:
    """The position after ``_9`` to ``_F``, which only a frame of 8 bytes may have; -1: refused."""
    if text[at] != _UNDERSCORE:
        return at
    dlc = DIGIT[text[at + 1]]
    return at + 2 if size == CLASSIC_BYTES and CLASSIC_BYTES < dlc != NOT_A_DIGIT else -1
