"""Times of a scenario in whole ticks: how many a run has, and in which a fault is there."""

from decimal import Decimal

from hypothesis import given
from hypothesis import strategies as st

from can_rig.scenario.settings import FaultSettings, Scenario


@given(st.integers(1, 10**6), st.integers(10_000, 10**9))
def test_ticks_are_the_whole_ones_that_fit(count, tick_ns):
    """In decimal, where 0.3 holds exactly three ticks of 0.1."""
    tick_s, exact_s = Decimal(tick_ns).scaleb(-9), Decimal(count * tick_ns).scaleb(-9)
    if exact_s > 10**6:
        return
    scenario = Scenario("x", tick_s=float(tick_s), duration_s=float(exact_s))
    assert (scenario.tick_ns, scenario.ticks) == (tick_ns, count)
    if count > 1:
        shorter = float(exact_s - tick_s / 2)
        assert Scenario("x", tick_s=float(tick_s), duration_s=shorter).ticks == count - 1


@given(st.integers(0, 30_000), st.integers(1, 5_000), st.sampled_from([10_000, 500_000, 10**6]))
def test_a_fault_lasts_its_whole_ticks_and_not_one_by_rounding(first, count, tick_ns):
    at_s, for_s = (float(Decimal(n * tick_ns).scaleb(-9)) for n in (first, count))
    fault = FaultSettings("frames-missing", "torque", at_s, for_s)
    around = [first - 1, first, first + count - 1, first + count]
    assert [fault.active(tick * tick_ns) for tick in around] == [False, True, True, False]
    assert FaultSettings("frames-missing", "torque", at_s).active(10**18)
    assert not FaultSettings("none", "torque", at_s).active(first * tick_ns)
