"""The blocks of an MDF 4 file: header, data groups, channel groups, channels, conversions.

Every block begins with "##", two letters, its length, and links to other blocks. A link that leads
nowhere, or in a circle, is an error; so reading never loops for ever or leaves the file. Source:
ASAM MDF 4.1, and the layouts as asammdf writes them.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from io import BufferedReader
from typing import Final

FINISHED: Final = b"MDF     4"
UNFINISHED: Final = b"UnFinMF 4"
"""How a file begins: finished or unfinished by the recorder."""

LAST_DATA_OPEN: Final = 1 << 2
"""Of the flags of an unfinished file: the length of the last data block is not written."""

_HEADER: Final = struct.Struct("<4s4xQQ")
_HEAD_AT: Final = 64
_MOST_BYTES: Final = 1 << 28
"""Largest block that is read whole."""
_MOST_BLOCKS: Final = 1 << 20

UNSIGNED, UNSIGNED_BIG, SIGNED, SIGNED_BIG, FLOAT, FLOAT_BIG, _LATIN_1, _UTF_8 = range(8)
TEXTS: Final = (_LATIN_1, _UTF_8)
BYTES: Final = 10
FIXED, VARIABLE, MASTER, VIRTUAL_MASTER, _SYNCHRONISED, MAXIMUM, VIRTUAL = range(7)
"""Kinds of channels."""


class MdfError(ValueError):
    """The message names the defect and its place in the file."""


class MdfCutError(MdfError):
    """Something that a link leads to is behind the end of the file."""


@dataclass(frozen=True)
class Block:
    """One block: its position, its links, and the bytes behind them."""

    at: int
    kind: bytes
    links: tuple[int, ...]
    data: bytes


@dataclass(frozen=True)
class Conversion:
    """Raw value → physical value."""

    kind: int
    values: tuple[float, ...] = ()
    words: tuple[str, ...] = ()
    at: int = 0
    """Its block."""
    is_nested: bool = False
    """Whether another conversion converts some values."""


@dataclass(frozen=True)
class Channel:
    """Where a value lies in a record."""

    name: str
    kind: int
    data_type: int
    bit_offset: int
    byte_offset: int
    bit_count: int
    data_at: int
    """Where values of varying length are; 0: nowhere."""
    conversion: Conversion
    elements: int = 1
    """Of an array."""


@dataclass(frozen=True)
class ChannelGroup:
    """Records of a single kind."""

    at: int
    record_id: int
    records: int
    """Number in the file; 0 in an unfinished file."""
    is_variable: bool
    """Each record holds the length and the bytes of one value of another group."""
    record_bytes: int
    channels: tuple[Channel, ...] = field(repr=False)


@dataclass(frozen=True)
class DataGroup:
    """Interleaved records of several groups."""

    id_bytes: int
    """Size of the group number before each record; 0: a single group."""
    data_at: int
    groups: tuple[ChannelGroup, ...]


class MdfFile:
    """The structure of an open file.

    Args:
        file: of MDF 4.
        size: its length [byte].

    Raises:
        MdfError: the file is damaged, or ends within its header.
    """

    def __init__(self, file: BufferedReader, size: int) -> None:
        self.file, self.size = file, size
        start = self._read(0, _HEAD_AT)
        self.is_finished = start.startswith(FINISHED)
        flags = int.from_bytes(start[60:62], "little")
        self.last_data_open = not self.is_finished and bool(flags & LAST_DATA_OPEN)
        head = self.block(_HEAD_AT, b"HD", 6, 12)
        start_ns, time_flags = struct.unpack_from("<Q4xB", head.data)
        self.start_ns = int(start_ns)
        self.is_local_time = bool(time_flags & 1)
        self.is_cut = False
        """Whether the file has turned out to end too early, so far."""
        self.groups: list[DataGroup] = []
        """Groups described before the file ends."""
        try:
            for block in self._chain(head.links[0], b"DG", 4, 1):
                self.groups.append(self._data_group(block))
        except MdfCutError:
            self.is_cut = True

    def block(self, at: int, kind: bytes, links: int = 0, least: int = 0) -> Block:
        """The block at ``at``; kind, least number of links and least size are checked.

        Raises:
            MdfError: a check fails.
        """
        found, length, count = self.header(at)
        if found != kind or length > _MOST_BYTES or not links <= count <= (length - 24) // 8:
            raise MdfError(f"byte {at}: no {kind.decode()} block of a plausible size")
        raw = self._read(at + _HEADER.size, length - _HEADER.size)
        data = raw[8 * count :]
        if len(data) < least:
            raise MdfError(f"byte {at}: {kind.decode()} block of {length} bytes is too short")
        return Block(at, found, struct.unpack_from(f"<{count}Q", raw), data)

    def header(self, at: int) -> tuple[bytes, int, int]:
        """Kind, length and number of links of the block at ``at``.

        Raises:
            MdfError: no block begins there.
        """
        mark, length, links = _HEADER.unpack(self._read(at, _HEADER.size))
        if not mark.startswith(b"##") or length < _HEADER.size:
            raise MdfError(f"byte {at}: a block must begin here")
        return mark[2:], length, links

    def piece(self, at: int, size: int) -> bytes:
        """Up to ``size`` bytes from ``at`` on; fewer where the file ends."""
        self.file.seek(min(at, self.size))
        return self.file.read(size)

    def _read(self, at: int, size: int) -> bytes:
        found = self.piece(at, size) if 0 <= at <= self.size else b""
        if len(found) < size:
            raise MdfCutError(f"byte {at}: the file ends before the {size} bytes that must be here")
        return found

    def _chain(self, at: int, kind: bytes, links: int, least: int) -> Iterator[Block]:
        """A block and its successors along the first link."""
        seen: set[int] = set()
        while at:
            if at in seen or len(seen) == _MOST_BLOCKS:
                raise MdfError(f"byte {at}: {kind.decode()} blocks lead in a circle")
            seen.add(at)
            block = self.block(at, kind, links, least)
            yield block
            at = block.links[0]

    def _data_group(self, block: Block) -> DataGroup:
        groups = tuple(
            self._channel_group(one) for one in self._chain(block.links[1], b"CG", 6, 32)
        )
        if block.data[0] not in (0, 1, 2, 4, 8):
            raise MdfError(f"byte {block.at}: record numbers of {block.data[0]} bytes")
        return DataGroup(block.data[0], block.links[2], groups)

    def _channel_group(self, block: Block) -> ChannelGroup:
        number, records, flags, record, invalid = struct.unpack_from("<QQH6xII", block.data)
        channels: list[Channel] = []
        self._channels(block.links[1], channels, 0)
        return ChannelGroup(
            block.at, number, records, bool(flags & 1), record + invalid, tuple(channels)
        )

    def _channels(self, at: int, found: list[Channel], depth: int) -> None:
        """The channels of a chain, with the components of composed channels."""
        if depth > 8:
            raise MdfError(f"byte {at}: channels within channels without end")
        for block in self._chain(at, b"CN", 8, 16):
            elements = 1
            if block.links[1]:
                kind = self.header(block.links[1])[0]
                if kind == b"CN":
                    self._channels(block.links[1], found, depth + 1)
                elif kind == b"CA":
                    elements = self._elements(block.links[1])
            found.append(self._channel(block, elements))

    def _channel(self, block: Block, elements: int) -> Channel:
        kind, _, data_type, bit_offset, byte_offset, bits = struct.unpack_from(
            "<BBBBII", block.data
        )
        return Channel(
            self._text(block.links[2]),
            kind,
            data_type,
            bit_offset,
            byte_offset,
            bits,
            block.links[5],
            self._conversion(block.links[4]),
            elements,
        )

    def _elements(self, at: int) -> int:
        block = self.block(at, b"CA", 1, 16)
        dimensions = struct.unpack_from("<2xH", block.data)[0]
        if len(block.data) < 16 + 8 * dimensions:
            raise MdfError(f"byte {at}: an array of {dimensions} dimensions in too short a block")
        count = 1
        for size in struct.unpack_from(f"<{dimensions}Q", block.data, 16):
            count = min(count * size, 1 << 20)
        return count

    def _conversion(self, at: int) -> Conversion:
        if not at:
            return Conversion(0)
        block = self.block(at, b"CC", 4, 24)
        kind, references, count = struct.unpack_from("<B3xHH", block.data)
        if len(block.data) < 24 + 8 * count or len(block.links) < 4 + references:
            raise MdfError(f"byte {at}: a conversion of {count} values in too short a block")
        values = struct.unpack_from(f"<{count}d", block.data, 24)
        links = block.links[4 : 4 + references]
        words = tuple(self._text(link) for link in links)
        is_nested = any(link and self.header(link)[0] == b"CC" for link in links)
        return Conversion(kind, values, words, at, is_nested)

    def _text(self, at: int) -> str:
        if not at or self.header(at)[0] not in (b"TX", b"MD"):
            return ""
        block = self.block(at, self.header(at)[0])
        return block.data.partition(b"\0")[0].decode("utf-8", "replace")
