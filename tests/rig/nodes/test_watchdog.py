"""A bus that refuses, fails, or is full of others: how long, how often, and what is said of it."""

import errno

import can
import pytest

from can_rig.errors import BusLostError, SilentNodeError
from can_rig.nodes.bus_access import PersistentSender
from can_rig.nodes.watchdog import StopRequest, Timeouts, Watchdog
from tests.clock import TurnedClock


def refusal(code):
    return can.CanOperationError("Failed to transmit: no", code)


@pytest.fixture
def clock():
    return TurnedClock()


class Refusing(can.BusABC):
    """Refuses to send, or to receive, a number of times; what it has sent comes back."""

    channel_info = "socketcan channel 'can9'"
    channel = "can9"

    def __init__(self, clock, times, code=errno.ENOBUFS):
        super().__init__(channel=self.channel)
        self.clock = clock
        self.times, self.code, self.asked, self.sent = times, code, 0, []

    def _refuse(self):
        self.asked += 1
        if self.asked <= self.times:
            raise refusal(self.code)

    def send(self, msg, timeout=None):
        self._refuse()
        self.sent.append(msg)

    def recv(self, timeout=None):
        self._refuse()
        self.clock.pass_s(0.001 if self.sent else timeout)
        return self.sent[0] if self.sent else None


FRAME = can.Message(arbitration_id=0x300, is_extended_id=False)


@pytest.mark.parametrize("times", [0, 1, 30])
def test_a_refused_frame_is_sent_once_as_soon_as_there_is_room(times, clock):
    with Refusing(clock, times) as bus:
        send = PersistentSender(bus, 10.0, clock)
        send(FRAME)
        assert bus.sent == [FRAME]
        assert sum(send.errors.values()) == times  # reported, every one


@pytest.mark.parametrize(
    ("code", "expected"),
    [
        (errno.ENETDOWN, "the interface has been down for 0.05 s: sudo ip link set up can9"),
        (errno.ENODEV, "the interface is gone: sudo modprobe vcan; sudo ip link add dev can9"),
        (errno.ENOBUFS, "the transmit queue has been full for 0.05 s"),
        (errno.EIO, "Failed to transmit: no"),
        (None, "Failed to transmit: no"),
    ],
)
def test_the_bound_and_the_line(code, expected, clock):
    with Refusing(clock, 10**9, code) as bus, pytest.raises(BusLostError) as caught:
        PersistentSender(bus, 0.05, clock)(FRAME)
    assert str(caught.value).startswith(f"socketcan channel 'can9': {expected}")
    assert 2 <= bus.asked <= 60  # neither once nor in a hot loop
    assert bus.sent == []


def test_a_receive_error_that_passes_is_counted_and_nothing_else(clock):
    with Refusing(clock, 3, errno.ENETDOWN) as bus:
        bus.sent.append(FRAME)
        watchdog = Watchdog(bus, "plant", Timeouts(10.0, 10.0), StopRequest(), clock=clock)
        assert watchdog.receive(0) is FRAME
        assert sum(watchdog.errors.values()) == 3


def test_after_a_receive_error_the_silence_is_the_bus_s(clock):
    with Refusing(clock, 1, errno.ENETDOWN) as bus:
        watchdog = Watchdog(bus, "plant", Timeouts(0.05, 0.05), StopRequest(), clock=clock)
        with pytest.raises(BusLostError, match="has been down"):
            watchdog.receive(0)


def test_an_error_before_the_partner_was_heard_again_does_not_explain_a_later_silence(clock):
    with Refusing(clock, 1, errno.ENETDOWN) as bus:
        bus.sent.append(FRAME)
        watchdog = Watchdog(bus, "plant", Timeouts(0.05, 0.05), StopRequest(), clock=clock)
        watchdog.receive(0)
        watchdog.hear()
        bus.sent.clear()
        with pytest.raises(SilentNodeError, match=r"no frame from the plant node for 0\.05 s"):
            watchdog.receive(1)


def test_a_node_alone_repeats_its_offer_though_others_talk_all_the_time(clock):
    """Or a node that comes late would wait for silence on a busy bus."""
    offers = []
    with Refusing(clock, 0) as bus:
        bus.sent.append(FRAME)
        watchdog = Watchdog(
            bus,
            "plant",
            Timeouts(1.6, 1.6),
            StopRequest(),
            while_alone=lambda: offers.append(1),
            clock=clock,
        )
        with pytest.raises(SilentNodeError):
            while True:
                watchdog.receive(0)
                watchdog.go_on_waiting(0)
    assert len(offers) == 6  # every 0.25 s of 1.6 s, not with every frame


def test_while_this_node_sleeps_itself_the_other_is_not_silent(clock):
    """A machine that is suspended, or stalls, wakes both; one second without a frame is left."""
    with Refusing(clock, 0) as bus:
        watchdog = Watchdog(bus, "plant", Timeouts(1.0, 1.0), StopRequest(), clock=clock)
        watchdog.go_on_waiting(0)
        clock.pass_s(3600.0)
        watchdog.go_on_waiting(0)
        woken_s = clock.now_s
        with pytest.raises(SilentNodeError):
            watchdog.receive(0)
    assert 0.85 < clock.now_s - woken_s <= 1.0


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
