"""The local bus as python-can expects its buses: protocols, timestamps, descriptors, notifiers."""

import asyncio
import select
import signal
import subprocess
import sys
import threading
import time
from typing import Any

import can
import pytest

from can_rig.buses.local.bus import LocalBus
from tests.processes import wait_for
from tests.rig.buses.local.nodes import TIMEOUT_S, buses, frame, number, sockets


def test_fd_frames_need_an_fd_bus():
    with buses({}, {"fd": True}, {}) as (classic, modern, listener):
        assert classic.protocol is can.CanProtocol.CAN_20
        assert modern.protocol is can.CanProtocol.CAN_FD
        with pytest.raises(can.CanOperationError, match="CAN FD disabled"):
            classic.send(frame(1, is_fd=True))
        modern.send(frame(1, is_fd=True))
        modern.send(frame(2))
        assert number(listener.recv(TIMEOUT_S)) == 2


def test_a_classic_frame_is_found_behind_thousands_of_fd_frames():
    with buses({"fd": True}, {}) as (modern, classic):
        for _ in range(3000):
            modern.send(frame(1, is_fd=True))
        modern.send(frame(2))
        assert number(classic.recv(TIMEOUT_S)) == 2


def test_receiving_ends_in_time_among_fd_frames_that_never_end():
    ended = threading.Event()

    def send_on(bus):
        for _ in range(800):
            bus.send(frame(1, is_fd=True))
            if ended.wait(0.01):
                return

    with buses({"fd": True}, {}) as (modern, classic):
        sending = threading.Thread(target=send_on, args=(modern,))
        sending.start()
        try:
            assert classic.recv(0.1) is None
            assert sending.is_alive()
        finally:
            ended.set()
            sending.join()


@pytest.mark.parametrize(
    "wrong",
    [{"arbitration_id": 0x800, "is_extended_id": False}, {"arbitration_id": 1 << 29},
     {"arbitration_id": -1}, {"data": bytes(9)}, {"data": bytes(65), "is_fd": True},
     {"data": bytes(3), "dlc": 4, "is_extended_id": False},
     {"is_fd": True, "is_remote_frame": True}],
    ids=str,
)  # fmt: skip
def test_what_is_no_can_frame_is_refused(wrong):
    with buses({"fd": True}, {"fd": True}) as (sender, receiver):
        with pytest.raises(can.CanOperationError, match="not a CAN frame"):
            sender.send(can.Message(**wrong))
        assert receiver.recv(0) is None


def test_timestamps_are_of_sending_or_preserved():
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


def test_descriptor_is_readable_while_frames_wait():
    with buses({}, {}) as (sender, receiver):
        assert select.select([receiver], [], [], 0)[0] == []
        sender.send(frame(1))
        assert select.select([receiver], [], [], TIMEOUT_S)[0] == [receiver]
        receiver.recv(0)
        assert select.select([receiver], [], [], 0)[0] == []


@pytest.mark.parametrize("timeout_s", [0.002, 0.04, 0.06])
def test_recv_sleeps_while_it_waits(timeout_s, monkeypatch):
    looks = []
    look = LocalBus._recv_internal

    def counted(self: LocalBus, timeout: float | None) -> Any:
        looks.append(timeout)
        return look(self, timeout)

    monkeypatch.setattr(LocalBus, "_recv_internal", counted)
    with buses({}) as (bus,):
        assert bus.recv(timeout_s) is None
        assert len(looks) < 10


def test_notifier_in_an_event_loop():
    async def listen() -> list[int]:
        with buses({}, {}) as (sender, receiver):
            reader = can.AsyncBufferedReader()
            with can.Notifier(receiver, [reader], loop=asyncio.get_running_loop()):
                for each in range(100):
                    sender.send(frame(each))
                wait = asyncio.wait_for
                return [number(await wait(reader.get_message(), TIMEOUT_S)) for _ in range(100)]

    assert asyncio.run(listen()) == list(range(100))


def test_python_can_finds_it():
    with (
        can.Bus(interface="local", channel="x", ignore_config=True) as bus,
        can.Bus(interface="local", channel=1, ignore_config=True),
    ):
        assert isinstance(bus, LocalBus)
        assert bus.state is can.BusState.ACTIVE
        assert str(bus) == "local bus x"
        found = can.detect_available_configs("local")
        assert [config["channel"] for config in found] == ["1", "rig", "x"]


def test_python_cans_own_logger_listens(root):
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
            logger.send_signal(signal.SIGINT)
            assert logger.wait(TIMEOUT_S) == 0
        finally:
            logger.kill()
