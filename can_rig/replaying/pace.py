"""Frames of a log onto a bus, in the log's own time.

Every frame has its own deadline in whole nanoseconds since the first frame, so delays do not add up
over hours. A frame later than its deadline, on a slow machine or after a backward step of the log's
clock, is sent at once.
"""

from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass
from fractions import Fraction
from typing import Final

import can

from can_rig.errors import BusError
from can_rig.logs.frames import ERROR, FD, NS_PER_S, Frames
from can_rig.nodes.bus_access import SYSTEM_CLOCK, Clock, StopRequest

SLICE_NS: Final = NS_PER_S // 20
"""Longest delay before a stop request takes effect."""

ROOM_S: Final = 0.1
"""Without a pace, how long a frame waits for a slow listener."""

LISTEN_EVERY: Final = 64
"""Number of sent frames between two readings of the bus; unread frames would delay senders."""

REFUSED_S: Final = 1.0
"""How long a bus may refuse a frame, for example because of a full queue."""

RETRY_NS: Final = NS_PER_S // 1000


@dataclass
class Paced:
    """The result of a replay onto a bus."""

    sent: int = 0
    error_frames: int = 0
    """Not sent: only a bus makes error frames."""
    fd_frames: int = 0
    """Not sent: the bus is a classic one."""
    late_ns: int = 0
    """Largest delay of a frame; 0 without a pace."""
    log_ns: int = 0
    """From the first sent frame to the last, by the log."""
    wall_ns: int = 0
    """By the clock."""


class Pacer:
    """Sends frames at their times.

    Args:
        bus: the destination.
        speed: multiple of the log's pace, above 0; None: as fast as the bus accepts frames.
        stop: ends the replay between two frames.
        clock: the time.
    """

    def __init__(
        self,
        bus: can.BusABC,
        speed: Fraction | None,
        stop: StopRequest,
        clock: Clock = SYSTEM_CLOCK,
    ) -> None:
        self._bus = bus
        self._fd = bus.protocol is not can.CanProtocol.CAN_20
        self._speed = speed
        self._stop = stop
        self._clock = clock
        self._first_ns: tuple[int, int] | None = None  # by the log, by the clock
        self.result: Final = Paced()

    def send_all(self, chunks: Iterable[Frames]) -> Paced:
        """Send a log, up to a stop request.

        Raises:
            BusError: the bus refuses a frame for too long.
        """
        for frames in chunks:
            for time_ns, kind, message in zip(
                frames.time_ns.tolist(), frames.flags.tolist(), frames.messages(), strict=True
            ):
                if kind & ERROR:
                    self.result.error_frames += 1
                elif kind & FD and not self._fd:
                    self.result.fd_frames += 1
                elif not self._wait(time_ns) or not self._put(message):
                    return self.result
            if self._stop.wanted:
                break
        return self.result

    def _wait(self, time_ns: int) -> bool:
        """Wait for the frame's deadline; return False at a stop request."""
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
        """Discard the frames of other senders."""
        with suppress(can.CanError):
            for _ in range(LISTEN_EVERY * LISTEN_EVERY):
                if self._bus.recv(0) is None:
                    return

    def _put(self, message: can.Message) -> bool:
        """Send a frame, repeatedly if the bus refuses; return False at a stop request."""
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
