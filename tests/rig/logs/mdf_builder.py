"""MDF 4 files put together block by block, as loggers write them that asammdf does not imitate."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from dataclasses import dataclass, field

LINEAR, RATIONAL, FORMULA, INTERPOLATED, NEAREST, RANGES, WORDS = range(1, 8)
TEXT_TO_VALUE, TEXT_TO_TEXT = 9, 10
FIXED, VARIABLE, MASTER, VIRTUAL = 0, 1, 2, 6
UNSIGNED, FLOAT, TEXT, BYTES = 0, 4, 7, 10

DATA = "CAN_DataFrame"
RECORD = struct.Struct("<QIBB8s")


class Builder:
    """Successive blocks from byte 168 on; links are block addresses."""

    def __init__(self, start: bytes = b"MDF     4.11    test    ", flags: int = 0) -> None:
        self.start, self.flags = start, flags
        self.body = bytearray()

    def put(self, kind: bytes, links: list[int], data: bytes) -> int:
        """A block; its place."""
        self.body += bytes(-len(self.body) % 8)
        at = 168 + len(self.body)
        length = 24 + 8 * len(links) + len(data)
        self.body += b"##" + kind + bytes(4) + struct.pack("<QQ", length, len(links))
        self.body += struct.pack(f"<{len(links)}Q", *links) + data
        return at

    def text(self, words: str) -> int:
        """A name."""
        return self.put(b"TX", [], words.encode() + b"\0")

    def conversion(self, kind: int, values: list[float], words: list[object] = ()) -> int:
        """A conversion of any type; a conversion may stand in place of a word."""
        links = [self.text(word) if isinstance(word, str) else word(self) for word in words]
        data = struct.pack("<BBHHHdd", kind, 0, 0, len(words), len(values), 0, 0)
        return self.put(b"CC", [0] * 4 + links, data + struct.pack(f"<{len(values)}d", *values))

    def linear(self, offset: float, factor: float) -> int:
        """A conversion offset + factor · raw."""
        return self.conversion(LINEAR, [offset, factor])

    def words(self, values: list[float], words: list[str]) -> int:
        """A conversion from values to words; one word more for all others."""
        return self.conversion(WORDS, values, words)

    def channels(self, members: list[Member]) -> int:
        """A chain of channels; the place of the first."""
        following = 0
        for member in reversed(members):
            conversion = member.conversion(self) if member.conversion else 0
            links = [following, member.parts, self.text(member.name), 0, conversion]
            sync = 1 if member.kind == MASTER else 0
            where = (member.kind, sync, member.data_type, member.bit % 8, member.bit // 8)
            data = struct.pack("<BBBBII", *where, member.bits) + bytes(60)
            following = self.put(b"CN", [*links, member.data, 0, 0], data)
        return following

    def packed(self, data: bytes, columns: int = 0) -> int:
        """A compressed block, its bytes transposed if there are columns."""
        rows = len(data) // columns if columns else 0
        turned = bytes(data[r * columns + c] for c in range(columns) for r in range(rows))
        content = zlib.compress(turned + data[rows * columns :])
        head = struct.pack("<2sBxIQQ", b"DT", 1 if columns else 0, columns, len(data), len(content))
        return self.put(b"DZ", [], head + content)

    def data_list(self, parts: list[int], following: int = 0) -> int:
        """A list of data blocks, and the list that follows."""
        data = struct.pack("<B3xI", 0, len(parts)) + bytes(8 * len(parts))
        return self.put(b"DL", [following, *parts], data)

    def file(self, groups: int, start_ns: int = 10**18) -> bytes:
        """The whole file with this first data group."""
        head = struct.pack(
            "<4s4xQQ6QQhhBBBxdd", b"##HD", 104, 6, groups, *[0] * 5, start_ns, *[0] * 7
        )
        first = self.start.ljust(60, b"\0") + struct.pack("<HH", self.flags, 0)
        return first + head + bytes(self.body)


@dataclass
class Member:
    """One channel, from ``bit`` of its records on."""

    name: str
    bit: int
    bits: int
    kind: int = FIXED
    data_type: int = UNSIGNED
    conversion: object = None
    data: int = 0
    parts: int = field(default=0)


def group(builder: Builder, members: list[Member], record: int, records: int, **more: int) -> int:
    """A channel group; the place of it."""
    links = [more.get("following", 0), builder.channels(members), 0, 0, 0, 0]
    numbers = (more.get("number", 0), records, more.get("flags", 2), 46, record, 0)
    return builder.put(b"CG", links, struct.pack("<QQHH4xII", *numbers))


def data_group(builder: Builder, first: int, data: int, id_bytes: int = 0) -> int:
    """A data group; the place of it."""
    return builder.put(b"DG", [0, first, data, 0], struct.pack("<B7x", id_bytes))


def described_first(
    builder: Builder, first: int, parts: list[Callable[[Builder], int]], id_bytes: int = 0
) -> int:
    """A data group, a list of its data, and behind both the data; the place of the group."""
    at = data_group(builder, first, 0, id_bytes)
    blocks = builder.data_list([0] * len(parts))
    for place, link in (
        (at + 40, blocks),
        *((blocks + 32 + 8 * n, part(builder)) for n, part in enumerate(parts)),
    ):
        builder.body[place - 168 : place - 160] = struct.pack("<Q", link)
    return at


def frames(count: int) -> bytes:
    """Records of 22 bytes: time in ns, identifier, DLC, length, payload."""
    return b"".join(
        RECORD.pack(at * 1_000_000 + 7, 0x100 + at, 8, 8, bytes([at % 256] * 8))
        for at in range(count)
    )


def members(builder: Builder, *more: Member, payload: Member | None = None) -> list[Member]:
    """The channels of such records: a time in ns, and the parts of a frame."""
    parts = builder.channels(
        [
            Member(f"{DATA}.ID", 64, 29),
            Member(f"{DATA}.DLC", 96, 4),
            Member(f"{DATA}.DataLength", 104, 7),
            payload or Member(f"{DATA}.DataBytes", 112, 64, data_type=BYTES),
            *more,
        ]
    )
    time = Member("Timestamp", 0, 64, MASTER, conversion=lambda b: b.linear(0, 1e-9))
    return [time, Member(DATA, 64, 112, data_type=BYTES, parts=parts)]
