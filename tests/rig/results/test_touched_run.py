"""The metrics of a touched run follow the injected faults."""

import json
from pathlib import Path

import can
import pytest

from can_rig.frames.operator_frames import Command, command_message, identifiers
from can_rig.nodes.bus_access import StopRequest
from can_rig.nodes.interaction import Interaction
from can_rig.nodes.operating import Touch
from can_rig.nodes.run_control import RunControl
from can_rig.results.execution import Options, execute
from can_rig.results.run_folder import REFERENCE
from can_rig.scenario.loading import load

FRAMES = 5  # of a tick


def touched(folder: Path, *commands: tuple[int, Command]):
    told = tuple(
        Touch(FRAMES * tick, tick, command_message(command, number))
        for number, (tick, command) in enumerate(commands)
    )
    scenario = load("ideal", ("duration_s=0.6", "fault.kind=none"))
    interaction = Interaction(injectable=True, told=told)
    return execute(scenario, folder, StopRequest(), Options(interaction=interaction, report=False))


def test_an_injected_fault_is_no_false_alarm(tmp_path):
    run = touched(tmp_path / "run", (300, Command("INJECT", "actuator-dead", "torque", 0.0, 0.1)))
    assert run.metrics["false_alarms"] == 0
    assert run.metrics["detection_delay_s"] < 0.1
    said = json.loads((run.folder / "run.json").read_text())
    (fault,) = said["faults"]
    assert (fault["kind"], fault["at_s"], fault["for_s"]) == ("actuator-dead", 0.3, 0.1)
    assert said["scenario"]["fault"]["kind"] == "none"  # the log has the command
    assert [each.kind for each in run.happened.faults] == ["actuator-dead"]


def test_a_reference_that_was_moved_is_no_deviation(tmp_path):
    run = touched(
        tmp_path / "run",
        (100, Command("MOVE_REFERENCE", value=0.5)),
        (300, Command("INJECT", "sensor-biased", "sensor", 0.05)),
    )
    assert run.metrics["deviation_peak_after_fault_mps2"] == pytest.approx(0.05, rel=0.3)
    assert (run.folder / REFERENCE).is_file()


def test_a_frame_with_a_long_identifier_is_no_command():
    node = RunControl.__new__(RunControl)
    node.refused = 0
    node.take(can.Message(arbitration_id=identifiers().control, is_extended_id=True))
    assert node.refused == 0
