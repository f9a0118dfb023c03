"""A node's access to time and to its bus: sending to a refusing bus, waiting for the other node.

A node waits no longer than permitted, and not beyond a stop request. The clock is an argument
everywhere, so tests control the time.
"""

import os
import signal
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from types import FrameType
from typing import Final, Protocol, Self, TypeVar

import can

from can_rig.buses.bus import lost
from can_rig.errors import SilentNodeError, one_line

NS_PER_S = 1_000_000_000


class Clock:
    """CLOCK_MONOTONIC, which no setting of the date moves, and the date for time stamps."""

    def now_ns(self) -> int:
        """Nanoseconds since the machine started; never goes back."""
        return time.monotonic_ns()

    def sleep_until(self, at_ns: int) -> None:
        """Return at ``at_ns`` or later; a signal handler does not shorten the sleep."""
        left_ns = at_ns - time.monotonic_ns()
        if left_ns > 0:
            time.sleep(left_ns / NS_PER_S)

    def stamp_s(self) -> float:
        """Seconds on the clock of the buses' time stamps; the date may jump at any time."""
        return time.time()


SYSTEM_CLOCK = Clock()


PROGRESS_EVERY_S: Final = 0.1

OnTick = Callable[[int], None]
"""Called with the number of ticks completed."""

Progress = Callable[[], AbstractContextManager[OnTick]]
"""Entered once the nodes have started: a display may start a thread, and a process that is forked
has a copy of the thread's locks but not the thread."""


@contextmanager
def no_progress() -> Iterator[OnTick]:
    """Shows nothing."""
    yield lambda tick: None


class Throttled:
    """Calls ``report(tick)`` at most every 0.1 s; reads the clock every ``stride`` ticks."""

    def __init__(self, report: OnTick, stride: int = 64) -> None:
        self._report = report
        self._countdown = self._stride = stride
        self._last_ns = SYSTEM_CLOCK.now_ns()

    def __call__(self, tick: int) -> None:
        """Note that ``tick`` ticks are done."""
        self._countdown -= 1
        if self._countdown:
            return
        self._countdown = self._stride
        now_ns = SYSTEM_CLOCK.now_ns()
        if now_ns - self._last_ns >= PROGRESS_EVERY_S * NS_PER_S:
            self._last_ns = now_ns
            self._report(tick)


class Pace:
    """Ticks a second from the first tick on; a node may wait long for tick 1 or join late."""

    def __init__(self, clock: Clock, on_tick: OnTick) -> None:
        self._clock = clock
        self._on_tick = on_tick
        self._first: tuple[int, int] | None = None
        self._last_tick = 0

    def __call__(self, tick: int) -> None:
        """Record the arrival at ``tick``, and pass ``tick`` on."""
        if self._first is None:
            self._first = tick, self._clock.now_ns()
        self._last_tick = tick
        self._on_tick(tick)

    @property
    def ticks_per_s(self) -> float:
        """Until now; 0 before two ticks are done."""
        if self._first is None:
            return 0.0
        elapsed_ns = self._clock.now_ns() - self._first[1]
        return (self._last_tick - self._first[0]) * NS_PER_S / elapsed_ns if elapsed_ns else 0.0


RETRY_S: Final = 0.001
"""How soon a node turns to a bus again that has just refused."""

Send = Callable[[can.Message], None]
Sent = TypeVar("Sent")


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
    recover. Both ends wait, in virtual time, so no frame is lost during retries. After ``within_s``
    of refusals the node ends.
    """

    def __init__(self, bus: NodeBus, within_s: float, clock: Clock) -> None:
        self._bus = bus
        self._within_s = within_s
        self._clock = clock
        self.errors: Counter[str] = Counter()
        """What the bus said, and how often."""

    def __call__(self, message: can.Message) -> None:
        """Send one frame; raises as ``insist``."""
        self.insist(self._bus.send, message)

    def insist(self, send: Callable[[Sent], None], frames: Sent) -> None:
        """Call ``send`` with a frame, or with several, until the bus takes them.

        Raises:
            BusLostError: the bus has refused them for ``within_s``.
        """
        deadline_ns: int | None = None
        while True:
            try:
                return send(frames)
            except can.CanError as error:
                now_ns = self._clock.now_ns()
                deadline_ns = deadline_ns or now_ns + round(self._within_s * NS_PER_S)
                if now_ns >= deadline_ns:
                    raise lost(self._bus, error, self._within_s) from None
                self.errors[one_line(error)] += 1
            pause(self._clock, RETRY_S)


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


POLL_S: Final = 0.05
"""How soon a waiting node notices a stop request."""

REPEAT_NS: Final = NS_PER_S // 4
"""How often an offer is repeated that nobody takes up; a partner that is there is quicker."""

AWAKE_NS: Final = round(2 * POLL_S * NS_PER_S)
"""After longer between two looks this node has slept itself, and so may have the other."""


class Interrupted(Exception):  # noqa: N818 (not an error)
    """A stop was requested during a wait."""


@dataclass(frozen=True)
class Timeouts:
    """Permitted silence in seconds; only time with the waiting node awake counts.

    ``first_s`` until the first frame of the other node, ``silence_s`` until each later frame.
    """

    first_s: float = 60.0
    silence_s: float = 1.0


DEFAULT_TIMEOUTS: Final = Timeouts()


class StopRequest:
    """Set by a signal handler, read between ticks and while waiting.

    The end of the process ``parent`` is a request too: a killed parent sends no signal.
    """

    def __init__(self, parent: int | None = None) -> None:
        self._wanted, self._parent = False, parent

    @property
    def wanted(self) -> bool:
        """Whether a stop was requested."""
        return self._wanted or (self._parent is not None and os.getppid() != self._parent)

    @wanted.setter
    def wanted(self, wanted: bool) -> None:
        self._wanted = wanted

    def on_signals(self) -> Self:
        """Let Ctrl-C, SIGTERM and a closed terminal end the node between two ticks, for good."""
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            if signal.getsignal(number) is not signal.SIG_IGN:  # nohup
                signal.signal(number, self._want)
        return self

    def require_none(self) -> None:
        """Do nothing, unless a stop was requested.

        Raises:
            Interrupted: a stop was requested.
        """
        if self.wanted:
            raise Interrupted

    def _want(self, _signal: int, _frame: FrameType | None) -> None:
        self._wanted = True


class Watchdog:
    """Receives from ``bus`` and gives up when the node ``other`` is silent.

    ``while_alone`` is called now and then until the other node's first frame.
    """

    def __init__(
        self,
        bus: NodeBus,
        other: str,
        timeouts: Timeouts,
        stop: StopRequest,
        while_alone: Callable[[], None] | None = None,
        clock: Clock = SYSTEM_CLOCK,
    ) -> None:
        self._bus = bus
        self._other = other
        self._allowed_s = timeouts.first_s
        self.silence_s = timeouts.silence_s
        self.stop = stop
        self._while_alone = self._while_starting = while_alone
        self._clock = clock
        self._looked_ns: int | None = None  # None: it has just been heard
        self._silent_ns = self._repeated_ns = 0
        self._trouble: can.CanError | None = None  # of the bus, since the other was heard
        self.errors: Counter[str] = Counter()
        """What the bus said, and how often."""

    def hear(self) -> None:
        """Record a frame of the other node: from now on only a short silence is permitted."""
        self._allowed_s = self.silence_s
        self._while_alone = None
        self._looked_ns = None
        self._silent_ns = self._repeated_ns = 0
        self._trouble = None

    def expect_restart(self) -> None:
        """The other node begins again: what is called while this node is alone is called again."""
        self._while_alone = self._while_starting

    def receive(self, tick: int) -> can.Message:
        """The next frame of any kind.

        Raises:
            SilentNodeError: no frame came within the permitted silence.
            BusLostError: likewise, after an error message of the bus.
            Interrupted: a stop was requested.
        """
        while True:
            try:
                message = self._bus.recv(POLL_S)
            except can.CanError as error:  # it may come back
                self._trouble, message = error, None
                self.errors[one_line(error)] += 1
                pause(self._clock, RETRY_S)
            if message is not None:
                return message
            self.go_on_waiting(tick)

    def glance(self, timeout_s: float) -> can.Message | None:
        """A frame of any kind, where the other node need not speak; None: none came in time.

        Raises:
            Interrupted: a stop was requested.
        """
        self.stop.require_none()
        try:
            return self._bus.recv(timeout_s)
        except can.CanError as error:
            self.errors[one_line(error)] += 1
            pause(self._clock, RETRY_S)
            return None

    def go_on_waiting(self, tick: int) -> None:
        """Record a timeout, or a frame of a foreign sender.

        Only time with this node awake counts as silence: the end of a machine's suspension
        wakes both nodes. Foreign frames do not shorten the other node's silence.

        Raises:
            SilentNodeError, BusLostError, Interrupted: as ``receive``.
        """
        self.stop.require_none()
        now_ns = self._clock.now_ns()
        if self._looked_ns is not None:
            self._silent_ns += min(now_ns - self._looked_ns, AWAKE_NS)
        self._looked_ns = now_ns
        if self._while_alone is not None and self._silent_ns - self._repeated_ns >= REPEAT_NS:
            self._repeated_ns = self._silent_ns
            self._while_alone()
        if self._silent_ns >= self._allowed_s * NS_PER_S:
            if self._trouble is not None:
                raise lost(self._bus, self._trouble, self._allowed_s)
            raise SilentNodeError(
                f"no frame from the {self._other} node for {self._allowed_s:g} s at tick {tick}"
            )
