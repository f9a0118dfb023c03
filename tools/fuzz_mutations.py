"""Damage: one file changed in a few places, the same for the same number."""

from __future__ import annotations

import random
import re
from collections.abc import Callable, Sequence
from typing import Final

_NUMBER: Final = re.compile(rb"[0-9][0-9A-Fa-f.]*")
_NUMBERS: Final = (
    b"0", b"-1", b"255", b"256", b"65536", b"2147483648", b"4294967296", b"18446744073709551616",
    b"99999999999999999999.5", b"1e999", b"nan", b"inf", b"F" * 17, b"9" * 35, b"0.0000000001",
)  # fmt: skip
_INTEGERS: Final = (0, 1, 0x7F, 0x80, 0xFF, 0x7FFF, 0xFFFF, 1 << 31, (1 << 32) - 1, (1 << 64) - 1)
_MOST_PLACES: Final = 4


def damaged(text: bytes, others: Sequence[bytes], number: int) -> bytes:
    """One of the many damaged versions of a file.

    Args:
        text: the file.
        others: files of which a piece may be put in.
        number: which version.
    """
    chance = random.Random(number)
    for _ in range(chance.randint(1, _MOST_PLACES)):
        change = chance.choice(_CHANGES)
        text = change(text, chance, others)
    return text


def _byte(text: bytes, chance: random.Random, _others: Sequence[bytes]) -> bytes:
    at = chance.randrange(len(text) + 1)
    return text[:at] + bytes([chance.randrange(256)]) + text[at + 1 :]


def _bit(text: bytes, chance: random.Random, _others: Sequence[bytes]) -> bytes:
    at = chance.randrange(max(len(text), 1))
    return (
        text[:at]
        + bytes([byte ^ 1 << chance.randrange(8) for byte in text[at : at + 1]])
        + text[at + 1 :]
    )


def _integer(text: bytes, chance: random.Random, _others: Sequence[bytes]) -> bytes:
    at, size = chance.randrange(len(text) + 1), chance.choice((1, 2, 4, 8))
    value = chance.choice(_INTEGERS) & (1 << 8 * size) - 1
    return text[:at] + value.to_bytes(size, "little") + text[at + size :]


def _number(text: bytes, chance: random.Random, _others: Sequence[bytes]) -> bytes:
    found = list(_NUMBER.finditer(text))
    if not found:
        return text
    chosen = chance.choice(found)
    return text[: chosen.start()] + chance.choice(_NUMBERS) + text[chosen.end() :]


def _without(text: bytes, chance: random.Random, _others: Sequence[bytes]) -> bytes:
    at = chance.randrange(len(text) + 1)
    return text[:at] + text[at + chance.randint(1, 40) :]


def _twice(text: bytes, chance: random.Random, _others: Sequence[bytes]) -> bytes:
    at = chance.randrange(len(text) + 1)
    end = at + chance.randint(1, 200)
    return text[:end] + text[at:]


def _cut(text: bytes, chance: random.Random, _others: Sequence[bytes]) -> bytes:
    return text[: chance.randrange(len(text) + 1)]


def _spliced(text: bytes, chance: random.Random, others: Sequence[bytes]) -> bytes:
    other = chance.choice(others)
    begin = chance.randrange(len(other) + 1)
    at = chance.randrange(len(text) + 1)
    return text[:at] + other[begin : begin + chance.randint(1, 300)] + text[at:]


def _moved(text: bytes, chance: random.Random, _others: Sequence[bytes]) -> bytes:
    """A few lines that come later, or twice, or not at all."""
    lines = text.splitlines(keepends=True)
    at = chance.randrange(len(lines) + 1)
    taken = lines[at : at + chance.randint(1, 8)]
    rest = lines[:at] + lines[at + len(taken) * chance.randint(0, 1) :]
    to = chance.randint(at, min(at + 40, len(rest)))
    return b"".join(rest[:to] + taken * chance.randint(0, 2) + rest[to:])


_CHANGES: Final[tuple[Callable[[bytes, random.Random, Sequence[bytes]], bytes], ...]] = (
    _byte, _byte, _bit, _bit, _integer, _integer, _number, _number, _without, _twice, _cut,
    _spliced, _moved, _moved,
)  # fmt: skip
