"""One tick of the decision at a time, from evidence that is set by hand.

At rest, and without a command, no tick adds to the evidence: so each branch stands alone.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from firmware_model.discretisation.tables import build
from firmware_model.discretisation.targets import Target
from firmware_model.law import controller
from firmware_model.law.fault_decision.decision import (
    CANNOT_TELL,
    CLEAR,
    CONFIRMED,
    SUSPECTED,
    compensated_output,
    decide,
    show_acting_commands,
)
from firmware_model.law.fault_decision.likelihood_ratio import candidate_shown
from firmware_model.law.fault_decision.loss_model import earlier_shown, loss_output
from tests.firmware.law.cases import DESIGN, TICK_S, changed, other_cars

NUMBERS: dict[str, dict[str, Any]] = {
    "decision": {"confirm": 10.0, "recover": 50.0, "suspect": 4.0, "shown": 100.0},
    "sequential_test": {"share": 0.8, "promising": 4.0, "deviations": 1e9},
    "loss_model": {"share_variance": 0.09, "doubt": 9.0, "least_doubt": 0.0, "moment": 0.5},
}  # fmt: skip
TORQUE_NM = 40.0


def begun(evidence: float = 0.0, before: int = CLEAR, **changes: Any) -> tuple[Any, Any]:
    """A table with round numbers and a state at rest with this evidence."""
    of = Target(TICK_S, changes.pop("latency", 0), "zoh", mismatch=other_cars(1), noise_rms=0.01)
    numbers = {part: {**values, **changes.pop(part, {})} for part, values in NUMBERS.items()}
    table = changed(build(DESIGN, of), **numbers, **changes)[0]
    state = controller.init(table)[0]
    state.fault_state = before
    state.sequential_test.evidence = evidence
    return table, state


def moving(state: Any, share: float = 0.0) -> None:
    """Motions of w and of the candidate, and what F̂ has carried so far."""
    draw = np.random.default_rng(3)
    for part in (state.loss_model, state.sequential_test):
        for name in ("channel_1", "earlier"):
            part[name].accumulators[:2] = 1e-3 * draw.standard_normal((2, 2))
        part.previous_output = draw.standard_normal()
    state.bumpless_transfer.carried, state.bumpless_transfer.carried_speed = 0.3, 0.02
    loss = state.loss_model
    loss.share = loss.between = loss.followed = share
    state.command_1 = TORQUE_NM


def tick(table: Any, state: Any, residual: float = 0.0, model_1: float = 1e3) -> int:
    state.measurement = 1.0 - state.measurement  # the sensor is not frozen
    decide(table, state, residual, model_1, 0.0)
    return int(state.fault_state)


ABOVE = 1.0 + 1e-12


@pytest.mark.every_case
@pytest.mark.parametrize(
    ("before", "evidence", "after"),
    [
        (CLEAR, 0.0, CLEAR),
        (CLEAR, 4.0, CLEAR),
        (CLEAR, 4.0 * ABOVE, SUSPECTED),
        (CLEAR, 10.0, SUSPECTED),
        (CLEAR, 10.0 * ABOVE, CONFIRMED),
        (CANNOT_TELL, 4.0 * ABOVE, SUSPECTED),
        (SUSPECTED, 1e-9, SUSPECTED),
        (SUSPECTED, 0.0, CLEAR),
        (SUSPECTED, -0.5, CLEAR),
        (SUSPECTED, 10.0 * ABOVE, CONFIRMED),
        (CONFIRMED, 0.0, CONFIRMED),
        (CONFIRMED, 50.0, CONFIRMED),
        (CONFIRMED, 50.0 * ABOVE, CLEAR),
    ],
)
def test_the_state_that_follows_from_the_evidence(before: int, evidence: float, after: int) -> None:
    table, state = begun(evidence, before)
    assert tick(table, state) == after
    taken = {before, after} & {CONFIRMED} and before != after
    assert state.sequential_test.evidence == (0.0 if taken else evidence)  # else it goes on


@pytest.mark.parametrize("before", [CLEAR, SUSPECTED])
@pytest.mark.parametrize("model_1", [0.99, 1.01, -1.01])
def test_where_a_loss_would_not_show_within_the_horizon_it_cannot_tell(
    model_1: float, before: int
) -> None:
    """100 model_1² against 10 S, S of a car at rest that of the noise."""
    table, state = begun(-0.5, before)
    edge = np.sqrt(10.0 * 1e-4 / 100.0)
    assert tick(table, state, model_1=model_1 * edge) == (CANNOT_TELL if model_1 == 0.99 else CLEAR)
    assert state.mismatch.variance == pytest.approx(1e-4, rel=1e-6)


def test_at_the_edge_itself_it_can() -> None:
    table, state = begun(mismatch={"n": 0, "noise": 0.5}, decision={"confirm": 8.0, "shown": 4.0})
    assert tick(table, state, model_1=1.0) == CLEAR
    assert tick(table, state, model_1=np.nextafter(1.0, 0.0)) == CANNOT_TELL


@pytest.mark.parametrize("known", [0.0, 0.6])
def test_the_evidence_is_for_a_loss_or_for_the_return_of_what_is_lost(known: float) -> None:
    before = CONFIRMED if known else CLEAR
    table, state = begun(0.0, before, mismatch={"n": 0, "noise": 0.01}, decision={"suspect": 1e9})
    moving(state, known)
    lost, w = known * float(loss_output(table, state)), float(candidate_shown(table, state))
    new, share = 0.05, -known if known else 0.8
    tick(table, state, lost + new)
    expected = share * (w * new - 0.5 * share * w * w) / 0.01
    assert state.sequential_test.evidence == pytest.approx(expected, rel=1e-9)
    assert abs(expected) > 1e-3


def test_a_tick_tells_the_filter_what_is_lost_what_the_model_does_and_the_rest() -> None:
    table, state = begun(0.0, CONFIRMED)
    moving(state, 0.6)
    state.estimator.showing_1, state.command_2 = 30.0, 500.0
    w, earlier = float(loss_output(table, state)), float(earlier_shown(table, state))
    decide(table, state, 0.7, 2.0, 3.0)
    known = state.mismatch
    assert known.previous_residual == pytest.approx(0.7 - 0.6 * w)
    assert known.previous_model_output == 5.0
    assert known.x[0] == w
    assert known.x[1] == earlier
    assert (state.other_cars.command_1, state.other_cars.command_2) == (
        pytest.approx(30.0 * 0.4),
        500.0,
    )


def test_what_f_hat_gets_of_the_share_follows_every_tick() -> None:
    table, state = begun(0.0, CONFIRMED)
    state.loss_model.share = 0.5
    tick(table, state)
    assert state.loss_model.between == pytest.approx(0.5 * table.loss_model.follow)


@pytest.mark.parametrize("fault_state", [CLEAR, SUSPECTED, CONFIRMED])
@pytest.mark.parametrize("shown_ticks_2", [0, 2])
def test_the_commands_that_act_are_those_that_show_without_what_is_known_to_be_lost(
    fault_state: int, shown_ticks_2: int
) -> None:
    table, state = begun(0.0, fault_state, estimator={"shown_ticks_2": shown_ticks_2})
    state.estimator.showing_1, state.estimator.showing_2 = 10.0, 20.0
    state.command_2, state.loss_model.share = 30.0, 0.25
    share = 0.75 if fault_state == CONFIRMED else 1.0
    second = 20.0 if shown_ticks_2 else 30.0
    show_acting_commands(table, state)
    shown = state.other_cars.command_1, state.other_cars.command_2
    assert shown == (10.0 * share, second)


def test_f_hat_makes_up_for_what_is_lost() -> None:
    table, state = begun()
    moving(state, 0.5)
    for fault_state in (CLEAR, SUSPECTED, CONFIRMED):
        state.fault_state = fault_state
        expected = 0.5 * float(loss_output(table, state))
        assert float(compensated_output(table, state)) == pytest.approx(expected, rel=1e-12)
