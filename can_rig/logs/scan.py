"""A line of a text log, scanned by compiled functions.

Every function gets the text and a position; the text ends with a newline, which stops every
function. Position -1 means "not found". `line_loop` compiles the loop over lines for a format.
"""

from collections.abc import Callable
from types import FunctionType
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from can_rig.logs.frames import ERROR, EXTENDED, FD_BYTES, REMOTE, Columns, UInt8s
from firmware_model.compiled import compiled

Found = tuple[int, int, int, int, int, int, int]
"""What is in a line: FRAME or another reason, time [ns], identifier, flags, number of the bus (-1:
unknown), payload bytes, and a position up to which the line has been read."""

Line = Callable[[UInt8s, int, NDArray[np.int64], UInt8s], Found]
"""(text, position of the line, settings of the format, row for the payload) → `Found`."""

Parse = Callable[[UInt8s, int, NDArray[np.int64], Columns], tuple[int, int, int, int]]
"""(text, position, settings, columns to fill) → frames, lines, position of the next line, why it
stopped there."""

FRAME: Final = 0
NO_FRAME: Final = 1
"""The line is passed over."""
BAD_LINE: Final = 2
"""The line has the form of a frame and is none."""
WIDER: Final = 3
"""The payload is longer than the rows of ``data``."""
NEW_BUS: Final = 4
"""The line names a bus that is not known yet."""
HEADING: Final = 5
"""The line is a heading, which may change how later lines are read."""
DONE: Final = 6
"""No text or no room is left."""

BAD: Final = (BAD_LINE, 0, 0, 0, 0, 0, 0)
"""`Found` in a malformed frame."""

DECIMAL: Final = 10
HEXADECIMAL: Final = 16

NOT_A_DIGIT: Final = 255
DIGIT: Final = np.full(256, NOT_A_DIGIT, dtype=np.uint8)
"""The value of each byte as a hexadecimal digit, or NOT_A_DIGIT."""
DIGIT[list(b"0123456789")] = range(10)
DIGIT[list(b"abcdef")] = range(10, 16)
DIGIT[list(b"ABCDEF")] = range(10, 16)

NEWLINE, RETURN, TAB, SPACE, POINT = 10, 13, 9, 32, 46
LOWER: Final = 32
"""Makes a capital letter a small one."""

BYTES_OF_DLC: Final = np.array([*range(9), 12, 16, 20, 24, 32, 48, 64], dtype=np.uint8)
"""Payload bytes by DLC of a CAN FD frame."""

EXTENDED_ID: Final = (1 << 29) - 1
STANDARD_ID: Final = (1 << 11) - 1
_LARGEST: Final = (1 << 63) - 1


def line_loop(line: Line) -> Parse:
    """The loop over lines, compiled for a format; fills columns with the frames of the lines.

    Numba caches neither a function that is passed as an argument nor a closure, so ``line`` becomes
    a global name of a copy of `_loop`; the copy counts as code of the format's file.
    """
    code = getattr(line, "py_func", line).__code__
    name = f"loop_of{code.co_name}"
    copy = _loop.__code__.replace(co_filename=code.co_filename, co_name=name, co_qualname=name)
    return compiled(FunctionType(copy, {**_loop.__globals__, "line": line}, name))


def _loop(
    text: UInt8s, at: int, settings: NDArray[np.int64], columns: Columns
) -> tuple[int, int, int, int]:
    """See `Parse`; sorts out times, identifiers and lengths out of range."""
    frames = lines = 0
    rows, width = columns.data.shape
    while frames < rows and at < len(text):
        row = columns.data[frames]
        why, time_ns, identifier, flags, bus, size, end = line(text, at, settings, row)  # type: ignore[name-defined]  # noqa: F821
        if why == FRAME:
            most = EXTENDED_ID if flags & (EXTENDED | ERROR) else STANDARD_ID
            if time_ns < 0 or identifier > most or size > FD_BYTES:
                why = BAD_LINE
            elif size > width:
                why = WIDER
            elif bus < 0:
                why = NEW_BUS
        if why > NO_FRAME:
            return frames, lines, at, why
        if why == FRAME:
            row[0 if flags & REMOTE else size :] = 0
            columns.time_ns[frames] = time_ns
            columns.arbitration_id[frames] = identifier
            columns.flags[frames] = flags
            columns.channel[frames] = bus
            columns.length[frames] = size
            frames += 1
        at = next_line(text, end)
        lines += 1
    return frames, lines, at, DONE


@compiled
def is_blank(byte: int) -> bool:
    """Whether a byte stands between the words of a line."""
    return byte in (SPACE, TAB, RETURN)


@compiled
def blanks(text: UInt8s, at: int) -> int:
    """The position after the blanks at ``at``, if any."""
    while is_blank(text[at]):
        at += 1
    return at


@compiled
def word_end(text: UInt8s, at: int) -> int:
    """The position after the word that begins at ``at``."""
    while text[at] > SPACE:
        at += 1
    return at


@compiled
def next_word(text: UInt8s, at: int) -> int:
    """Where the word after blanks begins; -1: no blanks, or the line ends."""
    if at < 0 or not is_blank(text[at]):
        return -1
    at = blanks(text, at)
    return -1 if text[at] == NEWLINE else at


@compiled
def next_line(text: NDArray[Any], at: int) -> int:
    """The position after the end of this line."""
    while text[at] != NEWLINE:
        at += 1
    return at + 1


@compiled
def fixed_point(text: UInt8s, at: int, places: int) -> tuple[int, int]:
    """``digits[.digits]`` · 10**places, finer digits cut off, and the position after it.

    Value -1: the number exceeds 63 bits. Position -1: no digit.
    """
    scale = 1
    for _ in range(places):
        scale *= DECIMAL
    most = _LARGEST // scale - 1
    first = at
    value = 0
    while DIGIT[text[at]] < DECIMAL:
        if value >= 0:
            value = value * DECIMAL + int(DIGIT[text[at]])
            if value > most:
                value = -1
        at += 1
    if at == first:
        return 0, -1
    if text[at] == POINT:
        at += 1
    else:
        return value * scale if value >= 0 else -1, at
    while DIGIT[text[at]] < DECIMAL:
        if scale > 1 and value >= 0:
            value = value * DECIMAL + int(DIGIT[text[at]])
            scale //= DECIMAL
        at += 1
    return value * scale if value >= 0 else -1, at


@compiled
def number(text: UInt8s, at: int, base: int, most: int) -> tuple[int, int]:
    """A whole number up to ``most``, and position after it; -1: no digit, or a larger number."""
    if at < 0:
        return 0, -1
    first = at
    value = 0
    while DIGIT[text[at]] < base:
        value = value * base + int(DIGIT[text[at]])
        if value > most:
            return 0, -1
        at += 1
    return value, at if at > first else -1


@compiled
def payload(text: UInt8s, at: int, base: int, size: int, row: UInt8s) -> int:
    """``size`` bytes, each after blanks, into ``row``; returns the position after them, or -1.

    Bytes beyond the end of ``row`` are read only.
    """
    for byte in range(size):
        at = next_word(text, at)
        value, at = number(text, at, base, 255)
        if at < 0:
            return -1
        if byte < len(row):
            row[byte] = value
    return at if at < 0 or text[at] <= SPACE else -1


@compiled
def same_word(text: UInt8s, at: int, word: UInt8s) -> bool:
    """Whether the text at ``at`` begins with ``word``, which is in small letters."""
    offset = 0
    while offset < len(word) and text[at + offset] | LOWER == word[offset]:
        offset += 1  # a newline is no letter, so the offset stays within the text
    return offset == len(word)
