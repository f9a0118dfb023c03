"""The loop on vcan0 beside the tools that people look at it with, and break it with."""

import io
import json
import os
import pty
import select
import shlex
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path

import cantools
import pytest

from can_rig.nodes.bus_access import StopRequest
from can_rig.nodes.runner import run_plant
from can_rig.results.run_folder import LOG, SUMMARY
from can_rig.results.signals import read_signals
from can_rig.scenario.build import network_of
from can_rig.scenario.loading import load
from tests.helpers import DBC, NAMES, record, sets, succeeded
from tests.vcan import PATIENT, TIMEOUT_S, beside, frames, on_two_buses, tool

pytestmark = pytest.mark.vcan

BUS = "socketcan:vcan0"
SHORT = "duration_s=0.3"
# -r: its own queue holds only 270 frames; the filter leaves out the question before the first tick
CANDUMP = ("candump", "-l", "-r", 8 << 20, "vcan0,700~7FE")
CANTOOLS = (sys.executable, "-m", "cantools")


def only(mark, seen):
    """Frames of one direction: T, the plant node's own, or R, what it received."""
    return [each for each in seen if each[1:] == [mark]]


def contains_in_order(seen, wanted):
    remaining = iter(seen)
    return all(each in remaining for each in wanted)


# --- looking on --------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def live(tmp_path_factory):
    """A run of two processes on vcan0 with a fault in it, and candump -l beside it."""
    folder = tmp_path_factory.mktemp("live")
    settings = ["duration_s=0.5", "fault.at_s=0.3"]
    with beside(*CANDUMP, "-n", 2500, cwd=folder) as heard:
        # it is stable, and to see that takes long in the guest
        words = [*sets(*settings), "--allow-unstable"]
        succeeded("run", "ideal", *words, "--bus", BUS, "--out", folder / "run")
        heard.wait(TIMEOUT_S)
    (candump,) = folder.glob("candump-*.log")
    return folder / "run", candump, settings


def test_the_log_is_that_of_any_other_bus_byte_for_byte(live, tmp_path):
    folder, _, settings = live
    expected = record(tmp_path, *settings, name="ideal")[0].read_bytes()
    assert (folder / LOG).read_bytes() == expected
    assert expected.count(b"\n") == 2500
    summary = json.loads((folder / SUMMARY).read_text())
    assert summary["bus"] == BUS
    assert summary["bus_events"] == {}


def test_candump_saw_the_same_frames_in_the_same_order(live):
    folder, candump, _ = live
    assert [each[0] for each in frames(candump)] == [each[0] for each in frames(folder / LOG)]


def test_cantools_decodes_what_candump_shows(live, monkeypatch, capsys):
    _, candump, _ = live
    lines = "".join(candump.read_text().splitlines(keepends=True)[:50])
    words = ["cantools", "decode", "--single-line", str(DBC / "steer_by_wire.dbc")]
    monkeypatch.setattr(sys, "argv", words)
    monkeypatch.setattr(sys, "stdin", io.StringIO(lines))
    cantools._main()  # as a process it would take seconds in the guest
    decoded = capsys.readouterr().out.splitlines()
    assert [line.partition(":: ")[2].partition("(")[0] for line in decoded] == [*NAMES] * 10


def seen_on_a_terminal(command, wanted, keep_going, listens=True):
    """What a program has shown by the time that all ``wanted`` have been on its screen."""
    terminal, screen = pty.openpty()
    shown = b""
    options = {"stdin": screen, "stdout": screen, "env": {**os.environ, "TERM": "xterm"}}
    with beside(*command, listens=listens, **options):
        deadline = time.monotonic() + TIMEOUT_S
        while not all(word in shown for word in wanted) and time.monotonic() < deadline:
            keep_going()
            while select.select([terminal], [], [], 0.05)[0]:
                shown += os.read(terminal, 65536)
        os.write(terminal, b"q")
    os.close(terminal)
    os.close(screen)
    return shown


@pytest.mark.parametrize(
    ("command", "wanted"),
    [(("cansniffer", "-c", "vcan0"), [b"100", b"101", b"110", b"111", b"120"]),
     ((*CANTOOLS, "monitor", "-i", "socketcan", "-c", "vcan0", DBC / "steer_by_wire.dbc"),
      [b"DSTAR_REFERENCE", b"DSTAR_FEEDBACK", b"CONTROLLER_STATUS", b"RUN"])],
    ids=["cansniffer", "cantools-monitor"],
)  # fmt: skip
def test_a_viewer_shows_the_loop(command, wanted, tmp_path):
    def run_a_while():
        record(tmp_path, "duration_s=0.05", bus=BUS)

    shown = seen_on_a_terminal(command, wanted, run_a_while)
    assert [word for word in wanted if word not in shown] == []


# --- playing back ------------------------------------------------------------------------------


def test_canplayer_in_the_controllers_place_gives_the_same_drive(tmp_path):
    """The plant node cannot tell: its whole log is the recorded one, byte for byte."""
    settings = [SHORT, "fault.at_s=0.1"]
    recorded = record(tmp_path, *settings)[0]
    controller_side = tmp_path / "controller.log"
    lines = recorded.read_text().splitlines(keepends=True)
    controller_side.write_text("".join(line for line in lines if line.endswith(" R\n")))
    log, stop = tmp_path / "plant.log", StopRequest()
    options = replace(PATIENT, by_hand=True, controller=None)
    run = (load("thesis-step", settings), BUS, log, stop, lambda tick: None, options)
    plant = threading.Thread(target=run_plant, args=run)
    with beside("candump", "-L", "vcan0,100:7FF", stdout=subprocess.PIPE) as heard:
        plant.start()
        try:
            heard.stdout.readline()  # the plant node is there and has made its first offer
            tool("canplayer", "-I", controller_side, "-t", "-g", 0)
            plant.join(TIMEOUT_S)
        finally:
            stop.wanted = True
            plant.join()
    assert log.read_bytes() == recorded.read_bytes()


# --- crowding ----------------------------------------------------------------------------------


def test_a_flood_of_random_frames_at_full_speed_changes_no_command(tmp_path):
    """Of every kind and identifier, the rig's own among them; the log has what was heard."""
    short = "duration_s=0.1"
    wanted = frames(record(tmp_path, short)[0])
    flood = ("cangen", "vcan0", "-g", 0, "-m", "-i")
    with beside(*flood, listens=False):
        tool("candump", "-n", 1, "vcan0")  # it has begun: the run is short
        log, summary, scenario = record(tmp_path, short, bus=BUS)
    seen = frames(log)
    assert only("T", seen) == only("T", wanted)  # D* is the same to the last bit, so all is
    assert contains_in_order(seen, wanted)
    assert len(seen) - len(wanted) > 200
    assert summary.ticks == scenario.ticks
    signals, quiet = (
        read_signals(each, network_of(scenario), scenario.tick_s)
        for each in (log, tmp_path / "0.log")
    )
    assert (signals.fault_estimate_mps2 == quiet.fault_estimate_mps2).all()
    times = [float(line.split()[0][1:-1]) for line in log.read_text().splitlines()]
    assert times == sorted(times)


# --- a gateway that breaks things --------------------------------------------------------------


@pytest.fixture
def gateway():
    """Forwards plant (vcan1) ↔ controller (vcan0); a call changes the fate of 0x110."""
    rule = ["-s", "vcan0", "-d", "vcan1", "-e"]
    others, torque = [*rule, "-f", "110~7FF"], [*rule, "-f", "110:7FF"]

    def break_it(*how):
        tool("cangw", "-D", *torque)
        if how:
            tool("cangw", "-A", *torque, *how)

    if Path("/sys/class/net/vcan1").exists() is False:
        pytest.skip("NOT TESTED: no vcan1 here; tools/vcan_guest has it")
    added = (["-s", "vcan1", "-d", "vcan0", "-e"], others, torque)
    commands = [["cangw", "-F"], *(["cangw", "-A", *words] for words in added)]
    tool("bash", "-c", "; ".join(map(shlex.join, commands)))
    yield break_it
    tool("cangw", "-F")


def without_torque(log):
    return [each for each in frames(log) if not each[0].startswith("110#")]


def test_a_gateway_that_drops_the_torque_frame_is_frames_missing(gateway, tmp_path):
    log = tmp_path / "gateway.log"

    def at_100(tick):
        if tick == 100:
            gateway()

    summary = on_two_buses("socketcan:vcan1", BUS, log, SHORT, on_tick=at_100)
    missing = record(tmp_path, SHORT, "fault.kind=frames-missing", "fault.at_s=0.1")[0]
    assert log.read_bytes() == missing.read_bytes()
    assert summary.rejected_frames[NAMES[2]] == {"no_new_data": 200}


def test_a_gateway_that_modifies_the_torque_frame_is_frames_corrupted(gateway, tmp_path):
    log = tmp_path / "gateway.log"

    def at_100(tick):
        if tick == 100:
            gateway("-m", f"XOR:D:0.0.{'00' * 5}5A{'00' * 2}")

    summary = on_two_buses("socketcan:vcan1", BUS, log, SHORT, on_tick=at_100)
    corrupted = record(tmp_path, SHORT, "fault.kind=frames-corrupted", "fault.at_s=0.1")[0]
    assert without_torque(log) == without_torque(corrupted)
    assert len(frames(log)) == 1500
    assert summary.rejected_frames[NAMES[2]] == {"wrong_crc": 200}
