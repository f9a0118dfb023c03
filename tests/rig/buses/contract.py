"""One contract for every bus: what the rig relies on, whatever carries the frames."""

from collections.abc import Callable
from typing import Any

import can
import pytest
from hypothesis import given, settings

from can_rig.buses.bus import open_bus
from tests.drawn_frames import frames

Open = Callable[..., can.BusABC]
TIMEOUT_S = 30.0  # for what must come; a test fails, and never hangs, without it


def frame(number: int, **kwargs: Any) -> can.Message:
    data = number.to_bytes(4, "little")
    return can.Message(**{"arbitration_id": 0x100, "is_extended_id": False, "data": data, **kwargs})


def numbers(bus: can.BusABC, count: int) -> list[int]:
    """What ``frame`` was given, of the next ``count`` frames; short if one does not come."""
    received = []
    for _ in range(count):
        msg = bus.recv(TIMEOUT_S)
        if msg is None:
            break
        received.append(int.from_bytes(msg.data, "little"))
    return received


class BusContract:
    """The contract; a subclass says how to open the bus and what it does not promise."""

    error_frames = True
    burst = 2000
    marks_own = True
    receive_own = True
    lossless = True
    has_descriptor = True
    refuses_when_closed = True

    @pytest.fixture
    def name(self, tmp_path):
        raise NotImplementedError

    @pytest.fixture
    def near(self, name):
        """Opens buses in this process and closes them after the test."""
        opened = []

        def open_near(**kwargs: Any) -> can.BusABC:
            opened.append(open_bus(name, fd=True, **kwargs))
            return opened[-1]

        yield open_near
        for bus in opened:
            bus.shutdown()

    @pytest.fixture
    def far(self, near):
        """Opens buses at the other end: here too, unless a subclass puts them elsewhere."""
        yield near

    def test_every_kind_of_frame_survives(self, near, far):
        sender, receiver = near(), far()
        kinds = ["data", "remote", "fd"] + ["error"] * self.error_frames

        @settings(max_examples=100)
        @given(frames(kinds))
        def survives(sent: can.Message) -> None:
            sender.send(sent)
            received = receiver.recv(TIMEOUT_S)
            assert received is not None
            assert received.is_rx == self.marks_own
            same = {"timestamp_delta": None, "check_channel": False, "check_direction": False}
            assert received.equals(sent, **same), f"{sent!r} became {received!r}"

        survives()

    def test_burst_arrives_whole_and_in_order(self, near, far):
        if not self.lossless:
            pytest.skip("NOT PROMISED: this bus may lose frames of a burst")
        sender, receiver = near(), far()
        for number in range(self.burst):
            sender.send(frame(number))
        assert numbers(receiver, self.burst) == list(range(self.burst))
        assert receiver.recv(0) is None

    def test_frames_go_both_ways(self, near, far):
        if not self.receive_own:
            pytest.skip("NOT PROMISED: this bus echoes a node's own frames")
        one, other = near(), far()
        for number in range(20):
            one.send(frame(number))
            assert numbers(other, 1) == [number]
            other.send(frame(number + 100))
            assert numbers(one, 1) == [number + 100]

    def test_every_listener_hears_every_frame(self, near, far):
        sender = near()
        listeners = [far(), near(), far(), near()]
        for number in range(10):
            sender.send(frame(number))
        for listener in listeners:
            assert numbers(listener, 10) == list(range(10))

    def test_frames_of_several_senders_each_in_order(self, near, far):
        senders, listener = [near(), far(), near()], near()
        for number in range(4):  # few: the senders themselves do not read
            for identifier, sender in enumerate(senders):
                sender.send(frame(number, arbitration_id=identifier))
        received = [listener.recv(TIMEOUT_S) for _ in range(12)]
        for identifier in range(len(senders)):
            mine = [msg.data[0] for msg in received if msg and msg.arbitration_id == identifier]
            assert mine == list(range(4))

    def test_own_frames_are_not_echoed(self, near, far):
        if not self.receive_own:
            pytest.skip("NOT PROMISED: this bus echoes a node's own frames")
        sender, witness = near(), far()
        sender.send(frame(1))
        assert numbers(witness, 1) == [1]  # it has been on the bus
        assert sender.recv(0) is None

    def test_own_frames_on_request(self, near, far):
        if not self.receive_own:
            pytest.skip("NOT PROMISED: this bus does not mark a node's own frames")
        sender, witness = near(receive_own_messages=True), far()
        sender.send(frame(7))
        echo, received = sender.recv(TIMEOUT_S), witness.recv(TIMEOUT_S)
        assert echo is not None
        assert received is not None
        assert echo.data == received.data
        assert (echo.is_rx, received.is_rx) == (False, self.marks_own)

    def test_filters_pass_what_matches_and_nothing_else(self, near, far):
        filters = [
            {"can_id": 0x120, "can_mask": 0x7F0},
            {"can_id": 0x300, "can_mask": 0x7FF, "extended": True},
        ]
        sender, receiver = near(), far(can_filters=filters)
        sender.send(frame(0, arbitration_id=0x110))
        sender.send(frame(1, arbitration_id=0x12A))
        sender.send(frame(2, arbitration_id=0x300))
        sender.send(frame(3, arbitration_id=0x300, is_extended_id=True))
        assert numbers(receiver, 2) == [1, 3]
        assert receiver.recv(0) is None

    @pytest.mark.parametrize("timeout_s", [0, 0.001, 0.06])
    def test_nothing_comes_of_silence(self, near, far, timeout_s):
        sender, receiver = near(), far()
        assert receiver.recv(timeout_s) is None
        sender.send(frame(5))
        assert numbers(receiver, 1) == [5]  # and a timeout leaves the bus as it was

    def test_a_late_joiner_hears_the_next_frame(self, near, far):
        sender, early = near(), near()
        for number in range(10):
            late = far()
            sender.send(frame(number))
            assert numbers(late, 1) == [number]
            late.shutdown()
        assert numbers(early, 10) == list(range(10))

    def test_who_leaves_disturbs_nobody(self, near, far):
        sender, stays, leaves = near(), near(), far()
        sender.send(frame(1))
        leaves.shutdown()
        sender.send(frame(2))
        assert numbers(stays, 2) == [1, 2]

    def test_shutdown_twice_and_as_context(self, near):
        with near() as bus:
            pass
        bus.shutdown()

    def test_a_closed_bus_refuses(self, near):
        if not self.refuses_when_closed:
            pytest.skip("NOT PROMISED: this bus raises whatever its closed socket raises")
        bus = near()
        bus.shutdown()
        with pytest.raises(can.CanOperationError):
            bus.send(frame(1))
        with pytest.raises(can.CanOperationError):
            bus.recv(0)

    def test_a_notifier_reads_it(self, near, far):
        sender, receiver = near(), near()
        reader = can.BufferedReader()
        with can.Notifier(receiver, [reader], timeout=0.01):
            for number in range(10):
                sender.send(frame(number))
            received = [reader.get_message(TIMEOUT_S) for _ in range(10)]
        assert [msg and msg.data[0] for msg in received] == list(range(10))

    def test_descriptor(self, near):
        if not self.has_descriptor:
            pytest.skip("NOT PROMISED: this bus has no file descriptor")
        assert near().fileno() >= 0
