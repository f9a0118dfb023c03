"""What the actuators applied, reconstructed from a log, moves the plant like the run."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import cont2discrete

from can_rig.results.counterfactual import applied_commands
from can_rig.results.signals import Signals, read_signals
from can_rig.scenario.build import continuous_plant, network_of
from can_rig.scenario.settings import Scenario
from tests.helpers import record
from tests.rig.results.quiet import COLUMNS

LATENCY = ("latency_ticks=2", "design.tau_s=0.005", "design.tau_q_s=0.01")
FAULT = ("duration_s=0.3", "fault.at_s=0.1", "fault.for_s=0.1", "actuator.hold_s=0.01")


def recorded(folder: Path, *settings: str) -> tuple[Scenario, Signals]:
    log, _, scenario = record(folder, *settings, name="thesis-sine")
    signals = read_signals(log, network_of(scenario), scenario.tick_s)
    return scenario, dataclasses.replace(signals, plant={})  # as of a log alone


@pytest.mark.parametrize("channel", ["torque", "force-difference"])
@pytest.mark.parametrize(
    "fault", ["none", "actuator-dead", "frames-missing", "frames-corrupted", "sensor-biased"]
)
def test_what_was_applied_moves_the_plant_as_the_log_has_it(tmp_path, fault, channel):
    """By scipy's zero-order hold, which has no part in the rig."""
    of = (f"fault.kind={fault}", f"fault.channel={channel}", "fault.left=0.25")
    scenario, signals = recorded(tmp_path, *LATENCY, *FAULT, *of)
    plant = continuous_plant(scenario.plant)
    a, b, c, _, _ = cont2discrete((plant.a, plant.b, plant.c, np.zeros((1, 2))), 1e-3)
    x, expected = np.zeros(len(a)), []
    for torque_nm, force_n in zip(*applied_commands(scenario, signals), strict=True):
        expected.append(float((c @ x).item()))
        x = a @ x + b @ [torque_nm, force_n]
    biased = (fault == "sensor-biased") & (signals.time_s > 0.0995) & (signals.time_s < 0.1995)
    assert np.abs(signals.dstar_mps2 - 0.1 * biased - expected).max() < 1e-8  # one LSB of D*


def test_a_command_that_is_not_on_record_is_held_and_then_zero(tmp_path):
    scenario, signals = recorded(tmp_path, *FAULT, "fault.kind=frames-missing")
    torque, _ = applied_commands(scenario, signals)
    last = signals.torque_nm[99]
    assert np.isnan(signals.torque_nm[100:200]).all()
    assert (torque[100:110] == last).all()
    assert (torque[110:200] == 0.0).all()
    assert (torque[200:] == signals.torque_nm[200:]).all()


def test_what_acts_at_the_start_of_a_log_that_starts_late_is_not_known(tmp_path):
    scenario, signals = recorded(tmp_path, *LATENCY, *FAULT, "fault.kind=actuator-dead")
    values = {name: getattr(signals, name)[50:] for name in COLUMNS}
    whole, late = applied_commands(scenario, signals), applied_commands(scenario, Signals(**values))
    for full, part in zip(whole, late, strict=True):
        assert np.flatnonzero(np.isnan(part)).tolist() == [0, 1]
        np.testing.assert_array_equal(part[2:], full[52:])
        assert full[:2].tolist() == [0.0, 0.0]
