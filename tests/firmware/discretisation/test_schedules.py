"""One filter at several speeds in the same sections, and what cannot be put into a schedule."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy import linalg

from firmware_model.design.actuator_dynamics import Stage, actuated
from firmware_model.design.continuous_design import DesignSpecification, design
from firmware_model.design.plants import Plant, steer_by_wire
from firmware_model.design.vehicle import TABLE_3_2
from firmware_model.discretisation.paired import coordinates, followed, groups, paired_alike, turn
from firmware_model.discretisation.schedules import AtSpeed, schedule
from firmware_model.discretisation.sections import from_delta_zpk, realisation
from firmware_model.discretisation.tustin import zoh
from firmware_model.errors import DesignError, ImproperError, ParameterError, UnstablePlantError
from tests.firmware.scheduled import SPECIFICATION, SPEEDS, TARGET, car, scheduled

TICK_S = 1e-3
ON_CIRCLE = np.exp(1j * np.geomspace(1e-3, 3.0, 40))


def pair(radius: float, damping: float) -> list[complex]:
    """Two roots in δ, conjugate below a damping of 1 and real above it."""
    root = np.sqrt(complex(damping**2 - 1.0))
    return [complex(radius * (-damping + root)), complex(radius * (-damping - root))]


@pytest.mark.compiled
@given(
    st.lists(st.floats(0.01, 0.3), min_size=3, max_size=3),
    st.floats(0.3, 0.9),
    st.floats(1.05, 2.0),
)
def test_each_has_the_response_that_it_has_alone(radii, damped, over):
    """Poles are conjugate at one speed and real at another, beside real poles."""
    designs = []
    for share in np.linspace(0.0, 1.0, 9):
        damping = damped + share * (over - damped)
        poles = [*pair(radii[0], damping), *pair(0.5 * radii[1] + 0.3, 0.5), complex(-radii[2])]
        designs.append(([complex(-0.4), complex(-1.2 - share)], poles, 0.1 + share))
    for (zeros, poles, gain), alike in zip(designs, paired_alike(designs, TICK_S), strict=True):
        alone = from_delta_zpk(zeros, poles, gain, TICK_S)
        np.testing.assert_allclose(alike(ON_CIRCLE), alone(ON_CIRCLE), rtol=1e-7)


def test_coefficients_are_smooth_where_conjugates_become_real():
    dampings = np.linspace(0.95, 1.05, 41)
    designs = [([], [*pair(0.05, damping), complex(-0.06)], 1.0) for damping in dampings]
    rows = np.array([each.coefficients for each in paired_alike(designs, TICK_S)])
    steps = np.abs(np.diff(rows, axis=0)).max(axis=(1, 2))
    assert steps.max() < 1.5 * steps.min()


def test_a_gain_alone_is_one_section():
    (alone,) = paired_alike([([], [], 2.5)], TICK_S)
    assert alone.coefficients.tolist() == [[2.5, 0.0, 0.0, 0.0, 0.0]]


def test_what_has_more_zeros_than_poles_is_refused():
    with pytest.raises(ImproperError, match="2 zeros and 1 poles: must not be more"):
        paired_alike([([-0.1, -0.2], [-0.3], 1.0)], TICK_S)


def test_roots_that_come_and_go_are_refused():
    with pytest.raises(ParameterError, match="2 roots at one speed and 1 at the next"):
        followed([[-0.1, -0.2], [-0.1]])


def test_a_root_that_changes_its_partner_is_refused():
    """The middle one of three meets the slow one first, the fast one later."""
    begin = [-0.30 + 0.01j, -0.30 - 0.01j, -0.6]
    between = [-0.28, -0.45, -0.6]
    end = [-0.28, -0.52 + 0.02j, -0.52 - 0.02j]
    with pytest.raises(ParameterError, match="has another conjugate at another speed"):
        groups(followed([begin, between, end]))


def test_an_unstable_car_has_no_schedule():
    oversteering = steer_by_wire(
        replace(TABLE_3_2, speed_mps=30.0, rear_cornering_stiffness_n_per_rad=20000.0,
                steering_damping_nms_per_rad=90.0, trail_m=0.01)
    )  # fmt: skip
    made = design(oversteering, DesignSpecification())
    with pytest.raises(UnstablePlantError, match=r"at 30 m/s: pole at .*: must be stable at every"):
        schedule([AtSpeed(30.0, made, TARGET)])


def test_designs_of_different_order_are_refused_by_name():
    orders = (2, 3)
    designs = [
        AtSpeed(
            12.0 + order, design(car(12.0 + order), replace(SPECIFICATION, alpha=order)), TARGET
        )
        for order in orders
    ]
    with pytest.raises(ParameterError, match=r"compensator: . roots at one speed and . at"):
        schedule(designs)


def test_too_many_speeds_are_refused():
    with pytest.raises(ParameterError, match="17 speeds: must be 1 to 16"):
        scheduled(tuple(np.linspace(10.0, 12.0, 17)))


def test_lags_that_are_equal_cannot_be_told_apart():
    with pytest.raises(DesignError, match="lags in series must not be equal"):
        scheduled(
            SPEEDS[:2],
            stages=(Stage(0.005), Stage(0.015), Stage(0.005)),
            specification=DesignSpecification(0.002, 3, 0.015, 4),
        )


def test_a_model_of_too_high_an_order_is_refused():
    one = actuated(car(12.0), Stage(0.002), Stage(0.003), Stage(natural_frequency_rad_per_s=90.0))
    long = actuated(
        one, *(Stage(natural_frequency_rad_per_s=each) for each in (150.0, 170.0, 260.0))
    )
    at = (long, zoh(long.g1, TICK_S))
    with pytest.raises(ParameterError, match="a model of 12 states: must have at most 8"):
        turn(at, at, 0, "zoh")


def test_a_state_that_no_output_shows_is_refused():
    a = [[-3.0, 1.0, 0.0], [0.0, -5.0, 0.0], [0.0, 1.0, -9.0]]
    hidden = Plant.from_state_space("hidden", a, [[0.0, 0.0], [1.0, 2.0], [0.0, 0.0]], [[1, 0, 0]])
    at = (hidden, zoh(hidden.g1, TICK_S))
    with pytest.raises(DesignError, match="has 3 states and 2 after discretisation"):
        turn(at, at, 0, "zoh")


@pytest.mark.parametrize("channel", [0, 1])
def test_a_turn_is_that_of_the_states_and_draws_no_random_number(channel):
    """Against the exponential of scipy: an export must have the same digits every time."""
    at = [(car(each), zoh((car(each).g1, car(each).g2)[channel], TICK_S)) for each in SPEEDS[:2]]
    before = np.random.get_state()[1:3]
    generator = turn(at[0], at[1], channel, "zoh")
    after = np.random.get_state()[1:3]
    assert after[1] == before[1] and (after[0] == before[0]).all()
    first, second = (coordinates(*each, channel, "zoh") for each in at)
    reached = realisation(at[0][1])[4]
    turned = linalg.expm(generator[np.ix_(reached, reached)]) @ first
    np.testing.assert_allclose(turned, second, rtol=1e-9, atol=1e-9 * abs(second).max())


@pytest.mark.parametrize("rule", ["tustin", "tustin-held"])
def test_the_other_rules_have_schedules_too(rule):
    of = scheduled(SPEEDS[:2], replace(TARGET, estimator=rule))
    assert of.schedule.n == 2
    assert np.isfinite(of.schedule.model.turn_1).all() and of.schedule.model.turn_1[0].any()


def test_the_turn_is_small_where_speeds_are_near():
    near, far = (scheduled((12.0, 12.0 * ratio)).schedule.model.turn_1[0] for ratio in (1.01, 1.02))
    np.testing.assert_allclose(far, 2.0 * near, rtol=0.05, atol=1e-6 * np.abs(far).max())
