"""A run in which nothing moves."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from can_rig.results.signals import Signals
from can_rig.scenario.settings import Scenario

Run = Callable[..., tuple[Scenario, Signals]]


def quiet(scenario: Scenario, **changed: np.ndarray) -> Signals:
    """A run in which nothing moves, but for the columns given."""
    zero = np.zeros(scenario.ticks)
    names = [
        name
        for name in Signals.__dataclass_fields__
        if name not in ("time_s", "plant", "sensors", "whose_fault")
    ]
    columns = {name: zero.copy() for name in names} | changed
    return Signals(np.arange(scenario.ticks) * scenario.tick_s, **columns)
