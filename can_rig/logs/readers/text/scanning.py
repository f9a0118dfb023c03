"""Common functions of the compiled text parsers: blanks, words, numbers, payloads.

Every function gets the text and a position; the text ends with a newline, which stops every
function. Position -1 means "not found".
"""

from __future__ import annotations

from typing import Final

import numpy as np

from can_rig.logs.frames import UInt8s
from firmware_model.compiled import compiled

DONE: Final = 0
"""Why a parser returned: no text or no room is left."""
BAD_LINE: Final = 1
"""The next line has the form of a frame and is none."""
NEW_CHANNEL: Final = 2
"""The next line names a bus that is not known yet."""
WIDER: Final = 3
"""The next line has a payload that is longer than the rows of ``data``."""
HEADING: Final = 4
"""The next line is a heading, which may change how later lines are read."""

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

_LARGEST: Final = (1 << 63) - 1


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
def next_line(text: UInt8s, at: int) -> int:
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
    """``size`` bytes, each after blanks, into ``row``; returns the position after them, or -1."""
    for byte in range(size):
        at = next_word(text, at)
        value, at = number(text, at, base, 255)
        if at < 0:
            return -1
        row[byte] = value
    row[size:] = 0
    return at if at < 0 or text[at] <= SPACE else -1


@compiled
def same_word(text: UInt8s, at: int, word: UInt8s) -> bool:
    """Whether the text at ``at`` begins with ``word``, which is in small letters."""
    offset = 0
    while offset < len(word) and text[at + offset] | LOWER == word[offset]:
        offset += 1  # a newline is no letter, so the offset stays within the text
    return offset == len(word)
