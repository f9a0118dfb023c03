"""When a candidate is given up, to the last number, and what one that begins knows of the last."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from firmware_model.design.continuous_design import DesignSpecification, design
from firmware_model.discretisation.tables import build
from firmware_model.discretisation.targets import Target
from firmware_model.law import controller
from firmware_model.law.fault_decision.likelihood_ratio import (
    forget_candidate,
    is_stale,
    start_candidate,
    update_test,
)
from firmware_model.law.filters.biquad import advance, output
from tests.firmware.law.cases import CAR, TICK_S, changed

DESIGN = design(CAR, DesignSpecification(tau_s=0.005, tau_q_s=0.02))
NUMBERS = {"freshness": 0.125, "needed": 100.0, "promising": 4.0, "restart": -1.0}
BELOW = math.nextafter(1.0, 0.0)


def begun(latency: int = 0, **numbers: Any) -> tuple[Any, Any]:
    table = changed(build(DESIGN, Target(TICK_S, latency, "zoh")), sequential_test=NUMBERS)[0]
    state = controller.init(table)[0]
    state.mismatch.variance = 1.0
    for name, value in numbers.items():
        state.sequential_test[name] = value
    return table, state


@pytest.mark.parametrize(
    ("age", "half_age", "looks"),
    [(3.0, 0.0, False), (4.0, 0.0, True), (5.0, 3.0, False), (6.0, 3.0, True), (19.0, 10.0, False),
     (20.0, 10.0, True)],
)  # fmt: skip
def test_it_is_looked_at_when_its_age_has_doubled(age: float, half_age: float, looks: bool) -> None:
    """The first look is at four ticks; the next look compares with that state."""
    table, state = begun(age=age, half_age=half_age, half_information=8.0, information=8.5)
    test = state.sequential_test
    assert is_stale(table.sequential_test, test) == looks
    assert (test.half_age, test.half_information) == ((age, 8.5) if looks else (half_age, 8.0))


@pytest.mark.parametrize(
    ("half_information", "learnt", "stale"),
    [(8.0, 1.0, False), (8.0, 0.999, True), (1e6, 100.0, False), (1e6, 99.5, True)],
)
def test_it_is_stale_with_less_than_an_eighth_more_or_than_decides(
    half_information: float, learnt: float, stale: bool
) -> None:
    table, state = begun(age=64.0, half_age=32.0, half_information=half_information)
    state.sequential_test.information = half_information + learnt
    assert is_stale(table.sequential_test, state.sequential_test) == stale


@pytest.mark.parametrize(
    ("evidence", "share", "kept"),
    [(4.0, 0.8, False), (4.0 / BELOW, 0.8, True), (4.0 / BELOW, -0.8, False),
     (4.0 / BELOW, 0.0, False)],
)  # fmt: skip
def test_a_stale_candidate_is_kept_for_a_suspicion_of_a_loss_alone(
    evidence: float, share: float, kept: bool
) -> None:
    """That has begun to be made up for; one for a return is not."""
    table, state = begun(age=63.0, half_age=32.0, half_information=8.0, information=8.0)
    state.sequential_test.evidence = evidence
    update_test(table, state, 0.0, share)
    assert (state.sequential_test.evidence == evidence) == kept


@pytest.mark.parametrize(("evidence", "kept"), [(-1.0, False), (-BELOW, True), (-2.0, False)])
def test_evidence_of_minus_one_is_enough_to_give_up(evidence: float, kept: bool) -> None:
    table, state = begun(evidence=evidence)
    update_test(table, state, 0.0, 0.8)
    assert state.sequential_test.evidence == (evidence if kept else 0.0)


@pytest.mark.parametrize("latency", [0, 1, 3])
def test_a_candidate_begins_with_nothing_of_the_last(latency: int) -> None:
    """Only commands on their way and the command before them remain, and count as lost."""
    table, state = begun(latency)
    fresh = state.copy()
    for record in (state, fresh):
        record.command_1 = 50.0
        record.estimator.delay_1[:latency] = [10.0, 20.0, 30.0][:latency]
    test = state.sequential_test
    for name in test.dtype.names:
        if name not in {"channel_1", "earlier"}:
            test[name] = 7.0
    test.channel_1.accumulators[:] = test.earlier.accumulators[:] = 7.0
    test.delay[latency:] = 0.0  # which is not used
    for record in (state, fresh):
        start_candidate(table, record)
    assert test.tobytes() == fresh.sequential_test.tobytes()
    # The answer to one command: of those on their way the first stands for the one that is gone.
    model = table.estimator.channel_1
    alone = fresh.sequential_test.earlier.copy()
    alone.accumulators[:] = 0.0
    advance(model, alone, 10.0 if latency else 50.0)
    answers = [float(output(model, earlier, 0.0)) for earlier in (alone, test.earlier)]
    assert answers[0] == answers[1] != 0.0


def test_what_the_car_was_taken_for_is_taken_back_in_its_share() -> None:
    table, state = begun()
    table.mismatch.n = 5
    state.mismatch.theta[:] = 1.0
    state.sequential_test.explained[:] = [0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7]
    forget_candidate(table, state, 0.5)
    expected = [0.95, 0.9, 0.85, 0.8, 0.75, 1.0, 1.0]
    np.testing.assert_allclose(state.mismatch.theta, expected)
