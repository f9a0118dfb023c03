"""From a design to the table, and everything a target refuses."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st

from firmware_model.design.actuator_dynamics import IDEAL, Stage, actuated
from firmware_model.design.continuous_design import ContinuousDesign, DesignSpecification, design
from firmware_model.design.mismatch import TRUSTED
from firmware_model.design.plants import steer_by_wire
from firmware_model.discretisation.sections import Sections
from firmware_model.discretisation.tables import algebraic_loop_gain, build, discretise
from firmware_model.discretisation.targets import Reporting, Target
from firmware_model.errors import DesignError, ParameterError
from firmware_model.law.structs import MAX_LATENCY_TICKS
from tests.firmware.discretisation.test_coprime import PENDULUM
from tests.firmware.law.cases import other_cars

DESIGN = design(steer_by_wire(), DesignSpecification())
UNSTABLE = design(PENDULUM, DesignSpecification(alpha=2, tau_q_s=0.05, alpha_q=3))


@pytest.mark.compiled
@given(tau_s=st.floats(1e-4, 1.0), tick_s=st.floats(1e-4, 1e-2))
def test_algebraic_loop_gain_is_that_of_the_text(tau_s, tick_s):
    """F̂ and Tustin's G2 together are q, so the gain is T/(2τ+T); 1/3 at T = τ."""
    filters = discretise(design(steer_by_wire(), DesignSpecification(tau_s=tau_s)), Target(tick_s))
    assert algebraic_loop_gain(filters, 0) == pytest.approx(tick_s / (2 * tau_s + tick_s), rel=1e-9)


@pytest.mark.parametrize(("latency", "rule"), [(1, "tustin"), (0, "zoh"), (0, "tustin-held")])
def test_no_loop_within_the_tick_when_the_command_acts_later(latency, rule):
    target = Target(1e-3, latency, rule)
    assert algebraic_loop_gain(discretise(DESIGN, target), latency) == 0.0
    assert build(DESIGN, target).compensator.loop_inverse == 1.0


def test_more_ticks_than_the_law_counts_are_refused():
    """An echo counts for 0.1 s, 1,677,722 ticks of 60 ns."""
    target = Target(2.0**-24, 1, "zoh", echoes=(Reporting(IDEAL), Reporting(IDEAL)))
    with pytest.raises(DesignError, match=r"echoes\.longest is 1677722: must be from 0 to 1000000"):
        build(UNSTABLE, target)


@pytest.mark.parametrize("precision", ["float64", "float32"])
@pytest.mark.parametrize("designed", [DESIGN, UNSTABLE], ids=["stable", "unstable"])
def test_the_table_is_the_filters(designed, precision):
    target = Target(1e-3, 2, "zoh", precision=precision, limit_1=10.0, lsb_2=0.5)
    table, filters = build(designed, target), discretise(designed, target)
    estimator = table.estimator
    assert table.tracking.excuses_limits == (designed is DESIGN)
    assert (filters.stabiliser is None) == (designed is DESIGN)
    none = Sections(np.zeros((0, 5)), target.tick_s)
    for cascade, sections in (
        (table.tracking.filter, filters.tracking),
        (table.tracking.stabiliser, filters.stabiliser or none),
        (estimator.measurement, filters.measurement),
        (estimator.channel_1, filters.estimator_1),
        (estimator.channel_2, filters.estimator_2),
        (estimator.one_plus_q, filters.one_plus_q),
        (table.compensator.filter, filters.compensator),
    ):
        n, stored = len(sections.coefficients), cascade.coefficients
        assert cascade.n == n
        assert stored.dtype == np.dtype(precision)
        np.testing.assert_array_equal(stored[:n], sections.coefficients.astype(precision))
        np.testing.assert_array_equal(stored[n:], 0.0)
    assert (table.actuator_1.limit, table.actuator_2.lsb) == (10.0, 0.5)
    assert math.isinf(table.actuator_2.limit)
    assert estimator.latency_ticks == 2


def test_the_table_is_constant():
    with pytest.raises(ValueError, match="read-only"):
        build(DESIGN, Target(1e-3)).actuator_1.limit = 1.0


OTHERS = other_cars()


@pytest.mark.parametrize("cars", [TRUSTED, OTHERS])
def test_the_test_looks_as_long_as_it_learns_and_doubts_where_cars_differ(cars):
    table = build(DESIGN, Target(1e-3, mismatch=cars))
    test = table.sequential_test
    assert test.freshness == 0.1
    assert (test.needed, test.promising) == (table.decision.confirm, table.decision.suspect)
    others = cars is OTHERS
    assert table.loss_model.least_doubt == (0.04 if others else 0.0)
    # By how many deviations more than all must be lost: on a trusted car it cannot be.
    assert test.deviations == 3.0 if others else test.deviations >= 1e9


@pytest.mark.parametrize(("limit", "lsb", "possible"), [(10.3, 0.5, 10.0), (10.0, 0.1, 10.0)])
def test_a_limit_is_what_the_frame_carries_within_it(limit, lsb, possible):
    actuators = build(DESIGN, Target(1e-3, limit_2=limit, lsb_2=lsb))
    assert actuators.actuator_2.limit == pytest.approx(possible, rel=1e-15)
    assert actuators.actuator_1.limit == math.inf


TICK_S = 1e-3


def at_infinity(sections: Sections) -> float:
    """At z → ∞."""
    return float(sections(np.array([1e9 + 0j]))[0].real)


def late(first_s: float = 0.0, second_s: float = 0.0, sensor_s: float = 0.0) -> ContinuousDesign:
    stages = (Stage(dead_time_s=dead_s) for dead_s in (first_s, second_s, sensor_s))
    return design(actuated(steer_by_wire(), *stages), DesignSpecification())


@pytest.mark.parametrize("latency", [0, 2])
def test_the_way_of_a_command_is_bus_actuator_and_sensor(latency):
    """In whole ticks: 3.4 + 1 ms are 4, 4.7 + 1 ms are 6."""
    estimator = build(late(0.0034, 0.0047, 0.001), Target(TICK_S, latency)).estimator
    assert (estimator.shown_ticks_1, estimator.shown_ticks_2) == (4 + latency, 6 + latency)
    assert build(late(second_s=0.002), Target(TICK_S, latency)).estimator.feedthrough_2 == 0.0


@pytest.mark.parametrize("tick_s", [5e-4, 1e-3, 5e-3])
@pytest.mark.parametrize(
    ("latency", "first", "second", "within_1", "within_2"),
    [(0, 0, 0, True, True), (1, 0, 0, False, False), (2, 0, 0, False, False),
     (0, 2, 0, False, True), (0, 0, 2, True, False)],
)  # fmt: skip
def test_what_acts_within_the_tick(tick_s, latency, first, second, within_1, within_2):
    """G2 sees this tick's command only if it acts at once; 1 + Q always sees this tick's sample.

    In its dead time neither Q G1 of u1 nor F̂ (1 + Q) G2 of u2 is a loop without delay.
    """
    plan, target = late(first * tick_s, second * tick_s), Target(tick_s, latency)
    table, filters = build(plan, target), discretise(plan, target)
    loop_1 = at_infinity(filters.tracking) * at_infinity(filters.estimator_1)
    compensator, one_plus_q = at_infinity(filters.compensator), at_infinity(filters.one_plus_q)
    through = at_infinity(filters.estimator_2)
    loop_2 = compensator * one_plus_q * through
    assert min(loop_1, loop_2) > 1e-4
    for stored, expected in (
        (table.tracking.loop_inverse, 1.0 / (1.0 - loop_1 * within_1)),
        (table.compensator.loop_inverse, 1.0 / (1.0 - loop_2 * within_2)),
        (table.compensator.feedthrough, compensator),
        (table.estimator.one_plus_q_feedthrough, one_plus_q),
        (table.estimator.feedthrough_2, through * within_2),
    ):
        assert stored == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("channel", [1, 2])
def test_a_dead_time_is_as_long_as_the_ring_at_most(channel):
    def dead(ticks: int) -> ContinuousDesign:
        return late(*(TICK_S * ticks if each == channel else 0.0 for each in (1, 2)))

    estimator = build(dead(MAX_LATENCY_TICKS), Target(TICK_S)).estimator
    assert estimator[f"shown_ticks_{channel}"] == MAX_LATENCY_TICKS
    with pytest.raises(ParameterError) as caught:
        build(dead(MAX_LATENCY_TICKS + 1), Target(TICK_S))
    assert str(caught.value) == (
        f"dead time of channel {channel}: 65 ticks; must be at most 64, 0.064 s"
    )


TINY = 5e-324
POSITIVE = ("limit_1", "limit_2", "rate_1", "rate_2", "reference_acceleration")
RATES = ("false_alarms_per_hour", "suspicions_per_hour")
SIZES = ("lsb_1", "lsb_2", "noise_rms", "resolution", "safe_stop_s")

ACCEPTED: list[dict[str, Any]] = [
    {"latency_ticks": 0},
    {"latency_ticks": MAX_LATENCY_TICKS},
    *({name: value} for name in POSITIVE for value in (TINY, 0.5, math.inf)),
    *({name: value} for name in RATES for value in (TINY, 0.5, 1e300)),
    *({name: value} for name in SIZES for value in (0.0, TINY, 1e300)),
    {"noise_pole": 0.0},
    {"noise_pole": math.nextafter(1.0, 0.0)},
    *({"estimator": rule} for rule in ("tustin", "tustin-held", "zoh")),
]
REFUSED: list[tuple[dict[str, Any], str]] = [
    ({"latency_ticks": -1}, f"latency_ticks = -1: must be 0 to {MAX_LATENCY_TICKS}"),
    ({"latency_ticks": MAX_LATENCY_TICKS + 1}, f"must be 0 to {MAX_LATENCY_TICKS}"),
    *(({name: value}, f"{name} = {value:g}: must be above 0")
      for name in POSITIVE for value in (0.0, -TINY, -math.inf, math.nan)),
    *(({name: value}, f"{name} = {value:g}: must be finite and above 0")
      for name in RATES for value in (0.0, -TINY, math.inf, math.nan)),
    *(({name: value}, f"{name} = {value:g}: must be finite and 0 or above")
      for name in SIZES for value in (-TINY, math.inf, math.nan)),
    *(({"noise_pole": value}, "must be 0 or above, below 1") for value in (-TINY, 1.0, math.nan)),
    ({"estimator": "euler"}, "estimator = 'euler': must be one of tustin, tustin-held, zoh"),
]  # fmt: skip


@pytest.mark.parametrize("change", ACCEPTED, ids=str)
def test_the_last_value_that_means_something_is_accepted(change):
    target = Target(1e-3, **change)
    assert {name: getattr(target, name) for name in change} == change


@pytest.mark.parametrize(("change", "reason"), REFUSED, ids=str)
def test_the_first_that_does_not_is_refused(change, reason):
    with pytest.raises(ParameterError) as caught:
        Target(1e-3, **change)
    assert reason in str(caught.value)
    assert "\n" not in str(caught.value)


def test_by_default_it_is_the_thesis_s():
    """No latency, no limits, no grid: d̂ is compensated as it is, always."""
    target = Target(1e-3)
    assert (target.latency_ticks, target.estimator) == (0, "tustin")
    for name in POSITIVE:
        assert getattr(target, name) == math.inf
    for name in ("lsb_1", "lsb_2", "safe_stop_s"):
        assert getattr(target, name) == 0.0
    assert target.on_confirmation is False
    assert target.prewarp_rad_per_s is None
    assert target.precision == "float64"
    # What is decided meanwhile: by a perfect sensor on a car that is the model.
    assert (target.noise_rms, target.noise_pole, target.resolution) == (0.0, 0.0, 0.0)
    assert target.mismatch.cars == ()
    assert (target.false_alarms_per_hour, target.suspicions_per_hour) == (1e-3, 3600.0)
