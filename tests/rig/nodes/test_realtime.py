"""Real time against lockstep: the same where nothing is late, and late is lost."""

import can
import numpy as np
import pytest

from can_rig.assessment.resolve import load
from can_rig.results.signals import read_signals
from firmware_model.target.status import FaultState
from tests.helpers import NAMES, decoded, record
from tests.rig.nodes.world import (
    LSB,
    TICK_NS,
    TORQUE,
    World,
    dstar_under,
    hold_up,
    scenario_of,
)


@pytest.mark.parametrize("name", ["ideal", "noisy"])
@pytest.mark.parametrize(("latency", "answer_ns"), [(1, 990_000), (2, 1_700_000), (3, 2_900_000)])
def test_where_nothing_is_late_commands_and_dstar_are_those_of_lockstep(
    name, latency, answer_ns, tmp_path
):
    """Bit for bit, with answers up to the last of the ticks that the latency gives them."""
    changes = [
        f"latency_ticks={latency}",
        "duration_s=0.4",
        "fault.at_s=0.3",
        "plant.sensor.noise_mps2=0.001",
    ]
    changes += ["design.tau_q_s=0.02"]
    log = tmp_path / "bus.log"
    scenario = load(name, changes)
    world = World(scenario, answers=lambda tick: 50_000 + (tick * 377_777) % (answer_ns - 50_000))
    _, plant = world.run(log)
    lockstep, *_ = record(tmp_path, *changes, name=name)
    assert plant.timing.unanswered_ticks == 0

    def frames(path):
        by_id = {}
        for frame in can.LogReader(path):
            by_id.setdefault(frame.arbitration_id, []).append(bytes(frame.data))
        return by_id

    mine, theirs = frames(log), frames(lockstep)
    assert len(mine[TORQUE]) >= 400 - latency  # the last ones may come after the end
    for number, data in mine.items():
        assert data == theirs[number][: len(data)]
    signals = read_signals(log, world.network, scenario.tick_s, latency)
    assert np.isfinite(signals.torque_nm[: 400 - latency]).all()
    expected = decoded(lockstep)[NAMES[2]][: 400 - latency]
    assert (signals.torque_nm[: 400 - latency] == expected).all()


@pytest.mark.parametrize("latency", [1, 2])
@pytest.mark.parametrize("excess_ns", [20_000, 900_000])
def test_a_late_answer_is_a_lost_one_and_the_estimate_knows(latency, excess_ns, tmp_path):
    """Sent too late, or not sent because a newer sample is there: the car holds, d̂ stays zero."""
    late = [20, 50, 51, 52, 90]
    log = tmp_path / "bus.log"
    scenario = scenario_of(f"latency_ticks={latency}", "design.tau_q_s=0.02", "duration_s=0.2")

    world = World(scenario)
    hold_up(world, dict.fromkeys(late, latency * TICK_NS - 200_000 + excess_ns))
    _, plant = world.run(log)
    assert plant.timing.unanswered_ticks >= len(late)
    signals = read_signals(log, world.network, 0.001, latency)
    lost = np.isnan(signals.torque_nm)
    assert set(late) <= set(np.flatnonzero(lost))
    u = np.stack([signals.torque_nm, signals.force_difference_n], axis=1)
    for tick in range(1, len(u)):
        if lost[tick]:
            u[tick] = u[tick - 1]
    acting = np.vstack([np.zeros((latency, 2)), u[:-latency]])
    assert np.abs(dstar_under(acting) - signals.dstar_mps2).max() < LSB
    assert np.abs(np.diff(u[15:25, 0])).max() > 0.01  # what is held matters
    estimate = signals.fault_estimate_mps2[np.isfinite(signals.fault_estimate_mps2)]
    assert np.abs(estimate).max() <= LSB
    assert int(np.nanmax(signals.fault_state)) != FaultState.CONFIRMED


def test_late_frames_are_counted_and_not_used(tmp_path):
    log = tmp_path / "bus.log"
    world = World(scenario_of("duration_s=0.1"))
    hold_up(world, {40: 900_000})
    _, plant = world.run(log)
    assert plant.realtime()["late_frames"] == 2
    assert plant.rejected()[NAMES[2]]["wrong_tick"] == 1
    signals = read_signals(log, world.network, 0.001)
    assert np.isnan(signals.torque_nm[40])
