"""The frames with which two nodes compare their scenarios: a key and its digest."""

import json
import zlib
from struct import Struct
from typing import Final, NamedTuple

from can import Message

from can_rig.errors import DbcError
from can_rig.frames.codec import FRAME_BYTES, Checker, CheckStatus, Protector
from can_rig.frames.databases import attribute, load_dbc, shipped_dbc

DBC: Final = "agreement.dbc"
SENDERS: Final = {"plant": "PLANT", "controller": "CONTROLLER"}

ASKED: Final = 0xFFFF
"""Key of a node that asks whether a node of the same kind is there."""
PRESENT: Final = 0xFFFE
"""Key of the answer."""

_FRAME: Final = Struct("<BBHI")  # checksum; counter; key; digest
_PLACES: Final = {"Checksum": (0, 8), "AliveCounter": (8, 4), "Key": (16, 16), "Digest": (32, 32)}
_DAMAGED: Final = (CheckStatus.WRONG_CRC, CheckStatus.WRONG_LENGTH)


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

    Raises:
        DbcError: a DBC without this message, or a different layout.
    """

    def __init__(self, node: str) -> None:
        path = shipped_dbc(DBC)
        found = [m for m in load_dbc(path).messages if m.senders == [SENDERS[node]]]
        if len(found) != 1:
            raise DbcError(f"{path}: {len(found)} messages of {SENDERS[node]}; it must have one")
        (message,) = found
        places = {each.name: (each.start, each.length) for each in message.signals}
        data_id = attribute(message, "E2EDataId")
        if places != _PLACES or message.length != FRAME_BYTES or not isinstance(data_id, int):
            raise DbcError(f"{path}: message {message.name}: it must have the signals {_PLACES}")
        self.frame_id: Final = message.frame_id
        self._protector = Protector(data_id)
        self._checker = Checker(data_id)

    def message(self, said: Comparison) -> Message:
        """The next frame, ready to send."""
        data = bytearray(_FRAME.pack(0, 0, said.key, said.digest))
        self._protector.protect(data)
        return Message(arbitration_id=self.frame_id, is_extended_id=False, data=data)

    def read(self, message: Message) -> Comparison | None:
        """The content of a frame; None for a damaged frame or another identifier.

        The counter has no influence: losing or repeating a frame causes no wrong comparison.
        """
        if message.arbitration_id != self.frame_id:
            return None
        if message.is_extended_id or message.is_remote_frame or message.is_error_frame:
            return None
        if self._checker.check(message.data) in _DAMAGED:
            return None
        _, _, key, said = _FRAME.unpack(message.data)
        return Comparison(key, said)
