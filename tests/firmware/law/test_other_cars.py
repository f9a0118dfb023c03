"""What other cars show: the difference of both channels, by scipy's filters."""

import math
from typing import Any

import numpy as np
import pytest
from scipy import signal

from firmware_model.design.mismatch import Mismatch
from firmware_model.discretisation.tables import build
from firmware_model.discretisation.targets import Target
from firmware_model.discretisation.tustin import zoh
from firmware_model.law import controller
from firmware_model.law.status import FaultState
from firmware_model.law.structs import FloatArray
from firmware_model.law.supervision.other_cars import (
    advance_other_cars,
    clear_other_cars,
    settle_other_cars,
    show_other_cars,
)
from tests.firmware.law.cases import CAR, DESIGN, NEVER, TICK_S, changed, other_cars


def table_of(mismatch: Mismatch, latency: int = 0) -> Any:
    return build(DESIGN, Target(TICK_S, latency, "zoh", noise_rms=0.01, mismatch=mismatch))


def differences(mismatch: Mismatch, commands: Any) -> FloatArray:
    """x of every car, (cars, ticks), for commands (2, ticks) as they act."""
    return np.array([
        sum(
            signal.sosfilt(zoh(other, TICK_S).sos, u) - signal.sosfilt(zoh(own, TICK_S).sos, u)
            for other, own, u in zip(car, (CAR.g1, CAR.g2), commands, strict=True)
        ) / 0.05
        for car in mismatch.cars
    ])  # fmt: skip


def shown(table: Any, state: Any, commands: FloatArray) -> FloatArray:
    own = state.supervision
    rows = []
    for command_1, command_2 in commands.T:
        state.command_2 = command_2
        show_other_cars(table, own.other_cars, state.estimator.measured, command_1, command_2)
        rows.append(own.other_cars.shown.copy())
        advance_other_cars(table, own.other_cars, state.estimator.measured, state.command_2)
    return np.array(rows).T


def random_commands(ticks: int) -> FloatArray:
    """As large as each channel needs for as much of D*."""
    scale = np.array([[1.0 / CAR.g1.dc_gain], [1.0 / CAR.g2.dc_gain]])
    return scale * np.cumsum(np.random.default_rng(4).standard_normal((2, ticks)), axis=1)


@pytest.mark.parametrize("parameters", [0, 1, 2, 3, 4])
def test_x_is_what_both_channels_of_the_car_make_otherwise(parameters):
    mismatch, commands = other_cars(parameters), random_commands(300)
    table = table_of(mismatch)
    assert len(mismatch.cars) == table.other_cars.n == parameters
    x = shown(table, controller.init(table)[0], commands)
    if parameters:
        expected = differences(mismatch, commands)
        assert np.abs(differences(mismatch, commands * [[0.0], [1.0]])).max() > 0.1
        np.testing.assert_allclose(x[:parameters], expected, atol=1e-9 * np.abs(expected).max())
    assert not x[parameters:].any()


@pytest.mark.parametrize("parameters", [0, 2, 4])
def test_settled_cars_stay_and_cleared_cars_rest(parameters):
    mismatch = other_cars(parameters)
    table = table_of(mismatch)
    state = controller.init(table)[0]
    shown(table, state, random_commands(20))
    steady = np.array([[3.0], [-40.0]])
    settle_other_cars(table, state.supervision.other_cars, state.estimator.measured, *steady[:, 0])
    at_once = state.supervision.other_cars.shown.copy()
    stays = shown(table, state, np.repeat(steady, 5, axis=1))
    np.testing.assert_array_equal(stays[:, 0], at_once)
    for x, (g1, g2) in zip(stays, mismatch.cars, strict=False):
        by_gain = 3.0 * (g1.dc_gain - CAR.g1.dc_gain) - 40.0 * (g2.dc_gain - CAR.g2.dc_gain)
        np.testing.assert_allclose(x, by_gain / 0.05, rtol=1e-9)
    clear_other_cars(state.supervision.other_cars)
    own = state.supervision.other_cars
    assert (own.command_1, own.command_2) == (0.0, 0.0)
    assert not own.shown.any()
    assert not shown(table, state, np.zeros((2, 5))).any()


@pytest.mark.compiled
@pytest.mark.parametrize("share", [0.0, 0.6, 1.0])
@pytest.mark.parametrize("latency", [0, 1, 3])
def test_commands_drive_them_when_they_act_and_lost_ones_do_not(latency, share):
    """A loss of ``share`` known from tick 100 on; missing inputs in five ticks, held in between."""
    mismatch, lost, ticks = other_cars(2), 100, 200
    tables = changed(table_of(mismatch, latency), decision=NEVER)
    state, sent, rows = controller.init(tables[0])[0], [], []
    for k in range(ticks):
        if k == lost:
            state.fault_state = FaultState.CONFIRMED
            state.supervision.loss_model.share = share
        y = math.nan if k in (60, 150, 151, 152, 153) else 0.02 * math.cos(0.1 * k)
        controller.step(tables[0], state, math.sin(0.05 * k), y)
        sent.append((float(state.command_1), float(state.command_2)))
        rows.append(state.supervision.other_cars.shown[:2].copy())
    acting = np.vstack([np.zeros((latency, 2)), sent])[:ticks].T
    acting[0, lost:] *= 1.0 - share
    expected = differences(mismatch, acting)
    assert np.abs(expected).max() > 0.01
    np.testing.assert_allclose(np.array(rows).T, expected, atol=1e-9 * np.abs(expected).max())


def test_what_command_2_makes_within_the_tick_is_that_of_the_held_one():
    """By Tustin's rule G2 feeds through, and d̂ is judged before this tick's command 2 is known."""
    of = Target(TICK_S, 0, noise_rms=0.01, mismatch=other_cars(1))
    tables = changed(build(DESIGN, of), decision=NEVER)
    state, table, pairs = controller.init(tables[0])[0], tables[0], []
    through = table.other_cars.cars[0].channel_2.coefficients[:, 0].prod(where=np.arange(8) < 2)
    through -= table.estimator.channel_2.coefficients[:, 0].prod(where=np.arange(8) < 2)
    for k in range(30):
        held = float(state.command_2)
        before = state.supervision.other_cars.copy()
        controller.step(table, state, math.sin(0.05 * k), 0.02 * math.cos(0.1 * k))
        shown = float(state.supervision.other_cars.shown[0])
        mine = controller.init(table)[0]
        mine.supervision.other_cars = before
        show_other_cars(
            table, mine.supervision.other_cars, mine.estimator.measured, state.command_1, 0.0
        )
        pairs.append((shown - float(mine.supervision.other_cars.shown[0]), through * held / 0.05))
    found, expected = np.array(pairs).T
    assert np.abs(expected).max() > 1e-6
    np.testing.assert_allclose(found, expected, atol=1e-9 * np.abs(expected).max())
