"""The frames with which two nodes compare their scenarios: a key and its digest."""

import json
import zlib
from typing import Final, NamedTuple

from can import Message

from can_rig.frames.codec import COUNTERS
from can_rig.frames.databases import load_dbc, shipped_dbc
from can_rig.frames.operator_frames import intact, protected

DBC: Final = "agreement.dbc"
SENDERS: Final = {"plant": "PLANT", "controller": "CONTROLLER"}

ASKED: Final = 0xFFFF
"""Key of a node that asks whether a node of the same kind is there."""
PRESENT: Final = 0xFFFE
"""Key of the answer."""


class Comparison(NamedTuple):
    """The content of one frame."""

    key: int
    """0: the whole scenario; n: its n-th key; `ASKED` or `PRESENT`."""
    digest: int
    """See `digest`; with `ASKED` and `PRESENT` a number that tells the sender from others."""


def digest(key: str, value: object) -> int:
    """CRC-32 of a key and its value."""
    return zlib.crc32(json.dumps([key, value]).encode())


class ComparisonFrame:
    """Both ends of one comparison message.

    Args:
        node: the sending node, a key of `SENDERS`.
    """

    def __init__(self, node: str) -> None:
        every = load_dbc(shipped_dbc(DBC)).messages
        (self._frame,) = (each for each in every if each.senders == [SENDERS[node]])
        self.frame_id: Final = self._frame.frame_id
        self._counter = -1

    def message(self, said: Comparison) -> Message:
        """The next frame, ready to send."""
        self._counter = (self._counter + 1) % COUNTERS
        return protected(self._frame, {"Key": said.key, "Digest": said.digest}, self._counter)

    def read(self, message: Message) -> Comparison | None:
        """The content of a frame; None for a damaged frame or another identifier.

        The counter has no influence: losing or repeating a frame causes no wrong comparison.
        """
        said = intact(self._frame, message) if message.arbitration_id == self.frame_id else None
        return None if said is None else Comparison(int(said["Key"]), int(said["Digest"]))
