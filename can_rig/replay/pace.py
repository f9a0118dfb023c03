"""Frames of a log onto a bus, in the log's own time.

Every frame has a deadline of its own, counted in whole nanoseconds from the first one, so nothing
adds up over hours: a frame that was late does not move the next. A frame whose time has passed,
because the machine was slow or the log's clock went back, is sent at once.
"""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass
from fractions import Fraction
from typing import Final

import can

from can_rig.errors import BusError
from can_rig.logs.frames import ERROR, FD, NS_PER_S, Frames
from can_rig.nodes.bus_access import StopRequest
from can_rig.nodes.clock import SYSTEM_CLOCK, Clock

SLICE_NS: Final = NS_PER_S // 20
"""How soon a stop request is noticed."""

ROOM_S: Final = 0.1
"""Without a pace, how long a frame waits for a listener that is behind, before it is refused."""

LISTEN_EVERY: Final = 64
"""Frames after which what others have sent is taken off the bus, so that they are not held up."""

REFUSED_S: Final = 1.0
"""How long a bus may refuse a frame, as one does whose queue is full."""

RETRY_NS: Final = NS_PER_S // 1000


@dataclass
class Paced:
    """How it went."""

    sent: int = 0
    error_frames: int = 0
    """Not sent: only a bus itself makes them."""
    fd_frames: int = 0
    """Not sent: the bus is a classic one."""
    late_ns: int = 0
    """The most that a frame was behind its time; without a pace 0."""
    log_ns: int = 0
    """From the first frame sent to the last, by the log."""
    wall_ns: int = 0
    """By the clock."""


class Pacer:
    """Sends frames when their time has come.

    Args:
        bus: where to.
        speed: times the log's own pace; None: as fast as the bus takes them.
        stop: ends it between two frames.
        clock: what time it is.

    Raises:
        ValueError: a speed that is not above zero.
    """

    def __init__(
        self,
        bus: can.BusABC,
        speed: Fraction | None,
        stop: StopRequest,
        clock: Clock = SYSTEM_CLOCK,
    ) -> None:
        if speed is not None and speed <= 0:
            raise ValueError(f"speed is {speed}; it must be above 0")
        self._bus = bus
        self._fd = bus.protocol is not can.CanProtocol.CAN_20
        self._speed = speed
        self._stop = stop
        self._clock = clock
        self._first_ns: tuple[int, int] | None = None  # by the log, by the clock
        self.result: Final = Paced()

    def send(self, frames: Frames) -> bool:
        """Send a chunk of the log; whether to go on with the next.

        Raises:
            BusError: the bus refuses a frame for too long.
        """
        flags = frames.flags.tolist()
        for time_ns, kind, message in zip(
            frames.time_ns.tolist(), flags, frames.messages(), strict=True
        ):
            if kind & ERROR:
                self.result.error_frames += 1
            elif kind & FD and not self._fd:
                self.result.fd_frames += 1
            elif not self._wait(time_ns) or not self._put(message):
                return False
        return not self._stop.wanted

    def send_all(self, chunks: Iterable[Frames]) -> Paced:
        """Send a whole log, or as much as there is before the stop request."""
        for frames in chunks:
            if not self.send(frames):
                break
        return self.result

    def _wait(self, time_ns: int) -> bool:
        """Until the frame's time has come; False at a stop request."""
        if self._first_ns is None:
            self._first_ns = time_ns, self._clock.now_ns()
        since_ns = time_ns - self._first_ns[0]
        self.result.log_ns = max(self.result.log_ns, since_ns)
        if self._speed is None:
            return not self._stop.wanted
        due_ns = self._first_ns[1] + since_ns * self._speed.denominator // self._speed.numerator
        while not self._stop.wanted:
            now_ns = self._clock.now_ns()
            if now_ns >= due_ns:
                self.result.late_ns = max(self.result.late_ns, now_ns - due_ns)
                return True
            self._take_away()
            self._clock.sleep_until(min(due_ns, now_ns + SLICE_NS))
        return False

    def _take_away(self) -> None:
        """What others have sent, unread."""
        with suppress(can.CanError):
            for _ in range(LISTEN_EVERY * LISTEN_EVERY):
                if self._bus.recv(0) is None:
                    return

    def _put(self, message: can.Message) -> bool:
        """Onto the bus, again and again for a while if it refuses; False at a stop request."""
        deadline_ns = None
        if self.result.sent % LISTEN_EVERY == 0:
            self._take_away()
        while not self._stop.wanted:
            try:
                self._bus.send(message, ROOM_S if self._speed is None else None)
            except can.CanError as error:
                now_ns = self._clock.now_ns()
                if deadline_ns is None:
                    deadline_ns = now_ns + round(REFUSED_S * NS_PER_S)
                if now_ns >= deadline_ns:
                    reason = " ".join(str(error).split())
                    raise BusError(
                        f"the bus refuses frame {message.arbitration_id:X} for {REFUSED_S:g} s, "
                        f"after {self.result.sent} that it took: {reason}"
                    ) from None
                self._clock.sleep_until(now_ns + RETRY_NS)
            else:
                self.result.sent += 1
                assert self._first_ns is not None
                self.result.wall_ns = self._clock.now_ns() - self._first_ns[1]
                return True
        return False
