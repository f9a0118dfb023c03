"""The fault state by evidence alone: no command, no d̂, so the evidence stays what a test gives."""

from __future__ import annotations

import math
from typing import Any

import pytest

from firmware_model.design.continuous_design import DesignSpecification, design
from firmware_model.discretisation.tables import build
from firmware_model.discretisation.targets import Target
from firmware_model.law import controller
from firmware_model.law.fault_decision.decision import decide
from firmware_model.law.status import FaultState
from tests.firmware.law.cases import CAR, TICK_S, changed

DESIGN = design(CAR, DesignSpecification(tau_s=0.005, tau_q_s=0.02))
CLEAR, SUSPECTED, CONFIRMED, CANNOT_TELL = FaultState
SUSPECT, CONFIRM, RECOVER = 3.0, 8.0, 40.0


def begun(before: FaultState = CLEAR) -> tuple[Any, Any]:
    of = Target(TICK_S, 1, "zoh", noise_rms=0.01, on_confirmation=True)
    levels = {"suspect": SUSPECT, "confirm": CONFIRM, "recover": RECOVER}
    tables = changed(build(DESIGN, of), decision=levels)
    state = controller.init(tables[0])[0]
    state.fault_state = before
    return tables[0], state


def decided(table: Any, state: Any, evidence: float, model_1: float = 1.0) -> int:
    """The fault state of a tick in which channel 1 adds ``model_1`` to y, if it works."""
    state.sequential_test.evidence = evidence
    state.mismatch.previous_model_output = model_1
    decide(table, state, 0.0, model_1, 0.0)
    return int(state.fault_state)


@pytest.mark.parametrize(
    ("before", "evidence", "after"),
    [
        (CLEAR, -0.5, CLEAR),
        (CLEAR, SUSPECT, CLEAR),
        (CLEAR, SUSPECT + 1e-9, SUSPECTED),
        (CLEAR, CONFIRM, SUSPECTED),
        (CLEAR, CONFIRM + 1e-9, CONFIRMED),
        (SUSPECTED, 1e-9, SUSPECTED),
        (SUSPECTED, 0.0, CLEAR),
        (SUSPECTED, -0.5, CLEAR),
        (SUSPECTED, CONFIRM + 1e-9, CONFIRMED),
        (CANNOT_TELL, SUSPECT + 1e-9, SUSPECTED),
        (CONFIRMED, CONFIRM + 1e-9, CONFIRMED),
        (CONFIRMED, -0.5, CONFIRMED),
        (CONFIRMED, RECOVER, CONFIRMED),
        (CONFIRMED, RECOVER + 1e-9, CLEAR),
    ],
)
def test_evidence_makes_the_state(before: FaultState, evidence: float, after: FaultState) -> None:
    assert decided(*begun(before=before), evidence) == after


@pytest.mark.parametrize("before", [CLEAR, SUSPECTED])
def test_what_would_not_show_within_the_horizon_says_nothing(before: FaultState) -> None:
    """horizon · (G1 u1)²/S against the evidence that confirms: 1 s of 1 ms, S of white noise."""
    table, state = begun(before=before)
    least = math.sqrt(CONFIRM * 0.01**2 / 1000.0)
    assert decided(table, state, -0.5, 0.999 * least) == CANNOT_TELL
    assert decided(table, state, -0.5, 1.001 * least) == CLEAR
    assert decided(table, state, -0.5, -1.001 * least) == CLEAR


def carrying(before: FaultState, **numbers: float) -> tuple[Any, Any]:
    """F̂ has carried 0.2 for some time; the candidate's w of the last tick is 0.5."""
    table, state = begun(before=before)
    state.bumpless_transfer.carried = 0.2
    state.sequential_test.previous_output = 0.5
    state.sequential_test.information = state.sequential_test.correlation = 1.0
    for name, value in numbers.items():
        state.loss_model[name] = value
    return table, state


@pytest.mark.parametrize(
    ("before", "evidence", "missed"),
    [
        (CLEAR, SUSPECT + 1.0, 0.0),
        (SUSPECTED, -0.5, 0.0),
        (CLEAR, -0.5, 0.0),
        (SUSPECTED, CONFIRM + 1.0, 0.5 - 0.2),
    ],
)
def test_f_hat_is_led_to_what_is_taken_for_lost(
    before: FaultState, evidence: float, missed: float
) -> None:
    table, state = carrying(before)
    decided(table, state, evidence)
    assert state.bumpless_transfer.missed == pytest.approx(missed)


def test_f_hat_is_led_back_from_what_has_come_back() -> None:
    """Lost until now 0.6 of 0.4; of that 0.6 of the candidate's 0.5 is lost no more."""
    table, state = carrying(CONFIRMED, share=0.6, between=0.6, followed=0.6, previous_output=0.4)
    decided(table, state, RECOVER + 1.0)
    assert state.bumpless_transfer.missed == pytest.approx(0.6 * 0.4 - 0.6 * 0.5 - 0.2)
