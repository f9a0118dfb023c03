"""A plant of one's own behind its actuators and its sensor: its steps, and what it is told."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from can_rig.assessment.resolve import load
from can_rig.logs.columns import TRUE_OUTPUT
from can_rig.plant.behind import plant_behind

LINEAR = "plant.kind=tests.rig.plant.linear:LinearPlant"
COUNTING = "plant.kind=tests.rig.plant.test_class_behind:Counting"
LAGS = [
    "plant.torque_actuator.lag_s=0.005",
    "plant.force_difference_actuator.lag_s=0.005",
    "plant.sensor.corner_hz=31.830988618379067",  # of 5 ms, so that all three are alike
]


class Counting:
    """Notes its steps, and answers with their number."""

    def __init__(self, settings: Any) -> None:
        self.reset()

    def reset(self) -> None:
        self.steps: list[tuple[float, float, float]] = []

    def advance(self, dt_s: float, torque_nm: float, force_difference_n: float) -> float:
        self.steps.append((dt_s, torque_nm, force_difference_n))
        return float(len(self.steps))

    def signals(self) -> dict[str, float]:
        longest_s = max((dt_s for dt_s, *_ in self.steps), default=0.0)
        return {"steps": float(len(self.steps)), "longest_s": longest_s}


def behind(*settings: str, tick_s: float = 1e-3) -> Any:
    return plant_behind(load("thesis-step", ["fault.kind=none", *settings]).plant, tick_s)


@pytest.mark.parametrize(
    ("settings", "tick_s", "steps"),
    [
        ([], 1e-3, 1),
        ([], 5e-3, 1),
        *(([one], 1e-3, 2) for one in LAGS),
        (LAGS[:2], 1e-3, 2),
        (LAGS, 1e-3, 2),
        (LAGS, 5e-4, 1),
        (LAGS, 1.1e-3, 3),
        (LAGS, 6e-3, 12),
    ],
)
def test_a_tick_is_one_step_or_as_many_as_are_short(
    settings: list[str], tick_s: float, steps: int
) -> None:
    """At most half a millisecond, where anything lags."""
    plant = behind(COUNTING, *settings, tick_s=tick_s)
    before = plant.report(0.0, 0.0, 1.0, 1.0)
    assert (before["steps"], before[TRUE_OUTPUT]) == (0.0, 0.0)  # it is at rest
    output, _ = plant.follow(1.0, 1.0, 1.0, 1.0)
    after = plant.report(1.0, 1.0, 1.0, 1.0)
    assert (after["steps"], after[TRUE_OUTPUT], output) == (steps, steps, steps)
    assert after["longest_s"] == pytest.approx(tick_s / steps)


def test_immediate_actuators_and_sensor_leave_a_class_as_it_is() -> None:
    """The linear plant as a class, bit for bit; what is lost does not reach it."""
    of_class, linear = behind(LINEAR), behind()
    draw = np.random.default_rng(2).normal(0.0, [40.0, 1500.0], (40, 2))
    for pair in draw.tolist():
        reports = [plant.report(*pair, 0.25, 0.5) for plant in (of_class, linear)]
        for name in ("applied_torque_nm", "applied_force_difference_n", TRUE_OUTPUT):
            assert reports[0][name] == reports[1][name]
        assert of_class.follow(*pair, 0.25, 0.5) == linear.follow(*pair, 0.25, 0.5)


def test_the_sensor_is_late_and_the_car_is_not() -> None:
    plant = behind(COUNTING, "plant.sensor.dead_time_s=0.0015")
    assert [plant.follow(0.0, 0.0, 1.0, 1.0) for _ in range(3)] == [(2, 0), (4, 1), (6, 3)]
