"""Further sensors of a plant: their readings, filters and frames."""

import numpy as np
import pytest

from firmware_model.analysis import hardware
from firmware_model.analysis.changing_plant import changing_plant, read_changing
from firmware_model.analysis.sampled_plant import sample
from firmware_model.analysis.witnesses import (
    ECHO,
    HEALTHY,
    INVALID,
    LIES,
    NOT_SENT,
    NOT_VALID,
    STANDING,
    SWAPPED,
    VALID,
    Reading,
    acting_before,
    filtered_readings,
    read_witnesses,
    sense,
    with_readings,
)
from firmware_model.design.actuator_dynamics import IDEAL, Stage, actuated
from firmware_model.design.plants import steer_by_wire
from firmware_model.design.vehicle import TABLE_3_2, dstar

STAGES = (Stage(0.005), IDEAL, IDEAL)
PLANT = actuated(steer_by_wire(), *STAGES)
READINGS = [Reading(0), Reading(1, 0.01), Reading(ECHO), Reading(ECHO + 1, 0.02)]


def response(a, b, c, s):
    return c @ np.linalg.solve(s * np.eye(len(a)) - a, b)


@pytest.mark.parametrize("s", [0.3j, 5j, 80j])
def test_a_filter_is_a_lag_of_its_reading(s):
    wide, readings = with_readings(PLANT, STAGES, READINGS)
    world = PLANT.world
    assert world is not None and len(readings) == 4
    x = response(wide.a, wide.b, readings.rows, s) + readings.acting
    plain = response(PLANT.a, PLANT.b, world.rows, s)
    np.testing.assert_allclose(x[0], plain[0], rtol=1e-9)
    np.testing.assert_allclose(x[1], plain[1] / (1.0 + 0.01 * s), rtol=1e-9)
    np.testing.assert_allclose(x[2], [1.0 / (1.0 + 0.005 * s), 0.0], atol=1e-12)
    np.testing.assert_allclose(x[3], [0.0, 1.0 / (1.0 + 0.02 * s)], atol=1e-12)


def test_without_filters_the_plant_stays_and_an_ideal_actuator_echoes_its_command():
    same, readings = with_readings(PLANT, STAGES, [Reading(2), Reading(ECHO + 1)])
    assert same is PLANT
    np.testing.assert_array_equal(readings.acting, [[0.0, 0.0], [0.0, 1.0]])
    found = np.zeros(2)
    x = np.arange(1.0, len(PLANT.a) + 1)
    read_witnesses(readings.constants, x, 7.0, 9.0, found)
    assert PLANT.world is not None
    np.testing.assert_allclose(found, [PLANT.world.rows[2] @ x, 9.0])


def test_an_echo_needs_no_world():
    (a, _, e), readings = filtered_readings(PLANT.a, PLANT.b, None, STAGES, [Reading(ECHO, 0.1)])
    assert len(a) == len(PLANT.a) + 1
    assert not e.any() and readings.rows[0, -1] == 1.0


@pytest.mark.parametrize(("dead_ticks", "expected"), [(0, 4.0), (2, 2.5)])
def test_the_acting_command_waited_for_the_dead_time(dead_ticks, expected):
    plant = actuated(steer_by_wire(), Stage(dead_time_s=dead_ticks * 0.001), IDEAL, IDEAL)
    sampled = sample(plant, 0.001)
    memory = sampled.memory
    commands = memory[2]
    for k, u in enumerate((5.0, 7.0, 8.0)):
        commands[k % len(commands), 0] = u
    assert acting_before(sampled.constants, memory, 2, 8.0, 0.5, 0) == expected


def test_a_changing_car_at_a_constant_speed_reads_as_the_car_of_that_speed():
    stages = (IDEAL, IDEAL, IDEAL)
    made = changing_plant(TABLE_3_2, "physics", stages, 40.0, 0.002, READINGS)
    wide, readings = with_readings(steer_by_wire(), stages, READINGS)
    x = np.random.default_rng(3).normal(size=len(wide.a))
    world = np.array([[300.0, 90.0, 0.03, 4.0, 1.0, 1.0]] * 2)
    ours, expected = np.zeros(4), np.zeros(4)
    acting = made.acting
    read_changing(made.constants, x, 10.0, world, acting, 11.0, 13.0, ours)
    read_witnesses(readings.constants, x, 11.0, 13.0, expected)
    expected += readings.direct @ world[0, :4]
    np.testing.assert_allclose(ours, expected, rtol=1e-9)


def said(ticks=12, delay=0, **faults):
    """Value, sample tick and state of two sensors, which read k and 100 + k, tick by tick."""
    timing = np.array([[3, 1, delay], [1, 0, 0]])
    row = np.tile(HEALTHY, (2, 1))
    for place, value in faults.items():
        row[
            0, {"lies": LIES, "swapped": SWAPPED, "invalid": INVALID, "standing": STANDING}[place]
        ] = value
    memory = np.zeros((8, 2)), np.zeros(2), np.zeros(2, np.int64)
    values, samples, states = np.zeros(2), np.zeros(2, np.int64), np.zeros(2, np.int64)
    constants = timing, np.zeros(2), hardware.EXACT_FRAMES[:2].copy()
    zero, rows = np.zeros(2), []
    for k in range(ticks):
        truth, told = np.array([k, 100.0 + k]), np.array([-k, 0.0])
        sense(k, truth, told, zero, zero, row, constants, memory, values, samples, states)
        rows.append((values[0], samples[0], states[0]))
    return np.array(rows).T


def test_period_phase_and_delay():
    values, samples, states = said(delay=2)
    np.testing.assert_array_equal(np.flatnonzero(states == VALID), [1, 4, 7, 10])
    np.testing.assert_array_equal(states[states != VALID], NOT_SENT)
    np.testing.assert_array_equal(values[2:], np.arange(10))
    np.testing.assert_array_equal(samples[2:], np.arange(10))


def test_faults_of_a_further_sensor():
    np.testing.assert_array_equal(said(lies=1.0)[0], -np.arange(12.0))
    np.testing.assert_array_equal(said(swapped=1.0)[0], 100.0 + np.arange(12))
    assert set(said(invalid=1.0)[2]) == {NOT_SENT, NOT_VALID}
    np.testing.assert_array_equal(said(standing=1.0)[1], 0)


def test_dstar_of_two_sensors_by_hand():
    assert dstar(0.25, 2.0, 0.1, 10.0) == pytest.approx(0.25 * 2.0 + 0.75 * 10.0 * 0.1)
