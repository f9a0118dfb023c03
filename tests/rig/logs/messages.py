"""python-can's messages as columns of frames."""

from collections.abc import Sequence

import numpy as np
from can import Message

from can_rig.logs.frames import (
    BITRATE_SWITCH,
    CLASSIC_BYTES,
    ERROR,
    ERROR_STATE,
    EXTENDED,
    FD,
    FD_BYTES,
    REMOTE,
    SENT,
    Frames,
)


def from_messages(messages: Sequence[Message], start_ns: int = 0) -> Frames:
    """python-can's messages as columns.

    Args:
        messages: with time stamps in float seconds after ``start_ns``; rounded to whole
            nanoseconds, which is exact for the first 50 days.
        start_ns: added to every time stamp [ns].
    """
    names = {str(m.channel if m.channel is not None else ""): 0 for m in messages}
    index = {name: at for at, name in enumerate(names)}
    width = FD_BYTES if any(len(m.data) > CLASSIC_BYTES for m in messages) else CLASSIC_BYTES
    payload = b"".join(bytes(m.data).ljust(width, b"\0") for m in messages)
    return Frames(
        np.array([round(m.timestamp * 1e9) + start_ns for m in messages], dtype=np.int64),
        np.array([m.arbitration_id for m in messages], dtype=np.uint32),
        np.array([_flags(m) for m in messages], dtype=np.uint8),
        np.array(
            [index[str(m.channel if m.channel is not None else "")] for m in messages],
            dtype=np.uint8,
        ),
        np.array([m.dlc for m in messages], dtype=np.uint8),
        np.frombuffer(payload, dtype=np.uint8).reshape(len(messages), width),
        tuple(names),
    )


def _flags(message: Message) -> int:
    return (
        EXTENDED * message.is_extended_id
        | REMOTE * message.is_remote_frame
        | ERROR * message.is_error_frame
        | FD * (message.is_fd and not message.is_remote_frame)  # FD has no remote frames
        | BITRATE_SWITCH * message.bitrate_switch
        | ERROR_STATE * message.error_state_indicator
        | SENT * (not message.is_rx)
    )
