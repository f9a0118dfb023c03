"""Numbers of the table that decide and limit a command."""

from __future__ import annotations

import math

import pytest

from firmware_model.design.continuous_design import DesignSpecification, design
from firmware_model.design.mismatch import TRUSTED, Mismatch
from firmware_model.design.plants import steer_by_wire
from firmware_model.discretisation.tables import build
from firmware_model.discretisation.targets import Target
from tests.firmware.law.cases import other_cars

CLOSED = design(steer_by_wire(), DesignSpecification())
OTHERS = other_cars()


@pytest.mark.parametrize("cars", [TRUSTED, OTHERS])
def test_the_test_looks_as_long_as_it_learns_and_doubts_where_cars_differ(cars: Mismatch) -> None:
    table = build(CLOSED, Target(1e-3, mismatch=cars))
    test = table.sequential_test
    assert test.freshness == 0.1
    assert (test.needed, test.promising) == (table.decision.confirm, table.decision.suspect)
    others = cars is OTHERS
    assert table.loss_model.least_doubt == (0.04 if others else 0.0)
    # By how many deviations more than all must be lost: on a trusted car it cannot be.
    assert test.deviations == 3.0 if others else test.deviations >= 1e9


@pytest.mark.parametrize(("limit", "lsb", "possible"), [(10.3, 0.5, 10.0), (10.0, 0.1, 10.0)])
def test_a_limit_is_what_the_frame_carries_within_it(
    limit: float, lsb: float, possible: float
) -> None:
    actuators = build(CLOSED, Target(1e-3, limit_2=limit, lsb_2=lsb))
    assert actuators.actuator_2.limit == pytest.approx(possible, rel=1e-15)
    assert actuators.actuator_1.limit == math.inf
