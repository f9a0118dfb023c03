"""The shaped reference: minimum time, within its limit, and the reference itself if that fits."""

import math

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from firmware_model.analysis.sampled_plant import sample
from firmware_model.analysis.simulation import simulate
from firmware_model.compiled import firmware
from firmware_model.design.continuous_design import DesignSpecification, design
from firmware_model.design.plants import steer_by_wire
from firmware_model.discretisation.tables import build
from firmware_model.discretisation.targets import Target
from firmware_model.law import controller
from firmware_model.law.core.reference_shaper import braking_speed, shape_reference, start

TICK_S, LARGEST = 1e-3, 0.25  # a power of two: sums of it are exact
CAR = steer_by_wire()
TABLE = build(
    design(CAR, DesignSpecification()), Target(TICK_S, reference_acceleration=LARGEST / TICK_S**2)
)


@firmware
def _follow(table, state, reference, shaped):  # type: ignore[no-untyped-def]
    for k in range(len(reference)):
        state.reference = reference[k]
        shaped[k] = shape_reference(table.reference_shaper, state.reference_shaper, state.reference)


def follow(reference: np.ndarray, at: float = 0.0, table=TABLE) -> np.ndarray:  # type: ignore[no-untyped-def]
    """r_g of every tick, from rest at ``at``."""
    state = controller.init(table)[0]
    start(state.reference_shaper, at)
    shaped = np.zeros(len(reference))
    _follow(table, state, np.asarray(reference, dtype=np.float64), shaped)
    return shaped


def changes_of_speed(shaped: np.ndarray, at: float = 0.0) -> np.ndarray:
    return np.diff(np.concatenate([[at, at], shaped]), n=2)


def fewest_ticks(distance: float) -> int:
    """To rest, when speed changes by at most 1: (n+1)²/4, rounded down, is the farthest in n."""
    n = 0
    while (n + 1) ** 2 // 4 < distance:
        n += 1
    return n


@given(st.floats(1e-6, 1e4))
def test_from_the_braking_speed_equal_decrements_end_at_the_target(distance):
    """A decrement a tick, and the last decrement is no larger than the others."""
    speeds = [braking_speed(distance)]
    while speeds[-1] > 1.0:
        speeds.append(speeds[-1] - 1.0)
    assert sum(speeds) == pytest.approx(distance, rel=1e-9)
    assert speeds[-1] >= -1e-9 * speeds[0]


@pytest.mark.compiled
@given(st.floats(1e-6, 1e4), st.booleans(), st.floats(-100.0, 100.0))
def test_a_step_is_followed_in_minimum_time_and_not_beyond(distance, down, at):
    to = at + math.copysign(distance * LARGEST, -1.0 if down else 1.0)
    ticks = fewest_ticks(abs(to - at) / LARGEST * (1.0 - 1e-9))
    shaped = follow(np.full(ticks + 50, to), at)
    # One tick more than a double integrator: its first move of a tick is what the step itself
    # would have moved.
    assert (shaped[ticks + 1 :] == to).all()
    rounding = 1e-12 * (1.0 + abs(at) + abs(to))
    low, high = min(at, to) - rounding, max(at, to) + rounding
    assert low <= shaped.min() <= shaped.max() <= high


@given(st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=60))
def test_no_reference_makes_it_faster_than_its_limit(values):
    reference = np.repeat(values, 7)
    assert np.abs(changes_of_speed(follow(reference))).max() <= LARGEST + 1e-11


@given(st.lists(st.floats(-LARGEST, LARGEST), min_size=1, max_size=300))
def test_a_reference_within_the_limit_comes_through_exactly(accelerations):
    reference = np.cumsum(np.cumsum(np.array(accelerations) * (1.0 - 1e-9)))
    np.testing.assert_array_equal(follow(reference), reference)


@pytest.mark.compiled
@given(st.lists(st.floats(-50.0, 50.0), min_size=1, max_size=20), st.floats(-50.0, 50.0))
def test_comes_to_rest_wherever_it_is_sent(before, last):
    shaped = follow(np.concatenate([before, np.full(2000, last)]))
    assert (shaped[-1000:] == last).all()


@pytest.mark.compiled
@settings(max_examples=20)
@given(st.lists(st.floats(-1e3, 1e3), min_size=2, max_size=20))
def test_single_precision_runs_the_same_course(values):
    single = build(
        design(CAR, DesignSpecification()),
        Target(TICK_S, reference_acceleration=LARGEST / TICK_S**2, precision="float32"),
    )
    reference = np.repeat(np.float32(values), 50)
    far = np.abs(reference).max() + 1.0
    np.testing.assert_allclose(
        follow(reference, table=single), follow(reference), atol=2e-4 * far + 2 * LARGEST
    )


def limited_table(torque_nm: float, share: float):  # type: ignore[no-untyped-def]
    specification = DesignSpecification(tau_s=1e-4, tau_q_s=2.7e-3)
    acceleration = share * torque_nm * CAR.g1.gain
    return build(
        design(CAR, specification),
        Target(TICK_S, 1, "zoh", limit_1=torque_nm, reference_acceleration=acceleration),
    )


@pytest.mark.compiled
@pytest.mark.parametrize("torque_nm", [200.0, 400.0, 1000.0])
def test_a_raw_step_keeps_off_the_limit_of_the_torque(torque_nm):
    """With half of the limit for r̈, where without shaping the loop hits both limits."""
    plant, step = sample(CAR, TICK_S), np.ones(3000)
    shaped = simulate(limited_table(torque_nm, 0.5), plant, step)
    raw = simulate(limited_table(torque_nm, math.inf), plant, step)
    assert np.abs(raw.command_1).max() == pytest.approx(torque_nm)
    assert np.abs(shaped.command_1).max() < 0.85 * torque_nm
    assert shaped.measurement.max() < 1.01
    assert raw.measurement.max() > 1.05
    assert abs(shaped.error[-1]) < 1e-9


def test_an_overflow_leaves_the_shaper_working():
    table = limited_table(400.0, 0.5)
    states = controller.init(table)
    for reference in (1.7e308, -1.7e308, 0.0, 0.0):
        controller.step(table, states[0], reference, 0.0)
    assert math.isfinite(states[0].reference_shaper.shaped)
    assert math.isfinite(states[0].command_1)
