"""A bus that refuses or is full of foreign frames: the node's wait and its error line."""

import errno
import signal
from collections import Counter

import can
import pytest

from can_rig.errors import BusLostError, SilentNodeError
from can_rig.nodes.bus_access import (
    Interrupted,
    PersistentSender,
    StopRequest,
    Timeouts,
    TolerantBus,
    Watchdog,
    bus_events,
)
from tests.clock import TurnedClock

FRAME = can.Message(arbitration_id=0x300, is_extended_id=False)


def refusal(code: int | None) -> can.CanOperationError:
    return can.CanOperationError("Failed to transmit: no", code)


class Refusing(can.BusABC):
    """Refuses a number of times; what it has sent comes back."""

    channel_info = "socketcan channel 'can9'"
    channel = "can9"

    def __init__(self, clock: TurnedClock, times: int, code: int | None = errno.ENOBUFS) -> None:
        super().__init__(channel=self.channel)
        self.clock = clock
        self.times, self.code, self.asked = times, code, 0
        self.sent: list[can.Message] = []

    def _refuse(self) -> None:
        self.asked += 1
        if self.asked <= self.times:
            raise refusal(self.code)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        self._refuse()
        self.sent.append(msg)

    def recv(self, timeout: float | None = None) -> can.Message | None:
        self._refuse()
        self.clock.pass_s(0.001 if self.sent else timeout or 0.0)
        return self.sent[0] if self.sent else None


@pytest.fixture
def clock():
    return TurnedClock()


@pytest.mark.parametrize("times", [0, 1, 30])
def test_a_refused_frame_is_sent_once_as_soon_as_there_is_room(times, clock):
    with Refusing(clock, times) as bus:
        send = PersistentSender(bus, 10.0, clock)
        send(FRAME)
        assert bus.sent == [FRAME]
        assert sum(send.errors.values()) == times  # reported, every one


@pytest.mark.parametrize(
    ("code", "expected"),
    [(errno.ENETDOWN, "the interface has been down for 0.05 s: sudo ip link set up can9"),
     (errno.ENODEV, "the interface is gone: is the adapter plugged in"),
     (errno.ENOBUFS, "the transmit queue has been full for 0.05 s"),
     (errno.EIO, "Failed to transmit: no"), (None, "Failed to transmit: no")],
)  # fmt: skip
def test_the_bound_and_the_line(code, expected, clock):
    with Refusing(clock, 10**9, code) as bus, pytest.raises(BusLostError) as caught:
        PersistentSender(bus, 0.05, clock)(FRAME)
    assert str(caught.value).startswith(f"socketcan channel 'can9': {expected}")
    assert bus.asked == 51  # once, and every millisecond of the 50 that are allowed
    assert clock.now_s == pytest.approx(0.05)
    assert bus.sent == []


def test_the_line_says_what_is_wrong_now(clock):
    """Not what was wrong at first: what has passed needs no remedy."""

    class Falling(Refusing):
        def send(self, msg: can.Message, timeout: float | None = None) -> None:
            self.code = errno.ENETDOWN if self.asked else errno.ENOBUFS
            super().send(msg, timeout)

    with Falling(clock, 10**9) as bus, pytest.raises(BusLostError, match="has been down"):
        PersistentSender(bus, 0.05, clock)(FRAME)


def test_in_real_time_a_refused_frame_is_counted_and_not_sent(clock):
    """A repeated frame would arrive in a wrong tick."""
    with Refusing(clock, 2) as bus:
        tolerant = TolerantBus(bus, clock)
        for _ in range(3):
            tolerant.send(FRAME)
        assert bus.sent == [FRAME]
        assert sum(tolerant.errors.values()) == 2
    assert clock.ns == 0


@pytest.mark.parametrize(
    ("timeout_s", "paused_ns"), [(None, 0), (0.0, 0), (0.0004, 400_000), (5.0, 1_000_000)]
)
def test_in_real_time_a_receive_error_is_counted_and_costs_no_more_than_the_timeout(
    timeout_s, paused_ns, clock
):
    with Refusing(clock, 2) as bus:
        bus.sent.append(FRAME)
        tolerant = TolerantBus(bus, clock)
        for already in (0, 1):
            assert tolerant.recv(timeout_s) is None
            assert clock.ns == (1 + already) * paused_ns
        assert sum(tolerant.errors.values()) == 2
        assert tolerant.recv(timeout_s) is FRAME


def test_the_timeout_is_the_bus_s(clock):
    with Refusing(clock, 0) as bus:
        assert TolerantBus(bus, clock).recv(0.25) is None
    assert clock.now_s == pytest.approx(0.25)


class Losing:
    """The part of a bus that counts what nobody has read in time."""

    def __init__(self, lost_frames: int) -> None:
        self.lost_frames = lost_frames


def test_the_events_of_a_bus_are_all_that_occurred(clock):
    sending, receiving = Counter({"full": 2, "down": 1}), Counter({"down": 4, "never": 0})
    assert bus_events("plant", Losing(3), sending, receiving) == {
        "plant": {"full": 2, "down": 5, "frames dropped unread": 3}
    }
    assert bus_events("plant", Losing(0), Counter()) == {}
    with Refusing(clock, 0) as bus:  # which counts no lost frames
        assert bus_events("controller", bus, Counter({"full": 1})) == {"controller": {"full": 1}}
        assert bus_events("controller", bus) == {}


def test_a_receive_error_that_passes_is_counted_and_nothing_else(clock):
    with Refusing(clock, 3, errno.ENETDOWN) as bus:
        bus.sent.append(FRAME)
        watchdog = Watchdog(bus, "plant", Timeouts(10.0, 10.0), StopRequest(), clock=clock)
        assert watchdog.receive(0) is FRAME
        assert sum(watchdog.errors.values()) == 3


@pytest.mark.parametrize(("times", "asked"), [(1, 2), (10**9, 51)])
def test_after_a_receive_error_the_silence_is_the_bus_s(times, asked, clock):
    """A failing bus is asked every millisecond: the other node needs the processor."""
    with Refusing(clock, times, errno.ENETDOWN) as bus:
        watchdog = Watchdog(bus, "plant", Timeouts(0.05, 0.05), StopRequest(), clock=clock)
        with pytest.raises(BusLostError, match="has been down"):
            watchdog.receive(0)
        assert bus.asked == asked


def test_an_error_before_the_partner_was_heard_again_does_not_explain_a_later_silence(clock):
    with Refusing(clock, 1, errno.ENETDOWN) as bus:
        bus.sent.append(FRAME)
        watchdog = Watchdog(bus, "plant", Timeouts(0.05, 0.05), StopRequest(), clock=clock)
        watchdog.receive(0)
        watchdog.hear()
        bus.sent.clear()
        with pytest.raises(SilentNodeError, match=r"no frame from the plant node for 0\.05 s"):
            watchdog.receive(1)


@pytest.mark.parametrize("every_s", [0.001, 0.04, 0.09])
def test_a_trickle_of_frames_that_are_not_the_partner_s_does_not_make_it_any_less_silent(
    every_s, clock
):
    """Each short silence between them counts; only their sum is longer than the watchdog allows."""
    with Refusing(clock, 0) as bus:
        watchdog = Watchdog(bus, "plant", Timeouts(60.0, 1.0), StopRequest(), clock=clock)
        watchdog.hear()
        with pytest.raises(SilentNodeError, match="for 1 s"):
            while True:
                watchdog.go_on_waiting(0)
                clock.pass_s(every_s)
                assert clock.now_s < 1.5
    assert clock.now_s == pytest.approx(1.0, abs=2 * every_s)


def test_the_partner_s_frames_start_the_silence_anew(clock):
    with Refusing(clock, 0) as bus:
        watchdog = Watchdog(bus, "plant", Timeouts(1.0, 1.0), StopRequest(), clock=clock)
        for _ in range(10):
            for _ in range(9):
                watchdog.go_on_waiting(0)
                clock.pass_s(0.09)
            watchdog.hear()
    assert clock.now_s > 8.0


def test_time_that_this_node_slept_through_is_not_silence_however_often(clock):
    """It counts as the longest look between two polls, and no more."""
    with Refusing(clock, 0) as bus:
        watchdog = Watchdog(bus, "plant", Timeouts(1.0, 1.0), StopRequest(), clock=clock)
        for _ in range(10):  # 0.1 s each at most: the eleventh look is one too many
            watchdog.go_on_waiting(0)
            clock.pass_s(30.0)
        with pytest.raises(SilentNodeError):
            watchdog.go_on_waiting(0)


def test_an_offer_is_repeated_every_quarter_of_a_second_until_the_partner_is_heard(clock):
    offers = []
    with Refusing(clock, 0) as bus:
        watchdog = Watchdog(
            bus, "plant", Timeouts(1.0, 1.0), StopRequest(),
            while_alone=lambda: offers.append(clock.now_s), clock=clock,
        )  # fmt: skip
        watchdog.go_on_waiting(0)
        for _ in range(11):
            clock.pass_s(0.05)
            watchdog.go_on_waiting(0)
        assert offers == pytest.approx([0.25, 0.5])
        watchdog.hear()
        with pytest.raises(SilentNodeError):
            watchdog.receive(0)
        assert len(offers) == 2


@pytest.mark.parametrize("heard", [False, True])
def test_the_allowed_silence_is_exact(heard, clock):
    """A look counts at most 0.1 s, so every nanosecond of silence may matter."""
    with Refusing(clock, 0) as bus:
        watchdog = Watchdog(bus, "plant", Timeouts(0.1, 0.1), StopRequest(), clock=clock)
        if heard:
            watchdog.go_on_waiting(0)
            clock.pass_s(0.07)
            watchdog.go_on_waiting(0)
            watchdog.hear()
            clock.pass_s(0.05)  # of its own work, before it waits again
        watchdog.go_on_waiting(0)
        clock.ns += 99_999_999
        watchdog.go_on_waiting(0)
        clock.ns += 1
        with pytest.raises(SilentNodeError):
            watchdog.go_on_waiting(0)


def test_without_other_words_a_minute_is_allowed_for_the_start_and_a_second_after_it(clock):
    with Refusing(clock, 0) as bus:
        watchdog = Watchdog(bus, "plant", Timeouts(), StopRequest(), clock=clock)
        with pytest.raises(SilentNodeError, match="for 60 s"):
            watchdog.receive(0)
        watchdog.hear()
        with pytest.raises(SilentNodeError, match="for 1 s"):
            watchdog.receive(0)


@pytest.fixture
def handlers():
    """Those of the tests, given back."""
    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    before = {number: signal.getsignal(number) for number in numbers}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.usefixtures("handlers")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_is_a_wish_to_stop_and_stays_one(number, clock):
    signal.signal(number, signal.SIG_DFL)
    stop = StopRequest().on_signals()
    for _ in range(2):  # whoever presses Ctrl-C twice does not cut the tick short either
        signal.raise_signal(number)
        assert stop.wanted
    with Refusing(clock, 0) as bus, pytest.raises(Interrupted):
        Watchdog(bus, "plant", Timeouts(), stop, clock=clock).receive(0)


@pytest.mark.usefixtures("handlers")
def test_what_nohup_ignores_stays_ignored():
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    stop = StopRequest().on_signals()
    signal.raise_signal(signal.SIGHUP)
    assert not stop.wanted
