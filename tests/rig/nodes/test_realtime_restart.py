"""A controller that joins late, stood still, or is one too many, on a clock that the tests turn."""

import can
import numpy as np
import pytest

from can_rig.assessment.resolve import load
from can_rig.errors import BusError
from can_rig.results.signals import read_signals
from firmware_model.target.status import FaultState, Mode, Verdict
from tests.rig.nodes.world import (
    PACE,
    TICK_NS,
    TORQUE,
    World,
    dstar_under,
    scenario_of,
)

HOLD_TICKS, STEADY_NM = 10, 42.54  # of the actuators; for 1 m/s²
# Of a pulse of the torque that was missing for the rest of 30 ticks, what D* shows before the first
# command that may be another can act: the rest is made up for.
MISSING = [(-STEADY_NM, 0.0) for tick in range(30 - HOLD_TICKS + 2)]
SHORT_OUTAGE_MPS2 = 1.05 * float(np.abs(dstar_under(np.array(MISSING))).max())


class Restart:
    """Kills the controller before one tick and starts it before another, perhaps ``again``."""

    def __init__(self, scenario, killed, back, log, again=None, **world):
        self.world = World(scenario, answers=self.answers, **world)
        self.again = again
        self.killed, self.back = killed, back
        self.alive = True
        done, self.plant = self.world.run(log, self.on_tick)
        assert done == scenario.ticks
        self.signals = read_signals(log, self.world.network, scenario.tick_s)
        # The actuator without a command is at zero: what it does when it hears one again counts.
        self.torque = np.nan_to_num(self.signals.torque_nm)
        back = again or back
        self.first = back + int(np.argmax(np.isfinite(self.signals.torque_nm[back:])))

    def answers(self, _tick):
        return 200_000 if self.alive else None

    def on_tick(self, tick):
        if tick == self.killed:
            self.alive = False
            self.world.runs.clear()
        if tick in (self.back, self.again):
            self.world.runs.clear()
            self.world.start_controller()
            self.alive = True


@pytest.mark.parametrize("outage", [*range(200, 215), 60, 1000])
def test_a_restarted_controller_takes_over_without_a_bump(outage, tmp_path):
    """Whatever the alive counter was, and whether the car rests or still moves."""
    killed = 500
    back = killed + outage
    scenario = scenario_of(f"duration_s={(back + 900) / 1000}", "latency_ticks=1")
    run = Restart(scenario, killed, back, tmp_path / "bus.log")
    signals, first = run.signals, run.first
    assert first - back <= 100  # ms
    assert np.isnan(signals.torque_nm[killed + 1 : first]).all()
    assert np.isfinite(signals.torque_nm[first:-1]).all()
    assert abs(run.torque[first]) < 0.1  # N m, of 42.5 that the reference takes
    assert np.abs(np.diff(run.torque[first - 1 :])).max() < 4.0  # a raw step: 400
    assert np.abs(run.torque[first:]).max() < 100.0
    assert np.nanmax(np.abs(signals.fault_estimate_mps2[back:])) < 2e-6
    assert not (signals.fault_state[back:] == FaultState.CONFIRMED).any()
    assert signals.error_mps2[first:].min() > -0.01  # no overshoot
    assert np.abs(signals.error_mps2[first + 450 :]).max() < 0.01
    listening = signals.mode[back + 2 : first - 2]
    assert (listening[np.isfinite(listening)] == Mode.INIT).all()


def test_a_restart_after_the_motor_died_gives_the_load_to_the_other_channel(tmp_path):
    settings = ["fault.at_s=0.3", "duration_s=3.0", PACE]
    scenario = load("ideal", settings)
    run = Restart(scenario, 900, 1900, tmp_path / "bus.log")
    signals, first = run.signals, run.first
    assert np.abs(np.diff(run.torque[first - 1 :])).max() < 10.0
    force = np.nan_to_num(signals.force_difference_n)
    assert np.abs(np.diff(force[first - 1 :])).max() < 100.0  # N a tick, of 2989 in the end
    assert force[-2] == pytest.approx(2989, abs=30)
    assert np.abs(signals.error_mps2)[first + 450 :].max() < 0.005


@pytest.mark.parametrize("seed", range(3))
def test_behind_a_noisy_sensor_a_motor_that_works_is_not_taken_for_lost(seed, tmp_path):
    """In mid-bend: where the car goes by itself is known only roughly."""
    scenario = load("default", [f"seed={seed}", "fault.kind=none", "duration_s=2.4"])
    run = Restart(scenario, 900, 1150, tmp_path / "bus.log")
    assert not (run.signals.fault_state[run.first :] == FaultState.CONFIRMED).any()
    said = [Verdict.NOTHING, Verdict.ANOTHER_CAR, Verdict.CANNOT_BE_TOLD]
    assert np.isin(run.signals.verdict[run.first :], said).all()
    assert np.abs(run.signals.error_mps2[run.first + 900 :]).max() < 0.03


@pytest.mark.parametrize("seed", range(3))
def test_behind_a_noisy_sensor_a_dead_motor_is_compensated_again(seed, tmp_path):
    """Also by a controller that was killed once more while it took over."""
    scenario = load("default", [f"seed={seed}", "fault.at_s=0.8", "duration_s=2.9"])
    run = Restart(scenario, 1500, 1520, tmp_path / "bus.log", again=1650)
    assert np.abs(run.signals.error_mps2[run.first + 1000 :]).max() < 0.1
    assert np.nanmax(np.abs(run.torque[run.first :])) < 150.0


def test_actuators_that_still_hold_are_met_at_what_they_hold(tmp_path):
    """Settled, and held for the whole outage: the restart is not to be seen."""
    scenario = scenario_of("actuator.hold_s=100", "duration_s=4.6")
    run = Restart(scenario, 3000, 4000, tmp_path / "bus.log")
    signals = run.signals
    torque = signals.torque_nm[np.isfinite(signals.torque_nm)]
    assert np.abs(np.diff(torque[2900:])).max() < 0.01
    assert np.abs(signals.error_mps2[2900:]).max() < 1e-4


@pytest.mark.parametrize(
    ("stall", "bump_nm", "error_mps2"),
    [(3, 0.1, 1e-5), (9, 0.1, 1e-5), (30, 400.0, SHORT_OUTAGE_MPS2), (400, 4.0, 2.0)],
)
def test_a_controller_that_stood_still_goes_on(stall, bump_nm, error_mps2, tmp_path):
    """Held while the actuators hold, then against what they let go, then taken over anew."""
    log = tmp_path / "bus.log"

    def answers(tick):
        return 200_000 + max(0, 2000 + stall - tick) * TICK_NS if tick >= 2000 else 200_000

    world = World(scenario_of("duration_s=3.2"), answers)
    _, plant = world.run(log)
    assert plant.realtime()["late_frames"] == 0  # it sends nothing that nobody can use
    signals = read_signals(log, world.network, 0.001)
    torque = signals.torque_nm[np.isfinite(signals.torque_nm)]
    torque = np.nan_to_num(signals.torque_nm)[2000 + stall :] if stall > 10 else torque[1900:]
    assert np.abs(np.diff(torque)).max() < bump_nm
    assert np.abs(signals.error_mps2[1900:]).max() < error_mps2
    assert not (signals.fault_state[1900:] == FaultState.CONFIRMED).any()
    assert np.abs(signals.error_mps2[-300:]).max() < 0.02


@pytest.mark.parametrize("busy_ms", [20, 45, 130])
def test_a_restart_with_frames_piled_up_is_as_smooth(busy_ms, tmp_path):
    """It comes to run only so long after it has joined."""
    log = tmp_path / "bus.log"
    scenario = scenario_of("duration_s=2.6")
    back = 1500

    def busy(tick):
        if back <= tick < back + busy_ms:
            return 200_000 + (back + busy_ms - tick) * TICK_NS
        return 200_000 if tick < 500 or tick >= back else None

    world = World(scenario, busy)

    def on_tick(tick):
        if tick == back:
            world.start_controller()

    world.run(log, on_tick)
    signals = read_signals(log, world.network, 0.001)
    torque = signals.torque_nm[back:]
    first = int(np.argmax(np.isfinite(torque)))
    assert first <= 50 + busy_ms
    assert abs(torque[first]) < 0.1
    assert np.abs(np.diff(torque[np.isfinite(torque)])).max() < 4.0
    assert np.abs(signals.error_mps2[-300:]).max() < 0.01


def test_a_second_controller_is_refused():
    scenario = scenario_of("duration_s=1")
    world = World(scenario)

    def on_tick(tick):
        if tick == 100:
            world.start_controller()
            world.to_controller.append((world.ns, stranger))

    stranger = can.Message(arbitration_id=TORQUE, is_extended_id=False, data=bytes(8))
    with pytest.raises(BusError, match="another controller node"):
        world.run(on_tick=on_tick)
