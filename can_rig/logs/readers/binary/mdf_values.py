"""Payloads of varying length in an MDF 4 file, and rows for payloads."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from can_rig.logs.frames import CLASSIC_BYTES, FD_BYTES, UInt8s
from firmware_model.compiled import compiled

_KEPT_BYTES: Final = 1 << 24
"""Bytes kept before the last requested value: simultaneous records may ask in any order."""
_LENGTH_BYTES: Final = 4


class Values:
    """A sequence of values: each length in four bytes, then the bytes.

    Args:
        source: yields the values on demand; `add` appends further values.
    """

    def __init__(self, source: Iterator[bytes]) -> None:
        self._source = source
        self._held = bytearray()
        self._begin = 0  # position of ``held`` in the sequence

    def add(self, more: bytes) -> None:
        """Append values."""
        self._held += more

    def rows(self, offsets: Any, length: UInt8s) -> tuple[UInt8s, NDArray[np.bool_]]:
        """(n, 8) or (n, 64) payloads that begin at ``offsets`` (n,), zero behind their lengths.

        And (n,) whether the file has the payload.
        """
        rows = empty_rows(length)
        found = np.ones(len(rows), np.bool_)
        if not len(rows):
            return rows, found
        last = min(int(offsets.max()), 1 << 62)
        while self._begin + len(self._held) < last + _LENGTH_BYTES + FD_BYTES:
            more = next(self._source, b"")
            if not more:
                break
            self._held += more
        places = offsets.astype(np.int64) - self._begin
        _copy(np.frombuffer(bytes(self._held), np.uint8), places, length, rows, found)
        unused = min(last - _KEPT_BYTES - self._begin, len(self._held))
        if unused > 0:
            del self._held[:unused]
            self._begin += unused
        return rows, found


def empty_rows(length: UInt8s) -> UInt8s:
    """(n, 8) bytes to be filled or, where a length is more, (n, 64)."""
    width = CLASSIC_BYTES if int(length.max(initial=0)) <= CLASSIC_BYTES else FD_BYTES
    return np.empty((len(length), width), np.uint8)


@compiled
def _copy(values: UInt8s, places: Any, length: UInt8s, rows: UInt8s, found: Any) -> None:
    """Fill ``rows`` from values with length prefixes, where ``found`` is true."""
    for row in range(len(rows)):
        at = places[row]
        size = np.int64(0)
        found[row] = at >= 0 and at + 4 <= len(values)
        if found[row]:
            for byte in range(4):
                size += np.int64(values[at + byte]) << np.int64(8 * byte)
            found[row] = at + 4 + size <= len(values)
        if not found[row]:
            continue
        size = min(size, np.int64(length[row]), rows.shape[1])
        for byte in range(size):
            rows[row, byte] = values[at + 4 + byte]
        for byte in range(size, rows.shape[1]):
            rows[row, byte] = 0
