"""What the dead times of actuators and sensor make of the table."""

from __future__ import annotations

import numpy as np
import pytest

from firmware_model.design.actuator_dynamics import Stage, behind
from firmware_model.design.continuous_design import ContinuousDesign, DesignSpecification, design
from firmware_model.design.plants import steer_by_wire
from firmware_model.discretisation.tables import build, discretise
from firmware_model.discretisation.targets import Target
from firmware_model.errors import ParameterError
from firmware_model.law.structs import MAX_LATENCY_TICKS

TICK_S = 1e-3
FAR = np.array([1e9 + 0j])  # z → ∞


def late(first_s: float = 0.0, second_s: float = 0.0, sensor_s: float = 0.0) -> ContinuousDesign:
    stages = (Stage(dead_time_s=dead_s) for dead_s in (first_s, second_s, sensor_s))
    return design(behind(steer_by_wire(), *stages), DesignSpecification())


@pytest.mark.parametrize("latency", [0, 2])
def test_the_way_of_a_command_is_bus_actuator_and_sensor(latency: int) -> None:
    """In whole ticks: 3.4 + 1 ms are 4, 4.7 + 1 ms are 6."""
    estimator = build(late(0.0034, 0.0047, 0.001), Target(TICK_S, latency)).estimator
    assert (estimator.dead_ticks_1, estimator.dead_ticks_2) == (4, 6)
    assert (estimator.shown_ticks_1, estimator.shown_ticks_2) == (4 + latency, 6 + latency)
    assert build(late(second_s=0.002), Target(TICK_S, latency)).estimator.feedthrough_2 == 0.0


@pytest.mark.parametrize(
    ("first_s", "second_s", "within_1", "within_2"),
    [(0.0, 0.0, True, True), (0.002, 0.0, False, True), (0.0, 0.002, True, False)],
)
def test_a_command_in_its_dead_time_does_not_act_within_the_tick(
    first_s: float, second_s: float, within_1: bool, within_2: bool
) -> None:
    """Then neither Q G1 of u1 nor F̂ (1 + Q) G2 of u2 is a loop without delay."""
    plan = late(first_s, second_s)
    table, filters = build(plan, Target(TICK_S)), discretise(plan, Target(TICK_S))
    loop_1 = (filters.tracking(FAR) * filters.estimator_1(FAR))[0].real
    loop_2 = (filters.compensator(FAR) * filters.one_plus_q(FAR) * filters.estimator_2(FAR))[0].real
    assert min(loop_1, loop_2) > 1e-3
    assert table.tracking.loop_inverse == pytest.approx(1.0 / (1.0 - loop_1 * within_1), rel=1e-6)
    assert table.compensator.loop_inverse == pytest.approx(
        1.0 / (1.0 - loop_2 * within_2), rel=1e-6
    )
    through = filters.estimator_2(FAR)[0].real
    assert table.estimator.feedthrough_2 == pytest.approx(through * within_2, rel=1e-6)


@pytest.mark.parametrize("channel", [1, 2])
def test_a_dead_time_is_as_long_as_the_ring_at_most(channel: int) -> None:
    def dead(ticks: int) -> ContinuousDesign:
        return late(*(TICK_S * ticks if each == channel else 0.0 for each in (1, 2)))

    estimator = build(dead(MAX_LATENCY_TICKS), Target(TICK_S)).estimator
    assert estimator[f"dead_ticks_{channel}"] == MAX_LATENCY_TICKS
    with pytest.raises(ParameterError) as caught:
        build(dead(MAX_LATENCY_TICKS + 1), Target(TICK_S))
    assert str(caught.value) == (
        f"dead time of channel {channel}: 65 ticks; must be at most 64, 0.064 s"
    )
