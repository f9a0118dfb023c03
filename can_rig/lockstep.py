"""What both nodes need to take turns on a bus: stop requests, and a watchdog in wall-clock time.

A tick is five frames in one order: reference and feedback from the plant node, then the commands
and the status from the controller node. The feedback starts the controller's tick, the status ends
the plant's, so a command that is not there when the status comes was dropped, and nobody waits.
"""

from __future__ import annotations

import signal
import time
from collections.abc import Callable
from dataclasses import dataclass
from types import FrameType
from typing import Self

import can

from can_rig.errors import SilentNodeError

POLL_S = 0.05  # how soon a waiting node notices a stop request


class Interrupted(Exception):  # noqa: N818 (not an error)
    """The node was asked to stop while it waited."""


@dataclass(frozen=True)
class Waiting:
    """Seconds of patience, in wall-clock time.

    ``first_s`` for the other node to appear, ``silence_s`` for its next frame after that.
    """

    first_s: float = 60.0
    silence_s: float = 1.0


class StopRequest:
    """Set by a signal handler, read between ticks and while waiting."""

    def __init__(self) -> None:
        self.wanted = False

    def on_signals(self) -> Self:
        """Let Ctrl-C, SIGTERM and a closed terminal end the node between two ticks, for good."""
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            if signal.getsignal(number) is not signal.SIG_IGN:  # nohup
                signal.signal(number, self._want)
        return self

    def _want(self, _signal: int, _frame: FrameType | None) -> None:
        self.wanted = True


class Patience:
    """Receives from ``bus`` and gives up on a silent node.

    Args:
        bus: where to receive.
        other: what the node on the other end is called.
        waiting: how long.
        stop: read while waiting.
        while_alone: called now and then until the other node is first heard.
    """

    def __init__(
        self,
        bus: can.BusABC,
        other: str,
        waiting: Waiting,
        stop: StopRequest,
        while_alone: Callable[[], None] | None = None,
    ) -> None:
        self._bus = bus
        self._other = other
        self._allowed_s = waiting.first_s
        self._silence_s = waiting.silence_s
        self.stop = stop
        self._while_alone = while_alone
        self._waiting_since_s: float | None = None  # None: it has just been heard

    def hear(self) -> None:
        """Note that the other node has spoken: from now on only a short silence is allowed."""
        self._allowed_s = self._silence_s
        self._while_alone = None
        self._waiting_since_s = None

    def receive(self, tick: int) -> can.Message:
        """The next frame of any kind.

        Args:
            tick: the one under way, for the message of the error.

        Raises:
            SilentNodeError: nothing came for as long as allowed.
            Interrupted: a stop was requested.
        """
        message = self._bus.recv(POLL_S)
        while message is None:
            self.go_on_waiting(tick)
            if self._while_alone is not None:
                self._while_alone()
            message = self._bus.recv(POLL_S)
        return message

    def go_on_waiting(self, tick: int) -> None:
        """Note that nothing came, or a frame that the other node did not send.

        Raises:
            SilentNodeError, Interrupted: as ``receive``.
        """
        if self.stop.wanted:
            raise Interrupted
        now_s = time.monotonic()
        if self._waiting_since_s is None:
            self._waiting_since_s = now_s
        elif now_s - self._waiting_since_s >= self._allowed_s:
            raise SilentNodeError(
                f"no frame from the {self._other} node for {self._allowed_s:g} s at tick {tick}"
            )
