"""The bus operations of a node, and the handling of a refusing bus."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from typing import Final, Protocol

import can

from can_rig.buses.bus import lost
from can_rig.errors import one_line
from can_rig.nodes.clock import NS_PER_S, Clock

RETRY_S: Final = 0.001
"""How soon a node turns to a bus again that has just refused."""

Send = Callable[[can.Message], None]


class NodeBus(Protocol):
    """The bus interface of a node; every python-can bus conforms."""

    def send(self, msg: can.Message) -> None:
        """Send a frame, or raise ``can.CanError``."""

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """The next frame; returns None after ``timeout`` seconds without a frame."""


def pause(clock: Clock, seconds: float) -> None:
    """Wait."""
    clock.sleep_until(clock.now_ns() + round(seconds * NS_PER_S))


class PersistentSender:
    """Sends on ``bus``, and retries a refused frame for a bounded time.

    A full transmit queue drains as soon as the controller has sent; an interface that is down may
    recover. Both ends wait, in virtual time, so no frame is lost during retries.

    Args:
        bus: the sending bus.
        within_s: the longest time of refusals before an error.
        clock: the time.
    """

    def __init__(self, bus: NodeBus, within_s: float, clock: Clock) -> None:
        self._bus = bus
        self._within_s = within_s
        self._clock = clock
        self.errors: Counter[str] = Counter()
        """What the bus said, and how often."""

    def __call__(self, message: can.Message) -> None:
        """Send one frame.

        Raises:
            BusLostError: the bus has refused the frame for ``within_s``.
        """
        try:
            self._bus.send(message)
        except can.CanError as error:
            self._insist(message, error)

    def _insist(self, message: can.Message, error: can.CanError) -> None:
        deadline_ns = self._clock.now_ns() + round(self._within_s * NS_PER_S)
        while self._clock.now_ns() < deadline_ns:
            self.errors[one_line(error)] += 1
            pause(self._clock, RETRY_S)
            try:
                self._bus.send(message)
            except can.CanError as again:
                error = again
            else:
                return
        raise lost(self._bus, error, self._within_s)


class TolerantBus:
    """A bus without retries: refused frames are lost, and counted in ``errors``.

    For real time: a delayed frame would belong to a past tick, and an interface that is down may
    recover; the watchdog ends a node that hears no frame during the outage.
    """

    def __init__(self, bus: NodeBus, clock: Clock) -> None:
        self._bus = bus
        self._clock = clock
        self.errors: Counter[str] = Counter()
        """What the bus said, and how often."""

    def send(self, msg: can.Message) -> None:
        """Send, or count why not."""
        try:
            self._bus.send(msg)
        except can.CanError as error:
            self.errors[one_line(error)] += 1

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """The next frame; returns None after a timeout or a bus failure."""
        try:
            return self._bus.recv(timeout)
        except can.CanError as error:
            self.errors[one_line(error)] += 1
            pause(self._clock, min(RETRY_S, timeout or 0.0))
            return None


def bus_events(node: str, bus: NodeBus, *errors: Counter[str]) -> dict[str, dict[str, int]]:
    """Counts of bus errors and other events on one node's bus; zero counts are left out."""
    counts: Counter[str] = Counter()
    for each in errors:
        counts.update(each)
    counts["frames dropped unread"] = getattr(bus, "lost_frames", 0)
    counts = +counts  # without zeros
    return {node: dict(counts)} if counts else {}
