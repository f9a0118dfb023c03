"""Real time on a turned clock: lateness is loss, deadlines are absolute, restarts are smooth."""

import can
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from can_rig.controllers.our_law import OurLaw
from can_rig.controllers.protocol import InNode
from can_rig.errors import BusError, ScenarioError, SilentNodeError
from can_rig.frames.codec import Transmitter
from can_rig.nodes.bus_access import StopRequest, Timeouts
from can_rig.nodes.ends import COMMANDS, PlantEnd
from can_rig.nodes.realtime.controller_node import warm_up
from can_rig.nodes.realtime.timing import CATCH_UP_TICKS, Schedule
from can_rig.results.signals import read_signals
from can_rig.scenario.build import network_of
from can_rig.scenario.loading import load
from firmware_model.firmware import PYTHON_LAW
from firmware_model.law.status import FaultState, Mode, Verdict
from tests.helpers import NAMES, decoded, record
from tests.rig.nodes.world import (
    FEEDBACK,
    LSB,
    PACE,
    TICK_NS,
    TORQUE,
    Slow,
    World,
    dstar_under,
    hold_up,
    scenario_of,
    tick_of,
)


@pytest.mark.parametrize(
    ("name", "latency", "answer_ns"),
    [("ideal", 1, 990_000), ("noisy", 2, 1_700_000), ("noisy", 3, 2_900_000)],
)
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


def test_a_second_answer_to_the_offer_has_no_delay(monkeypatch):
    """Two controllers, and frames of one's own without protection: both answer tick 0."""
    judge, send = PlantEnd.judge, World.Controller.send

    def twice(bus, message):
        send(bus, message)
        send(bus, message)

    monkeypatch.setattr(World.Controller, "send", twice)
    monkeypatch.setattr(PlantEnd, "judge", lambda *a: judge(*a) or (COMMANDS, None))
    _, plant = World(scenario_of("duration_s=0.1")).run()
    assert plant.realtime()["answer_after_us"]["max"] < 1000.0


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

    # The car, by scipy: commands act a tick later; a missing command is held for 10 ticks.
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


HOLD_TICKS, STEADY_NM = 10, 42.54  # of the actuators; for 1 m/s²
# D* after a torque pulse is missing for the rest of 30 ticks, until the first new command can act.
# The law makes up for the rest.
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
        # The actuator without a command is at zero; the first new command ends the gap.
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


@pytest.mark.parametrize("outage", [200, 204, 205, 206, 60, 1000])
def test_a_restarted_controller_takes_over_without_a_bump(outage, tmp_path):
    """Whatever the alive counter was (500 % 15 = 5), and whether the car rests or still moves."""
    killed = 500
    back = killed + outage
    scenario = scenario_of(f"duration_s={(back + 900) / 1000}", "latency_ticks=1")
    run = Restart(scenario, killed, back, tmp_path / "bus.log")
    signals, first = run.signals, run.first
    assert first - back <= 100  # ms
    assert np.isnan(signals.torque_nm[killed + 1 : first]).all()
    assert np.isfinite(signals.torque_nm[first:-1]).all()
    assert abs(run.torque[first]) < 0.1  # N m, of 42.5 that the reference takes
    assert np.abs(np.diff(run.torque[first - 1 :])).max() < 6.0  # a raw step: 400
    assert np.abs(run.torque[first:]).max() < 100.0
    assert np.nanmax(np.abs(signals.fault_estimate_mps2[back:])) < 0.025
    assert not (signals.fault_state[back:] == FaultState.CONFIRMED).any()
    assert signals.error_mps2[first:].min() > -0.01  # no overshoot
    assert np.abs(signals.error_mps2[first + 450 :]).max() < 0.01
    listening = signals.mode[back + 2 : first - 2]
    assert (listening[np.isfinite(listening)] == Mode.STANDBY).all()


def test_a_restart_after_the_motor_died_gives_the_load_to_the_other_channel(tmp_path):
    settings = ["fault.at_s=0.3", "duration_s=4.0", PACE]
    scenario = load("ideal", settings)
    run = Restart(scenario, 900, 1900, tmp_path / "bus.log")
    signals, first = run.signals, run.first
    force = np.nan_to_num(signals.force_difference_n)
    assert force[-2] == pytest.approx(2989, abs=30)
    assert np.abs(signals.error_mps2)[first + 900 :].max() < 0.05


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
    assert np.nanmax(np.abs(run.torque[run.first :])) < 200.0


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
    assert plant.realtime()["late_frames"] == 0  # the plant sends only useful frames
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

    stranger = Transmitter(world.network.command_1).frame(1.0, tick=99)
    with pytest.raises(BusError, match="another controller node"):
        world.run(on_tick=on_tick)


@pytest.mark.parametrize("kind", ["request", "damaged"])
def test_a_frame_that_no_controller_sends_is_no_second_controller(kind):
    world = World(scenario_of("duration_s=0.3"))
    frame = can.Message(arbitration_id=TORQUE, is_extended_id=False, is_remote_frame=True)
    if kind == "damaged":
        frame = Transmitter(world.network.command_1).frame(1.0, tick=99)
        frame.data[4] ^= 1

    def on_tick(tick):
        if tick == 100:
            world.start_controller()
            world.to_controller.append((world.ns, frame))

    world.run(on_tick=on_tick)


def test_a_controller_slower_than_its_tick_is_refused_before_the_run():
    scenario = scenario_of("latency_ticks=1")
    world = World(scenario)

    class Sleeping(Slow):
        ns = 0

        def step(self, inputs):
            world.ns += self.ns
            return OurLaw.step(self, inputs)

    def start(ns):
        def made(scenario, network):
            controller = Sleeping(world, scenario, network)
            controller.ns = ns
            return controller

        return InNode(made)

    warm_up(scenario, network_of(scenario), start(900_000), world)
    with pytest.raises(ScenarioError, match=r"too slow in real time: a step takes 1\.1 ms"):
        warm_up(scenario, network_of(scenario), start(1_100_000), world)


def test_an_old_reference_does_not_come_back_when_the_number_of_its_tick_does():
    """A tick has 16 bits; after each gap the controller listens before it drives again."""
    world, heard = World(load("ideal")), []

    class Noting(OurLaw):
        def step(self, inputs):
            heard.append(inputs.reference)
            return super().step(inputs)

    world.slow = lambda scenario, network: Noting(scenario, network, PYTHON_LAW)
    world.start_controller()
    reference, feedback = Transmitter(world.network.reference), Transmitter(world.network.feedback)
    for tick in [*range(10), 30_000, 60_000, *range(2**16 - 990, 2**16 + 10)]:
        if tick < 10:
            world.send(reference.frame(0.5, tick))
        world.send(feedback.frame(0.0, tick))
        world.controller_ns = world.ns = world.ns + TICK_NS
        world.controller.serve(world.watchdog)
    assert heard[:10] == pytest.approx([0.5] * 10)
    assert len(heard) > 500 and np.isnan(heard[10:]).all()
