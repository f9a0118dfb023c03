"""The monitor: what is taken away, what is left, and how far a car with a broken law gets."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from firmware_model.analysis.sampled_plant import sample
from firmware_model.design.continuous_design import DesignSpecification, design
from firmware_model.design.plants import Plant, steer_by_wire
from firmware_model.design.zpk import ZeroPoleGain
from firmware_model.discretisation.monitor import fill_monitor, widen_monitor
from firmware_model.discretisation.tables import build
from firmware_model.discretisation.targets import Target
from firmware_model.firmware import Firmware
from firmware_model.law import controller
from firmware_model.law.layout import state_type
from firmware_model.law.monitor import Constants, State as MonitorState, clear_monitor, watch
from firmware_model.law.status import Mode, Verdict
from firmware_model.law.structs import FloatArray, zeroed

TICK_S = 0.01
CAR = steer_by_wire()
PLANT = sample(CAR, TICK_S)
DESIGN = design(CAR, DesignSpecification(tau_s=0.0033, alpha=3, tau_q_s=0.047, alpha_q=4))
TARGET = Target(
    TICK_S, 1, "zoh", limit_1=400.0, limit_2=4000.0, noise_rms=0.03, disturbance=0.02,
    on_confirmation=True, motion_limit=0.9 * 9.81, doubt=0.2, reference_acceleration=20.0,
)  # fmt: skip
ASTRAY, SWING, REACH = 2.0, 0.5, 0.2  # of ``bench``; REACH for a reference of 1
NAN = math.nan


def bench(**changes: float) -> tuple[Any, Any]:
    """Constants with unit gains and immediate motions, and a state at rest."""
    table = zeroed(Constants, "float64")[0]
    values: dict[str, float] = {
        "enabled": 1, "limit_1": 10.0, "limit_2": 10.0, "slew_1": math.inf, "slew_2": math.inf,
        "gain_1": 1.0, "gain_2": 1.0, "lag": 1.0, "forgetting": 0.001, "doubt": 0.2,
        "swing": SWING, "astray": ASTRAY, "still": 0.2, "most_swings": 4.0, "patience": 50.0,
    }  # fmt: skip
    for name, value in (values | changes).items():
        table[name] = value
    return table, zeroed(MonitorState, "float64")[0]


def told(table: Any, own: Any, rows: Any) -> list[tuple[float, float]]:
    """What is left of the commands; a row has reference, y and both commands."""
    return [watch(table, own, *map(float, row)) for row in rows]


def swinging(amplitude: float, ticks: int = 200, half: int = 10) -> list[tuple[float, ...]]:
    """Commands that swing with y around a reference of 1; ``half`` ticks a half period."""
    wave = amplitude * np.sin(np.pi * (np.arange(ticks) + 0.5) / half)
    return [(1.0, 1.0 + each, 4.0, each) for each in wave]


# --- commands ------------------------------------------------------------------------------------


@pytest.mark.parametrize("bad", [(NAN, 1.0), (1.0, -math.inf), (11.0, 1.0), (1.0, -10.5)])
def test_a_command_out_of_range_takes_both_away_for_good(bad):
    table, own = bench()
    assert told(table, own, [(0.0, 0.01, 1.0, 1.0)]) == [(1.0, 1.0)]
    after = told(table, own, [(0.0, 0.02, *bad), (0.0, 0.03, 1.0, 1.0), (0.0, 0.04, 1.0, 1.0)])
    assert after == [(0.0, 0.0)] * 3
    assert own.reason == Verdict.BAD_COMMAND
    clear_monitor(own)
    assert told(table, own, [(0.0, 0.05, 1.0, 1.0)]) == [(1.0, 1.0)]


def test_a_command_beyond_the_rate_goes_to_zero_within_the_rate():
    table, own = bench(slew_1=2.0, slew_2=0.5)
    steps = [(0.0, 0.01 * k, 2.0 * k, 0.5 * k) for k in range(1, 5)]
    assert told(table, own, steps) == [(2.0 * k, 0.5 * k) for k in range(1, 5)]
    left = told(table, own, [(0.0, 0.05 + 0.01 * k, 10.1, 2.0) for k in range(5)])
    assert left == [(6.0, 1.5), (4.0, 1.0), (2.0, 0.5), (0.0, 0.0), (0.0, 0.0)]


def test_the_first_command_after_rest_may_be_any_within_the_range():
    table, own = bench(slew_1=0.1, slew_2=0.1)
    assert told(table, own, [(0.0, 0.01, 7.0, -7.0)]) == [(7.0, -7.0)]
    assert own.reason == 0


# --- motion --------------------------------------------------------------------------------------


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_car_that_its_commands_drive_astray_is_stopped(side):
    table, own = bench()
    far = side * (1.0 + REACH + ASTRAY)
    told(table, own, [(side, side, side, 0.0)])
    near = [(side, far - 0.01 * side + 0.001 * k, far, 0.0) for k in range(9)]
    assert all(left == (far, 0.0) for left in told(table, own, near))
    farther = [(side, far + side * (0.1 + 0.01 * k), far + 0.1 * side, 0.0) for k in range(3)]
    left = told(table, own, farther)
    assert left[-1] == (0.0, 0.0)
    assert own.reason == Verdict.ASTRAY


@pytest.mark.parametrize("force", [-9.0, 0.0])
def test_a_car_that_something_else_drives_astray_keeps_its_commands(force):
    table, own = bench()
    told(table, own, [(1.0, 1.0, 1.0, 0.0)])
    rows = [(1.0, min(1.0 + 0.1 * k, 9.0) + 0.001 * k, -9.0, force) for k in range(300)]
    assert told(table, own, rows) == [(-9.0, force)] * 300
    assert own.reason == 0


def test_a_sensor_that_repeats_itself_stops_no_car():
    table, own = bench()
    rows = [(1.0 if k < 50 else -1.0, 9.0, 9.0, 0.0) for k in range(200)]
    told(table, own, [(1.0, 1.0, 1.0, 0.0), (1.0, 9.0, 1.0, 0.0)])
    assert told(table, own, rows) == [(9.0, 0.0)] * 200


EFFECTS: dict[str, tuple[float, ...]] = {
    "no effect": (1.0, 0.1, 9.0, 0.0),
    "no effect of either": (1.0, -0.1, 2.0, 7.0),
    "a car that moves": (2.0, -0.3, 9.0, 0.0),
    "small commands": (1.0, 0.1, 2.0, 0.0),
    "straight on, as asked": (0.3, 0.1, 9.0, 0.0),
}


@pytest.mark.parametrize(("name", "ticks"), [*zip(EFFECTS, [40, 40, 0, 0, 0], strict=True)])
def test_ticks_in_which_commands_have_no_effect(name, ticks):
    table, own = bench()
    reference, y, *commands = EFFECTS[name]
    told(table, own, [(0.0, 0.0, 0.1, 0.0), (reference, y + 0.01, *commands)])
    told(table, own, [(reference, y + 1e-4 * k, *commands) for k in range(41)])
    assert own.powerless == pytest.approx(ticks, abs=1.0)
    told(table, own, [(reference, 0.5 * reference + 0.2, *commands)])
    assert own.powerless == 0.0


def test_swings_take_the_force_difference_first_then_the_torque():
    table, own = bench()
    amplitude = SWING + REACH + 0.4
    left = np.array(told(table, own, swinging(amplitude)))
    reasons = np.flatnonzero(left[:, 1] == 0.0)[0], np.flatnonzero(left[:, 0] == 0.0)[0]
    assert 30 < reasons[0] < 40 and 70 < reasons[1] < 80  # in the fourth and the eighth half swing
    assert not left[reasons[0] :, 1].any() and not left[reasons[1] :, 0].any()
    assert own.reason == Verdict.SWINGING


def test_swings_of_the_torque_alone_take_both_at_once():
    table, own = bench()
    rows = [(*row[:3], 0.0) for row in swinging(SWING + REACH + 0.4)]
    left = np.array(told(table, own, rows))
    assert 30 < np.flatnonzero(left[:, 0] == 0.0)[0] < 40
    assert own.reason == Verdict.SWINGING


@pytest.mark.parametrize(
    ("rows", "why"),
    [(swinging(SWING + REACH - 0.01), "small"), (swinging(1.5, half=120), "slow"),
     (swinging(1.5, ticks=30), "three swings"),
     ([(r, y, 0.2, -0.2) for r, y, *_ in swinging(1.5)], "commands too small to cause them"),
     ([(y, y, u, x) for _, y, u, x in swinging(1.5)], "the reference asks for them"),
     ([(1.0, 2.5 + 0.001 * k, 1.0, 1.0) for k in range(200)], "to one side"),
     ([(r, NAN, u, x) for r, _, u, x in swinging(1.5)], "not seen")],
)  # fmt: skip
def test_swings_that_are_no_limit_cycle(rows, why):
    table, own = bench()
    told(table, own, [(1.0, 1.0, 0.1, 0.0)])
    assert told(table, own, rows) == [row[2:] for row in rows], why


def test_a_monitor_that_is_off_changes_nothing():
    table, own = bench(enabled=0)
    rows = [*swinging(5.0), (0.0, 0.0, 99.0, -99.0)]
    assert told(table, own, rows) == [row[2:] for row in rows]


@pytest.mark.parametrize("gone", ["reference", "y"])
def test_a_missing_input_is_no_motion(gone):
    table, own = bench()
    told(table, own, [(1.0, 1.0, 1.0, 0.0)])
    rows = [(NAN if gone == "reference" else 1.0, NAN if gone == "y" else 1.1, 1.0, 0.0)] * 90
    assert told(table, own, rows) == [(1.0, 0.0)] * 90
    assert own.low <= 1.0 <= own.high


# --- constants -----------------------------------------------------------------------------------


def test_the_constants_follow_from_tires_noise_and_car():
    monitor = build(DESIGN, TARGET).monitor
    assert monitor.gain_1 == pytest.approx(1.0 / 42.54, rel=1e-3)  # 42.5 N m hold 1 m/s²
    assert monitor.gain_2 == pytest.approx(1.0 / 2989.0, rel=1e-3)
    assert monitor.swing == pytest.approx(0.04 * 0.9 * 9.81)
    assert monitor.astray == pytest.approx(0.15 * 0.9 * 9.81)
    noisy = build(DESIGN, replace(TARGET, noise_rms=0.5)).monitor
    assert (noisy.swing, noisy.astray) == pytest.approx((3.0, 3.0))
    slowest_s = 1.0 / 5.85  # of the car's poles
    assert monitor.lag == pytest.approx(1.0 - math.exp(-2.0 * TICK_S / (slowest_s + TICK_S)), 1e-2)


@pytest.mark.compiled
@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_a_command_at_limit_and_rate_is_within_both_after_rounding(precision):
    steep = replace(TARGET, rate_1=7777.7, lsb_1=1e-3, lsb_2=1e-3, precision=precision)
    table = build(DESIGN, steep)
    state, largest = controller.init(table)[0], 0.0
    for k in range(200):
        controller.step(table, state, math.copysign(99.0, math.sin(0.05 * k)), 0.001 * k)
        largest = max(largest, abs(float(state.command_1)))
    assert state.monitor.reason == 0
    assert largest == pytest.approx(400.0)


def test_commands_alone_are_bounded_where_tires_are_unknown_or_rest_is_unstable():
    tires = build(DESIGN, replace(TARGET, motion_limit=math.inf)).monitor
    pole = ZeroPoleGain((), (2.0, -3.0), 1.0)
    plant = Plant.from_transfer_functions("unstable", pole, pole)
    unstable = zeroed(Constants, "float64")[0]
    fill_monitor(unstable, plant, TARGET)
    for monitor in (tires, unstable):
        assert monitor.enabled == 1
        assert monitor.limit_1 == pytest.approx(400.0, rel=2e-6)
        assert monitor.swing == monitor.astray == math.inf


def test_a_monitor_for_several_speeds_suits_each():
    slow, fast = bench(swing=2.0, gain_1=-3.0)[0], bench(astray=5.0, gain_2=4.0, lag=0.5)[0]
    widen_monitor(slow, [slow, fast])
    assert (slow.swing, slow.astray, slow.lag) == (2.0, 5.0, 1.0)
    assert (slow.gain_1, slow.gain_2) == (-3.0, 4.0)


# --- a law that is broken ------------------------------------------------------------------------

FLIPS, TICKS = 3000, 500
Law = Callable[[int, float], tuple[float, float]]


def driven(law: Law, monitor: bool = True) -> FloatArray:
    """|y| of a car that any ``law`` drives: from tick and y to both commands."""
    table = build(DESIGN, replace(TARGET, monitor=monitor)).monitor
    own = zeroed(MonitorState, "float64")[0]
    random, found = np.random.default_rng(4), np.zeros(TICKS)
    x, sent, y = np.zeros(len(PLANT.c)), (0.0, 0.0), 0.0
    for k in range(TICKS):
        seen = y + 0.03 * random.standard_normal()
        left = watch(table, own, 1.0, seen, *law(k, seen))
        x = PLANT.phi @ x + PLANT.gamma @ np.array(sent)  # the commands of the tick before
        sent, y = left, float(PLANT.c @ x)
        found[k] = abs(y)
    return found


def stuck_at_limits(_tick: int, _y: float) -> tuple[float, float]:
    return 400.0, 4000.0


def with_flipped_sign(_tick: int, y: float) -> tuple[float, float]:
    return float(np.clip(-400.0 * (1.0 - y), -400.0, 400.0)), 0.0


def from_end_to_end(_tick: int, y: float) -> tuple[float, float]:
    return math.copysign(400.0, 1.0 - y), math.copysign(4000.0, 1.0 - y)


@pytest.mark.parametrize(
    ("law", "share"), [(stuck_at_limits, 0.5), (with_flipped_sign, 0.5), (from_end_to_end, 1.2)]
)
def test_a_law_that_is_broken_is_stopped(law, share):
    free, bounded = driven(law, monitor=False), driven(law)
    assert bounded.max() < share * free.max()
    assert bounded[-100:].max() < 0.1
    assert free[-100:].max() > 2.0


@pytest.mark.compiled
def test_the_law_says_what_is_taken_away_and_its_models_follow_what_is_left():
    firmware = Firmware(build(DESIGN, TARGET))
    firmware.begin(at_rest=True)
    waves = 2.5 * np.sin(2.0 * math.pi * TICK_S * np.arange(600))
    answers = [firmware.step(0.0, y) for y in [*waves.tolist(), *[0.0] * 400]]
    first = next(k for k, each in enumerate(answers) if each.verdict > Verdict.CANNOT_BE_TOLD)
    assert 0 < first < 600
    assert abs(answers[first].fault_estimate) > 0.1
    last = answers[-1]
    assert (last.command_1, last.command_2, last.mode) == (0.0, 0.0, Mode.SAFE_STOP)
    assert last.fault_estimate == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("latency", [0, pytest.param(1, marks=pytest.mark.compiled)])
def test_the_law_goes_on_without_the_force_difference(latency):
    """Swings of a loop that compensates take the force difference first, and only then the rest."""
    target = replace(TARGET, latency_ticks=latency, on_confirmation=False)
    firmware = Firmware(build(DESIGN, target))
    firmware.begin(at_rest=True)
    waves = 2.5 * np.sin(2.0 * math.pi * TICK_S * np.arange(900))
    answers = [firmware.step(0.0, y) for y in waves.tolist()]
    alone = [each for each in answers if each.verdict == Verdict.COMPENSATION_OFF]
    assert {each.mode for each in alone} == {Mode.RUN}
    assert alone[-1].command_1 != 0.0 == alone[-1].command_2
    assert (answers[-1].verdict, answers[-1].mode) == (Verdict.SWINGING, Mode.SAFE_STOP)


def flipped(monitor: bool) -> FloatArray:
    """Largest |y| of cars whose law loses one bit of its memory each: every other, a used one."""
    random = np.random.default_rng(1)
    table = build(DESIGN, replace(TARGET, monitor=monitor))
    tables, states = np.repeat(np.asarray(table).reshape(1), FLIPS), controller.init(table, FLIPS)
    memory = states.view(np.uint8).reshape(FLIPS, -1)
    dtype, start = (state_type("float64").fields or {})["monitor"][:2]
    at, x = random.integers(50, 250, FLIPS), np.zeros((FLIPS, len(PLANT.c)))
    y, peak, sent = np.zeros(FLIPS), np.zeros(FLIPS), np.zeros((FLIPS, 2))
    for k in range(TICKS):
        for i in np.flatnonzero(at == k):
            used = np.flatnonzero(memory[i]) if i % 2 else np.arange(memory.shape[1])
            place = random.choice(used[(used < start) | (used >= start + dtype.itemsize)])
            memory[i, place] ^= 1 << random.integers(0, 8)
        reference = np.full(FLIPS, math.sin(2.0 * k * TICK_S))
        seen = y + 0.03 * random.standard_normal(FLIPS)
        controller.step_many(tables, states, reference, seen)
        x = x @ PLANT.phi.T + sent @ PLANT.gamma.T  # the commands of the tick before
        sent = np.stack([states["command_1"], states["command_2"]], axis=1)
        y = x @ PLANT.c
        peak = np.maximum(peak, np.abs(y))
    return peak


@pytest.mark.compiled
def test_no_flipped_bit_gets_a_car_farther_than_commands_stuck_at_their_limits():
    free, bounded = flipped(False), flipped(True)
    limit = driven(stuck_at_limits).max()
    assert bounded.max() < limit
    assert (free > limit).sum() > 5
    assert (bounded[free < 1.3] == free[free < 1.3]).all()  # a car that follows is left alone
