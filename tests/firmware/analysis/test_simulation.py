"""The loop without frames: a plant class as the linear plant, the sensor, lost commands."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from firmware_model.analysis import witnesses
from firmware_model.analysis.changing_plant import changing_plant, follow_changing
from firmware_model.analysis.hardware import EXACT_FRAMES, GAIN, HEALTHY, SENSOR, SLEW, frame_of
from firmware_model.analysis.sampled_plant import SampledPlant, follow_plant, sample
from firmware_model.analysis.simulation import Simulation, Trace, simulate
from firmware_model.analysis.witnesses import ECHO, Reading, with_readings
from firmware_model.design.actuator_dynamics import IDEAL
from firmware_model.design.vehicle import TABLE_3_2
from firmware_model.discretisation.tables import build
from firmware_model.discretisation.targets import Reporting, Target
from firmware_model.firmware import Firmware
from firmware_model.law.controller import init
from firmware_model.law.structs import FloatArray
from firmware_model.law.supervision.takeover import UNKNOWN
from tests.firmware.analysis.loops import CAR, SLOW
from tests.firmware.scheduled import SPEEDS, scheduled

TICK_S = 0.001
TICKS = 40
LATENCY = 2
LOST_AT = 10
TABLE = build(SLOW, Target(TICK_S, latency_ticks=LATENCY, estimator="zoh"))
REFERENCE = np.linspace(0.0, 0.02, TICKS)


class Recorded:
    """The linear car as a plant class, which notes what acted on it."""

    def __init__(self) -> None:
        self.sampled: SampledPlant = sample(CAR, TICK_S)
        self.state = self.sampled.rest
        self.acted: list[tuple[float, float]] = []

    def follow(
        self, command_1: float, command_2: float, left_1: float, left_2: float
    ) -> tuple[float, float]:
        u1, u2 = left_1 * command_1, left_2 * command_2
        self.acted.append((u1, u2))
        plant = self.sampled
        y = float(follow_plant(plant.phi, plant.gamma, plant.c, self.state, u1, u2))
        return y, y


def test_a_plant_class_with_the_same_equations_gives_the_same_bits():
    linear = simulate(TABLE, sample(CAR, TICK_S), REFERENCE)
    own = simulate(TABLE, Recorded(), REFERENCE, tick_s=TICK_S)
    for name in ("time_s", "measurement", "command_1", "command_2", "fault_estimate"):
        np.testing.assert_array_equal(getattr(own, name), getattr(linear, name))
    assert np.abs(linear.command_1).max() > 0.0
    np.testing.assert_array_equal(linear.error, REFERENCE - linear.measurement)  # (3.41)


class Sensing(Recorded):
    """The same plant with a sensor, which notes what it heard of the actuators' commands."""

    def __init__(self) -> None:
        super().__init__()
        self.told: list[tuple[float, float]] = []

    def sense(self, told: tuple[float, float]) -> None:
        self.told.append(told)


def test_a_plant_with_sensors_hears_the_commands_of_the_tick_before():
    """Without faults what an actuator was told is what acted: one tick and the latency late."""
    plant = Sensing()
    simulate(TABLE, plant, REFERENCE, tick_s=TICK_S)
    assert plant.told == [(0.0, 0.0), *plant.acted[:-1]]
    assert np.abs(plant.told).max() > 0.0


def test_what_is_measured_lies_on_the_grid_and_within_its_ends():
    noise = np.random.default_rng(1).normal(0.0, 0.01, TICKS)
    frames = EXACT_FRAMES.copy()
    frames[SENSOR] = frame_of(0.005, -0.01, 0.01)
    trace = simulate(TABLE, sample(CAR, TICK_S), REFERENCE, noise=noise, frames=frames)
    sensed = trace.measurement + noise
    inside = np.abs(sensed) < 0.01
    assert 0 < inside.sum() < TICKS  # some saturate
    assert np.abs(trace.measured - sensed)[inside].max() <= 0.0025 + 1e-15
    np.testing.assert_allclose(trace.measured / 0.005, np.rint(trace.measured / 0.005), atol=1e-12)
    np.testing.assert_array_equal(np.abs(trace.measured[~inside]), 0.01)


@pytest.mark.parametrize("hold_ticks", [0, 3])
def test_an_actuator_holds_its_last_command_and_then_applies_zero(hold_ticks):
    arrives = np.ones((TICKS, 2), dtype=np.bool_)
    arrives[LOST_AT : LOST_AT + 8, 0] = False
    plant = Recorded()
    trace: Trace = simulate(
        TABLE, plant, REFERENCE, tick_s=TICK_S, arrives=arrives, hold_ticks=hold_ticks
    )
    expected = trace.command_1.copy()
    held = slice(LOST_AT, LOST_AT + hold_ticks)
    expected[held] = trace.command_1[LOST_AT - 1]
    expected[LOST_AT + hold_ticks : LOST_AT + 8] = 0.0
    acted = np.array(plant.acted)
    np.testing.assert_array_equal(acted[LATENCY:, 0], expected[: TICKS - LATENCY])
    np.testing.assert_array_equal(acted[LATENCY:, 1], trace.command_2[: TICKS - LATENCY])
    np.testing.assert_array_equal(acted[:LATENCY], 0.0)


def test_a_sensor_reads_in_whole_steps_of_its_resolution():
    """Rounded to the nearest: what the controller gets is at most half a step from the output."""
    step = 1e-4
    run = simulate(TABLE, sample(CAR, TICK_S), REFERENCE, resolution=step)
    np.testing.assert_allclose(run.measured, np.round(run.measured / step) * step, atol=1e-15)
    np.testing.assert_allclose(run.measured, run.measurement, atol=step / 2 * (1 + 1e-9))
    assert np.abs(run.measured - run.measurement).max() > 0.1 * step


def test_in_pieces_it_is_the_same_run_with_what_its_plant_did():
    """States of each tick, whose output is D*; commands as a weak actuator could follow them."""
    plant, weak = sample(CAR, TICK_S), 2.0
    whole = simulate(TABLE, plant, REFERENCE)
    limits = np.array([[weak, np.inf], [np.inf, np.inf]])
    in_pieces = Simulation(TABLE, plant, REFERENCE, keeps_states=True)
    limited = Simulation(TABLE, plant, REFERENCE, limits=limits)
    for until in (1, 17, None):
        in_pieces.run(until)
        limited.run(until)
    np.testing.assert_array_equal(in_pieces.trace.command_1, whole.command_1)
    np.testing.assert_allclose(in_pieces.plant_states @ plant.c, whole.measurement, atol=1e-15)
    for run, limit in ((in_pieces, np.inf), (limited, weak)):
        sent = np.concatenate([np.zeros(LATENCY), run.trace.command_1[:-LATENCY]])
        np.testing.assert_array_equal(run.reached[0], np.clip(sent, -limit, limit))
    assert np.abs(limited.trace.command_1).max() > weak


def test_a_run_goes_on_from_another_that_was_the_same_so_far():
    arrives = np.ones((TICKS, 2), dtype=np.bool_)
    arrives[LOST_AT:, 0] = False
    noise = np.random.default_rng(2).normal(0.0, 0.01, TICKS)
    before = Simulation(TABLE, sample(CAR, TICK_S), REFERENCE, noise=noise)
    branch, whole = (
        Simulation(TABLE, sample(CAR, TICK_S), REFERENCE, noise=noise, arrives=arrives)
        for _ in range(2)
    )
    before.run(LOST_AT)
    branch.go_on_from(before)
    assert branch.done == LOST_AT
    for loop in (branch, whole, before):
        loop.run()
    before.run(LOST_AT)  # which it has done long ago
    assert before.done == TICKS
    for name in ("measured", "command_1", "command_2", "fault_estimate", "evidence", "mode"):
        np.testing.assert_array_equal(getattr(branch.trace, name), getattr(whole.trace, name))
    np.testing.assert_array_equal(branch.reached, whole.reached)
    assert (before.trace.measured != branch.trace.measured).any()


@pytest.mark.parametrize("changing", [False, True], ids=["dead times", "changing speed"])
def test_a_window_that_moves_on_sees_the_same_run(changing):
    """The rings of a plant with dead times turn; a drive brings the speeds of the next ticks."""
    designs = scheduled(cars=1)
    late = sample(replace(CAR, dead_times_s=(0.0023, 0.004), sensor_dead_time_s=0.0015), TICK_S)
    speed = np.linspace(SPEEDS[0], SPEEDS[-1], TICKS)
    noise = np.random.default_rng(3).normal(0.0, 0.01, TICKS)
    weak = np.tile(HEALTHY, (TICKS, 3, 1))
    weak[:, 0, GAIN] = np.linspace(1.0, 0.5, TICKS)
    weak[LOST_AT + 12 :, 1, SLEW] = 0.1
    used = np.ones((TICKS, 2), dtype=np.bool_)
    used[LOST_AT : LOST_AT + 2] = False

    def loop(ticks: range) -> Simulation:
        more: dict[str, Any] = {}
        if changing:
            more = {"tick_s": TICK_S, "schedule": designs.schedule, "speed": speed[ticks]}
        return Simulation(
            designs.table if changing else TABLE, Recorded() if changing else late,
            REFERENCE[ticks].copy(), noise=noise[ticks].copy(),
            arrives=used[ticks].copy(), faults=weak[ticks].copy(), **more,
        )  # fmt: skip

    whole = loop(range(TICKS))
    whole.run()
    seen, length, keep, first = [], 16, 8, 0
    window = loop(range(length))
    while True:
        begin = window.done
        window.run()
        seen.append(window.trace.measured[begin:].copy())
        if first + window.done == TICKS:
            break
        first += length - keep
        ticks = slice(first, first + length)
        nothing = np.zeros(length)
        inputs = (REFERENCE[ticks], nothing, noise[ticks], np.ones((length, 2)), used[ticks])
        window.move_on(keep, inputs, weak[ticks], speed[ticks] if changing else None)
    np.testing.assert_array_equal(np.concatenate(seen), whole.trace.measured)
    for name in ("measurement", "command_1", "command_2", "fault_estimate", "mode"):
        own, expected = (getattr(run.trace, name) for run in (window, whole))
        np.testing.assert_array_equal(own[keep:], expected[keep - length :])
    np.testing.assert_array_equal(window.reached, whole.reached[:, -length:])


@pytest.mark.parametrize("survives", [False, True])
def test_a_restarted_controller_answers_as_a_fresh_one_while_the_plant_goes_on(survives):
    at_rest = init(TABLE)
    at_rest["supervision"]["takeover"]["pending"] = UNKNOWN
    restart = (12, 15, survives)
    whole = Simulation(TABLE, sample(CAR, TICK_S), REFERENCE, restarts=[restart], at_rest=at_rest)
    whole.run(12)
    whole.run(15)  # a restart at the end of a part belongs to the next
    whole.run()
    trace = whole.trace
    before, firmware = Firmware(TABLE), Firmware(TABLE)
    before.begin()
    for inputs in zip(REFERENCE[:12], trace.measured[:12], strict=True):
        before.step(*inputs)
    firmware.begin()
    assert firmware.restore(before.saved() if survives else b"") is survives
    answers = [
        firmware.step(*inputs) for inputs in zip(REFERENCE[15:], trace.measured[15:], strict=True)
    ]
    np.testing.assert_array_equal(trace.command_1[15:], [each.command_1 for each in answers])
    np.testing.assert_array_equal(trace.command_2[15:], [each.command_2 for each in answers])
    without = simulate(TABLE, sample(CAR, TICK_S), REFERENCE)
    np.testing.assert_array_equal(trace.measurement[:15], without.measurement[:15])
    assert np.abs(trace.command_1[15:] - without.command_1[15:]).max() > 0.0


def test_a_restarted_controller_hears_the_speed_anew():
    of = scheduled()
    speed = np.linspace(SPEEDS[0], SPEEDS[-1], TICKS)
    loop = Simulation(
        of.table, Recorded(), REFERENCE, tick_s=TICK_S, schedule=of.schedule, speed=speed,
        restarts=[(15, 15, False)],
    )  # fmt: skip
    loop.run()
    fresh = Firmware(of.table, speeds=of.schedule)
    for tick in range(15, TICKS):
        fresh.change_speed(speed[tick])
        answer = fresh.step(REFERENCE[tick], loop.trace.measured[tick])
        assert answer.command_1 == loop.trace.command_1[tick]


class AsAnyController:
    """The firmware as a controller of another kind."""

    latency_ticks = LATENCY

    def __init__(self) -> None:
        self.restart()

    def restart(self) -> None:
        self.firmware = Firmware(TABLE)

    def answer(
        self, reference: float, measurement: float, speed: float
    ) -> tuple[float, float, float, int, int, int]:
        assert np.isnan(speed)
        return self.firmware.step(reference, measurement)


@pytest.mark.parametrize("keeps", [False, True])
@pytest.mark.parametrize("restarts", [(), ((20, 20, False),)])
def test_the_firmware_as_any_controller_gives_the_bits_of_the_law(restarts, keeps):
    for plant in (lambda: sample(CAR, TICK_S), Recorded):
        law = simulate(TABLE, plant(), REFERENCE, tick_s=TICK_S, restarts=restarts)
        keeps_states = keeps and plant is not Recorded
        other = simulate(
            AsAnyController(), plant(), REFERENCE, tick_s=TICK_S, restarts=restarts,
            keeps_states=keeps_states,
        )  # fmt: skip
        for name in ("measurement", "command_1", "command_2", "fault_estimate", "fault_state"):
            np.testing.assert_array_equal(getattr(other, name), getattr(law, name))
        assert np.abs(law.command_1).max() > 0.0


class Pushed:
    """A car in the world, whose ticks the loop compiles."""

    def __init__(self) -> None:
        world = 50.0 * np.random.default_rng(2).normal(size=(TICKS + 1, 4))
        self.world = np.hstack([world, np.ones((TICKS + 1, 2))])
        made = changing_plant(TABLE_3_2, "physics", (IDEAL, IDEAL, IDEAL), 40.0, TICK_S)
        n = len(made.b)
        self.memory = np.zeros(n), np.zeros(n), np.zeros((2, 2)), np.zeros(1)
        self.constants, self.work, self.tick = made.constants, made.work, 0
        self.speeds = made.speeds(lambda time_s: 10.0 + 0.0 * time_s, range(TICKS))

    def follow(self, *commands: float) -> tuple[float, float]:
        k = self.tick
        self.tick += 1
        world = self.world[k : k + 2]
        return follow_changing(
            self.constants, self.memory, self.work, self.speeds[k], k, *commands, world
        )

    def run_loop(
        self,
        loop: Callable[..., tuple[float, float]],
        begin: int,
        end: int,
        output: tuple[float, float],
    ) -> tuple[float, float]:
        world, speeds = self.world[begin : end + 1], self.speeds[begin:end]
        return loop(begin, end, *output, self.constants, self.memory, 0, world, self.work, speeds)


class OneByOne:
    """The same car, tick by tick."""

    def __init__(self) -> None:
        self.follow = Pushed().follow


def test_compiled_ticks_of_a_car_in_the_world_have_the_bits_of_single_ticks():
    together = Simulation(TABLE, Pushed(), REFERENCE, tick_s=TICK_S)
    for until in (0, 7, TICKS):
        together.run(until)
    single = simulate(TABLE, OneByOne(), REFERENCE, tick_s=TICK_S)
    for name in ("measurement", "measured", "command_1", "command_2", "fault_estimate"):
        np.testing.assert_array_equal(getattr(together.trace, name), getattr(single, name))
    assert np.abs(single.measurement).max() > 0.0


class Echoes:
    """Every third tick, an actuator that does less than it was told."""

    def __init__(self) -> None:
        self.tick, self.restarts = 0, 0

    def samples(self) -> list[tuple[int, float, float]]:
        self.tick += 1
        return echoes_at(self.tick - 1)

    def restart(self) -> None:
        self.restarts += 1


def echoes_at(k: int) -> list[tuple[int, float, float]]:
    return [(1, -5.0 * k, 1.0), (2, 3.0 * k, 0.0)] if k % 3 == 0 else []


@pytest.mark.parametrize("plant", [sample(CAR, TICK_S), Recorded()])
def test_the_law_hears_the_echoes_of_each_tick(plant):
    target = Target(TICK_S, 1, "zoh", echoes=(Reporting(IDEAL), Reporting(IDEAL)), noise_rms=0.01)
    table, hears = build(SLOW, target), Echoes()
    loop = Simulation(
        table, plant, REFERENCE, tick_s=TICK_S, hears=hears, restarts=[(15, 20, False)]
    )
    loop.run()
    assert (hears.tick, hears.restarts) == (len(REFERENCE), 1)
    firmware, missed = Firmware(table), 0.0
    for k, (r, y) in enumerate(zip(REFERENCE, loop.trace.measured, strict=True)):
        if k == 20:
            firmware = Firmware(table)
        for echo in echoes_at(k):
            firmware.hear(*echo)
        answer = firmware.step(float(r), float(y))
        assert answer[:2] == (loop.trace.command_1[k], loop.trace.command_2[k])
        missed = max(missed, *firmware.echo_errors)
    assert missed > 0.0


PERIOD, PHASE, DELAY, WRAPS = 3, 1, 2, 8
LYING, STANDING, INVALID = range(60, 85), range(85, 110), range(110, 130)


class AllEchoes:
    """Echoes of the torque for compiled ticks; the yaw rate beside is not heard."""

    def __init__(self, noise: FloatArray) -> None:
        self._noise, self._done = noise, 0
        timing = np.array([[1, 0, 0], [PERIOD, PHASE, DELAY]])
        constants = timing, np.zeros(2), EXACT_FRAMES[:2].copy()
        self._fixed = np.array([[1, 1]]), np.array([0, 0]), np.array([1, WRAPS]), constants
        memory = np.zeros((DELAY + 1, 2)), np.zeros(2), np.zeros(2, np.int64)
        self._now = memory, np.zeros(2), np.zeros(2), np.zeros(2), *np.zeros((2, 2), np.int64)

    def samples_of(self, ticks: int) -> Any:
        its = range(self._done, self._done + ticks)
        self._done = its.stop
        faults = np.tile(witnesses.HEALTHY, (ticks, 2, 1))
        for row, k in zip(faults, its, strict=True):
            row[1, witnesses.LIES] = k in LYING
            row[1, witnesses.STANDING] = k in STANDING
            row[1, witnesses.INVALID] = k in INVALID
        noise = np.column_stack([np.zeros(ticks), self._noise[its.start : its.stop]])
        return self._fixed, self._now, its.start, np.zeros((ticks, 2)), noise, faults


class Echoing(Sensing):
    """The same echoes, tick by tick: what acted before the sample, with the sample's noise."""

    def __init__(self, noise: FloatArray) -> None:
        super().__init__()
        self._noise = noise

    def samples(self) -> list[tuple[int, float, float]]:
        k = len(self.acted)
        at = k - DELAY
        if (k - PHASE) % PERIOD or k in INVALID:
            return []
        acted = [(0.0, 0.0), *self.acted]
        value = (self.told if at in LYING else acted)[max(at, 0)][0] + self._noise[max(at, 0)]
        stamp = STANDING.start - 1 - DELAY if k in STANDING else at
        return [(1, value if at >= 0 else 0.0, float((k - stamp) % WRAPS))]

    def restart(self) -> None:
        raise AssertionError("nothing restarts here")


def test_echoes_that_all_arrive_are_heard_in_compiled_ticks_as_one_by_one():
    ticks = 140
    echoes = Reporting(IDEAL, 0.1), Reporting(IDEAL, 0.1)
    table = build(SLOW, Target(TICK_S, LATENCY, "zoh", echoes=echoes, noise_rms=0.01))
    reading, readings = with_readings(CAR, (IDEAL,) * 3, [Reading(0), Reading(ECHO)])
    left = np.ones((ticks, 2))
    left[30:, 0] = 0.0
    noise = 0.1 * np.random.default_rng(4).standard_normal(ticks)
    plant, heard = Echoing(noise), {"effectiveness": left}
    one_by_one = simulate(table, plant, np.ones(ticks), tick_s=TICK_S, hears=plant, **heard)
    sampled = sample(reading, TICK_S, readings)
    compiled = Simulation(table, sampled, np.ones(ticks), hears=AllEchoes(noise), **heard)
    for until in (1, 17, None):
        compiled.run(until)
    for name in ("measurement", "command_2", "fault_estimate", "evidence", "verdict"):
        found = getattr(compiled.trace, name)
        np.testing.assert_array_equal(found, getattr(one_by_one, name))
