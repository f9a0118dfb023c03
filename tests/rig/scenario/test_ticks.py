"""Times of a scenario in whole ticks: how many a run has, and in which a fault is there."""

from decimal import Decimal

from hypothesis import given, strategies as st

from can_rig.scenario.fault_settings import FaultSettings
from can_rig.scenario.settings import Scenario


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
    run = range(100_000)
    assert fault.ticks(tick_ns, run) == range(first, first + count)
    assert FaultSettings("frames-missing", "torque", at_s).ticks(tick_ns, run) == run[first:]
    assert not FaultSettings("none", "torque", at_s).ticks(tick_ns, run)


@given(
    st.integers(0, 50),
    st.integers(1, 60),
    st.integers(1, 9),
    st.integers(0, 80),
    st.integers(0, 80),
)
def test_part_of_a_run_has_the_same_ticks_of_a_fault_as_the_whole(first, count, every, begin, many):
    """By definition: every n-th tick from the first on."""
    fault = FaultSettings("frames-missing", "torque", first / 1000, count / 1000, every)
    part = range(begin, begin + many)
    wanted = [k for k in part if first <= k < first + count and (k - first) % every == 0]
    assert list(fault.ticks(10**6, part)) == wanted
