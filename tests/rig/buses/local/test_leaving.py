"""Nodes that shut down, are killed, or leave with frames unread."""

import fcntl
import gc
import socket
import threading
import time
from pathlib import Path

import can
import pytest

from can_rig.buses.local import bus as local_bus
from tests.processes import wait_for
from tests.rig.buses.local.nodes import TIMEOUT_S, buses, frame, node, number, sockets


@pytest.mark.parametrize("burst", [0, 1000], ids=["idle", "backlogged"])
def test_killed_node_is_cleaned_away(root, burst, caplog):
    with buses({}, {}) as (sender, witness):
        with node("import time; time.sleep(60)") as victim:
            for each in range(burst + 1):
                sender.send(frame(each))
                assert number(witness.recv(TIMEOUT_S)) == each
            victim.kill()
            victim.wait()
            assert len(sockets(root)) == 3
        wait_for(lambda: sender.send(frame(0)) or len(sockets(root)) == 2)
        sender.send(frame(1))
        while (each := number(witness.recv(TIMEOUT_S))) != 1:
            assert each == 0  # one for every look above
    assert "never read" not in caplog.text
    assert not (root / "x").exists()


def test_node_killed_before_anyone_sent_is_cleaned_away(root):
    with node("import time; time.sleep(60)") as victim:
        victim.kill()
        victim.wait()
    with buses({}, {}) as (sender, receiver):
        assert len(sockets(root)) == 3
        sender.send(frame(1))
        assert len(sockets(root)) == 2
        assert number(receiver.recv(TIMEOUT_S)) == 1


def test_socket_of_a_node_that_is_just_joining_is_not_taken_for_dead(root):
    with buses({}) as (sender,), (root / "x" / local_bus.GENERATION).open() as lock:
        path = root / "x" / "1-abcdef.node"
        fcntl.flock(lock, fcntl.LOCK_EX)  # as a node does that joins
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as earlier:
            earlier.bind(str(path))
        sending = threading.Thread(target=sender.send, args=(frame(1),))
        sending.start()
        time.sleep(0.02)  # enough for a scan that ignores the lock; the test holds if not
        path.unlink()
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as joining:
            joining.bind(str(path))
            fcntl.flock(lock, fcntl.LOCK_UN)
            sending.join(TIMEOUT_S)
            assert joining.recv(100, socket.MSG_DONTWAIT)


def test_shutdown_delivers_the_backlog():
    with buses({}, {}) as (sender, receiver):
        for each in range(1000):
            sender.send(frame(each))
        received: list[int] = []
        reader = threading.Thread(
            target=lambda: received.extend(number(receiver.recv(TIMEOUT_S)) for _ in range(1000))
        )
        reader.start()
        sender.shutdown()
        reader.join()
    assert received == list(range(1000))


def test_shutdown_gives_up_on_a_listener_and_says_so(caplog):
    with buses({}, {}) as (sender, _silent):
        for each in range(100):
            sender.send(frame(each))
        sender.shutdown()
        assert "frames were never read by" in caplog.text


def test_nodes_that_leave_together_do_not_wait_for_each_other(monkeypatch, caplog):
    monkeypatch.setattr(local_bus, "_SHUTDOWN_S", 60.0)
    with buses({}, {}) as (one, other):
        for each in range(100):
            one.send(frame(each))
            other.send(frame(each))
        leaving = threading.Thread(target=one.shutdown)
        leaving.start()
        other.shutdown()
        leaving.join(TIMEOUT_S)
        assert not leaving.is_alive()


def test_shutdown_does_not_wait_for_a_listener_that_was_cut_off(monkeypatch):
    with buses({"tx_backlog": 50}, {}) as (sender, _silent):
        for each in range(100):
            sender.send(frame(each))
        monkeypatch.setattr(local_bus, "_SHUTDOWN_S", 60.0)
        leaving = threading.Thread(target=sender.shutdown)
        leaving.start()
        leaving.join(TIMEOUT_S)
        assert not leaving.is_alive()


def test_shutdown_wakes_a_waiting_recv():
    with buses({}) as (bus,):
        caught: list[BaseException] = []

        def wait() -> None:
            try:
                bus.recv()
            except can.CanOperationError as error:
                caught.append(error)

        waiting = threading.Thread(target=wait, daemon=True)
        waiting.start()
        time.sleep(0.02)  # most likely inside recv() by now; the test holds if not
        bus.shutdown()
        waiting.join(TIMEOUT_S)
        assert [str(error) for error in caught] == ["Cannot operate on a closed bus"]
        assert bus.fileno() == -1


def test_no_descriptor_is_left_behind():
    def descriptors() -> int:
        gc.collect()  # a bus that a failed call still refers to keeps its map
        return len(list(Path("/proc/self/fd").iterdir()))

    before = descriptors()
    for _ in range(3):
        with buses({}, {}, {"receive_own_messages": True}) as opened:
            for bus in opened:
                bus.send(frame(1))
        del opened, bus
    assert descriptors() <= before
