"""What both nodes need to take turns on a bus: stop requests, and a watchdog in wall-clock time.

A tick is five frames in one order: reference and feedback from the plant node, then the commands
and the status from the controller node. The feedback starts the controller's tick, the status ends
the plant's, so a command that is not there when the status comes was dropped, and nobody waits.
"""

from __future__ import annotations

import signal
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from types import FrameType
from typing import Self

import can

from can_rig.buses.bus import lost
from can_rig.errors import SilentNodeError, one_line

POLL_S = 0.05  # how soon a waiting node notices a stop request
REPEAT_S = 0.25  # of an offer that nobody takes up; a partner that is there is quicker
AWAKE_S = 2 * POLL_S  # longer between two looks: this node slept itself, and so did the other
RETRY_S = 0.001  # how soon it turns to a bus again that has just refused


class Interrupted(Exception):  # noqa: N818 (not an error)
    """The node was asked to stop while it waited."""


@dataclass(frozen=True)
class Waiting:
    """Seconds of watchdog, in wall-clock time through which the waiting node itself was awake.

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


class Sender:
    """Sends on ``bus``, again and again for a bounded time where the bus refuses.

    A full transmit queue has room again as soon as the controller has sent; an interface that is
    down may come back. Both ends wait, in virtual time, so nothing is lost meanwhile.

    Args:
        bus: where to send.
        within_s: how long a frame may be refused, in wall-clock time.
    """

    def __init__(self, bus: can.BusABC, within_s: float) -> None:
        self._bus = bus
        self._within_s = within_s
        self.errors: Counter[str] = Counter()  # what the bus said, and how often

    def __call__(self, message: can.Message) -> None:
        """Send one frame.

        Raises:
            BusLostError: the bus has refused it for too long.
        """
        try:
            self._bus.send(message)
        except can.CanError as error:
            self._insist(message, error)

    def _insist(self, message: can.Message, error: can.CanError) -> None:
        deadline_s = time.monotonic() + self._within_s
        while time.monotonic() < deadline_s:
            self.errors[one_line(error)] += 1
            time.sleep(RETRY_S)
            try:
                self._bus.send(message)
            except can.CanError as again:
                error = again
            else:
                return
        raise lost(self._bus, error, self._within_s)


class Watchdog:
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
        self.silence_s = waiting.silence_s
        self.stop = stop
        self._while_alone = while_alone
        self._looked_s: float | None = None  # None: it has just been heard
        self._silent_s = self._repeated_s = 0.0
        self._trouble: can.CanError | None = None  # of the bus, since the other was heard
        self.errors: Counter[str] = Counter()  # what the bus said, and how often

    def hear(self) -> None:
        """Note that the other node has spoken: from now on only a short silence is allowed."""
        self._allowed_s = self.silence_s
        self._while_alone = None
        self._looked_s = None
        self._trouble = None

    def receive(self, tick: int) -> can.Message:
        """The next frame of any kind.

        Args:
            tick: the one under way, for the message of the error.

        Raises:
            SilentNodeError: nothing came for as long as allowed.
            BusLostError: likewise, and the bus itself had said why.
            Interrupted: a stop was requested.
        """
        while True:
            try:
                message = self._bus.recv(POLL_S)
            except can.CanError as error:  # it may come back
                self._trouble, message = error, None
                self.errors[one_line(error)] += 1
                time.sleep(RETRY_S)
            if message is not None:
                return message
            self.go_on_waiting(tick)

    def go_on_waiting(self, tick: int) -> None:
        """Note that nothing came, or a frame that the other node did not send.

        Raises:
            SilentNodeError, BusLostError, Interrupted: as ``receive``.
        """
        if self.stop.wanted:
            raise Interrupted
        now_s = time.monotonic()
        if self._looked_s is None:
            self._silent_s = self._repeated_s = 0.0
        else:
            self._silent_s += min(now_s - self._looked_s, AWAKE_S)
        self._looked_s = now_s
        if self._while_alone is not None and self._silent_s - self._repeated_s >= REPEAT_S:
            self._repeated_s = self._silent_s
            self._while_alone()
        if self._silent_s >= self._allowed_s:
            if self._trouble is not None:
                raise lost(self._bus, self._trouble, self._allowed_s)
            raise SilentNodeError(
                f"no frame from the {self._other} node for {self._allowed_s:g} s at tick {tick}"
            )
