"""What the local bus promises beyond the contract of every bus."""

import asyncio
import contextlib
import fcntl
import gc
import logging
import os
import select
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import can
import pytest

from can_rig.buses.local import bus as local_bus
from can_rig.buses.local import directory as local_bus_directory
from can_rig.buses.local.bus import LocalBus

TIMEOUT_S = 30.0  # for what must come

NODE = """
import sys, can
from can_rig.buses.local.bus import LocalBus
bus = LocalBus("x")
print("ready", flush=True)
"""


@pytest.fixture(autouse=True)
def root(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Buses of a test, and of the processes that it starts, are its own."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.setattr(local_bus, "_SHUTDOWN_S", 0.2)
    return tmp_path / "can-rig"


@contextlib.contextmanager
def buses(*options: dict[str, Any]) -> Iterator[list[LocalBus]]:
    with contextlib.ExitStack() as stack:
        yield [stack.enter_context(LocalBus("x", **each)) for each in options]


@contextlib.contextmanager
def node(program: str) -> Iterator[subprocess.Popen[str]]:
    """Another process on the bus; it is there when the block begins, and gone when it ends."""
    command = [sys.executable, "-u", "-c", NODE + program]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == "ready\n"
            yield process
        finally:
            process.kill()


def frame(number: int, **kwargs: Any) -> can.Message:
    data = number.to_bytes(4, "little")
    return can.Message(arbitration_id=0x100, is_extended_id=False, data=data, **kwargs)


def number(msg: can.Message | None) -> int:
    assert msg is not None
    return int.from_bytes(msg.data, "little")


def wait_for(condition: Any) -> None:
    deadline = time.monotonic() + TIMEOUT_S
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.001)


def sockets(root: Path) -> list[Path]:
    return sorted(root.glob("x/*.node"))


def test_burst_of_20000_before_the_first_recv_in_one_thread() -> None:
    with buses({}, {}) as (sender, receiver):
        for each in range(20_000):
            sender.send(frame(each))
        assert [number(receiver.recv(TIMEOUT_S)) for _ in range(20_000)] == list(range(20_000))
        assert receiver.recv(0) is None


def test_no_thread_outlives_its_backlog() -> None:
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


def test_two_processes_burst_at_each_other() -> None:
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


def test_threads_may_send_at_once() -> None:
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


def test_frame_sent_right_after_a_constructor_is_delivered() -> None:
    with buses({}) as (sender,):
        for each in range(300):  # far more often than the clock of the file system ticks
            with LocalBus("x") as late:
                sender.send(frame(each))
                assert number(late.recv(0)) == each


@pytest.mark.parametrize("burst", [0, 1000], ids=["idle", "backlogged"])
def test_killed_node_is_cleaned_away(
    root: Path, burst: int, caplog: pytest.LogCaptureFixture
) -> None:
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


def test_socket_of_a_node_that_is_just_joining_is_not_taken_for_dead(root: Path) -> None:
    with buses({}) as (sender,), (root / "x" / local_bus_directory.GENERATION).open() as lock:
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


def test_node_killed_before_anyone_sent_is_cleaned_away(root: Path) -> None:
    with node("import time; time.sleep(60)") as victim:
        victim.kill()
        victim.wait()
    with buses({}, {}) as (sender, receiver):
        assert len(sockets(root)) == 3
        sender.send(frame(1))
        assert len(sockets(root)) == 2
        assert number(receiver.recv(TIMEOUT_S)) == 1


def test_last_node_takes_the_directory_of_a_name_away_but_not_a_users(
    root: Path, tmp_path: Path
) -> None:
    with buses({}, {}):
        assert (root / "x").is_dir()
    assert not (root / "x").exists()
    theirs = tmp_path / "theirs"
    theirs.mkdir()
    with LocalBus(str(theirs)):
        pass
    assert theirs.is_dir()


def test_other_files_in_the_directory_are_left_alone(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    (tmp_path / "1-abcdef.node").write_text("looks like a node, but is no socket")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as foreign:
        foreign.bind(str(tmp_path / "foreign.sock"))
    with LocalBus(str(tmp_path)) as sender, LocalBus(str(tmp_path)) as receiver:
        sender.send(frame(1))
        assert number(receiver.recv(TIMEOUT_S)) == 1
    for name in ("notes.txt", "1-abcdef.node", "foreign.sock"):
        assert (tmp_path / name).exists()


def test_silent_listener_is_cut_off_and_both_ends_are_told(
    caplog: pytest.LogCaptureFixture,
) -> None:
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


def test_own_queue_that_nobody_reads_is_bounded_too(caplog: pytest.LogCaptureFixture) -> None:
    with buses({"tx_backlog": 50, "receive_own_messages": True}) as (bus,):
        for each in range(500):
            bus.send(frame(each))
        assert "cut off" in caplog.text
        with pytest.raises(can.CanOperationError, match="cut off"):
            for each in range(500):
                assert number(bus.recv(TIMEOUT_S)) == each


def test_shutdown_delivers_the_backlog() -> None:
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


def test_shutdown_gives_up_on_a_listener_and_says_so(caplog: pytest.LogCaptureFixture) -> None:
    with buses({}, {}) as (sender, _silent):
        for each in range(100):
            sender.send(frame(each))
        sender.shutdown()
        assert "frames were never read by" in caplog.text


def test_nodes_that_leave_together_do_not_wait_for_each_other(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
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


def test_shutdown_does_not_wait_for_a_listener_that_was_cut_off(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with buses({"tx_backlog": 50}, {}) as (sender, _silent):
        for each in range(100):
            sender.send(frame(each))
        monkeypatch.setattr(local_bus, "_SHUTDOWN_S", 60.0)
        leaving = threading.Thread(target=sender.shutdown)
        leaving.start()
        leaving.join(TIMEOUT_S)
        assert not leaving.is_alive()


def test_shutdown_wakes_a_waiting_recv() -> None:
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


def test_send_with_timeout_waits_for_room_and_is_all_or_nothing() -> None:
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


def test_flush_tx_buffer_discards_what_waits() -> None:
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


def test_fd_frames_need_an_fd_bus() -> None:
    with buses({}, {"fd": True}, {}) as (classic, modern, listener):
        assert classic.protocol is can.CanProtocol.CAN_20
        assert modern.protocol is can.CanProtocol.CAN_FD
        with pytest.raises(can.CanOperationError, match="CAN FD disabled"):
            classic.send(frame(1, is_fd=True))
        modern.send(frame(1, is_fd=True))
        modern.send(frame(2))
        assert number(listener.recv(TIMEOUT_S)) == 2


@pytest.mark.parametrize(
    "wrong",
    [
        {"arbitration_id": 0x800, "is_extended_id": False},
        {"arbitration_id": 1 << 29},
        {"arbitration_id": -1},
        {"data": bytes(9)},
        {"data": bytes(65), "is_fd": True},
        {"data": bytes(3), "dlc": 4, "is_extended_id": False},
        {"is_fd": True, "is_remote_frame": True},
    ],
    ids=str,
)
def test_what_is_no_can_frame_is_refused(wrong: dict[str, Any]) -> None:
    with buses({"fd": True}, {"fd": True}) as (sender, receiver):
        with pytest.raises(can.CanOperationError, match="not a CAN frame"):
            sender.send(can.Message(**wrong))
        assert receiver.recv(0) is None


def test_timestamps_are_of_sending_or_preserved() -> None:
    with buses({}, {"preserve_timestamps": True}, {}) as (clock, preserver, receiver):
        preserver.send(frame(1, timestamp=123.456789))
        received = receiver.recv(TIMEOUT_S)
        assert received is not None
        assert received.timestamp == 123.456789
        earliest = time.time()
        clock.send(frame(1, timestamp=123.456789))
        received = receiver.recv(TIMEOUT_S)
        assert received is not None
        assert earliest <= received.timestamp <= time.time()
        assert received.channel == "x"


def test_descriptor_is_readable_while_frames_wait() -> None:
    with buses({}, {}) as (sender, receiver):
        assert select.select([receiver], [], [], 0)[0] == []
        sender.send(frame(1))
        assert select.select([receiver], [], [], TIMEOUT_S)[0] == [receiver]
        receiver.recv(0)
        assert select.select([receiver], [], [], 0)[0] == []


def test_no_descriptor_is_left_behind() -> None:
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


@pytest.mark.parametrize("timeout_s", [0.002, 0.04, 0.06])
def test_recv_sleeps_while_it_waits(timeout_s: float, monkeypatch: pytest.MonkeyPatch) -> None:
    looks = []
    look = LocalBus._recv_internal

    def counted(self: LocalBus, timeout: float | None) -> Any:
        looks.append(timeout)
        return look(self, timeout)

    monkeypatch.setattr(LocalBus, "_recv_internal", counted)
    with buses({}) as (bus,):
        assert bus.recv(timeout_s) is None
        assert len(looks) < 10


def test_notifier_in_an_event_loop() -> None:
    async def listen() -> list[int]:
        with buses({}, {}) as (sender, receiver):
            reader = can.AsyncBufferedReader()
            with can.Notifier(receiver, [reader], loop=asyncio.get_running_loop()):
                for each in range(100):
                    sender.send(frame(each))
                wait = asyncio.wait_for
                return [number(await wait(reader.get_message(), TIMEOUT_S)) for _ in range(100)]

    assert asyncio.run(listen()) == list(range(100))


def test_python_can_finds_it() -> None:
    with (
        can.Bus(interface="local", channel="x", ignore_config=True) as bus,
        can.Bus(interface="local", channel=1, ignore_config=True),
    ):
        assert isinstance(bus, LocalBus)
        assert bus.state is can.BusState.ACTIVE
        assert str(bus) == "local bus x"
        found = can.detect_available_configs("local")
        assert [config["channel"] for config in found] == ["1", "rig", "x"]


def test_python_cans_own_logger_listens(root: Path) -> None:
    command = [sys.executable, "-u", "-m", "can.logger", "-i", "local", "-c", "x"]
    with (
        buses({}) as (bus,),
        subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as logger,
    ):
        try:
            wait_for(lambda: len(sockets(root)) == 2)
            for each in range(50):
                bus.send(frame(each))
            assert logger.stdout is not None
            lines: list[str] = []
            while len(lines) < 50:
                line = logger.stdout.readline()
                assert line, "the logger has ended"
                if "DL:" in line:
                    lines.append(line)
            assert all(f"{each:02x} 00 00 00" in line for each, line in enumerate(lines))
        finally:
            logger.send_signal(signal.SIGINT)
    assert logger.returncode == 0


@pytest.mark.parametrize("name", ["a/b", "", ".", "..", ".hidden"])
def test_wrong_names(name: str) -> None:
    with pytest.raises(can.CanInitializationError, match="neither a name"):
        LocalBus(name)


def test_longest_path_that_a_socket_can_have(tmp_path: Path) -> None:
    room = local_bus_directory.PATH_MAX - len(str(tmp_path)) - 1
    with LocalBus(f"{tmp_path}/{'y' * room}") as one, LocalBus(one.channel) as other:
        one.send(frame(1))
        assert number(other.recv(TIMEOUT_S)) == 1
    with pytest.raises(can.CanInitializationError, match="3 bytes too long for a socket"):
        LocalBus(f"{tmp_path}/{'y' * (room + 3)}")


def test_directory_that_cannot_be_made() -> None:
    with pytest.raises(can.CanInitializationError, match="No such file or directory"):
        LocalBus("/nowhere/x")


def test_root_that_others_can_enter_is_refused(root: Path) -> None:
    root.mkdir()
    root.chmod(0o755)
    with pytest.raises(can.CanInitializationError, match="not a private directory"):
        LocalBus("x")


def test_root_without_a_runtime_directory(monkeypatch: pytest.MonkeyPatch) -> None:
    for unusable in ("", "relative", "/nowhere"):
        monkeypatch.setenv("XDG_RUNTIME_DIR", unusable)
        assert local_bus_directory.bus_root().name == f"can-rig-{os.getuid()}"
