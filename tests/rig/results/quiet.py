"""A run in which nothing moves."""

import numpy as np

from can_rig.results.signals import Signals
from can_rig.scenario.settings import Scenario

COLUMNS = [
    name
    for name in Signals.__dataclass_fields__
    if name not in ("plant", "sensors", "whose_fault", "sample_ages", "left_out")
]
"""The fields with a number for each tick."""


def quiet(scenario: Scenario, **changed: np.ndarray) -> Signals:
    """A run in which nothing moves, but for the columns given."""
    zero = np.zeros(scenario.ticks)
    columns = {name: zero.copy() for name in COLUMNS if name != "time_s"} | changed
    return Signals(np.arange(scenario.ticks) * scenario.tick_s, **columns)
