"""A small search for tests: a scenario, a few candidates, a box of cars."""

import os
from functools import cache
from itertools import product

import pytest

from can_rig.assessment.tuning.candidate import cars, parameter_ranges
from can_rig.assessment.tuning.search import Tunings, tune
from can_rig.scenario.loading import load
from can_rig.scenario.settings import Scenario

SMALL = list(product((0.0002, 0.001), (1, 2), (0.001, 0.0033, 0.01), (2, 3)))
SETTINGS = [
    "latency_ticks=1", "design.estimator=zoh", "design.compensation=on-confirmation",
    "limits.torque_nm=400.0", "limits.force_difference_n=6000.0", "budget.box=0.2",
]  # fmt: skip
ALWAYS = "design.compensation=always"
compiled_only = pytest.mark.skipif(
    os.environ.get("NUMBA_DISABLE_JIT") == "1", reason="half a million ticks"
)


def scenario_of(*settings: str) -> Scenario:
    return load("thesis-step", [*SETTINGS, *settings])


@cache
def found_for(  # type: ignore[no-untyped-def]
    *settings: str, share: float = 0.2, spare: int = 1, limit=None, torque_limit=None
) -> Tunings:
    scenario = scenario_of(*settings)
    some = cars(scenario.model, parameter_ranges(scenario.model, share))
    return tune(scenario, some, spare, limit, torque_limit, SMALL)
