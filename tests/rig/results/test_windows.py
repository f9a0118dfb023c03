"""The windows of a run, by hand."""

from __future__ import annotations

import numpy as np
import pytest

from can_rig.assessment.resolve import load
from can_rig.results.metrics import windows
from can_rig.scenario.settings import Scenario
from tests.rig.results.quiet import quiet


def spans(scenario: Scenario) -> dict[str, tuple[float, float] | None]:
    """First and last time of every window, s."""
    signals = quiet(scenario)
    found = {}
    for name, mask in vars(windows(scenario, signals)).items():
        inside = signals.time_s[mask]
        found[name] = (round(inside[0], 6), round(inside[-1], 6)) if len(inside) else None
    return found


def test_windows_of_a_lasting_fault() -> None:
    assert spans(load("thesis-step", ["tick_s=0.01"])) == {
        "before": (0.0, 9.99),
        "after": (10.0, 19.99),
        "active": (10.0, 19.99),
        "lost": (10.0, 19.99),
        "settled_before": (7.99, 9.99),
        "settled_after": (17.99, 19.99),
    }


def test_windows_of_a_passing_fault_settle_after_it_has_passed() -> None:
    found = spans(load("thesis-step", ["tick_s=0.01", "fault.for_s=9"]))
    assert found["lost"] == (10.0, 18.99)
    assert found["after"] == (10.0, 19.99)
    # Half of the second that is left: its first half is the transient of the return.
    assert found["settled_after"] == (19.5, 19.99)
    # The tick of its end is the first without it: 10 ms, 5 ms, half of either, and zero.
    settings = ["tick_s=0.005", "duration_s=20", "fault.for_s=9.985"]
    assert spans(load("thesis-step", settings))["settled_after"] == (19.99, 19.995)


def test_two_periods_of_a_slow_reference_count_as_settled() -> None:
    settings = ["tick_s=0.01", "reference.frequency_rad_per_s=3.141592653589793"]
    assert spans(load("thesis-sine", settings))["settled_after"] == (15.99, 19.99)


@pytest.mark.parametrize("settings", [["fault.kind=none"], ["duration_s=2.0"]])
def test_windows_without_a_fault(settings: list[str]) -> None:
    found = spans(load("thesis-step", ["tick_s=0.01", *settings]))
    assert found["after"] is found["lost"] is found["settled_after"] is None
    assert found["before"] is not None


def test_the_fault_is_lost_at_the_ticks_at_which_the_nodes_lose_it() -> None:
    """Binary fractions of a second must not shift it by a tick."""
    for at in range(1, 1500, 7):
        scenario = load("thesis-step", ["duration_s=2.0", f"fault.at_s={at / 1000}"])
        lost = windows(scenario, quiet(scenario)).lost
        assert np.flatnonzero(lost).tolist() == list(range(at, scenario.ticks))
