"""A log onto a bus: when each frame is sent, on a clock that the test turns."""

import json
import signal
from fractions import Fraction
from pathlib import Path

import can
import pytest
from can import Message
from hypothesis import given, strategies as st

from can_rig.buses.bus import open_bus
from can_rig.errors import BusError
from can_rig.logs.frames import Frames
from can_rig.nodes.bus_access import StopRequest
from can_rig.replaying.pace import Pacer
from tests.clock import TurnedClock
from tests.helpers import refused, start
from tests.rig.logs.messages import from_messages

HOUR_NS = 3600 * 10**9


class Oversleeping(TurnedClock):
    """Time passes when somebody sleeps, a little longer than asked, and when the bus sends."""

    def __init__(self, oversleep_ns: int = 0) -> None:
        super().__init__(12_345)
        self._oversleep_ns = oversleep_ns

    def sleep_until(self, at_ns: int) -> None:
        assert at_ns > self.ns
        self.ns = at_ns + self._oversleep_ns


class Probe(can.BusABC):
    """Notes what is sent and when; takes its time, and refuses as often as it is told."""

    def __init__(self, clock: Oversleeping, cost_ns: int = 0, refuse: int = 0) -> None:
        super().__init__("probe")
        self.shutdown()
        self.clock, self.cost_ns, self.refuse = clock, cost_ns, refuse
        self.sent: list[tuple[int, Message]] = []

        self.unread = 1000

    def _recv_internal(self, timeout: float | None) -> tuple[Message | None, bool]:
        self.unread -= 1
        return (Message(), True) if self.unread >= 0 else (None, True)

    def send(self, msg: Message, timeout: float | None = None) -> None:
        if self.refuse:
            self.refuse -= 1
            raise can.CanOperationError("no buffer space")
        self.sent.append((self.clock.ns, msg))
        self.clock.ns += self.cost_ns


def frames(times_ns: list[int], **kwargs: object) -> Frames:
    messages = [
        Message(arbitration_id=at % 2048, is_extended_id=False, data=[at & 255], **kwargs)
        for at in range(len(times_ns))
    ]
    chunk = from_messages(messages)
    chunk.time_ns[:] = times_ns
    return chunk


def sent_after(bus: Probe) -> list[int]:
    return [time_ns - bus.sent[0][0] for time_ns, _ in bus.sent]


@pytest.mark.parametrize("speed", [Fraction(1), Fraction(2), Fraction(1, 2), Fraction(7, 3)])
def test_hours_do_not_drift(speed):
    """Every frame is late by what the last sleep was too long, never by the sum of them."""
    clock = Oversleeping(oversleep_ns=70_000)
    bus = Probe(clock)
    times = [HOUR_NS * hour + 1_700_000_000 * 10**9 + 333 * hour for hour in range(6)]
    result = Pacer(bus, speed, StopRequest(), clock).send_all(
        [frames(times[:2]), frames(times[2:])]
    )
    for time_ns, after_ns in zip(times, sent_after(bus), strict=True):
        due_ns = (time_ns - times[0]) / speed
        assert 0 <= after_ns - due_ns <= 70_001
    assert result.sent == 6
    assert result.late_ns <= 70_000
    assert result.log_ns == times[-1] - times[0]


@given(
    st.lists(st.integers(0, 10**10), min_size=1, max_size=40),
    st.fractions(min_value=Fraction(1, 50), max_value=50),
    st.integers(0, 10**6),
)
def test_no_frame_is_early_none_is_lost_and_the_order_stays(times, speed, cost_ns):
    """Whatever the time stamps: a clock that went back sends at once."""
    clock = Oversleeping()
    bus = Probe(clock, cost_ns)
    Pacer(bus, speed, StopRequest(), clock).send_all([frames(times)])
    assert [message.data[0] for _, message in bus.sent] == list(range(len(times)))
    reached = 0
    for time_ns, after_ns in zip(times, sent_after(bus), strict=True):
        due_ns = (time_ns - times[0]) * speed.denominator // speed.numerator
        free_ns = reached
        assert after_ns == max(due_ns, free_ns)  # in time, or as soon as the bus was free
        reached = after_ns + cost_ns


def test_what_others_send_is_taken_off_the_bus():
    class Busy(Oversleeping):
        def sleep_until(self, at_ns: int) -> None:
            super().sleep_until(at_ns)
            bus.unread = max(bus.unread, 0) + 10

    clock = Busy()
    bus = Probe(clock)
    Pacer(bus, Fraction(1), StopRequest(), clock).send_all([frames([0, 10**9])])
    assert bus.unread == 10  # of the last sleep, of twenty


def test_as_fast_as_possible_never_sleeps():
    clock = Oversleeping()
    bus = Probe(clock, 5)
    Pacer(bus, None, StopRequest(), clock).send_all([frames([0, HOUR_NS, 2 * HOUR_NS])])
    assert sent_after(bus) == [0, 5, 10]


def test_a_stop_request_ends_it_within_a_moment():
    stop = StopRequest()

    class Stopping(Oversleeping):
        def sleep_until(self, at_ns: int) -> None:
            super().sleep_until(at_ns)
            stop.wanted = self.ns > 10**9

    clock = Stopping()
    bus = Probe(clock)
    result = Pacer(bus, Fraction(1), stop, clock).send_all([frames([0, HOUR_NS])])
    assert result.sent == 1
    assert clock.ns < 1.2 * 10**9


def test_a_bus_that_refuses_for_a_while_loses_nothing_and_one_that_goes_on_is_named():
    clock = Oversleeping()
    bus = Probe(clock, refuse=20)
    assert Pacer(bus, None, StopRequest(), clock).send_all([frames([0, 1])]).sent == 2
    bus = Probe(clock, refuse=10**9)
    with pytest.raises(BusError, match=r"refuses frame 0 for 1 s, after 0 .*: no buffer space"):
        Pacer(bus, None, StopRequest(), clock).send_all([frames([0, 1])])


def test_what_cannot_be_sent_is_counted():
    clock = Oversleeping()
    bus = Probe(clock)
    errors = from_messages([Message(is_error_frame=True), Message(arbitration_id=3)])
    result = Pacer(bus, None, StopRequest(), clock).send_all([errors, frames([0, 1], is_fd=True)])
    assert (result.sent, result.error_frames, result.fd_frames) == (1, 1, 2)
    bus._can_protocol = can.CanProtocol.CAN_FD
    assert Pacer(bus, None, StopRequest(), clock).send_all([frames([0], is_fd=True)]).sent == 1


def lines(count: int, every_s: float) -> str:
    return "".join(f"({at * every_s:.6f}) can3 18FF{at:04X}#{at:04X}\n" for at in range(count))


def test_other_programs_see_the_frames(tmp_path):
    Path("drive.log").write_text(lines(300, 0.0001))
    name = f"local:{tmp_path}/bus"
    with open_bus(name) as listener:
        process = start("replay", "drive.log", "--bus", name, "--speed", "max", "--json")
        seen = [listener.recv(60.0) for _ in range(300)]
        out, err = process.communicate(timeout=60)
    assert (process.returncode, err) == (0, "")
    assert json.loads(out)["sent"] == 300
    assert [m.arbitration_id & 0xFFFF for m in seen if m] == list(range(300))
    assert all(m is not None and m.is_extended_id for m in seen)


def test_ctrl_c_and_bad_words_are_one_line(tmp_path):
    Path("drive.log").write_text(lines(100, 1.0))
    process = start("replay", "drive.log", "--bus", f"local:{tmp_path}/bus")
    with open_bus(f"local:{tmp_path}/bus") as listener:
        assert listener.recv(60.0) is not None or listener.recv(60.0) is not None
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert out == ""
    assert "frames sent" in err
    for arguments, words in (
        (("drive.log", "--bus", "nothing:x"), "unknown bus interface"),
        (("drive.log", "--bus", "local:x", "--speed", "0"), "a number above 0"),
        (("drive.log", "--bus", "local:x", "--set", "tick_s=1"), "--bus and --set"),
        (("drive.log", "--speed", "2", "--scenario", "default"), "--bus"),
        (("away.log", "--bus", "local:x"), "there is no such file"),
    ):
        assert words in refused("replay", *arguments)
