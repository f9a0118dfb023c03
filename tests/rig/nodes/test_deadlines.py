"""Deadlines on a clock that the tests turn: absolute, made up for, or skipped."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from can_rig.assessment.resolve import load
from can_rig.errors import ScenarioError, SilentNodeError
from can_rig.nodes.bus_access import StopRequest, Timeouts
from can_rig.nodes.realtime.controller_node import RealTimeControllerNode
from can_rig.nodes.realtime.plant_node import RealTimePlantNode
from can_rig.nodes.realtime.timing import CATCH_UP_TICKS, Schedule
from can_rig.results.signals import read_signals
from can_rig.scenario.build import network_of
from tests.rig.nodes.world import (
    FEEDBACK,
    LSB,
    TICK_NS,
    World,
    dstar_under,
    scenario_of,
    tick_of,
)


@settings(max_examples=20, deadline=None)
@given(st.lists(st.integers(0, TICK_NS - 1), min_size=60, max_size=60))
def test_lateness_never_adds_up(lateness):
    """Tick k is sent at start + kT + what the k-th wake-up was late, whatever came before."""
    world = World(scenario_of("duration_s=0.05"), wakes=lambda k: lateness[k - 1])
    _, plant = world.run()
    sent = [ns for ns, message in world.sent if message.arbitration_id == FEEDBACK]
    start_ns = sent[0] + 200_000  # the clock starts with the first answer
    expected = [k * TICK_NS + lateness[k - 1] for k in range(1, 50)]
    assert [ns - start_ns for ns in sent[1:]] == expected
    assert plant.timing.missed_deadlines == plant.timing.skipped_ticks == 0
    assert plant.timing.as_dict()["wake_up_lateness_us"]["max"] == max(lateness[:49]) / 1000


@given(st.integers(0, 2**62), st.integers(10_000, 10**9), st.integers(0, 10**7), st.data())
def test_a_moment_belongs_to_the_last_deadline_before_it(start_ns, tick_ns, tick, data):
    schedule = Schedule(start_ns, tick_ns)
    after = data.draw(st.integers(0, tick_ns - 1))
    assert schedule.newest(schedule.deadline_ns(tick) + after) == tick
    assert schedule.deadline_ns(tick) == start_ns + tick * tick_ns


def late_once(tick, ticks):
    """A plant node that wakes late at one deadline, by so many ticks and a half."""
    return lambda k: round((ticks + 0.5) * TICK_NS) if k == tick else 0


@pytest.mark.parametrize("ticks", [1, 2, CATCH_UP_TICKS])
def test_a_few_missed_ticks_are_made_up_for_at_once(ticks):
    world = World(scenario_of(), wakes=late_once(100, ticks))
    _, plant = world.run()
    sent = [(tick_of(m), ns) for ns, m in world.sent if m.arbitration_id == FEEDBACK]
    assert [tick for tick, _ in sent] == list(range(300))
    burst = [ns for tick, ns in sent if 100 <= tick <= 100 + ticks]
    assert len(set(burst)) == 1
    assert sent[200][1] - sent[99][1] == 101 * TICK_NS  # deadlines stay where they were
    assert plant.timing.missed_deadlines == ticks
    assert plant.timing.skipped_ticks == 0


@pytest.mark.parametrize("ticks", [CATCH_UP_TICKS + 1, 50])
def test_many_missed_ticks_are_skipped_and_the_car_drives_through_them(ticks, tmp_path):
    log = tmp_path / "bus.log"
    changes = ["reference.kind=sine", "reference.frequency_rad_per_s=20", "limits.torque_nm=9000"]
    changes += ["plant.sensor.noise_mps2=0.001", "seed=7"]
    world = World(scenario_of(*changes), wakes=late_once(100, ticks))
    done, plant = world.run(log)
    sent = [(tick_of(m), ns) for ns, m in world.sent if m.arbitration_id == FEEDBACK]
    there = [*range(100), *range(100 + ticks, 300)]
    assert done == 300
    assert [tick for tick, _ in sent] == there
    assert sent[-1][1] - sent[99][1] == 200 * TICK_NS
    assert plant.timing.missed_deadlines == plant.timing.skipped_ticks == ticks
    signals = read_signals(log, world.network, 0.001)
    assert len(signals) == 300
    missing = np.isnan(signals.dstar_mps2)
    assert list(np.flatnonzero(~missing)) == there

    # The car, by scipy: commands act a tick later; one that is missing is held for 10 ticks.
    acting, silent, last = [], 0, np.zeros(2)
    for tick in range(-1, 299):
        pair = np.array([signals.torque_nm[tick], signals.force_difference_n[tick]])
        silent = 0 if tick >= 0 and np.isfinite(pair).all() else silent + 1
        last = pair if not silent else last if silent <= 10 else np.zeros(2)
        acting.append(last)
    noise = 0.001 * np.random.Generator(np.random.PCG64(7)).standard_normal(300)  # one a tick
    assert np.abs(dstar_under(acting) + noise - signals.dstar_mps2)[~missing].max() < LSB


def test_a_sleep_past_the_end_sends_the_last_tick_and_ends():
    world = World(scenario_of(), wakes=late_once(100, 5000))
    done, plant = world.run()
    assert done == 300
    assert tick_of(world.sent[-1][1]) == 299
    assert plant.timing.skipped_ticks == 199


def test_alone_the_plant_drives_on_or_as_long_as_it_is_told(tmp_path):
    scenario = scenario_of("duration_s=1")

    def answers(tick):
        return 200_000 if tick < 100 else None

    done, plant = World(scenario, answers).run()
    assert done == 1000
    assert plant.timing.unanswered_ticks == 899
    with pytest.raises(SilentNodeError, match=r"controller node for 0\.2 s at tick 300"):
        World(scenario, answers).run(waiting=Timeouts(1.0, 0.2))


def test_a_stop_request_ends_between_two_ticks(tmp_path):
    stop, log = StopRequest(), tmp_path / "bus.log"

    def on_tick(tick):
        stop.wanted = tick == 17

    done, _ = World(scenario_of()).run(log, on_tick, stop=stop)
    assert done == 18
    assert len(log.read_text().splitlines()) == 5 * 18


def test_a_latency_of_zero_is_refused_with_the_remedy():
    scenario = load("thesis-step")
    with pytest.raises(ScenarioError, match=r"latency_ticks = 0.*--set latency_ticks=1"):
        RealTimePlantNode(scenario, network_of(scenario), None, None, None)
    with pytest.raises(ScenarioError, match="latency_ticks = 0"):
        RealTimeControllerNode(scenario, network_of(scenario), None, None)
