"""The data of an MDF 4 file: plain or compressed blocks, whose records may be interleaved.

Payloads of varying length stand in blocks or records of their own (`Values`).
"""

from __future__ import annotations

import struct
from collections.abc import Generator, Iterator
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from can_rig.logs.formats.inflate import InflateError, inflated
from can_rig.logs.formats.mdf_blocks import (
    ChannelGroup,
    DataGroup,
    MdfCutError,
    MdfError,
    MdfFile,
)
from can_rig.logs.frames import CLASSIC_BYTES, FD_BYTES, UInt8s
from firmware_model.compiled import compiled

_PIECE_BYTES: Final = 1 << 22
_MOST_BYTES: Final = 1 << 28
_DATA: Final = (b"DT", b"SD", b"RD", b"DV")
_DEFLATE, _TRANSPOSED = 0, 1
_HEADER_BYTES: Final = 24
_KEPT_BYTES: Final = 1 << 24
"""Bytes kept before the last requested value: simultaneous records may ask in any order."""
_LENGTH_BYTES: Final = 4
_VARIABLE: Final = -1  # replaces a record's size: four bytes hold the size


def stream(file: MdfFile, at: int) -> Iterator[bytes]:
    """The data behind a link, through all lists and compressed blocks.

    Ends at the end of the file, which then counts as cut off.

    Raises:
        MdfError: a block is damaged, or its kind is not supported.
    """
    try:
        yield from _pieces(file, at)
    except MdfCutError:
        file.is_cut = True


def _pieces(file: MdfFile, at: int) -> Iterator[bytes]:
    seen: set[int] = set()
    waiting = [at] if at else []
    while waiting:
        at = waiting.pop()
        if at in seen:
            raise MdfError(f"byte {at}: data blocks lead in a circle")
        seen.add(at)
        kind, length, _ = file.header(at)
        if kind in _DATA:
            end = at + length
            if file.last_data_open and not waiting:
                end = file.size
            yield from _plain(file, at + _HEADER_BYTES, end)
        elif kind == b"DZ":
            yield _unpacked(file, at, length)
        elif kind == b"HL":
            waiting.append(file.block(at, b"HL", 1).links[0])
        elif kind in (b"DL", b"LD"):
            waiting += [link for link in reversed(_listed(file, at, kind)) if link]
        else:
            raise MdfError(f"byte {at}: data in a block {kind!r}, which is not read")


def _listed(file: MdfFile, at: int, kind: bytes) -> list[int]:
    """The data blocks of a list, and the list that follows."""
    block = file.block(at, kind, 1, 8)
    flags = block.data[0] if kind == b"DL" else struct.unpack_from("<I", block.data)[0]
    blocks = list(block.links[1:])
    if kind == b"LD" and flags >> 31:  # every second block holds invalidation bits
        blocks = blocks[::2]
    return [*blocks, block.links[0]]


def _plain(file: MdfFile, at: int, end: int) -> Iterator[bytes]:
    while at < end:
        piece = file.piece(at, min(_PIECE_BYTES, end - at))
        if not piece:
            raise MdfCutError
        yield piece
        at += len(piece)


def _unpacked(file: MdfFile, at: int, length: int) -> bytes:
    head = file.piece(at + _HEADER_BYTES, 24)
    if len(head) < 24:
        raise MdfCutError
    _, how, columns, size, packed = struct.unpack("<2sBxIQQ", head)
    if how not in (_DEFLATE, _TRANSPOSED) or max(size, length) > _MOST_BYTES:
        raise MdfError(f"byte {at}: data compressed in a way that is not read (type {how})")
    content = file.piece(at + _HEADER_BYTES + 24, min(packed, length))
    try:
        data = inflated(content, size)
    except InflateError as error:
        raise MdfError(f"byte {at}: {error}") from None
    if len(content) < packed:
        file.is_cut = True
        if how == _TRANSPOSED:
            return b""  # the last bytes of every record are missing
    if how == _TRANSPOSED and columns:
        rows = len(data) // columns
        table = np.frombuffer(data, np.uint8, rows * columns).reshape(columns, rows)
        return table.T.tobytes() + data[rows * columns :]
    return data


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


def records(
    file: MdfFile, data: DataGroup, group: ChannelGroup, values: ChannelGroup | None, held: Values
) -> Generator[UInt8s, None, bool]:
    """(n, bytes of a record) of one group, piece by piece; returns whether the end is cut off.

    Args:
        file: the file.
        data: where the group's records are, perhaps among others.
        group: the group.
        values: the interleaved group with the values of varying length; None: no such group.
        held: receives the values before the records that refer to them.

    Raises:
        MdfError: the data are damaged.
    """
    size = group.record_bytes
    rest = b""
    waiting = np.zeros(0, np.uint8)
    for piece in stream(file, data.data_at):
        text = rest + piece
        if data.id_bytes:
            found, used = _split(file, text, data, group, values, held)
        else:
            used = len(text) // size * size
            found = np.frombuffer(text, np.uint8, used)
        rest = text[used:]
        if values is not None:  # a value may come a little later than its record
            found, waiting = waiting, found
        if len(found):
            yield found.reshape(-1, size)
    if len(waiting):
        yield waiting.reshape(-1, size)
    return bool(rest)


def _split(
    file: MdfFile,
    data: bytes,
    among: DataGroup,
    group: ChannelGroup,
    values: ChannelGroup | None,
    held: Values,
) -> tuple[UInt8s, int]:
    """The records of one group among interleaved records; and the bytes used of ``data``."""
    groups = among.groups
    numbers = np.array([one.record_id for one in groups], np.uint64)
    sizes = np.array([_VARIABLE if g.is_variable else g.record_bytes for g in groups], np.int64)
    codes = np.frombuffer(data, np.uint8)
    own, varying = np.empty(len(data), np.uint8), np.empty(len(data), np.uint8)
    wanted, of_values = groups.index(group), groups.index(values) if values else -1
    used, count, found, is_known = split(
        codes, among.id_bytes, numbers, sizes, wanted, of_values, own, varying
    )
    if not is_known:
        if data[used:].strip(b"\0"):
            number = int.from_bytes(data[used : used + among.id_bytes], "little")
            raise MdfError(f"a record of group {number}, which the file does not have")
        file.is_cut, used = True, len(data)  # the logger had room for more
    held.add(varying[:found].tobytes())
    return own[:count], used


@compiled
def split(
    data: UInt8s,
    id_bytes: int,
    numbers: Any,
    sizes: Any,
    wanted: int,
    values: int,
    records: UInt8s,
    varying: UInt8s,
) -> tuple[int, int, int, bool]:
    """Copy the records of group ``wanted``, and with their lengths those of group ``values``.

    Returns how much of ``data`` is used, how much of ``records`` and of ``varying`` is filled, and
    whether it ended otherwise than at a record of an unknown group.
    """
    at = count = found = 0
    end = len(data)
    while at + id_bytes <= end:
        number = np.uint64(0)
        for byte in range(id_bytes):
            number |= np.uint64(data[at + byte]) << np.uint64(8 * byte)
        which = 0
        while which < len(numbers) and numbers[which] != number:
            which += 1
        if which == len(numbers):
            return at, count, found, False
        begin = at + id_bytes
        size = sizes[which]
        if size < 0:
            if begin + 4 > end:
                break
            size = 4
            for byte in range(4):
                size += np.int64(data[begin + byte]) << np.int64(8 * byte)
        if begin + size > end:
            break
        if which == wanted:
            records[count : count + size] = data[begin : begin + size]
            count += size
        elif which == values:
            varying[found : found + size] = data[begin : begin + size]
            found += size
        at = begin + size
    return at, count, found, True
