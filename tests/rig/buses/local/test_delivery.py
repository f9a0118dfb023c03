"""Every frame arrives, once and in order; a listener that does not read is cut off."""

import logging
import threading

import can
import pytest

from can_rig.buses.local.bus import LocalBus
from tests.processes import wait_for
from tests.rig.buses.local.nodes import TIMEOUT_S, buses, frame, node, number


def test_burst_of_20000_before_the_first_recv_in_one_thread():
    with buses({}, {}) as (sender, receiver):
        for each in range(20_000):
            sender.send(frame(each))
        assert [number(receiver.recv(TIMEOUT_S)) for _ in range(20_000)] == list(range(20_000))
        assert receiver.recv(0) is None


def test_no_thread_outlives_its_backlog():
    before = threading.active_count()
    with buses({}, {}) as (sender, receiver):
        for each in range(5):
            sender.send(frame(each))
        assert threading.active_count() == before
        for each in range(100):
            sender.send(frame(each))
        assert threading.active_count() == before + 1
        for _ in range(105):
            receiver.recv(TIMEOUT_S)
        wait_for(lambda: threading.active_count() == before)


def test_two_processes_burst_at_each_other():
    program = """
for number in range(5000):
    bus.send(can.Message(arbitration_id=1, data=number.to_bytes(4, "little")))
for number in range(5000):
    assert int.from_bytes(bus.recv(30.0).data, "little") == number
bus.shutdown()
print("heard all", flush=True)
"""
    with buses({}) as (bus,), node(program) as other:
        for each in range(5000):
            bus.send(frame(each))
        assert [number(bus.recv(TIMEOUT_S)) for _ in range(5000)] == list(range(5000))
        assert other.stdout is not None
        assert other.stdout.readline() == "heard all\n"


def test_threads_may_send_at_once():
    with buses({}, {}) as (sender, receiver):

        def burst(identifier: int) -> None:
            for each in range(1000):
                msg = frame(each)
                msg.arbitration_id = identifier
                sender.send(msg)

        threads = [threading.Thread(target=burst, args=(i,)) for i in range(4)]
        for thread in threads:
            thread.start()
        received = [receiver.recv(TIMEOUT_S) for _ in range(4000)]
        for identifier in range(4):
            mine = [number(msg) for msg in received if msg and msg.arbitration_id == identifier]
            assert mine == list(range(1000))


def test_frame_sent_right_after_a_constructor_is_delivered():
    with buses({}) as (sender,):
        for each in range(300):  # far more often than the clock of the file system ticks
            with LocalBus("x") as late:
                sender.send(frame(each))
                assert number(late.recv(0)) == each


def test_silent_listener_is_cut_off_and_both_ends_are_told(caplog):
    with buses({"tx_backlog": 50}, {}, {}) as (sender, silent, attentive):
        for each in range(500):
            sender.send(frame(each))
            assert number(attentive.recv(TIMEOUT_S)) == each
        warnings = [r.getMessage() for r in caplog.records if r.levelno == logging.WARNING]
        assert len(warnings) == 1
        assert "left 50 frames unread and is cut off" in warnings[0]

        with pytest.raises(can.CanOperationError, match="cut off"):
            for each in range(500):
                assert number(silent.recv(TIMEOUT_S)) == each
        assert 50 < each < 100
        attentive.send(frame(7))  # cut off from one sender, not from the bus
        assert number(silent.recv(TIMEOUT_S)) == 7


def test_own_queue_that_nobody_reads_is_bounded_too(caplog):
    with buses({"tx_backlog": 50, "receive_own_messages": True}) as (bus,):
        for each in range(500):
            bus.send(frame(each))
        assert "cut off" in caplog.text
        with pytest.raises(can.CanOperationError, match="cut off"):
            for each in range(500):
                assert number(bus.recv(TIMEOUT_S)) == each


def test_send_with_timeout_waits_for_room_and_is_all_or_nothing():
    with buses({}, {}, {}) as (sender, slow, attentive):
        sent = 0
        with pytest.raises(can.CanTimeoutError, match=r"took no frame within 0\.01 s"):
            for sent in range(100):
                sender.send(frame(sent), timeout=0.01)
        assert [number(attentive.recv(TIMEOUT_S)) for _ in range(sent)] == list(range(sent))
        assert attentive.recv(0) is None
        assert [number(slow.recv(TIMEOUT_S)) for _ in range(sent)] == list(range(sent))
        sender.send(frame(sent), timeout=TIMEOUT_S)
        assert number(slow.recv(TIMEOUT_S)) == sent


def test_flush_tx_buffer_discards_what_waits():
    with buses({}, {}) as (sender, receiver):
        for each in range(1000):
            sender.send(frame(each))
        sender.flush_tx_buffer()
        sender.send(frame(1000))
        received: list[int] = []
        while 1000 not in received:
            received.append(number(receiver.recv(TIMEOUT_S)))
        assert len(received) < 100
        assert received == [*range(len(received) - 1), 1000]
