"""SocketCAN under the nodes: what crowds, refuses or breaks, on a real kernel."""

import math
import subprocess
import threading
from contextlib import suppress
from dataclasses import replace

import can
import pytest
from click.testing import CliRunner

from can_rig.buses import bus as opening
from can_rig.buses.bus import open_bus, open_for_node
from can_rig.cli.main import main
from can_rig.controllers.our_law import PYTHON
from can_rig.errors import BusLostError, SilentNodeError
from can_rig.nodes.bus_access import (
    SYSTEM_CLOCK,
    Interrupted,
    PersistentSender,
    StopRequest,
    Timeouts,
    Watchdog,
)
from can_rig.nodes.interaction import Interaction
from can_rig.nodes.runner import run_controller, run_in_process, run_plant
from can_rig.scenario.loading import load
from tests.helpers import record, refuses
from tests.vcan import PATIENT, TIMEOUT_S, frame, on_two_buses, own_can, tool

__all__ = ["own_can"]

pytestmark = pytest.mark.vcan

OWN = (0x100, 0x101)
SHORT = "duration_s=0.2"


def received(bus, timeout_s=0.05):
    """Every message in the receive queue."""
    while (message := bus.recv(timeout_s)) is not None:
        yield message


# --- a node's end of the bus -------------------------------------------------------------------


def test_a_flood_of_others_neither_loses_nor_delays_the_nodes_own_frames(own_can):
    """More than any queue holds; the rest is heard as far as there was room for it, and counted."""
    count = 30_000
    with (
        open_for_node(f"socketcan:{own_can}", OWN, overhear=True) as node,
        open_bus(f"socketcan:{own_can}") as other,
    ):
        other.send(frame(OWN[0], b"first"))
        tool("cangen", own_can, "-g", 0, "-I", "300", "-L", 8, "-n", count)
        other.send(frame(OWN[1], b"last"))
        heard = list(received(node))
        own = [m.data for m in heard[:4] if m.arbitration_id in OWN]
        assert own == [b"first", b"last"]  # they take turns with the flood, and wait for no more
        overheard = [m for m in heard if m.arbitration_id not in OWN]
        assert {m.arbitration_id for m in overheard} == {0x300}
        assert 0 < node.lost_frames < count  # type: ignore[attr-defined]
        assert len(overheard) + node.lost_frames == count  # type: ignore[attr-defined]


def test_what_is_overheard_is_everything_else_and_in_order(own_can):
    with (
        open_for_node(f"socketcan:{own_can}", OWN, overhear=True) as node,
        open_for_node(f"socketcan:{own_can}", OWN, overhear=False) as deaf,
        open_bus(f"socketcan:{own_can}", fd=True) as other,
    ):
        others = [
            frame(0x102, b"a"),
            frame(0x100, b"b", is_extended_id=True),
            frame(0x7FF, is_remote_frame=True, dlc=3),
            frame(0x12345678, b"c", is_extended_id=True),
        ]
        for each in (*others, frame(0x105, bytes(64), is_fd=True), frame(OWN[1], b"mine")):
            other.send(each)
        heard = list(received(node))
        heard.remove(next(m for m in heard[:2] if m.data == b"mine"))
        assert [m.data for m in heard] == [b"a", b"b", b"", b"c"]
        for message, sent in zip(heard, others, strict=True):
            assert message.equals(
                sent, timestamp_delta=None, check_channel=False, check_direction=False
            )
        assert [m.data for m in received(deaf)] == [b"mine"]
        assert node.lost_frames == deaf.lost_frames == 0  # type: ignore[attr-defined]


def test_what_was_on_the_bus_before_is_not_heard(own_can):
    stop = threading.Event()

    def talk():
        with open_bus(f"socketcan:{own_can}") as other:
            while not stop.is_set():
                other.send(frame(0x300))

    talking = threading.Thread(target=talk)
    talking.start()
    try:
        for _ in range(20):
            with open_for_node(f"socketcan:{own_can}", OWN, overhear=False) as node:
                assert node.recv(0) is None
    finally:
        stop.set()
        talking.join()


# --- what the loop makes of frames that are not its own ----------------------------------------


@pytest.mark.parametrize("number", [0x100, 0x101, 0x110, 0x120, 0x123])
def test_frames_of_every_kind_change_nothing(number, own_can, tmp_path):
    """Extended, remote, FD and error frames, wrong lengths and checksums, before every tick."""
    kinds = [
        {"data": bytes(8)}, {"data": b"123"}, {"data": bytes(8), "is_extended_id": True},
        {"is_remote_frame": True, "dlc": 8}, {"data": bytes(8), "is_fd": True},
        {"data": bytes(64), "is_fd": True}, {"data": bytes(8), "is_error_frame": True},
    ]  # fmt: skip
    settings = ["duration_s=0.03"]
    quiet = record(tmp_path, *settings)[0].read_text().splitlines()
    log = tmp_path / "disturbed.log"
    with open_bus(f"socketcan:{own_can}", fd=True) as other:

        def disturb(_tick):
            for kind in kinds:
                other.send(frame(number, **kind))

        scenario = load("thesis-step", settings)
        summary = run_in_process(
            scenario, f"socketcan:{own_can}", log, StopRequest(), disturb, PYTHON
        )
    seen = [line.split()[2:] for line in log.read_text().splitlines()]
    wanted = [line.split()[2:] for line in quiet]
    assert [each for each in seen if each[1:] == ["T"]] == [
        each for each in wanted if each[1:] == ["T"]
    ]
    remaining = iter(seen)
    assert all(each in remaining for each in wanted)  # in this order, the others between
    assert len(seen) > len(wanted)
    assert summary.ticks == 30


# --- a bus that refuses ------------------------------------------------------------------------


@pytest.fixture
def shaped(own_can):
    """Limits the interface to so many bits a second, with room for a few frames that wait."""

    def shape(rate):
        try:
            tool("modprobe", "sch_tbf")
        except subprocess.CalledProcessError as error:
            pytest.skip(f"NOT TESTED: the kernel has no sch_tbf: {error.stderr.strip()}")
        tool(*f"tc qdisc add dev {own_can} root tbf rate {rate} burst 32 limit 32".split())

    return shape


def test_a_full_transmit_queue_is_waited_for_and_reported(shaped, own_can, tmp_path):
    expected = record(tmp_path, "duration_s=0.02")[0].read_bytes()
    shaped("20kbit")
    log, summary, _ = record(tmp_path, "duration_s=0.02", bus=f"socketcan:{own_can}")
    assert log.read_bytes() == expected
    for node in ("plant", "controller"):
        ((what, count),) = summary.bus_events[node].items()
        assert "No buffer space available" in what
        assert count > 0


def test_a_transmit_queue_that_stays_full_ends_the_node_in_one_line(shaped, own_can):
    shaped("8bit")
    with open_bus(f"socketcan:{own_can}") as bus:
        send = PersistentSender(bus, 0.2, SYSTEM_CLOCK)
        with pytest.raises(BusLostError) as caught:
            for number in range(20):
                send(frame(0x100, bytes([number])))
    assert str(caught.value) == (
        f"socketcan channel '{own_can}': the transmit queue has been full for 0.2 s; is there a "
        f"node that acknowledges? for a longer queue: sudo ip link set {own_can} txqueuelen 1000"
    )
    assert caught.value.exit_status == SilentNodeError.exit_status == 3


# --- a bus that goes down ----------------------------------------------------------------------


def set_link(state, name):
    tool("ip", "link", "set", state, name)


def test_an_interface_that_comes_back_in_time_costs_nothing_but_time(own_can, tmp_path):
    expected = record(tmp_path, SHORT)[0].read_bytes()
    log = tmp_path / "run.log"
    back = threading.Timer(0.3, set_link, ("up", own_can))

    def on_tick(tick):
        if tick == 100:
            set_link("down", own_can)
            back.start()

    bus = f"socketcan:{own_can}"
    summary = on_two_buses(bus, bus, log, SHORT, on_tick=on_tick)  # however late it comes back
    back.join()
    assert log.read_bytes() == expected
    assert any("Network is down" in what for what in summary.bus_events["plant"])


@pytest.mark.parametrize(
    ("command", "expected"),
    [
        ("ip link set down {}", "the interface has been down for 1 s: sudo ip link set up {}"),
        ("ip link del {}", "the interface is gone: sudo modprobe vcan; sudo ip link add dev {} "),
    ],
    ids=["down", "gone"],
)
def test_an_interface_that_stays_away_ends_the_run_in_one_line(
    command, expected, own_can, tmp_path
):
    scenario, log = load("thesis-step", [SHORT]), tmp_path / "run.log"

    def on_tick(tick):
        if tick == 100:
            tool(*command.format(own_can).split())

    with refuses(expected.format(own_can), BusLostError):
        run_in_process(scenario, f"socketcan:{own_can}", log, StopRequest(), on_tick, PYTHON)
    assert log.read_text().count("\n") >= 500  # every tick until then
    if "del" in command:
        tool("ip", "link", "add", "dev", own_can, "type", "vcan")


def test_a_node_that_only_listens_says_that_the_interface_is_down(own_can):
    """Not that its partner is silent: it cannot know."""
    with open_bus(f"socketcan:{own_can}") as bus:
        watchdog = Watchdog(bus, "plant", Timeouts(0.3, 0.3), StopRequest())
        set_link("down", own_can)
        with pytest.raises(BusLostError, match=f"down for 0.3 s: sudo ip link set up {own_can}"):
            watchdog.receive(7)
    assert watchdog.errors == {"Error receiving: Network is down [Error Code 100]": 1}


def test_an_interface_that_falls_while_a_node_opens_it_is_no_traceback(own_can, monkeypatch):
    monkeypatch.setattr(opening, "_widen", lambda _: set_link("down", own_can))
    with open_for_node(f"socketcan:{own_can}", [0x100], False) as bus:
        with pytest.raises(BusLostError, match="has been down"):
            PersistentSender(bus, 0.01, SYSTEM_CLOCK)(can.Message(arbitration_id=0x100))
        set_link("up", own_can)


@pytest.mark.parametrize("interaction", [Interaction(pace=50.0), Interaction(injectable=True)])
def test_a_run_that_bears_every_silence_ends_when_its_interface_stays_away(
    interaction, own_can, tmp_path
):
    """As one that may be paused; tests/rig/cli has which runs bear it."""
    scenario, bus = load("thesis-step", ["fault.kind=none"]), f"socketcan:{own_can}"
    stop, ready = StopRequest(), threading.Event()
    timeouts = Timeouts(TIMEOUT_S, math.inf)
    options = replace(PATIENT, timeouts=timeouts, interaction=interaction)

    def controller():
        with suppress(Interrupted, BusLostError):
            run_controller(scenario, bus, stop, ready.set, lambda tick: None, options)

    def on_tick(tick):
        if tick == 100:
            set_link("down", own_can)

    beside = threading.Thread(target=controller)
    beside.start()
    ready.wait(TIMEOUT_S)
    try:
        with pytest.raises(BusLostError) as caught:
            run_plant(scenario, bus, tmp_path / "run.log", stop, on_tick, options)
    finally:
        stop.wanted = True
        set_link("up", own_can)
        beside.join(TIMEOUT_S)
    line = f"the interface has been down for 1 s: sudo ip link set up {own_can}"
    assert line in str(caught.value)
    assert "\n" not in str(caught.value)


def test_before_the_run_one_line_and_its_recipe(own_can, tmp_path):
    def failure(bus):
        result = CliRunner().invoke(
            main, ["run", "thesis-step", "--bus", bus, "--in-process", "--out", str(tmp_path / "r")]
        )
        assert result.exit_code == 2
        assert not (tmp_path / "r").exists()
        (line,) = [line for line in result.output.splitlines() if "error:" in line]
        return line

    set_link("down", own_can)
    assert f"{own_can} is down: sudo ip link set up {own_can}" in failure(f"socketcan:{own_can}")
    assert "no such CAN interface vcan77: sudo modprobe vcan" in failure("socketcan:vcan77")
