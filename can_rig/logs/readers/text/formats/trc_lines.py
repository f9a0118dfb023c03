"""The lines of PEAK traces → columns, compiled: one pass over the bytes.

    1)     1059  0300  7  00 00 00 00 04 00 00             version 1.0: N O I L D
    1)   1059.9  Rx   0300  7  00 00 00 00 04 00 00        version 1.1: N O T I L D
    1)  17535.400 1  Tx  00000100 -  8  00 …               version 1.3: N O B T I R L D
    1   17535.400 DT 1  00000100 Tx -  8  00 …             version 2.1: as $COLUMNS says
    2   17540.000 FB 1      0123 Rx -  9  00 …             CAN FD; L: DLC 9 is 12 bytes

A column is named by a letter: N number, O offset in ms, T type, B bus, I identifier (extended where
it has more than four digits), d direction, R reserved, l bytes, L data length code, D data. Types
that are no frames (ST, EC, Warng, …) are passed over.

    46,016 1  0004  45A  8  5A 04 00 …                     CARBUS Analyzer 2: s B F i l D
    15,321000 1  00000005  1B000067  8  67 00 …            CARBUS Analyzer 3: S B F i l D

Its columns are parted by tabs; where no data follow a length, the frame is a remote one. Letters: s
and S are seconds and a number of ms or µs, F flags, of which the lowest marks an extended
identifier, i an identifier that is extended if it has more than 11 bits. With i, more than 8 bytes
mean CAN FD.

Source: PEAK-System, "PEAK CAN TRC File Format"; SavvyCAN, `framefileio.cpp`.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from can_rig.logs.frames import (
    BITRATE_SWITCH,
    CLASSIC_BYTES,
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
    TAB,
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

_NS_DIGITS_OF_MS = 6
_EXTENDED_ID, _STANDARD_ID, _NO_ID = (1 << 29) - 1, (1 << 11) - 1, (1 << 32) - 1
_STANDARD_DIGITS = 4
_CLOSE, _CAPITAL, _T_OF_TX = 41, 0xDF, ord("t")
_O, _T, _B, _I, _D = ord("O"), ord("T"), ord("B"), ord("I"), ord("D")
_DIRECTION, _BYTES, _DLC = ord("d"), ord("l"), ord("L")
_SECONDS_MS, _SECONDS_US, _FLAGS, _UNMARKED = ord("s"), ord("S"), ord("F"), ord("i")
_NS_PER_S, _NS_PER_MS, _NS_PER_US = 1_000_000_000, 1_000_000, 1_000
_MOST_SECONDS = 1 << 32
_COMMA = ord(",")
_UNTYPED = ord("n")  # the number in version 1.0, without types
_RTR = np.frombuffer(b"rtr", np.uint8)
_OTHER = -1

_TYPES = {
    "DT": 0,
    "RR": REMOTE,
    "FD": FD,
    "FB": FD | BITRATE_SWITCH,
    "FE": FD | ERROR_STATE,
    "BI": FD | BITRATE_SWITCH | ERROR_STATE,
    "RX": 0,  # of versions 1.x
    "TX": SENT,
}
_NAMES = np.array([ord(name[0]) << 8 | ord(name[1]) for name in _TYPES], np.int64)
_BITS = np.array(list(_TYPES.values()), np.int64)


@compiled
def parse(
    text: UInt8s,
    at: int,
    columns: UInt8s,
    time_ns: Any,
    arbitration_id: Any,
    flags: UInt8s,
    channel: UInt8s,
    length: UInt8s,
    data: UInt8s,
) -> tuple[int, int, int, int]:
    """Fill the columns from the lines that begin at ``at``; a line ends with a newline.

    ``columns`` are the letters of the trace's own; ``channel`` gets numbers of buses. Returns the
    number of frames, of lines, where the next line begins, and why it stopped there.
    """
    frames = lines = 0
    while frames < len(time_ns) and at < len(text):
        bits, stamp, bus, identifier, size, begin = _head(text, at, columns)
        if bits != _OTHER:
            if begin < 0:
                return frames, lines, at, BAD_LINE
            if size > data.shape[1]:
                return frames, lines, at, WIDER
            row = data[frames]
            if size and _is_empty(text, begin):
                bits |= REMOTE
            first = next_word(text, begin)
            if first >= 0 and same_word(text, first, _RTR):
                bits |= REMOTE
            if bits & REMOTE:
                row[:] = 0
            elif payload(text, begin, HEXADECIMAL, size, row) < 0:
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
def _head(text: UInt8s, at: int, columns: UInt8s) -> tuple[int, int, int, int, int, int]:
    """The fields before the data: flags, time in ns, bus, identifier, length, and where it ends.

    Flags _OTHER: the line holds no frame. End -1: the frame is malformed.
    """
    at = blanks(text, at)
    bits = _OTHER  # until the type is known
    stamp = identifier = size = direction = 0
    bus = 1
    is_dlc = bad = is_unmarked = False
    if DIGIT[text[at]] >= DECIMAL:
        return _OTHER, 0, 0, 0, 0, 0
    for place in range(len(columns)):
        column = columns[place]
        if column == _D:
            break
        if place:
            at = next_word(text, at)
        if at < 0:
            return bits, 0, 0, 0, 0, -1
        after = end = word_end(text, at)
        if column == _O:
            stamp, after = fixed_point(text, at, _NS_DIGITS_OF_MS)
            bad |= stamp < 0
        elif column in (_SECONDS_MS, _SECONDS_US):
            stamp, after = _seconds(text, at, _NS_PER_MS if column == _SECONDS_MS else _NS_PER_US)
        elif column == _UNTYPED:
            bits = 0 if text[end - 1] == _CLOSE else _OTHER
        elif column == _T:
            bits = _type(text, at, end)
        elif column == _B:
            bus, after = number(text, at, DECIMAL, 255)
        elif column in (_I, _UNMARKED):
            identifier, after = number(text, at, HEXADECIMAL, _NO_ID)
            is_unmarked = column == _UNMARKED
            is_long = identifier > _STANDARD_ID if is_unmarked else end - at > _STANDARD_DIGITS
            direction |= EXTENDED * is_long
        elif column == _FLAGS:
            marks, after = number(text, at, HEXADECIMAL, _NO_ID)
            bits, direction = 0, EXTENDED * (marks & 1)
        elif column == _DIRECTION:
            direction |= SENT * (text[at] | LOWER == _T_OF_TX)
        elif column in (_BYTES, _DLC):
            size, after = number(text, at, DECIMAL, FD_BYTES)
            is_dlc = column == _DLC
        bad |= after != end
        at = end
    if bits == _OTHER or identifier == _NO_ID:  # in version 1.0: bus state
        return _OTHER, 0, 0, 0, 0, 0
    if is_dlc:
        bad |= size >= len(BYTES_OF_DLC)
        size = int(BYTES_OF_DLC[min(size, len(BYTES_OF_DLC) - 1)])
    bits |= FD * (is_unmarked and size > CLASSIC_BYTES)
    if not bits & FD:
        bad |= not is_dlc and size > CLASSIC_BYTES
        size = min(size, CLASSIC_BYTES)
    bits |= direction
    bad |= identifier > (_EXTENDED_ID if bits & EXTENDED else _STANDARD_ID)
    return bits, stamp, bus, identifier, size, -1 if bad else at


@compiled
def _seconds(text: UInt8s, at: int, unit: int) -> tuple[int, int]:
    """``seconds,parts`` in ns and the position after it; the fraction may lack leading zeros."""
    seconds, at = number(text, at, DECIMAL, _MOST_SECONDS)
    if at < 0 or text[at] != _COMMA:
        return 0, -1
    parts, at = number(text, at + 1, DECIMAL, _NS_PER_S // unit - 1)
    return seconds * _NS_PER_S + parts * unit, at


@compiled
def _is_empty(text: UInt8s, at: int) -> bool:
    """Whether two tabs enclose only spaces."""
    if text[at] != TAB:
        return False
    at += 1
    while text[at] == SPACE:
        at += 1
    return bool(text[at] == TAB)


@compiled
def _type(text: UInt8s, at: int, end: int) -> int:
    """The flags of a type; _OTHER for types without a frame."""
    if end == at + 2:
        name = int(text[at] & _CAPITAL) << 8 | int(text[at + 1] & _CAPITAL)
        for known in range(len(_NAMES)):
            if name == _NAMES[known]:
                return int(_BITS[known])
    return _OTHER
