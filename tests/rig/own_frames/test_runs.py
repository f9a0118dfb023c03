"""The whole rig on the user's frames: other programs read the rig's values in the log."""

import re
import subprocess
import sys
from functools import partial
from pathlib import Path

import can
import numpy as np
import pytest

from can_rig.controllers.our_law import PYTHON
from can_rig.errors import DbcError, ScenarioError, SilentNodeError
from can_rig.frames.network import Network
from can_rig.nodes.bus_access import StopRequest, Timeouts, Watchdog
from can_rig.nodes.realtime.controller_node import RealTimeControllerNode
from can_rig.nodes.ticks import drive
from can_rig.plant.frameless import frameless
from can_rig.results.signals import Signals, read_signals
from can_rig.scenario.build import network_of
from can_rig.scenario.loading import load
from can_rig.scenario.settings import Scenario
from firmware_model.law.status import FaultState
from tests.clock import TurnedClock, Wire
from tests.helpers import asked, record, refused, refuses, succeeded
from tests.rig.own_frames.scenarios import FD_SIGNALS, MOTOROLA, SIGNALS, database, options

DRIVE = ["duration_s=1.5", "fault.at_s=1.0"]
CHASSIS = [
    "tick_s=0.02", "latency_ticks=1", "design.tau_s=0.02", "design.tau_q_s=0.1", "duration_s=2.0",
    "fault.at_s=1.0",
]  # fmt: skip
COLUMNS = {
    "reference": "reference_mps2", "feedback": "dstar_mps2", "command_1": "torque_nm",
    "command_2": "force_difference_n", "fault_estimate": "fault_estimate_mps2", "mode": "mode",
}  # fmt: skip


def run(folder: Path, words: list[str]) -> tuple[Path, Signals]:
    log, summary, scenario = record(folder, *words, name="default")
    assert summary.ticks == scenario.ticks
    return log, read_signals(log, network_of(scenario), scenario.tick_s)


def by_cantools(log: Path, dbc: Path, signals: dict[str, str]) -> dict[str, list[float]]:
    """The signal of each role, as the command line of cantools has it."""
    with log.open() as lines:
        done = subprocess.run(
            [sys.executable, "-m", "cantools", "decode", "--single-line", "--no-strict",
             "--no-decode-choices", str(dbc)],
            stdin=lines, capture_output=True, text=True, check=True,
        )  # fmt: skip
    found: dict[str, list[float]] = {role: [] for role in signals}
    for line in done.stdout.splitlines():
        for role, name in signals.items():
            message, _, signal = name.partition(".")
            if match := re.search(rf":: {message}\(.*\b{signal}: (\S+?)[ ,)]", line):
                found[role].append(float(match[1]))
    return found


def require_agreement(log: Path, dbc: Path, names: dict[str, str], signals: Signals) -> None:
    theirs = by_cantools(log, dbc, names)
    for role, column in COLUMNS.items():
        ours = getattr(signals, column)
        assert len(theirs[role]) == len(ours), role
        np.testing.assert_allclose(theirs[role], ours, rtol=1e-7, atol=1e-12, err_msg=role)


def test_16_bit_big_endian_without_protection(tmp_path):
    log, signals = run(tmp_path, [*DRIVE, *options(MOTOROLA, SIGNALS)])
    require_agreement(log, MOTOROLA, SIGNALS, signals)
    confirmed = np.flatnonzero(signals.fault_state == FaultState.CONFIRMED)
    assert 1000 < confirmed[0] < 1100
    assert np.abs(signals.error_mps2[-100:]).max() < 0.05
    again, _ = run(tmp_path, [*DRIVE, *options(MOTOROLA, SIGNALS)])
    assert log.read_bytes() == again.read_bytes()


@pytest.mark.parametrize("bits", [0, 16, 32, 64])
@pytest.mark.parametrize("precision", ["float64", "float32"])
def test_it_is_the_run_without_frames(bits, precision, tmp_path):
    dbc, names = MOTOROLA, SIGNALS
    if bits:
        dbc, names = tmp_path / "floats.dbc", FD_SIGNALS
        kind = "2" if bits == 64 else "1"
        place = f"64|{bits}@1- (1,0) [0|0]"
        dbc.write_text(database(place, 16, 0x98FF0000, types=kind, fd=True))
    words = ["duration_s=0.3", "fault.at_s=0.2", f"design.precision={precision}"]
    words += options(dbc, names)
    _, signals = run(tmp_path, words)
    scenario = load("default", words)
    trace = frameless(scenario)
    np.testing.assert_array_equal(trace.measured, signals.dstar_mps2)
    np.testing.assert_array_equal(trace.command_1, signals.torque_nm)
    np.testing.assert_array_equal(trace.command_2, signals.force_difference_n)


def test_can_fd_with_floats_29_bits_and_protection(tmp_path):
    dbc = tmp_path / "fd.dbc"
    dbc.write_text(database("64|32@1- (1,0) [0|0]", 12, 0x98FF0000, types="1", fd=True))
    ids = {"reference": 1, "feedback": 2, "command_1": 3, "command_2": 4, "status": 5}
    log, signals = run(tmp_path, [*DRIVE, *options(dbc, FD_SIGNALS, data_ids=ids)])
    assert " 18FF0001##0" in log.read_text().splitlines()[0]
    require_agreement(log, dbc, FD_SIGNALS, signals)
    assert np.abs(signals.error_mps2[-100:]).max() < 0.05


def test_a_run_folder_is_replayed_and_decoded_by_its_own_database(tmp_path):
    words = [w for word in [*CHASSIS, *options(MOTOROLA, SIGNALS)] for w in ("--set", word)]
    succeeded("run", "default", *words, "--out", tmp_path / "run")
    again = asked("replay", tmp_path / "run")
    assert again.returncode == 0 and "identical, bit for bit" in again.stdout
    alone = asked("decode", tmp_path / "run" / "bus.log")  # the file itself, which lies in its run
    assert alone.returncode == 0 and "EPS_Command" in alone.stdout
    other = asked("replay", tmp_path / "run", "--set", "design.tau_q_s=0.12")
    assert other.returncode == 1 and "MotorTorque" in other.stdout


def test_real_time_needs_no_tick(tmp_path):
    words = [w for word in [*CHASSIS, *options(MOTOROLA, SIGNALS, "")] for w in ("--set", word)]
    assert "network.tick: must name the signal that counts the ticks" in refused(
        "run", "default", *words, "--out", tmp_path / "lockstep"
    )
    assert not (tmp_path / "lockstep").exists()
    assert "no network.tick: runs in real time" in asked("bus", "default", *words).stdout
    succeeded("run", "default", *words, "--realtime", "--out", tmp_path / "run")
    scenario = load("default", [*CHASSIS, *options(MOTOROLA, SIGNALS, "")])
    signals = read_signals(tmp_path / "run" / "bus.log", network_of(scenario), scenario.tick_s)
    assert 0 < len(signals) <= scenario.ticks
    theirs = by_cantools(tmp_path / "run" / "bus.log", MOTOROLA, SIGNALS)
    for role, column in COLUMNS.items():  # a busy machine misses ticks, and sends two in another
        ours = getattr(signals, column)
        left = iter(theirs[role])
        for value in ours[np.isfinite(ours)]:
            assert any(abs(value - other) <= 1e-12 + 1e-7 * abs(other) for other in left), role


def driven(scenario: Scenario, network: Network, *frames: can.Message) -> int:
    """The ticks of a controller that hears some frames and then silence."""
    clock = TurnedClock()
    wire = Wire(clock, *frames)
    node = RealTimeControllerNode(scenario, network, wire, clock, PYTHON)
    watchdog = Watchdog(wire, "plant", Timeouts(), StopRequest(), clock=clock)
    return drive(partial(node.carry, watchdog), node.ticks, lambda _: None)


@pytest.mark.parametrize("tick", ["", "Count"])
def test_where_frames_have_no_tick_silence_is_the_end(tick):
    scenario = load("default", [*CHASSIS, *options(MOTOROLA, SIGNALS, tick)])
    network = network_of(scenario)
    with pytest.raises(SilentNodeError):
        driven(scenario, network)
    feedback = network.feedback
    data = feedback.encode(0.0, 0)
    wide = feedback.extended
    frame = can.Message(arbitration_id=feedback.frame_id, is_extended_id=wide, data=data)
    if not tick:
        assert driven(scenario, network, *3 * [frame]) == 3
        return
    with pytest.raises(SilentNodeError):
        driven(scenario, network, frame)


def test_check_and_bus_say_what_the_frames_cannot(tmp_path):
    words = [*CHASSIS, *options(MOTOROLA, SIGNALS), "limits.torque_nm=9000"]
    settings = [w for word in words for w in ("--set", word)]
    said = " ".join(asked("check", "default", *settings).stdout.split())
    assert "5 of 5 frames unprotected" in said
    assert "limits.torque_nm = 9000: EPS_Command.MotorTorque carries ±4095.88 N m only" in said
    coarse = tmp_path / "coarse.dbc"
    text = MOTOROLA.read_text().replace("(0.001,-32.768) [-32.768|32.767]", "(1,-32768) [0|0]")
    coarse.write_text(text.replace("BO_ 1304 ESP_Other", "BO_ 1301 ESP_Other"))
    settings = [w for word in [*CHASSIS, *options(coarse, SIGNALS)] for w in ("--set", word)]
    said = " ".join(asked("check", "default", *settings).stdout.split())
    assert "ESP_Motion.DStarMeas is too coarse: its step of 1 moves" in said
    done = asked("bus", "default", *settings)
    assert "5 of 5 frames unprotected" in done.stdout
    assert "collide: ESP_Other has identifier 0x515 of command_1 too" in done.stdout.replace(
        "\n", " "
    )
    assert "0x18FECA15" in done.stdout


KEYS = {
    "network.dbc=missing.dbc": "missing.dbc: cannot be read: No such file",
    "network.signals.feedback=ESP_Motion": "network.signals.feedback = 'ESP_Motion': must be Mess",
    "network.signals.feedback=ESP_Moton.DStarMeas": "no message ESP_Moton; did you mean ESP_Motio",
    "network.signals.feedback=ESP_Motion.DStarMes": "has no signal DStarMes; did you mean DS",
    "network.signals.feedback=VMC_Request.Speed": "reference and feedback both have identifier",
    "network.signals.feedback=''": "network.signals.feedback: must be set beside the other",
    "network.signals.mode=ESP_Motion.Valid": "must be in message EPS_Status, with the fault",
    "network.signals.mode=EPS_Status.Estimate": "are both EPS_Status.Estimate: each must",
    "network.signals.mode=EPS_Status.Count": "network.signals.mode and network.tick are both EPS",
    "network.signals.verdict=EPS_Status.State": "mode and network.signals.verdict are both",
    "network.signals.torqe=A.B": "network.signals.torqe: unknown key",
    "network.tick=Tick": "network.tick = 'Tick'",
    "network.dbc=''": "network.dbc: must name the database of network.signals",
    "network.data_ids.feedback=0": "network.data_ids.feedback = 0: must be at least 1",
    "network.data_ids.status=70000": "network.data_ids.status = 70000: must be at most 65535",
    "network.data_ids.command_1=9": "MotorTorque (network.signals.command_1) lies in byte 0",
    "fault.kind=frames-corrupted": "network.data_ids.command_1 must be set: nothing tells that",
}


@pytest.mark.parametrize(("setting", "line"), KEYS.items(), ids=KEYS)
def test_a_bad_key_is_one_line_that_names_it(setting, line):
    with refuses(line, (ScenarioError, DbcError)):
        network_of(load("default", [*options(MOTOROLA, SIGNALS), setting]))


def test_keys_that_need_the_signals_say_so():
    with pytest.raises(ScenarioError, match=r"network.signals: must be set beside network.tick"):
        load("default", [f"network.dbc={MOTOROLA}", "network.tick=Count"])
    with pytest.raises(DbcError, match=r"no message has RigRole reference"):
        network_of(load("default", [f"network.dbc={MOTOROLA}"]))
