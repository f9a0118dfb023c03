"""What was missed is made up smoothly, whole and in about the time that it took to be noticed."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, strategies as st

from firmware_model.analysis.sampled_plant import sample
from firmware_model.analysis.simulation import simulate
from firmware_model.design.continuous_design import DesignSpecification, design
from firmware_model.design.plants import steer_by_wire
from firmware_model.discretisation.tables import HASTE, SLOWEST_TRANSFER_S, build
from firmware_model.discretisation.targets import Target
from firmware_model.law import controller
from firmware_model.law.status import FaultState
from firmware_model.law.supervision.bumpless_transfer import begin_transfer, release, transfer

TICK_S, LOST = 1e-3, 600
CAR = steer_by_wire()
DESIGN = design(CAR, DesignSpecification(tau_s=0.0001, tau_q_s=0.0027))
SLOWEST = TICK_S / SLOWEST_TRANSFER_S  # pace a tick


def late(noise_rms: float = 0.0) -> Target:
    """A target that finds the loss the later the more noise it reckons with."""
    return Target(TICK_S, 1, "zoh", limit_2=1e5, noise_rms=noise_rms, on_confirmation=True)


def begun(missed: float, speed: float) -> tuple[Any, Any]:
    table = build(DESIGN, late())
    state = controller.init(table)[0].supervision
    begin_transfer(table.bumpless_transfer, state.bumpless_transfer, missed, speed)
    return table, state.bumpless_transfer


sizes = st.floats(-1.0, 1.0).filter(lambda value: abs(value) > 1e-9)


@pytest.mark.compiled
@given(missed=st.floats(1e-6, 1.0), ticks=st.integers(4, 40))
def test_of_a_square_of_time_hardly_more_is_missed(missed, ticks):
    """Speed 2/n, pace 4/n: max of (1 + 6x) exp(-4x) at x = 1/12, 3/2 exp(-1/3) = 1.075."""
    _, state = begun(missed, 2.0 * missed / ticks)
    left = [-transfer(state, 0.0) for _ in range(4 * ticks)]
    assert max(left) <= 1.5 * math.exp(-1.0 / 3.0) * missed * (1.0 + 1e-9)
    assert left[-1] < 0.01 * missed


@pytest.mark.compiled
@given(missed=sizes, speed=sizes, carried=sizes, earlier=sizes)
@example(missed=1.0, speed=0.5, carried=0.0, earlier=0.0)
@example(missed=0.5, speed=0.0, carried=0.0, earlier=0.0)  # settled: the pace of the car
def test_what_is_carried_already_is_not_missed(missed, speed, carried, earlier):
    """A critically damped motion, m'' + 2λm' + λ²m = 0 in k: (m0 + (m0' + λ m0) k) exp(-λk).

    F̂'s input goes on from its value and its speed, here ``carried`` after ``earlier``.
    """
    table = build(DESIGN, late())
    state = controller.init(table)[0].supervision.bumpless_transfer
    transfer(state, earlier)
    transfer(state, carried)
    value, change = missed + carried, speed + carried - earlier
    begin_transfer(table.bumpless_transfer, state, value, change)
    missed, speed = value - carried, change - (carried - earlier)  # as rounding has them
    pace = max(HASTE * abs(speed / missed), SLOWEST)
    left = [-transfer(state, 0.0) for _ in range(20)]
    k = np.arange(1, 21)
    expected = (missed + (speed + pace * missed) * k) * np.exp(-pace * k)
    np.testing.assert_allclose(left, expected, rtol=1e-6, atol=1e-9)


def test_a_transfer_ends_where_nothing_is_missed():
    table, state = begun(0.5, 0.03)
    transfer(state, 0.6)
    begin_transfer(table.bumpless_transfer, state, float(state.carried), 0.2)
    assert [transfer(state, lost) for lost in (0.3, 0.4)] == [0.3, 0.4]


def test_where_nothing_was_missed_all_is_carried_at_once():
    for missed, speed in ((0.0, 0.3), (5e-324, 1e300)):
        _, state = begun(missed, speed)
        assert [transfer(state, value) for value in (0.3, 0.4, -1.0)] == [0.3, 0.4, -1.0]


@pytest.mark.compiled
@pytest.mark.parametrize("noise_rms", [0.0, 1e-3])
@pytest.mark.parametrize("period", [1300, 1900, 2600])
def test_a_loose_connection_asks_for_no_more_than_the_load_in_a_tick(noise_rms, period):
    """Lost again while the last loss is released: 18 times the load, were F̂ to jump to it."""
    left = np.ones((12_000, 2))
    left[6000:, 0] = (np.arange(6000) // (period // 2)) % 2
    plant, table = sample(CAR, TICK_S), build(DESIGN, late(noise_rms))
    trace = simulate(table, plant, np.ones(12_000), effectiveness=left)
    again = np.diff((trace.fault_state == FaultState.CONFIRMED).astype(int)) == 1
    assert again.sum() > 2
    assert np.abs(np.diff(trace.command_2)).max() < 1.0 / CAR.g2.dc_gain
    assert np.abs(trace.error[6000:]).max() < 0.1


@pytest.mark.compiled
@pytest.mark.parametrize("after", [20, 28, 40, 48, 64, 100])
def test_a_loss_that_comes_back_while_the_last_is_released_makes_no_bump(after):
    """The new share belongs to the new loss alone: no false return follows."""
    table = build(DESIGN, late(1e-3))
    plant, left = sample(CAR, TICK_S), np.ones((2500, 2))
    left[LOST : LOST + 200, 0] = 0.0
    once = simulate(table, plant, np.ones(2500), effectiveness=left).fault_state
    cleared = LOST + 200 + int(np.argmax(once[LOST + 200 :] == FaultState.CLEAR))
    left[cleared + after :, 0] = 0.0
    again = simulate(table, plant, np.ones(2500), effectiveness=left)
    confirmed = again.fault_state == FaultState.CONFIRMED
    assert not confirmed[cleared : cleared + after].any()
    assert (np.diff(confirmed[cleared:].astype(int)) != 0).sum() == 1
    assert np.abs(np.diff(again.command_2[cleared:])).max() < 0.15 / CAR.g2.dc_gain
    assert np.abs(again.error[-100:]).max() < 1e-2


@pytest.mark.compiled
@pytest.mark.parametrize("noise_rms", [1e-4, 1e-3, 5e-3])
def test_compensation_that_engages_late_needs_no_more_than_the_load_and_makes_up_all(noise_rms):
    """Given w as it is, F̂ would ask for w/(g T²): 2e4 N after 15 ticks, and as much back."""
    left = np.ones((2500, 2))
    left[LOST:, 0] = 0.0
    table, plant = build(DESIGN, late(noise_rms)), sample(CAR, TICK_S)
    trace = simulate(table, plant, np.ones(2500), effectiveness=left)
    acts = int(np.argmax(trace.fault_state[LOST:] > FaultState.CLEAR))
    assert 1 < acts < 40
    load = 1.0 / CAR.g2.dc_gain
    assert np.abs(trace.command_2).max() < 2.5 * load
    assert np.abs(np.diff(trace.command_2)).max() < load
    assert np.abs(trace.error[LOST:]).max() < 0.03
    assert np.abs(trace.error[-100:]).max() < 2e-3


def test_a_transfer_that_was_released_is_forgotten():
    """The next transfer begins at zero, not at the end of the last transfer."""
    table, state = begun(0.2, 0.01)
    _, fresh = begun(0.5, 0.03)
    for lost in (0.3, 0.4):
        transfer(state, lost)
    assert state.carried != 0.0
    release(state)
    begin_transfer(table.bumpless_transfer, state, 0.5, 0.03)
    expected = [transfer(fresh, lost) for lost in (0.53, 0.56)]
    assert [transfer(state, lost) for lost in (0.53, 0.56)] == expected
