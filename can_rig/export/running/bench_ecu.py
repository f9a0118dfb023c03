"""A controller node that answers a bench over a link of bytes: ``bench.h`` says how."""

from __future__ import annotations

from typing import Final, Protocol

from can_rig.errors import ExportError
from can_rig.export.running.ecu import COUNTS, IDENTITY_BYTES, MOST_SENT, SENT_BYTES, Sent, sent

ORDER_BYTES: Final = 12


def order(letter: bytes, *parts: bytes) -> bytes:
    """An order with its operands."""
    return b"".join((letter, *parts)).ljust(ORDER_BYTES, b"\0")


def frame_order(frame_id: int, data: bytes) -> bytes:
    """The order to take a frame."""
    return order(b"F", frame_id.to_bytes(2, "little"), bytes([len(data)]), data)


def time_order(now_us: int) -> bytes:
    """The order that sets the clock, modulo 2^32."""
    return order(b"T", (now_us & 0xFFFFFFFF).to_bytes(4, "little"))


RESTART: Final = order(b"R")
COUNT: Final = order(b"C")


class Link(Protocol):
    """Bytes to and from a program, in order."""

    def write(self, data: bytes) -> None:
        """Send all bytes."""

    def read(self, size: int) -> bytes:
        """The next ``size`` bytes.

        Raises:
            ExportError: the bytes do not arrive.
        """

    def close(self) -> None:
        """Close the link."""


class BenchEcu:
    """The program at the other end of ``link``; see ``Ecu``.

    Args:
        link: the link to the program.
        receivers: number of received frames: 2, or 3 with the speed.
    """

    def __init__(self, link: Link, receivers: int = 2) -> None:
        self._link = link
        self._receivers = receivers

    def restart(self) -> bytes:
        """Restart the node, as after power-up; returns the controller's identity, 8 bytes."""
        return self._ask(RESTART, IDENTITY_BYTES)

    def take(self, frame_id: int, data: bytes) -> Sent:
        """See ``Ecu``."""
        (n,) = self._ask(frame_order(frame_id, data), 1)
        if n > MOST_SENT:
            raise ExportError(f"the controller says that it sent {n} frames: must be 0 to 3")
        return sent(self._link.read(n * SENT_BYTES), n)

    def counts(self) -> list[int]:
        """See ``Ecu``."""
        answer = self._ask(COUNT, 4 * self._receivers * COUNTS)
        return [int.from_bytes(answer[i : i + 4], "little") for i in range(0, len(answer), 4)]

    def close(self) -> None:
        """See ``Ecu``."""
        self._link.close()

    def _ask(self, order: bytes, size: int) -> bytes:
        self._link.write(order)
        return self._link.read(size)
