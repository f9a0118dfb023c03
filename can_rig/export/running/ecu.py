"""Interface between the rig and a controller node outside Python: frames in, frames out."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from typing import Final, Protocol

from can_rig.export.law import filled, support
from can_rig.export.speed_words import words_of
from can_rig.frames.protection import FRAME_BYTES, USABLE, CheckStatus

SENT_BYTES: Final = 2 + FRAME_BYTES
MOST_SENT: Final = 3
COUNTS: Final = len(CheckStatus)
IDENTITY_BYTES: Final = 8

Sent = list[tuple[int, bytes]]
"""Identifier and data of each frame, in sending order."""


class Ecu(Protocol):
    """A controller node in C."""

    def take(self, frame_id: int, data: bytes) -> Sent:
        """Deliver a frame; returns the sent frames: none unless the frame completes a tick.

        Raises:
            ExportError: the node has ended.
        """

    def counts(self) -> list[int]:
        """Frames by ``CheckStatus``: for reference, feedback and, if received, speed."""

    def close(self) -> None:
        """Stop the node."""


def harness(application: Mapping[str, str]) -> dict[str, str]:
    """The files of a test bench, without the application: text by file name.

    Args:
        application: of `can_rig.export.application`.
    """
    names = ("harness.h", "harness.c")
    return {name: filled(support(name), **words_of(application)) for name in names}


def bench(application: Mapping[str, str]) -> dict[str, str]:
    """The files of a node that answers a bench over a link: text by file name.

    Args:
        application: of `can_rig.export.application`.
    """
    numbers = ", ".join(f"0x{byte:02X}" for byte in identity(application))
    texts = {
        name: filled(support(name), identity=numbers, **words_of(application))
        for name in ("bench.h", "bench.c")
    }
    return harness(application) | texts


def identity(application: Mapping[str, str]) -> bytes:
    """Identity of a controller: 8 bytes, a hash of its files."""
    said = repr(sorted(application.items())).encode()
    return hashlib.sha256(said).digest()[:IDENTITY_BYTES]


def sent(memory: bytes, n: int) -> Sent:
    """The first ``n`` frames that the harness has written."""
    frames = (memory[i * SENT_BYTES : (i + 1) * SENT_BYTES] for i in range(n))
    return [(int.from_bytes(frame[:2], "little"), frame[2:]) for frame in frames]


def rejected(counts: list[int]) -> dict[str, int]:
    """Rejected frames by reason; reasons without frames are left out."""
    named = zip(CheckStatus, counts, strict=True)
    return {status.name.lower(): n for status, n in named if n and status not in USABLE}
