"""A bus that refuses, fails, or is full of others: how long, how often, and what is said of it."""

import errno

import can
import pytest

from can_rig.errors import BusLostError, SilentNodeError
from can_rig.nodes import lockstep
from can_rig.nodes.lockstep import Sender, StopRequest, Waiting, Watchdog


def refusal(code):
    return can.CanOperationError("Failed to transmit: no", code)


class TurnedTime:
    """A clock that only sleeping moves."""

    now_s = 0.0

    def monotonic(self):
        return self.now_s

    def sleep(self, seconds):
        self.now_s += seconds


@pytest.fixture(autouse=True)
def clock(monkeypatch):
    turned = TurnedTime()
    monkeypatch.setattr(lockstep, "time", turned)
    return turned


class Refusing(can.BusABC):
    """Refuses to send, or to receive, a number of times; what it has sent comes back."""

    channel_info = "socketcan channel 'can9'"
    channel = "can9"

    def __init__(self, times, code=errno.ENOBUFS):
        super().__init__(channel=self.channel)
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
        lockstep.time.sleep(0.001 if self.sent else timeout)
        return self.sent[0] if self.sent else None


FRAME = can.Message(arbitration_id=0x300, is_extended_id=False)


@pytest.mark.parametrize("times", [0, 1, 30])
def test_a_refused_frame_is_sent_once_as_soon_as_there_is_room(times):
    with Refusing(times) as bus:
        send = Sender(bus, within_s=10.0)
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
def test_the_bound_and_the_line(code, expected):
    with Refusing(10**9, code) as bus, pytest.raises(BusLostError) as caught:
        Sender(bus, within_s=0.05)(FRAME)
    assert str(caught.value).startswith(f"socketcan channel 'can9': {expected}")
    assert 2 <= bus.asked <= 60  # neither once nor in a hot loop
    assert bus.sent == []


def test_a_receive_error_that_passes_is_counted_and_nothing_else():
    with Refusing(3, errno.ENETDOWN) as bus:
        bus.sent.append(FRAME)
        watchdog = Watchdog(bus, "plant", Waiting(10.0, 10.0), StopRequest())
        assert watchdog.receive(0) is FRAME
        assert sum(watchdog.errors.values()) == 3


def test_after_a_receive_error_the_silence_is_the_bus_s():
    with Refusing(1, errno.ENETDOWN) as bus:
        watchdog = Watchdog(bus, "plant", Waiting(0.05, 0.05), StopRequest())
        with pytest.raises(BusLostError, match="has been down"):
            watchdog.receive(0)


def test_an_error_before_the_partner_was_heard_again_does_not_explain_a_later_silence():
    with Refusing(1, errno.ENETDOWN) as bus:
        bus.sent.append(FRAME)
        watchdog = Watchdog(bus, "plant", Waiting(0.05, 0.05), StopRequest())
        watchdog.receive(0)
        watchdog.hear()
        bus.sent.clear()
        with pytest.raises(SilentNodeError, match=r"no frame from the plant node for 0\.05 s"):
            watchdog.receive(1)


def test_a_node_alone_repeats_its_offer_though_others_talk_all_the_time():
    """Or a node that comes late would wait for silence on a busy bus."""
    offers = []
    with Refusing(0) as bus:
        bus.sent.append(FRAME)
        watchdog = Watchdog(
            bus, "plant", Waiting(1.6, 1.6), StopRequest(), while_alone=lambda: offers.append(1)
        )
        with pytest.raises(SilentNodeError):
            while True:
                watchdog.receive(0)
                watchdog.go_on_waiting(0)
    assert len(offers) == 6  # every 0.25 s of 1.6 s, not with every frame


def test_while_this_node_sleeps_itself_the_other_is_not_silent(clock):
    """A machine that is suspended, or stalls, wakes both; one second without a frame is left."""
    with Refusing(0) as bus:
        watchdog = Watchdog(bus, "plant", Waiting(1.0, 1.0), StopRequest())
        watchdog.go_on_waiting(0)
        clock.sleep(3600.0)
        watchdog.go_on_waiting(0)
        woken_s = clock.now_s
        with pytest.raises(SilentNodeError):
            watchdog.receive(0)
    assert 0.85 < clock.now_s - woken_s <= 1.0
