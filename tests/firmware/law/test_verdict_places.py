"""Where a fault is, and where its evidence and its size come from."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from firmware_model.discretisation.tables import build
from firmware_model.discretisation.targets import Target
from firmware_model.law import controller
from firmware_model.law.fault_decision.hypotheses.verdict import (
    clear_hypotheses,
    find,
    found_elsewhere,
    place_of,
    size_of,
    weigh_hypotheses,
)
from firmware_model.law.status import Verdict
from tests.firmware.law.cases import DESIGN, TICK_S, changed, other_cars

pytestmark = pytest.mark.every_case  # a case each of few lines

TABLES = changed(build(DESIGN, Target(TICK_S, 1, "zoh", noise_rms=0.01, mismatch=other_cars(2))))
PLACES = {
    "TORQUE_LOST": "TORQUE_LOST",
    "TORQUE_OFFSET": "TORQUE_LOST",
    "FORCE_LOST": "FORCE_LOST",
    "SENSOR_WRONG": "SENSOR_WRONG",
    "SENSOR_DRIFTING": "SENSOR_WRONG",
    "SENSOR_FROZEN": "SENSOR_WRONG",
}


@pytest.mark.parametrize("fault", PLACES)
def test_a_fault_is_where_the_part_is_that_has_it(fault: str) -> None:
    place = Verdict[PLACES[fault]]
    assert place_of(int(Verdict[fault])) == place
    own = controller.init(TABLES[0])[0].hypotheses
    assert not found_elsewhere(own)  # nothing is found
    own.found = Verdict[fault]
    assert found_elsewhere(own) == (place != Verdict.TORQUE_LOST)


@pytest.mark.parametrize("fault", PLACES)
def test_an_actuator_alone_keeps_the_size_of_its_fault(fault: str) -> None:
    """That of a loss of the torque is a matter of its test, of an error of the sensor, added up."""
    own = controller.init(TABLES[0])[0].hypotheses.signatures
    own.torque_offset.candidate.size_now, own.force_lost.candidate.size_now = -20.0, 0.8
    own.sensor_biased.candidate.size_now = own.sensor_drifting.candidate.size_now = 0.3
    kept = {"TORQUE_OFFSET": -20.0, "FORCE_LOST": 0.8}
    assert size_of(own, int(Verdict[fault])) == kept.get(fault, 0.0)


@pytest.mark.parametrize("fault", ["TORQUE_LOST", "FORCE_LOST"])
def test_a_loss_is_not_the_end_of_a_negative_offset(fault: str) -> None:
    """A loss has no sign, or concerns a different part."""
    state = controller.init(TABLES[0])[0]
    own = state.hypotheses
    own.verdict, own.found_size = Verdict.TORQUE_OFFSET, -20.0
    own.signatures.force_lost.candidate.size_now = 0.8
    find(TABLES[0], state, int(Verdict[fault]))
    assert Verdict(own.verdict).name == Verdict(own.found).name == fault


def likely(own: Any, evidence: float, size: float) -> None:
    """m c - ½ m i of a size m = c/i, about which a tick of much noise says nothing."""
    own.information = 2.0 * evidence / size**2
    own.correlation = size * own.information
    own.age = 10.0


def test_the_evidence_of_each_is_known_by_the_number_of_its_verdict() -> None:
    table = changed(TABLES[0], decision={"confirm": math.inf})[0]  # and none is found
    state = controller.init(table)[0]
    own, n = state.hypotheses, int(table.mismatch.n)
    assert len(own.evidence) == Verdict.ANOTHER_CAR + 1
    state.mismatch.variance = 1e30
    state.mismatch.covariance.upper[:] = 0.0
    state.mismatch.covariance.variances[:n] = 0.04
    state.mismatch.theta[2] = math.sqrt(2.0 * 0.04 * 2.0)  # the least there is
    likely(state.sequential_test, 3.0, 0.9)
    likely(own.signatures.torque_offset.candidate, 4.0, -20.0)
    likely(own.signatures.force_lost.candidate, 5.0, 0.8)
    likely(own.signatures.sensor_biased.candidate, 6.0, 0.3)
    likely(own.signatures.sensor_drifting.candidate, 7.0, 0.01)
    likely(own.frozen.candidate, 8.0, 1.0)
    own.frozen.repetitions, own.frozen.measurement = 4.0, 0.3
    state.measurement = 0.3
    weigh_hypotheses(table, state, 0.0, 1.0)
    frozen = 8.0 + 5.0 * float(table.hypotheses.frozen.repetition)
    expected = [0.0, 3.0, 4.0, 5.0, 6.0, 7.0, frozen, 2.0]
    np.testing.assert_allclose(own.evidence, expected, rtol=1e-9)
    assert own.signatures.sensor_drifting.candidate.age == 11.0


def test_a_bias_is_weighed_in_the_tick_in_which_it_begins() -> None:
    state = controller.init(TABLES[0])[0]
    state.mismatch.variance = 0.01
    weigh_hypotheses(TABLES[0], state, 0.3, 0.0)
    assert state.hypotheses.evidence[Verdict.SENSOR_WRONG] == pytest.approx(0.5 * 0.3**2 / 0.01)


def test_a_clearing_leaves_nothing_of_any_number() -> None:
    states = controller.init(TABLES[0])
    fresh = states[0].hypotheses.tobytes()
    states["hypotheses"] = 3  # every number there is
    own = states[0].hypotheses
    assert own.frozen.expected == own.signatures.force_lost.answer.accumulators[7, 1] == 3.0
    clear_hypotheses(states[0])
    assert own.tobytes() == fresh
