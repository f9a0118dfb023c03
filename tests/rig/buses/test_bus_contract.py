"""Each bus against the contract, less the promises that the bus declines."""

import multiprocessing
import os
from multiprocessing.managers import BaseManager
from typing import Any

import can
import pytest

from can_rig.buses.bus import open_bus, open_for_node
from can_rig.errors import BusError
from tests.helpers import record
from tests.rig.buses.contract import BusContract, frame, numbers


class TestLocal(BusContract):
    @pytest.fixture
    def name(self, tmp_path):
        return f"local:{tmp_path}"


class _Elsewhere(BaseManager):
    """A second process that lends its buses to this process."""


_Elsewhere.register("open_bus", open_bus, exposed=["send", "recv", "shutdown"])


@pytest.fixture(scope="module")
def elsewhere():
    with _Elsewhere(ctx=multiprocessing.get_context("spawn")) as manager:
        yield manager


class TestLocalAcrossProcesses(TestLocal):
    @pytest.fixture
    def far(self, name, elsewhere):
        opened = []

        def open_far(**kwargs: Any) -> can.BusABC:
            opened.append(elsewhere.open_bus(name, fd=True, **kwargs))
            return opened[-1]

        yield open_far
        for bus in opened:
            bus.shutdown()


class TestVirtual(BusContract):
    has_descriptor = False

    @pytest.fixture
    def name(self, tmp_path):
        return f"virtual:{tmp_path}"


class TestUdpMulticast(BusContract):
    receive_own = False
    lossless = False
    refuses_when_closed = False

    @pytest.fixture
    def name(self):
        port = 20_000 + os.getpid() % 40_000  # a different port for each test process
        return f"udp_multicast:239.74.163.2?port={port}"

    @pytest.fixture
    def near(self, name):
        """Skips where a frame does not even come back to its own sender."""
        try:
            with open_bus(name) as bus:
                bus.send(frame(0))
                heard = bus.recv(0.5) is not None
        except (BusError, can.CanOperationError) as error:
            pytest.skip(f"NOT TESTED: {error}")
        if not heard:
            pytest.skip("NOT TESTED: there is no multicast here")
        yield from super().near.__wrapped__(self, name)  # type: ignore[attr-defined]

    @pytest.mark.usefixtures("near")
    def test_the_log_of_a_run_is_that_of_every_bus(self, name, tmp_path):
        """A group brings a node's own frames back."""
        here, there = (record(tmp_path, "duration_s=0.2", bus=bus) for bus in (name, "virtual:x"))
        assert here[0].read_bytes() == there[0].read_bytes()

    @pytest.mark.usefixtures("near")
    def test_a_node_hears_a_frame_of_another_like_its_own(self, name):
        with open_for_node(name, (), True) as node, open_bus(name) as other:
            node.send(frame(1))
            other.send(frame(1))
            node.send(frame(2))
            other.send(frame(3))
            assert numbers(node, 2) == [1, 3]


@pytest.mark.vcan
class TestSocketcan(BusContract):
    error_frames = False  # the kernel delivers those alone that have a class; see test_socketcan
    burst = 250  # a receive queue of the kernel's default size holds some 270
    marks_own = False  # the kernel marks frames of this machine, of any process
    refuses_when_closed = False

    @pytest.fixture
    def name(self):
        return "socketcan:vcan0"
