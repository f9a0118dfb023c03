"""J1939: the parameter group in an identifier of 29 bits, and messages of several frames.

    3 bits priority | 18 bits parameter group number (PGN) | 8 bits source address

In the PGN the second byte is the PDU format; below 240 the third one is no part of the number, but
the destination address. Source: SAE J1939-21, section 5.2.

The transport protocol puts messages of 9 to 1785 bytes together from frames of 7 bytes each. A
sender announces a message in a TP.CM frame (connection management), and sends the data in TP.DT
frames (data transfer). The message goes to all addresses (BAM), or to one address (RTS); the
address answers with CTS, a request for packets. Source: SAE J1939-21, sections 5.4.7 and 5.10.

    TP.CM  EC00  control | size, 2 bytes | packets | most at once | PGN, 3 bytes
    TP.DT  EB00  number of the packet, from 1 | 7 bytes
"""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from can_rig.decoding.message_decoder import MessageColumns, byte_column
from can_rig.logs.frames import CLASSIC_BYTES, EXTENDED, REMOTE, Frames

SOURCE_ADDRESS: Final = "SourceAddress"

GROUP_BIT: Final = 1 << 30
"""Marks the key of a parameter group."""

PEER_TO_PEER: Final = 0xF0
"""A smaller PDU format means that a destination address follows."""

GLOBAL: Final = 0xFF
"""Destination address of broadcasts."""

_MANAGEMENT, _DATA = 0xEC, 0xEB  # PDU formats, on data page 0
_RTS, _CTS, _ALL_RECEIVED, _BAM, _ABORT = 16, 17, 19, 32, 255
_PACKET_BYTES: Final = 7
_LEAST_BYTES, _MOST_BYTES = 9, 255 * _PACKET_BYTES
_LONGEST_PAUSE_NS: Final = 1_250_000_000  # T2 and T3

_Ends = tuple[str, int, int]  # bus, from, to


def group_key(identifier: int) -> int:
    """The key of a parameter group: the PGN, without addresses and priority."""
    return int(group_keys(np.array([identifier], np.uint32))[0])


def group_keys(identifier: NDArray[np.uint32]) -> NDArray[np.uint32]:
    """(n,) the same of many identifiers."""
    group = identifier >> np.uint32(8) & np.uint32(0x3FFFF)
    to_one = (group >> np.uint32(8) & np.uint32(0xFF)) < PEER_TO_PEER
    group[to_one] &= np.uint32(0x3FF00)
    return group | np.uint32(GROUP_BIT)


def identifier_of(priority: int, group: int, source: int, destination: int) -> int:
    """The identifier of a parameter group's message, if the message fitted into one frame."""
    if group >> 8 & 0xFF < PEER_TO_PEER:
        group = group & 0x3FF00 | destination
    return priority << 26 | (group & 0x3FFFF) << 8 | source


def with_source(columns: MessageColumns, frames: Frames, rows: NDArray[np.int64]) -> MessageColumns:
    """Columns with the address of each sender.

    Args:
        columns: columns of some ``frames``.
        frames: frames of one message.
        rows: (n,) their numbers in the log.
    """
    source = (frames.arbitration_id & np.uint32(0xFF)).astype(np.int64)
    source = source[np.searchsorted(rows, columns.row)]
    layout: dict[str, Any] = {**columns.layout, SOURCE_ADDRESS: byte_column(SOURCE_ADDRESS)}
    return replace(columns, signals={**columns.signals, SOURCE_ADDRESS: source}, layout=layout)


@dataclass
class _Session:
    """A message in transmission."""

    priority: int
    group: int
    size: int
    packets: list[bytes | None]
    last_ns: int
    next: int = 0
    """The packet after the last one, from 0."""


class Message(NamedTuple):
    """A complete message."""

    row: int
    """Row of the last frame within the chunk."""
    identifier: int
    data: bytes


@dataclass
class Transport:
    """Puts messages together, chunk after chunk of a log."""

    messages: int = 0
    """Number of complete messages."""
    unknown: Counter[str] = field(default_factory=Counter)
    """Number of complete messages by identifier, for parameter groups unknown to every database."""
    _lost: int = 0
    _open: dict[_Ends, _Session] = field(default_factory=dict)

    @property
    def incomplete(self) -> int:
        """Number of announced messages that still lack a packet."""
        return self._lost + len(self._open)

    def put_together(
        self, frames: Frames, rows: NDArray[np.int64]
    ) -> tuple[Frames, NDArray[np.int64]]:
        """The messages completed by the chunk, as frames of more than 8 bytes.

        A message has time and row of its last frame.
        """
        chosen = is_transport(frames)
        mine, rows = frames[chosen], rows[chosen]
        found = list(self._complete(mine))
        self.messages += len(found)
        at = np.array([message.row for message in found], np.int64)
        width = max((len(message.data) for message in found), default=CLASSIC_BYTES)
        payload = b"".join(message.data.ljust(width, b"\0") for message in found)
        whole = Frames(
            mine.time_ns[at],
            np.array([message.identifier for message in found], np.uint32),
            np.full(len(found), EXTENDED, np.uint8),
            mine.channel[at],
            np.array([len(message.data) for message in found], np.uint16),
            np.frombuffer(payload, np.uint8).reshape(len(found), width),
            frames.channels,
        )
        return whole, rows[at]

    def _complete(self, frames: Frames) -> Iterator[Message]:
        columns = (frames.time_ns, frames.arbitration_id, frames.channel)
        rows = zip(*(column.tolist() for column in columns), strict=True)
        text = frames.data[:, :CLASSIC_BYTES].tobytes()
        for row, (time_ns, identifier, channel) in enumerate(rows):
            data = text[row * CLASSIC_BYTES : (row + 1) * CLASSIC_BYTES]
            ends = (frames.channels[channel], identifier & 0xFF, identifier >> 8 & 0xFF)
            if identifier >> 16 & 0xFF == _MANAGEMENT:
                self._manage(ends, identifier >> 26, data, time_ns)
                continue
            session = self._open.get(ends)
            if session is not None and self._take(ends, session, data, time_ns):
                del self._open[ends]
                whole = b"".join(packet or b"" for packet in session.packets)[: session.size]
                made = identifier_of(session.priority, session.group, ends[1], ends[2])
                yield Message(row, made, whole)

    def _manage(self, ends: _Ends, priority: int, data: bytes, time_ns: int) -> None:
        bus, source, destination = ends
        group = int.from_bytes(data[5:8], "little")
        if data[0] in (_RTS, _BAM):
            self._drop(ends)
            size, packets = int.from_bytes(data[1:3], "little"), data[3]
            if (
                not _LEAST_BYTES <= size <= _MOST_BYTES
                or packets != -(-size // _PACKET_BYTES)
                or (data[0] == _BAM) != (destination == GLOBAL)
            ):
                self._lost += 1
                return
            self._open[ends] = _Session(priority, group, size, [None] * packets, time_ns)
            return
        there = (bus, destination, source)  # the receiver answers the sender
        for key in (there, ends) if data[0] == _ABORT else (there,):
            session = self._open.get(key)
            if session is None or session.group != group:
                continue
            if data[0] == _CTS:
                session.last_ns = time_ns
            elif data[0] in (_ALL_RECEIVED, _ABORT):
                self._drop(key)

    def _take(self, ends: _Ends, session: _Session, data: bytes, time_ns: int) -> bool:
        """Store a packet at its position; returns whether the message is complete."""
        number = data[0] - 1
        in_order = number == session.next or ends[2] != GLOBAL  # to one address: again, if asked
        pause_ns = time_ns - session.last_ns
        if not 0 <= number < len(session.packets) or not in_order or pause_ns > _LONGEST_PAUSE_NS:
            self._drop(ends)
            return False
        session.packets[number] = data[1:]
        session.next, session.last_ns = number + 1, time_ns
        return None not in session.packets

    def _drop(self, ends: _Ends) -> None:
        self._lost += self._open.pop(ends, None) is not None


def is_transport(frames: Frames) -> NDArray[np.bool_]:
    """(n,) whether a frame is one of the transport protocol."""
    page_and_format = frames.arbitration_id >> np.uint32(16) & np.uint32(0x3FF)
    right: NDArray[np.bool_] = (
        ((page_and_format == _MANAGEMENT) | (page_and_format == _DATA))
        & frames.has(EXTENDED)
        & ~frames.has(REMOTE)
        & (frames.length == CLASSIC_BYTES)
    )
    return right
