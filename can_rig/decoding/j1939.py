"""J1939: what an identifier of 29 bits says, and whose frames make up a longer message.

    3 bits priority | 18 bits parameter group number (PGN) | 8 bits source address

In the PGN the second byte is the PDU format; below 240 the third one is no part of the number, but
the destination address. Source: SAE J1939-21, section 5.2.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from can_rig.decoding.message_columns import MessageColumns
from can_rig.decoding.signal_columns import unsigned_column
from can_rig.logs.frames import Frames

SOURCE_ADDRESS: Final = "SourceAddress"

GROUP_BIT: Final = 1 << 30
"""Marks the key of a parameter group."""

PEER_TO_PEER: Final = 0xF0
"""A smaller PDU format means that a destination address follows."""

GLOBAL: Final = 0xFF
"""Destination address of broadcasts."""


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
    layout: dict[str, Any] = {**columns.layout, SOURCE_ADDRESS: unsigned_column(SOURCE_ADDRESS, 8)}
    return replace(columns, signals={**columns.signals, SOURCE_ADDRESS: source}, layout=layout)
