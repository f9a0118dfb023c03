"""A plant whose speed changes: exact at one speed, of fourth order where it changes."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from firmware_model.analysis.changing_plant import NO_WORLD, changing_plant, follow_changing
from firmware_model.analysis.sampled_plant import follow, sample
from firmware_model.design.actuator_dynamics import IDEAL, Stage
from firmware_model.design.vehicle import TABLE_3_2, vehicle_state_space
from tests.firmware.scheduled import LAGS, car

DEAD = (Stage(0.005, dead_time_s=0.0073), Stage(0.015, dead_time_s=0.0021), Stage(0.002))
IMMEDIATE = (IDEAL, IDEAL, IDEAL)
SENSED_LATE = (IDEAL, Stage(0.015), Stage(0.002, dead_time_s=0.0034))


def driven(changing, speeds, commands, left=(1.0, 1.0)):
    """Output and reading of every tick."""
    n, length = len(changing.b), max(changing.dead_ticks) + 2
    memory = (
        np.zeros(n), np.zeros(n), np.zeros((length, 2)), np.zeros(changing.sensor_dead_ticks + 1)
    )  # fmt: skip
    work, constants = changing.work, changing.constants
    return memory, [
        follow_changing(constants, memory, work, speeds[k], k, *command, *left, NO_WORLD)
        for k, command in enumerate(commands)
    ]


def commands(ticks):
    k = np.arange(ticks)
    return np.stack([80.0 * np.sin(k / 9.0), 500.0 * np.cos(k / 5.0)], axis=1).tolist()


@pytest.mark.parametrize("stages", [LAGS, DEAD, SENSED_LATE, IMMEDIATE])
def test_at_a_constant_speed_it_is_the_sampled_plant(stages):
    tick_s, ticks = 1e-3, 40
    changing = changing_plant(TABLE_3_2, "physics", stages, 30.0, tick_s)
    speeds = changing.speeds(lambda time_s: np.full(time_s.shape, 17.0), range(ticks))
    _, ours = driven(changing, speeds, commands(ticks), left=(1.0, 0.5))
    exact = sample(car(17.0, stages), tick_s)
    constants, memory = exact.constants, exact.memory
    theirs = [follow(constants, memory, k, *u, 1.0, 0.5) for k, u in enumerate(commands(ticks))]
    size = np.abs(theirs).max()
    assert np.abs(np.subtract(ours, theirs)).max() < 1e-11 * size


def test_its_error_falls_with_the_fourth_power_of_the_tick():
    end_s, u = 0.4, np.array([100.0, 500.0])

    def speed(time_s):
        return 8.0 + 40.0 * time_s + 5.0 * np.sin(20.0 * time_s)

    def rate(time_s, x):
        a, b, _ = vehicle_state_space(replace(TABLE_3_2, speed_mps=float(speed(time_s))))
        return a @ x + b @ u

    exact = solve_ivp(rate, (0.0, end_s), np.zeros(4), method="DOP853", rtol=1e-12, atol=1e-14).y[
        :, -1
    ]
    errors = []
    for tick_s in (0.02, 0.01, 0.005):
        changing = changing_plant(TABLE_3_2, "physics", IMMEDIATE, 40.0, tick_s)
        ticks = round(end_s / tick_s)
        memory, _ = driven(changing, changing.speeds(speed, range(ticks)), [u.tolist()] * ticks)
        errors.append(np.abs(memory[0] - exact).max() / np.abs(exact).max())
    assert errors[-1] < 1e-6
    for coarse, fine in pairwise(errors):
        assert 13.0 < coarse / fine < 19.0
