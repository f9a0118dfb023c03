"""ASAM MDF 4 files of bus logging.

A file has separate channel groups for data frames, error frames and remote frames of a bus; their
channels have the names of ASAM's "MDF Bus Logging". Groups are read in pieces and merged by time.

python-can's writer dates every file at the moment of writing and rounds time to 0.2 µs; a file from
here starts when the log does, and its time stamps are exact to the nanosecond.
"""

import re
import struct
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from io import BufferedReader
from pathlib import Path
from typing import Any, Final

import numpy as np
from can.util import channel2int
from numpy.typing import NDArray

from can_rig.errors import LogError, one_line
from can_rig.logs.compression import InflateError, inflated
from can_rig.logs.frames import (
    BITRATE_SWITCH,
    CLASSIC_BYTES,
    ERROR,
    ERROR_STATE,
    EXTENDED,
    FD,
    FD_BYTES,
    NS_PER_S,
    REMOTE,
    SENT,
    Format,
    Frames,
    Log,
    UInt8s,
    concatenate,
    numbered,
)
from firmware_model.compiled import compiled

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
    """Something that a link leads to is beyond the end of the file."""


@dataclass(frozen=True)
class Block:
    """One block: its position, its links, and the bytes after them."""

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
        name, conversion = self._text(block.links[2]), self._conversion(block.links[4])
        kind, data_type, bit, byte, bits = struct.unpack_from("<BxBBII", block.data)
        return Channel(name, kind, data_type, bit, byte, bits, block.links[5], conversion, elements)

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


_PIECE_BYTES: Final = 1 << 22
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
        """(n, 8) or (n, 64) payloads that begin at ``offsets`` (n,), zero beyond their lengths.

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
) -> Iterator[UInt8s]:
    """(n, bytes of a record) of one group, piece by piece; ``file`` knows of a cut end.

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
    file.is_cut |= bool(rest)


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


_ONE_TO_ONE, _LINEAR, _FORMULA, _VALUE_TO_TEXT, _RANGE_TO_TEXT = 0, 1, 3, 7, 8
_TEXT_TO_VALUE, _TEXT_TO_TEXT = 9, 10
_ARITHMETIC: Final = re.compile(  # a formula goes through Python's `eval`, where powers may not end
    r"(?!.*\*\s*\*)(?:[X\d.eE+\-*/(),\s]|"
    r"(?:arc)?(?:sin|cos|tan)h?(?=\()|(?:exp|log|log10|sqrt|abs)(?=\())+",
    re.S,
)
_MOST_NUMBER: Final = (1 << 32) - 1
_YES: Final = ("Tx", "1", "true")
_EXACT: Final = 1 << 53


def raw(channel: Channel, records: UInt8s, first: int) -> NDArray[Any]:
    """(n,) raw values in ``records``; of a virtual channel the numbers of the records.

    Args:
        channel: of 64 bits or fewer.
        records: (n, bytes).
        first: the number of the first record.

    Raises:
        MdfError: the channel does not lie within the records.
    """
    count, size = records.shape
    if channel.kind in (VIRTUAL, VIRTUAL_MASTER):
        return np.arange(first, first + count)
    width = (channel.bit_offset + channel.bit_count + 7) // 8
    if not 0 < width <= 8 or channel.byte_offset + width > size:
        raise MdfError(f"channel {channel.name} must lie within the {size} bytes of its records")
    is_big = channel.data_type in (UNSIGNED_BIG, SIGNED_BIG, FLOAT_BIG)
    kind = {FLOAT: "f", FLOAT_BIG: "f", SIGNED: "i", SIGNED_BIG: "i"}.get(channel.data_type, "u")
    if channel.data_type in TEXTS:
        return np.ndarray((count,), f"S{width}", records, channel.byte_offset, (size,))
    whole = channel.bit_offset == 0 and channel.bit_count in (8, 16, 32, 64)
    if whole and not (kind == "f" and width == 1):
        dtype = np.dtype(f"{'>' if is_big else '<'}{kind}{width}")
        return np.ndarray((count,), dtype, records, channel.byte_offset, (size,))
    word = np.zeros(count, np.uint64)
    places = range(width) if not is_big else range(width - 1, -1, -1)
    for shift, byte in enumerate(places):
        word |= records[:, channel.byte_offset + byte].astype(np.uint64) << np.uint64(8 * shift)
    return word >> np.uint64(channel.bit_offset) & np.uint64((1 << channel.bit_count) - 1)


def numbers(file: MdfFile, channel: Channel, records: UInt8s, first: int) -> NDArray[Any]:
    """(n,) whole physical values of 32 bits; words become 1 for "Tx" and the like, else 0.

    Raises:
        MdfError: see `physical`; or a value is not between 0 and 2**32 - 1.
    """
    values = physical(file, channel, records, first)
    if values.dtype.kind in "if":
        with np.errstate(invalid="ignore"):
            if not ((values >= 0) & (values <= _MOST_NUMBER)).all():
                raise MdfError(f"channel {channel.name} must be between 0 and {_MOST_NUMBER}")
    return values


def physical(file: MdfFile, channel: Channel, records: UInt8s, first: int) -> NDArray[Any]:
    """(n,) physical values; words become 1 for "Tx" and the like, else 0.

    Raises:
        MdfError: see `raw`; or asammdf cannot apply the conversion.
    """
    values = raw(channel, records, first)
    conversion = channel.conversion
    if values.dtype.kind == "S" and conversion.kind not in (_TEXT_TO_VALUE, _TEXT_TO_TEXT):
        return np.array([_is_yes(said) for said in values.tolist()], np.uint8)
    if conversion.kind == _ONE_TO_ONE:
        return values
    if conversion.kind == _LINEAR and len(conversion.values) >= 2:
        offset, factor = conversion.values[:2]
        return values if (offset, factor) == (0, 1) else offset + factor * values
    if conversion.kind in (_VALUE_TO_TEXT, _RANGE_TO_TEXT) and not conversion.is_nested:
        if channel.kind != VIRTUAL:
            return values  # codes: 1 for Tx, whatever the words
        return np.array([_says_yes(conversion, float(value)) for value in values], np.uint8)
    found = _by_asammdf(file, channel, values)
    if found.dtype.kind in "iufb":
        return found
    is_code = values.dtype.kind != "S" and channel.kind != VIRTUAL
    numbered = [
        said if not isinstance(said, bytes) else code if is_code else _is_yes(said)
        for said, code in zip(found.tolist(), values.tolist(), strict=True)
    ]
    return np.array(numbered, np.float64)


def _by_asammdf(file: MdfFile, channel: Channel, values: NDArray[Any]) -> NDArray[Any]:
    """Raw values converted by asammdf, for conversions that loggers rarely use."""
    conversion = channel.conversion
    if conversion.kind == _FORMULA and not _ARITHMETIC.fullmatch("".join(conversion.words)):
        raise MdfError(f"channel {channel.name} has a formula that is not read: {conversion.words}")
    from asammdf.blocks.v4_blocks import ChannelConversion  # noqa: PLC0415 (slow to import)

    try:
        block = ChannelConversion(
            stream=file.file, address=conversion.at, mapped=False, file_limit=file.size
        )
        return np.asarray(block.convert(values, as_object=True))
    except Exception as error:  # whatever a damaged block leads to
        raise MdfError(
            f"channel {channel.name} has a conversion of type {conversion.kind} that asammdf does "
            f"not apply: {one_line(error)}"
        ) from None


def _is_yes(said: bytes) -> bool:
    return said.decode("utf-8", "replace") in _YES


def _says_yes(conversion: Conversion, value: float) -> bool:
    step = 1 if conversion.kind == _VALUE_TO_TEXT else 2
    lows, highs = conversion.values[::step], conversion.values[step - 1 :: step]
    pairs = enumerate(zip(lows, highs, strict=False))
    at = next((i for i, (low, high) in pairs if low <= value <= high), len(lows))
    return at < len(conversion.words) and conversion.words[at] in _YES


def time_ns(file: MdfFile, channel: Channel, records: UInt8s, first: int) -> NDArray[np.int64]:
    """(n,) time stamps since the start of the recording, to the nearest nanosecond.

    Raises:
        MdfError: see `physical`; or a time stamp exceeds 146 years.
    """
    conversion = channel.conversion
    if channel.kind == VIRTUAL_MASTER or conversion.kind == _LINEAR:
        offset, factor = conversion.values[:2] if len(conversion.values) > 1 else (0.0, 1.0)
        ticks = raw(channel, records, first)
        step_ns = factor * NS_PER_S
        if ticks.dtype.kind in "ui" and offset == 0 and step_ns >= 1 and step_ns < _EXACT:
            nearest = round(step_ns)
            if abs(step_ns - nearest) <= 1e-9 * step_ns:
                if len(ticks) and int(ticks.max()) > (1 << 62) // nearest:
                    raise MdfError("a time stamp later than 146 years after the start")
                return ticks.astype(np.int64) * nearest
    with np.errstate(invalid="ignore", over="ignore"):
        times = physical(file, channel, records, first).astype(np.float64)
        stamps = np.round(times * NS_PER_S)
    if not (np.abs(stamps) < 1 << 62).all():
        raise MdfError("a time stamp that is no number, or later than 146 years after the start")
    return stamps.astype(np.int64)


def payloads(channel: Channel, records: UInt8s, length: UInt8s) -> UInt8s:
    """(n, 8) or (n, 64) bytes of a channel of fixed size; zero beyond the lengths.

    Raises:
        MdfError: the channel does not lie within the records.
    """
    width = channel.elements if channel.elements > 1 else channel.bit_count // 8
    if channel.byte_offset + width > records.shape[1]:
        raise MdfError(f"channel {channel.name} must lie within the bytes of its records")
    rows = empty_rows(length)
    size = min(width, rows.shape[1])
    rows[:, :size] = records[:, channel.byte_offset : channel.byte_offset + size]
    rows[np.arange(rows.shape[1]) >= np.minimum(length, size)[:, np.newaxis]] = 0
    return rows


KINDS: Final = {"CAN_DataFrame": 0, "CAN_ErrorFrame": ERROR, "CAN_RemoteFrame": REMOTE}
"""Channel groups by name, and the flag of their frames."""

_NUMBERS: Final = ("ID", "DLC", "DataLength", "BusChannel")
"""Channels of a frame in which words mean nothing."""

_ID_MASK: Final = (1 << 29) - 1
_EXTENDED_BIT: Final = 1 << 31
_MEMBER_FLAGS: Final = {
    "IDE": EXTENDED,
    "EDL": FD,
    "BRS": BITRATE_SWITCH,
    "ESI": ERROR_STATE,
    "Dir": SENT,
    "RTR": REMOTE,
}
_DLC: Final = np.array([*range(9), *np.repeat(range(9, 16), [4, 4, 4, 4, 8, 16, 16])], np.uint8)
"""DLC by payload length: 9 for 9 to 12 bytes, …, 15 for 49 to 64."""


def _read(log: Log) -> Iterator[Frames]:
    """Chunks of the CAN frames of an MDF 4 file.

    Raises:
        LogError: the file is not MDF 4, is damaged, or lacks CAN bus logging.
    """
    try:
        with log.path.open("rb") as opened:
            if opened.read(len(FINISHED)) not in (FINISHED, UNFINISHED):
                raise LogError(f"{log.path}: not an MDF 4 file: it must begin with 'MDF     4'")
            file = MdfFile(opened, log.path.stat().st_size)
            log.start_ns = _start_ns(file)
            groups = [
                _Group(file, log, data, group, kind)
                for data in file.groups
                for group in data.groups
                for kind in KINDS
                if any(channel.name == kind for channel in group.channels)
            ]
            if not groups and file.is_cut:
                raise LogError(
                    f"{log.path}: an MDF 4 file that is cut off: it lacks the description of its "
                    "records, which asammdf writes last and without which none can be read"
                )
            if not groups:
                raise LogError(f"{log.path}: holds no CAN frames (no channel group CAN_DataFrame)")
            total = sum(group.expected for group in groups)
            done = 0
            for frames in _merged(groups):
                if not done:  # python-can states when a log was converted, also for an old log
                    log.start_ns = min(log.start_ns, int(frames.time_ns[0]))
                done += len(frames)
                log.fraction = done / max(total, done)
                yield frames
            log.fraction = 1.0
    except (MdfError, struct.error) as error:
        raise LogError(f"{log.path}: an MDF 4 file that is cut off or damaged: {error}") from None
    missing = sum(group.missing for group in groups)
    if done < total or missing or file.is_cut:
        of_all = f" of {total}" if done < total else f" of {done + missing}" if missing else ""
        log.notice = f"{log.path}: is cut off; {done}{of_all} frames are in it"


def _start_ns(file: MdfFile) -> int:
    """Start of the recording [ns]; a local time is taken in this machine's time zone."""
    if file.start_ns >= 1 << 62:
        raise MdfError("a start after the year 2116")
    if not file.is_local_time:
        return file.start_ns
    seconds, rest_ns = divmod(file.start_ns, NS_PER_S)
    local = datetime(1970, 1, 1) + timedelta(seconds=seconds)
    return int(local.timestamp()) * NS_PER_S + rest_ns


class _Group:
    """The frames of one channel group, piece by piece."""

    def __init__(
        self, file: MdfFile, log: Log, data: DataGroup, group: ChannelGroup, kind: str
    ) -> None:
        self._file, self._log, self._data, self._group = file, log, data, group
        self._kind, self._start_ns = kind, log.start_ns
        prefix = f"{kind}."
        self._members = {
            channel.name.removeprefix(prefix): channel
            for channel in group.channels
            if channel.name.startswith(prefix)
        }
        masters = [c for c in group.channels if c.kind in (MASTER, VIRTUAL_MASTER)]
        for name in ("ID", "DLC"):
            if name not in self._members and kind != "CAN_ErrorFrame":
                raise MdfError(f"group {kind} has no channel {prefix}{name}")
        if not masters or not group.record_bytes:
            raise MdfError(f"group {kind} has no time, or records of no bytes")
        self._master = masters[0]
        self.expected = group.records
        """Frames by the file."""
        self.missing = 0
        """Frames without their payloads."""

    def __iter__(self) -> Iterator[Frames]:
        payload = self._members.get("DataBytes")
        held, of_values = Values(iter(())), None
        if payload is not None and payload.kind == VARIABLE:
            of_values = next((g for g in self._data.groups if g.at == payload.data_at), None)
            if of_values is None:
                held = Values(stream(self._file, payload.data_at))
        first = 0
        for found in records(self._file, self._data, self._group, of_values, held):
            piece = found[: max(self.expected - first, 0)] if self._file.is_finished else found
            for begin in range(0, len(piece), self._log.chunk_frames):
                part = piece[begin : begin + self._log.chunk_frames]
                frames = self._frames(np.ascontiguousarray(part), first, held)
                if len(frames):
                    yield frames
                first += len(part)

    def _frames(self, part: UInt8s, first: int, held: Values) -> Frames:
        count = len(part)

        def member(name: str) -> NDArray[Any]:
            channel = self._members.get(name)
            if channel is None:
                return np.zeros(count, np.uint8)
            is_text = channel.data_type in TEXTS and channel.conversion.kind != _TEXT_TO_VALUE
            if name in _NUMBERS and is_text:
                raise MdfError(f"channel {channel.name} must hold numbers, not text")
            return numbers(self._file, channel, part, first)

        identifier = member("ID").astype(np.uint32)
        flags = np.full(count, KINDS[self._kind], dtype=np.uint8)
        for name, flag in _MEMBER_FLAGS.items():
            if name in self._members:
                flags |= np.where(member(name) != 0, np.uint8(flag), np.uint8(0))
        flags |= np.where(identifier & np.uint32(_EXTENDED_BIT), np.uint8(EXTENDED), np.uint8(0))
        remote = (flags & REMOTE) != 0
        if remote.any():  # CAN FD lacks remote frames
            flags[remote] &= np.uint8(~(FD | BITRATE_SWITCH | ERROR_STATE) & 0xFF)
        has_length = "DataLength" in self._members and self._kind != "CAN_RemoteFrame"
        length = np.minimum(member("DataLength" if has_length else "DLC"), 64).astype(np.uint8)
        if not (flags & FD).all():
            plain = (flags & (FD | ERROR)) == 0
            length[plain] = np.minimum(length[plain], CLASSIC_BYTES)
        bus = member("BusChannel")
        if count and not 0 <= int(bus.min()) <= int(bus.max()) <= 0xFFFF:
            raise MdfError(f"bus {int(bus.max())}; it must be between 0 and 65535")
        payload, found = self._payload(part, first, length, held)
        self.missing += count - int(found.sum())
        frames = Frames(
            time_ns(self._file, self._master, part, first) + self._start_ns,
            identifier & np.uint32(_ID_MASK),
            flags,
            bus.astype(np.uint16),
            length,
            payload,
            (),
        )[found]
        return numbered(frames) if len(frames) else frames

    def _payload(
        self, part: UInt8s, first: int, length: UInt8s, held: Values
    ) -> tuple[UInt8s, NDArray[np.bool_]]:
        """The payloads, and whether the file has each."""
        channel: Channel | None = self._members.get("DataBytes")
        if channel is not None and channel.kind == VARIABLE:
            return held.rows(raw(channel, part, first), length)
        rows = np.zeros((len(part), CLASSIC_BYTES), np.uint8)
        if channel is not None:
            rows = payloads(channel, part, length)
        return rows, np.ones(len(part), np.bool_)


def _merged(groups: Sequence[_Group]) -> Iterator[Frames]:
    """The frames of all groups by time; at equal times in the order of the groups."""
    sources = [iter(group) for group in groups]
    held: list[Frames | None] = [next(source, None) for source in sources]
    while any(frames is not None for frames in held):
        there = [frames for frames in held if frames is not None]
        if len(there) == 1 and len(groups) == 1:
            yield there[0]
            held = [next(sources[0], None)]
            continue
        # Up to the earliest last time stamp of all the pieces no older frame can follow.
        safe = min(int(frames.time_ns[-1]) for frames in there)
        whole = concatenate([frames[frames.time_ns <= safe] for frames in there])
        yield whole[np.argsort(whole.time_ns, kind="stable")]
        for at, frames in enumerate(held):
            if frames is not None:
                left = frames[frames.time_ns > safe]
                held[at] = left if len(left) else next(sources[at], None)


def _write(chunks: Iterable[Frames], path: Path, start_ns: int, _final: Path) -> None:
    """Write a log; a channel group for each kind of frame and width of payload that occurs."""
    from asammdf import MDF, Signal, Source  # noqa: PLC0415 (slow to import)

    source = Source("CAN", "", "", Source.SOURCE_BUS, Source.BUS_TYPE_CAN)
    with MDF(version="4.10") as file:
        file.header.start_time = datetime.fromtimestamp(start_ns // NS_PER_S, UTC)
        file.header.abs_time = start_ns
        groups: dict[tuple[str, int], int] = {}
        for frames in chunks:
            for (kind, width), part in _kinds(frames).items():
                time_s = (part.time_ns - start_ns) / NS_PER_S
                records = _records(kind, width, part)
                if (kind, width) in groups:
                    file.extend(groups[kind, width], [(time_s, None), (records, None)])
                else:
                    signal = Signal(records, time_s, name=kind, source=source)
                    groups[kind, width] = file.append(signal, acq_source=source)
        file.save(path, overwrite=True, compression=1)


def _kinds(frames: Frames) -> dict[tuple[str, int], Frames]:
    """The frames of each kind; frames longer than 8 bytes are separate."""
    error, remote = frames.has(ERROR), frames.has(REMOTE)
    long = frames.length > CLASSIC_BYTES
    rows = {
        ("CAN_DataFrame", CLASSIC_BYTES): ~(error | remote | long),
        ("CAN_DataFrame", FD_BYTES): ~(error | remote) & long,
        ("CAN_ErrorFrame", FD_BYTES): error,
        ("CAN_RemoteFrame", 0): remote & ~error,
    }
    return {key: frames[chosen] for key, chosen in rows.items() if chosen.any()}


def _records(kind: str, width: int, frames: Frames) -> NDArray[np.void]:
    numbers = np.array([channel2int(name) or 0 for name in frames.channels] or [0], dtype=np.uint8)
    data = np.pad(frames.data, ((0, 0), (0, max(0, width - frames.data.shape[1]))))[:, :width]
    members: dict[str, NDArray[Any]] = {
        "BusChannel": numbers[frames.channel],
        "ID": frames.arbitration_id,
        "IDE": frames.has(EXTENDED),
        "DLC": np.where(frames.has(FD), _DLC[frames.length], frames.length),
        "DataLength": frames.length,
        "Dir": frames.has(SENT),
        "EDL": frames.has(FD),
        "BRS": frames.has(BITRATE_SWITCH),
        "ESI": frames.has(ERROR_STATE),
    }
    if width:
        members["DataBytes"] = data
    shapes = {"ID": "<u4", "DataBytes": f"({width},)u1"}
    kinds = [(f"{kind}.{name}", shapes.get(name, "<u1")) for name in members]
    records = np.zeros(len(frames), dtype=kinds)
    for name, values in members.items():
        records[f"{kind}.{name}"] = values
    return records


MDF: Final = Format(
    key=".mf4",
    mark=re.compile(rb"MDF     |UnFinMF "),
    read=_read,
    gzipped=False,
    write=_write,
    name="an MDF log",
    start_ns=1,
    since_ns=0,
    order=False,
)
