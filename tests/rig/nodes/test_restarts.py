"""A controller without power for a while, which begins again from nothing in mid-drive."""

import json
import os
import shutil
from pathlib import Path

import numpy as np
import pytest

from can_rig.controllers.making import controller_of
from can_rig.errors import ScenarioError
from can_rig.logs.reading import read_log
from can_rig.nodes.bus_access import StopRequest
from can_rig.nodes.realtime.timing import require_causal
from can_rig.results.counterfactual import signals_without_log
from can_rig.results.execution import Options, execute, two_processes
from can_rig.results.metrics import metrics
from can_rig.results.signals import read_signals
from can_rig.scenario.build import network_of
from can_rig.scenario.controls import controls
from can_rig.scenario.fault_settings import FaultSettings, Outage, outages
from can_rig.scenario.loading import load
from can_rig.scenario.settings import Scenario
from firmware_model.firmware import Firmware
from firmware_model.law.status import FaultState
from tests.helpers import succeeded

COMPILER = pytest.mark.skipif(shutil.which("cc") is None, reason="needs a C compiler")
ARM = pytest.mark.skipif(
    shutil.which("arm-none-eabi-gcc") is None or shutil.which("qemu-system-arm") is None,
    reason="needs a cross compiler and an emulator",
)


def restarting(
    *settings: str, at_s: float = 0.2, for_s: float = 0.02, name: str = "default"
) -> Scenario:
    """A short run with a restart; further faults have the numbers from 1 on."""
    restart = [
        "fault.0.kind=controller-restarted",
        f"fault.0.at_s={at_s}",
        f"fault.0.for_s={for_s}",
    ]
    return load(name, ["duration_s=0.5", *restart, *settings])


CASES = {
    "short": restarting(for_s=0.003),
    "first tick": restarting(at_s=0.0, for_s=0.01),
    "between two ticks": restarting(at_s=0.2001, for_s=0.0005),
    "counter repeated": restarting(at_s=0.196, for_s=0.02),
    "to the end": restarting(for_s=1.0),
    "two": restarting(
        "fault.1.kind=controller-restarted", "fault.1.at_s=0.3", "fault.1.for_s=0.1"
    ),
    "with a loss and lost frames": restarting(
        "fault.1.kind=actuator-dead", "fault.1.at_s=0.1",
        "fault.2.kind=frames-missing", "fault.2.at_s=0.21", "fault.2.for_s=0.02",
        "fault.3.kind=frames-corrupted", "fault.3.channel=force-difference", "fault.3.at_s=0.215",
        "fault.3.for_s=0.04",
    ),
    "with a known loss": restarting(
        "duration_s=3", "reference.kind=lane-change", "fault.0.at_s=2.2",
        "fault.0.state_survives=true", "fault.1.kind=actuator-dead", "fault.1.at_s=1",
    ),
    "drive": restarting("fault.0.state_survives=true", name="drive-cycle"),
    "on other frames": restarting(name="chassis-can", at_s=0.2, for_s=0.1),
}  # fmt: skip
IN_BURSTS = ("first tick", "two", "with a known loss", "drive")


def log_of(scenario: Scenario, where: Path, controller: str = "python", **how: object) -> bytes:
    """bus.log of a run."""
    chosen = controller_of(controller, scenario)
    options = Options(report=False, controller=chosen, **how)  # type: ignore[arg-type]
    done = execute(scenario, where, StopRequest(), options)
    assert done is not None and done.failure is None, done
    return (where / "bus.log").read_bytes()


@pytest.mark.parametrize("name", CASES)
def test_every_loop_records_the_same(name, tmp_path):
    scenario = CASES[name]
    without = log_of(scenario, tmp_path / "without")
    ways = {"frame by frame": "virtual:restarts", "bursts": f"local:restarts-{os.getpid()}"}
    for way in list(ways)[: 2 if name in IN_BURSTS else 1]:
        assert log_of(scenario, tmp_path / way, bus=ways[way]) == without, way
        for file in ("signals.csv", "bus.plant.csv"):
            assert (tmp_path / way / file).read_bytes() == (
                tmp_path / "without" / file
            ).read_bytes()
        summaries = [
            json.loads((tmp_path / each / "run.json").read_text()) for each in ("without", way)
        ]
        assert summaries[0]["metrics"] == summaries[1]["metrics"]
    one, other = (
        signals_without_log(scenario),
        read_signals(tmp_path / "without" / "bus.log", network_of(scenario), scenario.tick_s),
    )
    for column in ("torque_nm", "force_difference_n", "fault_state", "mode", "dstar_mps2"):
        assert np.array_equal(getattr(one, column), getattr(other, column), equal_nan=True), column


@COMPILER
@pytest.mark.parametrize("name", ["with a loss and lost frames", "with a known loss", "drive"])
def test_every_controller_sends_the_same(name, tmp_path):
    scenario = CASES[name]
    python = log_of(scenario, tmp_path / "python")
    assert log_of(scenario, tmp_path / "processes", runner=two_processes) == python
    for controller in ("c", "ecu"):
        assert log_of(scenario, tmp_path / controller, controller) == python, controller


@ARM
@pytest.mark.parametrize("name", ["counter repeated", "drive"])
def test_an_emulated_board_sends_the_same(name, tmp_path):
    scenario = CASES[name]
    assert log_of(scenario, tmp_path / "m7", "arm:m7") == log_of(scenario, tmp_path / "python")


def test_the_controller_is_silent_and_then_counts_from_zero(tmp_path):
    scenario = CASES["short"]
    log_of(scenario, tmp_path / "run")
    network = network_of(scenario)
    frames = [frame for part in read_log(tmp_path / "run" / "bus.log") for frame in part.messages()]
    for codec in (network.command_1, network.command_2, network.status):
        counters = {
            int.from_bytes(each.data[2:4], "little"): each.data[1] & 15
            for each in frames
            if each.arbitration_id == codec.frame_id
        }
        assert sorted(counters) == [*range(200), *range(203, 500)]
        assert [counters[tick] for tick in range(203, 220)] == [*range(15), 0, 1]
    assert sum(each.arbitration_id == network.feedback.frame_id for each in frames) == 500
    plant = np.genfromtxt(tmp_path / "run" / "bus.plant.csv", delimiter=",", names=True)
    signals = read_signals(tmp_path / "run" / "bus.log", network, scenario.tick_s)
    # E2E profile 1: counter 0 after 4 is a jump of 11, so one more frame only confirms it
    assert np.isnan(signals.torque_nm[200:205]).all() and np.isfinite(signals.torque_nm[205])
    assert len(plant) == 500


def test_a_restart_is_the_start_of_a_fresh_controller():
    """From the first sample on the law answers as one that has just been made."""
    scenario = load("default", [
        "duration_s=0.4", "reference.kind=step", "actuator.hold_s=0",
        "fault.kind=controller-restarted", "fault.at_s=0.2", "fault.for_s=0.05",
    ])  # fmt: skip
    signals = signals_without_log(scenario)
    of = controls(scenario, network_of(scenario))
    firmware = Firmware(of.table)
    firmware.begin()
    inputs = zip(signals.reference_mps2[250:], signals.dstar_mps2[250:], strict=True)
    answers = np.array([firmware.step(*each)[:2] for each in inputs])
    said = np.column_stack([signals.torque_nm, signals.force_difference_n])[250:]
    used = np.isfinite(said)
    steps = [network_of(scenario).command_1.lsb, network_of(scenario).command_2.lsb]
    assert used[5:].all()
    assert (np.abs(said - answers)[used] <= np.tile(steps, (150, 1))[used]).all()


@pytest.mark.parametrize("name", ["two", "drive", "to the end"])
def test_a_replay_of_a_restart_is_identical(name, tmp_path):
    log_of(CASES[name], tmp_path / "run")
    said = succeeded("replay", tmp_path / "run")
    assert "missing" not in said.stdout and "counter jump" not in said.stdout


def test_a_verdict_after_a_restart_in_a_bend_is_a_false_alarm():
    scenario = load("default", [
        "duration_s=4", "reference.kind=step",
        "fault.kind=controller-restarted", "fault.at_s=2", "fault.for_s=0.2",
    ])  # fmt: skip
    signals = signals_without_log(scenario)
    claimed = np.isin(signals.fault_state[2200:], FaultState.CONFIRMED).any()
    found = metrics(scenario, signals)
    assert found["false_alarms"] == int(claimed)
    assert found["missed_detection"] is None


def test_real_time_refuses_a_restart():
    with pytest.raises(ScenarioError, match="must be in lockstep"):
        require_causal(CASES["short"])


def test_outages_that_touch_are_one():
    def fault(at_s: float, for_s: float) -> FaultSettings:
        survives = at_s != 2.0
        return FaultSettings(
            kind="controller-restarted", at_s=at_s, for_s=for_s, state_survives=survives
        )

    found = outages([fault(5.0, 1.0), fault(1.0, 2.0), fault(2.0, 1.0), fault(3.0, 0.5)], 10**9)
    assert found == (Outage(1, 4), Outage(5, 6, state_survives=True))
    assert [tick in found[0] for tick in (0, 1, 3, 4)] == [False, True, True, False]
    assert outages([FaultSettings(kind="actuator-dead")], 10**9) == ()
