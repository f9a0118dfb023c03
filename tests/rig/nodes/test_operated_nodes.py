"""Faults of frames injected into two nodes on a bus: the log says what a scenario would say."""

import os
import time
from dataclasses import replace
from pathlib import Path

import can
import pytest

from can_rig.buses.bus import open_bus
from can_rig.errors import RigError
from can_rig.frames import operator_frames
from can_rig.frames.operator_frames import Command
from can_rig.logs.reading import read_log
from can_rig.nodes.interaction import Interaction
from can_rig.nodes.operating import done, operate, touches
from can_rig.scenario.build import network_of
from can_rig.scenario.fault_settings import FaultSettings
from can_rig.scenario.loading import load
from tests.helpers import on_a_bus, two_nodes
from tests.vcan import PATIENT, TIMEOUT_S

TOLD = (
    Command("PAUSE"), Command("INJECT", "frames-missing", "torque", None, 0.1),
    Command("INJECT", "frames-forged", "force-difference", 40.0), Command("STEP", value=50.0),
    Command("INJECT", "frames-corrupted", "sensor"), Command("STEP", value=80.0),
    Command("CLEAR", place="force-difference"), Command("PACE", value=0.0),
)  # fmt: skip


YAW, ACCELERATION, ECHO = "yaw-rate", "lateral-acceleration", "torque-echo"
TO_SENSORS = (
    Command("PAUSE"), Command("INJECT", "sensor-scaled", ACCELERATION, 1.5),
    Command("INJECT", "sensor-biased", YAW, 0.05, 0.1),
    Command("INJECT", "frames-missing", YAW, None, 0.2), Command("STEP", value=50.0),
    Command("INJECT", "sensor-lying", ECHO), Command("INJECT", "sensor-tick-stuck", ACCELERATION),
    Command("INJECT", "sensor-late", YAW, 12.0), Command("STEP", value=80.0),
    Command("CLEAR", place=ACCELERATION), Command("INJECT", "sensor-invalid", ECHO),
    Command("STEP", value=60.0), Command("CLEAR"),
    Command("INJECT", "sensor-swapped", YAW, float(operator_frames.places().index(ACCELERATION))),
    Command("PACE", value=0.0),
)  # fmt: skip


TOUCHABLE = replace(PATIENT, interaction=Interaction(injectable=True, pace=0.05))
"""Until somebody pauses it."""


def wait_for(bus: can.BusABC, frame_id: int) -> None:
    """Until somebody sends such a frame."""
    end_s = time.monotonic() + TIMEOUT_S
    while time.monotonic() < end_s:
        message = bus.recv(1.0)
        if message is not None and message.arbitration_id == frame_id:
            return
    raise AssertionError(f"no frame {frame_id:03X} has come")


def sent(log: Path) -> list[str]:
    """The frames of the network in a log, in their order."""
    said = [line.split()[2] for line in log.read_text().splitlines()]
    return [frame for frame in said if not frame.startswith("71")]


def test_frames_fail_at_both_nodes_from_the_same_tick_on(tmp_path):
    frames_fail_as_in_a_scenario(f"local:{os.getpid()}-operated", tmp_path)


def test_further_sensors_fail_at_both_nodes_too(tmp_path):
    bus = f"local:{os.getpid()}-sensors"
    faults = frames_fail_as_in_a_scenario(bus, tmp_path, "cluster", TO_SENSORS)
    assert faults[-1].other == ACCELERATION
    assert faults[1].offset == 0.05


def test_a_sensor_that_the_scenario_lacks_does_not_fail(tmp_path):
    scenario, bus = load("ideal", ["duration_s=0.1", "fault.kind=none"]), f"local:{os.getpid()}-no"
    log = tmp_path / "bus.log"
    with two_nodes(scenario, scenario, bus, log, TOUCHABLE), open_bus(bus) as operator:
        wait_for(operator, operator_frames.identifiers().state)
        with pytest.raises(RigError, match="refused"):
            operate(operator, bus, Command("INJECT", "sensor-invalid", YAW))
        operate(operator, bus, Command("PACE", value=0.0))


@pytest.mark.vcan
def test_on_socketcan_too(tmp_path):
    frames_fail_as_in_a_scenario("socketcan:vcan0", tmp_path)


def frames_fail_as_in_a_scenario(
    bus: str, tmp_path: Path, name: str = "ideal", commands: tuple[Command, ...] = TOLD
) -> tuple[FaultSettings, ...]:
    """A run that is touched, against one with the faults of its log, and one of its log."""
    scenario = load(name, ["duration_s=0.4", "fault.kind=none"])
    log, other = tmp_path / "bus.log", tmp_path / "scheduled.log"
    with two_nodes(scenario, scenario, bus, log, TOUCHABLE) as nodes, open_bus(bus) as operator:
        wait_for(operator, operator_frames.identifiers().state)
        for command in commands:
            operate(operator, bus, command)
    assert not any(node.exception() for node in nodes.values())
    told = tuple(touches(read_log(log), network_of(scenario)))
    what = done(scenario, told).scenario
    assert [(each.kind, each.place) for each in what.faults] == [
        (command.kind, command.place) for command in commands if command.action == "INJECT"
    ]
    on_a_bus(what, other)
    assert sent(log) == sent(other)
    again = tmp_path / "again.log"
    on_a_bus(scenario, again, interaction=Interaction(injectable=True, told=told))
    assert again.read_bytes() == log.read_bytes()
    _, *ours = operator_frames.identifiers()
    assert not [each for each in ours if f" {each:03X}#" in log.read_text()]
    return what.faults
