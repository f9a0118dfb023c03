"""A bus that refuses: how often it is asked again, for how long, and what is said of it."""

from __future__ import annotations

import errno
from collections import Counter

import can
import pytest

from can_rig.errors import BusLostError
from can_rig.nodes.bus_access import PersistentSender, TolerantBus, bus_events
from tests.clock import TurnedClock
from tests.rig.nodes.refusing import FRAME, Refusing


@pytest.fixture
def clock() -> TurnedClock:
    return TurnedClock()


@pytest.mark.parametrize("times", [0, 1, 30])
def test_a_refused_frame_is_sent_once_as_soon_as_there_is_room(
    times: int, clock: TurnedClock
) -> None:
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
def test_the_bound_and_the_line(code: int | None, expected: str, clock: TurnedClock) -> None:
    with Refusing(clock, 10**9, code) as bus, pytest.raises(BusLostError) as caught:
        PersistentSender(bus, 0.05, clock)(FRAME)
    assert str(caught.value).startswith(f"socketcan channel 'can9': {expected}")
    assert bus.asked == 51  # once, and every millisecond of the 50 that are allowed
    assert clock.now_s == pytest.approx(0.05)
    assert bus.sent == []


def test_the_line_says_what_is_wrong_now(clock: TurnedClock) -> None:
    """Not what was wrong at first: what has passed needs no remedy."""

    class Falling(Refusing):
        def send(self, msg: can.Message, timeout: float | None = None) -> None:
            self.code = errno.ENETDOWN if self.asked else errno.ENOBUFS
            super().send(msg, timeout)

    with Falling(clock, 10**9) as bus, pytest.raises(BusLostError, match="has been down"):
        PersistentSender(bus, 0.05, clock)(FRAME)


def test_in_real_time_a_refused_frame_is_counted_and_not_sent(clock: TurnedClock) -> None:
    """It would come in a tick that it does not belong to."""
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
    timeout_s: float | None, paused_ns: int, clock: TurnedClock
) -> None:
    with Refusing(clock, 2) as bus:
        bus.sent.append(FRAME)
        tolerant = TolerantBus(bus, clock)
        for already in (0, 1):
            assert tolerant.recv(timeout_s) is None
            assert clock.ns == (1 + already) * paused_ns
        assert sum(tolerant.errors.values()) == 2
        assert tolerant.recv(timeout_s) is FRAME


def test_the_timeout_is_the_bus_s(clock: TurnedClock) -> None:
    with Refusing(clock, 0) as bus:
        assert TolerantBus(bus, clock).recv(0.25) is None
    assert clock.now_s == pytest.approx(0.25)


class Losing:
    """The part of a bus that counts what nobody has read in time."""

    def __init__(self, lost_frames: int) -> None:
        self.lost_frames = lost_frames


def test_the_events_of_a_bus_are_all_that_occurred(clock: TurnedClock) -> None:
    sending, receiving = Counter({"full": 2, "down": 1}), Counter({"down": 4, "never": 0})
    assert bus_events("plant", Losing(3), sending, receiving) == {
        "plant": {"full": 2, "down": 5, "frames dropped unread": 3}
    }
    assert bus_events("plant", Losing(0), Counter()) == {}
    with Refusing(clock, 0) as bus:  # which counts no lost frames
        assert bus_events("controller", bus, Counter({"full": 1})) == {"controller": {"full": 1}}
        assert bus_events("controller", bus) == {}
