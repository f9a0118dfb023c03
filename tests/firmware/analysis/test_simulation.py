"""The loop without frames: a plant class as the linear plant, the sensor, lost commands."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from firmware_model.analysis.hardware import EXACT_FRAMES, GAIN, HEALTHY, SENSOR, SLEW, frame_of
from firmware_model.analysis.sampled_plant import SampledPlant, follow_plant, sample
from firmware_model.analysis.simulation import Simulation, Trace, simulate
from firmware_model.discretisation.tables import build
from firmware_model.discretisation.targets import Target
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


def test_a_plant_class_with_the_same_equations_gives_the_same_bits() -> None:
    linear = simulate(TABLE, sample(CAR, TICK_S), REFERENCE)
    own = simulate(TABLE, Recorded(), REFERENCE, tick_s=TICK_S)
    for name in ("time_s", "measurement", "command_1", "command_2", "fault_estimate"):
        np.testing.assert_array_equal(getattr(own, name), getattr(linear, name))
    assert np.abs(linear.command_1).max() > 0.0
    np.testing.assert_array_equal(linear.error, REFERENCE - linear.measurement)  # (3.41)


def test_what_is_measured_lies_on_the_grid_and_within_its_ends() -> None:
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
def test_an_actuator_holds_its_last_command_and_then_applies_zero(hold_ticks: int) -> None:
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


def test_a_sensor_reads_in_whole_steps_of_its_resolution() -> None:
    """Rounded to the nearest: what the controller gets is at most half a step from the output."""
    step = 1e-4
    run = simulate(TABLE, sample(CAR, TICK_S), REFERENCE, resolution=step)
    np.testing.assert_allclose(run.measured, np.round(run.measured / step) * step, atol=1e-15)
    np.testing.assert_allclose(run.measured, run.measurement, atol=step / 2 * (1 + 1e-9))
    assert np.abs(run.measured - run.measurement).max() > 0.1 * step


def test_in_pieces_it_is_the_same_run_with_what_its_plant_did() -> None:
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


def test_a_run_goes_on_from_another_that_was_the_same_so_far() -> None:
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
def test_a_window_that_moves_on_sees_the_same_run(changing: bool) -> None:
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
