"""A loop that is stable and hardly: what is found of it, and how thin a margin may be."""

from __future__ import annotations

import json

from can_rig.assessment.resolve import load
from can_rig.assessment.stability import check_stability
from tests.helpers import asked


def test_a_loop_that_is_stable_with_nothing_to_spare_is_not_called_stable() -> None:
    """Of 1.5 ms ticks and two of latency, τ = 7 ms leaves 0.4 % of the distance to -1."""
    thin = ["tick_s=0.0015", "latency_ticks=2", "design.tau_s=0.007", "design.tau_q_s=0.0015"]
    done = asked(
        "check", "thesis-step", *(word for key in thin for word in ("--set", key)), "--json"
    )
    assert done.returncode == 1
    values = json.loads(done.stdout)
    assert max(values[end]["peak_sensitivity"] for end in ("healthy", "faulted")) > 100.0
    assert max(values[end]["spectral_radius"] for end in ("healthy", "faulted")) < 1.0
    assert not values["stable"]
    (found,) = values["thin_margins"]
    assert "must be at most 5 (budget.peak_sensitivity)" in found


def test_how_thin_a_margin_may_be_is_a_key() -> None:
    own = ("budget.peak_sensitivity=2", "budget.spare_ticks=6")
    result = check_stability(load("ideal", own))
    assert result.thin_margins == [
        f"{name}: the spare ticks of delay are {spare} and must be at least 6 (budget.spare_ticks)"
        for name, spare in (("healthy", 5), ("torque dead", 4))
    ]
    assert result.verdict == "thin margin: " + "; ".join(result.thin_margins)
    assert not result.stable
    assert check_stability(load("ideal", ["budget.spare_ticks=4"])).stable
