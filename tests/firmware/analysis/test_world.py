"""A car that the world pushes, against an independent integration of its equations of motion."""

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy import linalg

from firmware_model.analysis.changing_plant import (
    NO_WORLD,
    changing_plant,
    follow_changing,
    specific_force,
)
from firmware_model.analysis.sampled_plant import follow, sample
from firmware_model.design.actuator_dynamics import IDEAL, Stage, actuated
from firmware_model.design.plants import Plant, steer_by_wire
from firmware_model.design.vehicle import (
    LOW_SPEED_MPS,
    TABLE_3_2,
    regular_speed,
    single_track,
    vehicle_state_space,
)
from firmware_model.errors import ParameterError
from tests.firmware.analysis.world import Integrated, regular

LAGS = (Stage(0.005), Stage(0.015), Stage(0.002))
DEAD = (Stage(0.005, dead_time_s=0.0073), Stage(0.015, dead_time_s=0.0021), Stage(0.002))
IMMEDIATE = (IDEAL, IDEAL, IDEAL)
SENSED_LATE = (IDEAL, Stage(0.015), Stage(dead_time_s=0.0034))
ALL = [LAGS, DEAD, IMMEDIATE, SENSED_LATE]
TICK_S, TICKS = 2e-3, 30
SIZES = np.array([800.0, 300.0, 0.08, 5.0])
DRY = np.ones((TICKS + 1, 2))


def commands(ticks=TICKS):
    k = np.arange(ticks)
    return np.stack([80.0 * np.sin(k / 9.0), 500.0 * np.cos(k / 5.0)], axis=1)


def inputs(seed=5, ticks=TICKS):
    return SIZES * np.random.default_rng(seed).normal(size=(ticks + 1, 4))


def changing(world, given, speed, stages=IMMEDIATE, tick_s=TICK_S, left=(1.0, 1.0)):
    """Output and reading of every tick, and what an accelerometer reads at its begin."""
    made = changing_plant(TABLE_3_2, "physics", stages, 40.0, tick_s)
    n = len(made.b)
    memory = (
        np.zeros(n), np.zeros(n), np.zeros((max(made.dead_ticks) + 2, 2)),
        np.zeros(made.sensor_dead_ticks + 1),
    )  # fmt: skip
    constants, work, found, forces = made.constants, made.work, [], []
    speeds = made.speeds(np.vectorize(speed), range(len(given)))
    for k, u in enumerate(given):
        rows = NO_WORLD if world is None else np.ascontiguousarray(world[k : k + 2])
        forces.append(specific_force(constants, memory[0], speed(k * tick_s), rows))
        found.append(follow_changing(constants, memory, work, speeds[k], k, *u, *left, rows))
    return np.array(found), np.array(forces), memory


def speeding(time_s):
    return 3.0 + 60.0 * time_s + 2.0 * math.sin(40.0 * time_s)


@pytest.mark.parametrize("stages", ALL)
def test_while_speed_and_friction_change_too(stages):
    k = np.arange(TICKS + 1)[:, None]
    world = np.hstack([inputs(), 0.7 + 0.4 * np.sin(k / [6.0, 9.0])])
    found, forces, _ = changing(world, commands(), speeding, stages)
    solved = Integrated(TABLE_3_2, stages, TICK_S, commands(), world, speeding)
    expected = solved.answers()
    error, size = np.abs(found - expected).max(axis=0), np.abs(expected).max(axis=0)
    assert error[0] < 1e-6 * size[0]
    assert error[1] < (1e-4 if stages[2].lag_s else 1e-6) * size[1]  # a lag of one tick
    felt = [solved.accelerometer(k * TICK_S, solved.state(k * TICK_S)) for k in range(TICKS)]
    assert np.abs(forces - felt).max() < 1e-6 * np.abs(felt).max()


@pytest.mark.compiled
def test_the_error_falls_with_the_fourth_power_of_the_tick():
    """Inputs and friction are straight lines, which ticks of any length sample exactly."""
    end_s, u = 0.24, np.array([[100.0, 500.0]])

    def world(ticks):
        part = np.linspace(0.0, 1.0, ticks + 1)[:, None]
        return np.hstack([SIZES * (1 - 2 * part), 1.0 - part * [0.6, 0.3]])

    stages = (Stage(0.02), Stage(0.05), Stage(0.03))
    exact = Integrated(TABLE_3_2, stages, end_s, u, world(1), speeding).state(end_s)
    errors = []
    for ticks in (12, 24, 48):
        given = np.repeat(u, ticks, axis=0)
        *_, memory = changing(world(ticks), given, speeding, stages, end_s / ticks)
        errors.append(np.abs(memory[0] - exact).max() / np.abs(exact).max())
    assert errors[-1] < 1e-5
    for coarse, fine in pairwise(errors):
        assert 12.0 < coarse / fine < 20.0


@pytest.mark.compiled
@pytest.mark.parametrize(
    ("speed", "variant"),
    [(0.05, "physics"), (1.3, "published"), (2.0, "physics"), (25.0, "published")],
)
def test_a_constant_speed_and_road_is_exact(speed, variant):
    """By scipy's exponential of the plant of these conditions, its command and straight lines."""
    car, friction = replace(TABLE_3_2, speed_mps=speed), (0.4, 0.7)
    (a, b, c), at = single_track(car, variant, friction)
    plant = actuated(Plant.from_state_space("slippery", a, b, c, at), *LAGS)
    around, n = plant.world, len(plant.a)
    made = changing_plant(car, variant, LAGS, 40.0, TICK_S)
    world = np.hstack([inputs(), np.tile(friction, (TICKS + 1, 1))])
    memory, constants, work = sample(plant, TICK_S).memory, made.constants, made.work
    speeds = made.speeds(lambda time_s: np.full(time_s.shape, speed), range(TICKS))
    x, found, expected = np.zeros(n), [], []
    for k, u in enumerate(commands()):
        rows = world[k : k + 2]
        w, after = rows[:, :4]
        assert specific_force(constants, memory[0], speed, rows) == pytest.approx(
            around.rows[1] @ x + around.direct[1] @ w, rel=1e-9, abs=1e-9
        )
        found.append(follow_changing(constants, memory, work, speeds[k], k, *u, 1.0, 1.0, rows))
        rates = np.zeros((n + 2, n + 2))  # of the state, of 1 and of the part of the tick
        rates[:n, :n], rates[n + 1, n] = plant.a, 1.0 / TICK_S
        rates[:n, n] = plant.b @ u + around.e @ w
        rates[:n, n + 1] = around.e @ (after - w)
        x = (linalg.expm(rates * TICK_S) @ [*x, 1.0, 0.0])[:n]
        output, read = plant.sensed @ x + around.f @ after, plant.c @ x + around.read @ after
        expected.append((output[0], read[0]))
    assert np.abs(np.subtract(found, expected)).max() < 1e-10 * np.abs(expected).max()


@pytest.mark.compiled
@pytest.mark.parametrize("stages", ALL)
def test_at_a_constant_speed_without_a_world_it_is_the_sampled_plant(stages):
    found, *_ = changing(None, commands(), lambda _: 17.0, stages, left=(1.0, 0.5))
    exact = sample(actuated(steer_by_wire(replace(TABLE_3_2, speed_mps=17.0)), *stages), TICK_S)
    constants, memory = exact.constants, exact.memory
    expected = [follow(constants, memory, k, *u, 1.0, 0.5) for k, u in enumerate(commands())]
    assert np.abs(found - expected).max() < 1e-11 * np.abs(expected).max()


@pytest.mark.compiled
@pytest.mark.parametrize("stages", ALL)
def test_a_calm_world_changes_no_bit(stages):
    calm = np.hstack([np.zeros((TICKS + 1, 4)), DRY])
    quiet, *_ = changing(None, commands(), speeding, stages)
    pushed, *_ = changing(calm, commands(), speeding, stages)
    assert (quiet == pushed).all()


# --- from standstill to motorway ------------------------------------------------------------------


def test_the_regular_speed_is_the_speed_but_where_a_car_creeps():
    for speed in (2.0, 3.7, 50.0):
        assert regular_speed(speed) == speed
    for speed in (0.0, 0.3, 1.1, 1.999):
        assert regular_speed(speed) == pytest.approx(regular(speed), rel=1e-12)
    h = 1e-4
    near = [regular_speed(LOW_SPEED_MPS + k * h) for k in (-2, -1, 0, 1)]
    assert np.diff(near) / h == pytest.approx(1.0, abs=1e-7)  # no jump of the slope
    assert np.diff(near, 2) / h**2 == pytest.approx(0.0, abs=1e-3)  # nor of the curvature


def steady(speed, lateral_weight=0.5):
    """Yaw rate and D* of a steadily turning car, for a steer angle of 1 rad."""
    car = replace(TABLE_3_2, speed_mps=speed, lateral_weight=lateral_weight)
    a, b, c = vehicle_state_space(car)
    x = np.linalg.solve(a, -b[:, 0])
    return x[1] / x[3], (c @ x)[0] / x[3]


def test_a_creeping_car_is_the_kinematic_car():
    length = TABLE_3_2.front_axle_distance_m + TABLE_3_2.rear_axle_distance_m
    for speed in (0.01, 0.1, 0.5, 1.0):
        yaw_rate, d_star = steady(speed)
        assert yaw_rate == pytest.approx(speed / length, rel=4e-3 * speed)
        assert d_star == pytest.approx(speed**2 / length, rel=4e-3 * speed)


@pytest.mark.compiled
def test_from_standstill_to_motorway():
    """Against the ODE solver; wind and a kick while it stands, ice while it creeps."""
    tick_s, ticks = 0.01, 300

    def speed(time_s):
        return 36.0 * math.sin(math.pi / 6.0 * time_s) ** 4

    k = np.arange(ticks + 1)[:, None]
    waves = SIZES * np.sin(k / [34.0, 30.0, 62.0, 18.0])
    friction = 1.0 - 0.6 * np.exp(-(((k - 120) / 24.0) ** 2)) * [1.0, 0.8]
    world = np.hstack([waves, friction])
    given = np.array([20.0, 200.0]) * np.sin(np.arange(ticks) / 40.0)[:, None]
    found, *_ = changing(world, given, speed, tick_s=tick_s)
    expected = Integrated(TABLE_3_2, IMMEDIATE, tick_s, given, world, speed, 1e-8).answers()
    assert speed(0.0) == 0.0 and speed(3.0) == 36.0
    assert np.abs(found - expected).max() < 1e-3 * np.abs(expected).max()


def test_a_car_that_rolls_backward_is_refused():
    made = changing_plant(TABLE_3_2, "physics", IMMEDIATE, 1.0, TICK_S)
    with pytest.raises(ParameterError, match=r"speed = -0.5 m/s: must be 0 or above"):
        made.speeds(lambda time_s: np.full(time_s.shape, -0.5), range(3))


@given(st.floats(0.0, 80.0), st.floats(0.2, 1.5), st.floats(0.2, 1.5))
def test_the_parts_put_together_are_the_equations(speed, front, rear):
    """From a standing car on; ``single_track`` itself refuses a speed of 0."""
    made = changing_plant(TABLE_3_2, "physics", LAGS, 60.0, TICK_S)
    v = regular_speed(speed)
    share = speed / v
    (a, _, c), world = single_track(TABLE_3_2, friction=(front, rear), rolling=(v, share))
    powers = np.array([v, 1.0, 1.0 / v, 1.0 / v**2])
    shares = [front - 1, rear - 1, share - 1, (front - 1) * (share - 1)]
    matrix = np.tensordot(powers, made.dry, 1)
    matrix += np.tensordot(shares, np.tensordot(powers, made.road, (0, 1)), 1)
    size = np.abs(a).max()
    assert np.abs(matrix[:4, :4] - a).max() < 1e-11 * size
    assert np.abs(matrix[-2, :4] - c[0]).max() < 1e-11 * size
    assert np.abs(np.tensordot(powers, made.e, 1)[:4] - world.e).max() < 1e-11
