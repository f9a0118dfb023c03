"""A CAN frame as a datagram: a header of fixed size, then the payload."""

from __future__ import annotations

import struct
from typing import Final

from can import Message

HEADER: Final = struct.Struct("<dIBB")
"""Time stamp [s], identifier, flags, DLC."""

MAX_BYTES: Final = HEADER.size + 64

EXTENDED, REMOTE, ERROR, FD, BRS, ESI, OWN, CUT_OFF = (1 << bit for bit in range(8))
"""Flags. OWN: sent by the receiver itself; CUT_OFF: not a frame, but a sender's last datagram."""

CUT_OFF_NOTICE: Final = HEADER.pack(0.0, 0, CUT_OFF, 0)
"""A sender's notice to a listener before cutting the listener off."""


def flags_of(msg: Message) -> int:
    """The flags of a frame other than a plain data frame."""
    return (
        EXTENDED * msg.is_extended_id
        | REMOTE * msg.is_remote_frame
        | ERROR * msg.is_error_frame
        | FD * msg.is_fd
        | BRS * msg.bitrate_switch
        | ESI * msg.error_state_indicator
    )


def message(datagram: bytes, channel: str) -> tuple[Message, int]:
    """The frame of a datagram, and its flags."""
    timestamp, identifier, flags, dlc = HEADER.unpack_from(datagram)
    data = bytearray(datagram[HEADER.size :])
    if not flags:
        return Message(timestamp, identifier, False, False, False, channel, dlc, data), 0
    return Message(
        timestamp=timestamp,
        arbitration_id=identifier,
        is_extended_id=bool(flags & EXTENDED),
        is_remote_frame=bool(flags & REMOTE),
        is_error_frame=bool(flags & ERROR),
        channel=channel,
        dlc=dlc,
        data=data,
        is_fd=bool(flags & FD),
        is_rx=not flags & OWN,
        bitrate_switch=bool(flags & BRS),
        error_state_indicator=bool(flags & ESI),
    ), flags
