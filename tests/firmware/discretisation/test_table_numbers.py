"""Each number of the table from what it means, computed another way than the table is filled."""

import math

import numpy as np
import pytest

from firmware_model.design.continuous_design import DesignSpecification, design
from firmware_model.design.mismatch import Mismatch
from firmware_model.design.plants import chapter_2, steer_by_wire
from firmware_model.discretisation import tables
from firmware_model.discretisation.sections import make_up_gain
from firmware_model.discretisation.tables import build, discretise
from firmware_model.discretisation.targets import Target
from firmware_model.discretisation.tustin import by_rule
from firmware_model.discretisation.whitening import whitening
from firmware_model.errors import DesignError, ParameterError
from firmware_model.law.structs import MAX_SECTIONS
from tests.firmware.law.cases import other_cars

CLOSED = design(steer_by_wire(), DesignSpecification())
OPEN = design(chapter_2(), DesignSpecification(feedback=False))
OTHERS = other_cars()
TICKS_S = (5e-4, 1e-3, 5e-3)


@pytest.mark.parametrize("tick_s", TICKS_S)
def test_memories_keep_a_part_in_e_over_their_time_constants(tick_s):
    """θ of three cars over 3 s, of the remainder over 0.12 s; squares over half of 1 s."""
    table = build(CLOSED, Target(tick_s, mismatch=OTHERS))
    constants = table.mismatch
    assert (table.other_cars.n, constants.n) == (3, 6)
    memories = 1.0 - constants.forgetting
    assert memories[:2].tolist() == [1.0, 1.0]  # share and moment of a loss do not wander
    for memory, time_constant_s in (*((m, 3.0) for m in memories[2:5]), (memories[5], 0.12)):
        assert memory ** (time_constant_s / tick_s) == pytest.approx(math.exp(-1.0), rel=1e-10)
    assert constants.fading ** (0.5 / tick_s) == pytest.approx(math.exp(-1.0), rel=1e-10)
    assert constants.motion == pytest.approx((0.12 / tick_s) ** 2, rel=1e-12)
    table = build(CLOSED, Target(tick_s))
    assert table.bumpless_transfer.slowest_pace == pytest.approx(tick_s / 0.05, rel=1e-12)
    assert table.bumpless_transfer.haste == 2.0


def test_a_tick_of_a_minute_leaves_something_of_every_memory():
    """exp(-60 s/0.12 s) is nothing: but the factors of P are divided by it."""
    table = build(OPEN, Target(60.0, mismatch=OTHERS))
    assert (table.mismatch.forgetting <= 0.99).all()
    assert table.bumpless_transfer.slowest_pace == pytest.approx(1200.0)


def test_what_wanders_keeps_its_variance():
    """φ² P + growth = P for the P of a θ at rest: 0.36 of a box of ±1; of the remainder 1."""
    constants = build(CLOSED, Target(1e-3, mismatch=OTHERS)).mismatch
    left = (1.0 - constants.forgetting) ** 2
    n = constants.n
    np.testing.assert_allclose(
        constants.growth[2:n] / (1.0 - left)[2:n], [0.36] * 3 + [1.0], rtol=1e-9
    )
    assert constants.growth[:2].tolist() == [0.0, 0.0]
    assert constants.prior == 0.36
    assert constants.beyond == pytest.approx(0.01 * 0.36)
    assert constants.white == 0.1


@pytest.mark.parametrize("rule", ["zoh", "tustin", "tustin-held"])
def test_other_cars_are_those_of_the_box_by_the_rule_of_the_estimator(rule):
    target = Target(1e-3, estimator=rule, mismatch=OTHERS)
    table = build(CLOSED, target)
    assert table.other_cars.scale == pytest.approx(20.0)
    assert table.mismatch.rule == (0.0 if rule == "zoh" else 1.0)
    cars = list(table.other_cars.cars)
    assert len(OTHERS.cars) == 3
    assert table.mismatch.n == 2 + 3 + 1  # of a loss, the cars, the remainder
    for car, (g1, g2) in zip(cars[:3], OTHERS.cars, strict=True):
        for stored, channel in ((car.channel_1, g1), (car.channel_2, g2)):
            sections = by_rule(rule, channel, 1e-3)
            n = len(sections.coefficients)
            assert stored.n == n
            np.testing.assert_array_equal(stored.coefficients[:n], sections.coefficients)
    assert cars[3].channel_1.n == cars[3].channel_2.n == 0


def test_there_is_room_for_four_other_cars():
    car = OTHERS.cars[0]
    assert build(CLOSED, Target(1e-3, mismatch=Mismatch((car,) * 4))).mismatch.n == 7
    with pytest.raises(ParameterError, match="mismatch: 5 other cars; must be at most 4"):
        build(CLOSED, Target(1e-3, mismatch=Mismatch((car,) * 5)))


@pytest.mark.parametrize(("rule", "states"), [("zoh", 2), ("tustin", 3), ("tustin-held", 3)])
def test_a_trusted_model_has_what_a_loss_and_its_rule_leave(rule, states):
    table = build(CLOSED, Target(1e-3, estimator=rule))
    assert (table.other_cars.n, table.mismatch.n) == (0, states)


@pytest.mark.parametrize(("tick_s", "lag_s"), [(1e-4, 0.01), (1e-3, 0.01), (5e-3, 0.015)])
def test_the_share_of_a_loss_is_followed_by_lags_of_some_ticks(tick_s, lag_s):
    """Of 10 ms, at least three ticks; the doubt about it is a box of ±0.5, and some more."""
    constants = build(CLOSED, Target(tick_s)).loss_model
    assert constants.follow == pytest.approx(tick_s / lag_s)
    assert (constants.share_variance, constants.doubt) == (0.09, 9.0)
    assert constants.moment == 0.5


@pytest.mark.parametrize("disturbance", [0.0, 0.4])
def test_the_decision_gets_the_whitener_and_what_it_leaves(disturbance):
    """The white noise, the energy of a constant within a second, and the remainder's size."""
    target = Target(1e-3, noise_rms=0.02, noise_pole=0.7, disturbance=disturbance)
    table = build(CLOSED, target)
    expected = whitening(discretise(CLOSED, target).estimator_1, target)
    whitener, count = table.mismatch.whitener, len(expected.sections.coefficients)
    assert whitener.n == count > 0
    np.testing.assert_array_equal(whitener.coefficients[:count], expected.sections.coefficients)
    assert table.mismatch.noise == expected.variance
    assert table.decision.shown == expected.energy(1000)
    slow = abs(expected.sections(np.array([np.exp(1j * 1e-3 / 0.12)]))[0])
    assert table.mismatch.remainder_shown == pytest.approx(slow)


@pytest.mark.parametrize(("precision", "rms"), [("float64", 1e-9), ("float32", 1e-6)])
def test_a_perfect_sensor_has_what_rounding_leaves(precision, rms):
    least = build(CLOSED, Target(1e-3, precision=precision)).mismatch.noise
    assert least == pytest.approx(rms**2, rel=1e-6, abs=0.0)
    coarse = build(CLOSED, Target(1e-3, precision=precision, resolution=1e3)).mismatch.noise
    assert coarse == pytest.approx(1e6 / 12.0)


@pytest.mark.parametrize("tick_s", TICKS_S)
@pytest.mark.parametrize(
    ("plan", "acceleration", "enabled"),
    [(CLOSED, 250.0, 1), (CLOSED, math.inf, 0), (OPEN, 250.0, 0), (OPEN, math.inf, 0)],
    ids=["closed", "closed, no limit", "open", "open, no limit"],
)
def test_the_reference_shaper_belongs_to_a_loop_and_a_limit(plan, acceleration, enabled, tick_s):
    """Its acceleration is a second difference: that of a t²/2 is a T²."""
    shaper = build(plan, Target(tick_s, reference_acceleration=acceleration)).reference_shaper
    assert shaper.enabled == enabled
    if enabled:
        parabola = acceleration * (np.arange(3) * tick_s) ** 2 / 2
        assert shaper.acceleration == pytest.approx(np.diff(parabola, 2)[0], rel=1e-9)


def test_in_open_loop_the_reference_is_the_command():
    table = build(OPEN, Target(1e-3))
    assert (table.tracking.feedback, table.tracking.loop_inverse) == (0.0, 1.0)
    assert table.tracking.filter.n == 1
    assert table.tracking.filter.coefficients[0].tolist() == [1.0, 0.0, 0.0, 0.0, 0.0]
    assert table.compensator.reference_share == 1.0


def test_without_compensation_nothing_is_added():
    table = build(design(steer_by_wire(), DesignSpecification(compensation=False)), Target(1e-3))
    assert not table.compensator.filter.coefficients.any()
    assert (table.compensator.feedthrough, table.compensator.loop_inverse) == (0.0, 1.0)
    assert table.compensator.reference_share == 0.0


def test_limits_of_a_second_become_those_of_a_tick():
    target = Target(2e-3, rate_1=50.0, rate_2=7.0, limit_1=3.0, limit_2=4.0, lsb_1=0.5, lsb_2=0.25)
    table = build(CLOSED, target)
    for actuator, slew, limit, lsb in (
        (table.actuator_1, 0.1, 3.0, 0.5),
        (table.actuator_2, 0.014, 4.0, 0.25),
    ):
        assert (actuator.slew, actuator.limit, actuator.lsb) == (pytest.approx(slew), limit, lsb)


@pytest.mark.parametrize("tick_s", TICKS_S)
def test_evidence_asked_for_is_the_logarithm_of_the_ticks_between_two_alarms(tick_s):
    """Wald: e^-h of the candidates, one a tick, get beyond h by chance."""
    target = Target(tick_s, false_alarms_per_hour=0.02, suspicions_per_hour=30.0)
    decision = build(CLOSED, target).decision
    for h, an_hour in ((decision.confirm, 0.02), (decision.suspect, 30.0)):
        assert math.exp(-h) * 3600.0 / tick_s == pytest.approx(an_hour, rel=1e-9)
    assert decision.recover == pytest.approx(2.0 * decision.confirm)
    assert decision.certain == pytest.approx(5.0 * decision.confirm)
    assert decision.horizon == pytest.approx(1.0 / tick_s)


def test_no_evidence_is_none_and_a_suspicion_comes_first():
    lax = Target(1e-3, false_alarms_per_hour=1e9, suspicions_per_hour=1e12)
    assert (build(CLOSED, lax).decision.confirm, build(CLOSED, lax).decision.suspect) == (1.0, 1.0)
    strict = Target(1e-3, false_alarms_per_hour=10.0, suspicions_per_hour=1e-3)
    decision = build(CLOSED, strict).decision
    assert decision.suspect == decision.confirm


def test_what_is_asked_for_the_decision():
    table = build(CLOSED, Target(2e-3, on_confirmation=True))
    assert table.compensator.on_confirmation == 1
    assert (table.sequential_test.share, table.sequential_test.restart) == (0.8, -1.0)
    assert build(CLOSED, Target(1e-3)).compensator.on_confirmation == 0


def test_the_largest_filter_of_the_layout_is_built_and_one_more_is_not():
    alpha = 2 * MAX_SECTIONS - 3  # F̂ has three poles beside those of q
    largest = design(steer_by_wire(), DesignSpecification(alpha=alpha))
    assert build(largest, Target(1e-3)).compensator.filter.n == MAX_SECTIONS
    with pytest.raises(ParameterError, match=rf"^compensator: order {2 * MAX_SECTIONS + 2} "):
        build(design(steer_by_wire(), DesignSpecification(alpha=alpha + 1)), Target(1e-3))


@pytest.mark.parametrize("gain", [1.0, 1.5, math.nan])
def test_an_algebraic_loop_of_one_or_more_is_refused(gain, monkeypatch):
    monkeypatch.setattr(tables, "algebraic_loop_gain", lambda filters, latency: gain)
    with pytest.raises(DesignError, match="algebraic loop"):
        build(CLOSED, Target(1e-3))


def test_each_channel_makes_up_by_its_own_model():
    table, filters = build(CLOSED, Target(1e-3)), discretise(CLOSED, Target(1e-3))
    for channel, model in ((1, filters.estimator_1), (2, filters.estimator_2)):
        gain, n = table[f"shortfall_{channel}"].gain, len(model.coefficients)
        np.testing.assert_array_equal(gain[:n], make_up_gain(model))
        assert gain[:n].any()
        assert not gain[n:].any()
