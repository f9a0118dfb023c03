"""Effects of a decision: transfer, loss model, doubts, the next candidate."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from firmware_model.law.fault_decision.bumpless_transfer import begin_transfer
from firmware_model.law.fault_decision.decision import CLEAR, CONFIRMED, SUSPECTED
from firmware_model.law.fault_decision.likelihood_ratio import candidate_output
from firmware_model.law.fault_decision.loss_model import loss_output
from tests.firmware.law.test_decision_steps import begun, moving, tick


def transferred(table: Any, before: Any, after: Any, share: float) -> Any:
    """The transfer of ``after``, and its expectation: to the known loss and to this candidate.

    ``before`` is the state within the tick, as it was when the transfer began.
    """
    expected = before.bumpless_transfer.copy()
    loss, test = before.loss_model, before.sequential_test
    lost = loss.followed * loss.previous_output + share * test.previous_output
    w, of_candidate = loss_output(table, before), candidate_output(table, before)
    now = loss.followed * w + share * of_candidate
    begin_transfer(table.bumpless_transfer, expected, lost, now - lost)
    ours = after.bumpless_transfer
    names = ("missed", "missed_growth", "missed_memory")
    return [[float(part[name]) for name in names] for part in (ours, expected)]


def set_up(evidence: float, before: int, share: float, **changes: Any) -> tuple[Any, Any]:
    """A candidate in motion, and a tick without new information."""
    table, state = begun(evidence, before, **changes)
    moving(state, share)
    test = state.sequential_test
    test.correlation, test.information, test.age = 9.0, 10.0, 20.0
    test.explained[0] = 0.02
    table.sequential_test.restart = -math.inf
    table.mismatch.noise = 1e12  # far above the information of a tick
    table.mismatch.growth[:] = table.mismatch.forgetting[:] = 0.0
    table.loss_model.follow = 0.0
    table.decision.shown = 1e30
    return table, state


@pytest.mark.parametrize("before", [CLEAR, SUSPECTED])
def test_a_confirmed_loss_takes_the_candidate_over(before: int) -> None:
    table, state = set_up(20.0, before, 0.0)
    was = state.copy()
    assert tick(table, state) == CONFIRMED
    assert state.loss_model.share == pytest.approx(0.9)
    assert state.loss_model.followed == pytest.approx(0.9)
    ours, expected = transferred(table, was, state, 0.9)
    np.testing.assert_allclose(ours, expected, rtol=1e-9)
    np.testing.assert_allclose(
        state.loss_model.channel_1.accumulators, was.sequential_test.channel_1.accumulators
    )
    test = state.sequential_test
    assert (test.evidence, test.correlation, test.information, test.age) == (0.0, 0.0, 0.0, 0.0)


def test_a_return_takes_away_what_is_known_to_be_lost() -> None:
    table, state = set_up(60.0, CONFIRMED, 0.6)
    was = state.copy()
    assert tick(table, state) == CLEAR
    loss = state.loss_model
    assert loss.share == pytest.approx(0.6)
    ours, expected = transferred(table, was, state, -0.6)
    np.testing.assert_allclose(ours, expected, rtol=1e-9)
    np.testing.assert_allclose(
        loss.fading.accumulators, 0.6 * was.loss_model.channel_1.accumulators
    )
    np.testing.assert_allclose(
        loss.channel_1.accumulators, -was.sequential_test.channel_1.accumulators
    )
    assert state.sequential_test.evidence == 0.0


@pytest.mark.parametrize(("before", "sign"), [(CLEAR, 1.0), (CONFIRMED, -1.0)])
def test_what_the_car_was_taken_for_because_of_the_candidate_is_forgotten(
    before: int, sign: float
) -> None:
    table, state = set_up(60.0, before, 0.6)
    state.sequential_test.explained[2] = 0.02
    state.sequential_test.correlation = 6.0
    state.mismatch.theta[2] = 0.5
    tick(table, state)
    assert state.mismatch.theta[2] == pytest.approx(0.5 - sign * 0.6 * 0.02)
    assert state.mismatch.theta[:2].tolist() == [0.0, 0.0]
