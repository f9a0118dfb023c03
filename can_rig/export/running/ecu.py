"""A controller node that is no Python, as the rig talks to it: frames in, frames out."""

from __future__ import annotations

from typing import Final, Protocol

from can_rig.export.law import support
from can_rig.frames.protection import FRAME_BYTES, USABLE, CheckStatus

SENT_BYTES: Final = 2 + FRAME_BYTES
MOST_SENT: Final = 3
COUNTS: Final = len(CheckStatus)

Sent = list[tuple[int, bytes]]
"""Identifier and data of each frame, in the order in which they were sent."""


class Ecu(Protocol):
    """A controller node in C."""

    def take(self, frame_id: int, data: bytes) -> Sent:
        """Hand it a frame; what it sends, which is nothing unless the frame completes a tick.

        Raises:
            ExportError: it has ended.
        """

    def counts(self) -> list[int]:
        """Frames of the reference, then of the feedback, by ``CheckStatus``."""

    def close(self) -> None:
        """End it."""


def harness() -> dict[str, str]:
    """What a test bench needs beside the application: text by file name."""
    return {name: support(name) for name in ("harness.h", "harness.c")}


def sent(memory: bytes, n: int) -> Sent:
    """The first ``n`` frames that the harness has written."""
    frames = (memory[i * SENT_BYTES : (i + 1) * SENT_BYTES] for i in range(n))
    return [(int.from_bytes(frame[:2], "little"), frame[2:]) for frame in frames]


def rejected(counts: list[int]) -> dict[str, int]:
    """Frames that were not used, by reason, if there are any."""
    named = zip(CheckStatus, counts, strict=True)
    return {status.name.lower(): n for status, n in named if n and status not in USABLE}
