"""The verdict: enough evidence, evidence that stands, evidence that ends."""

from typing import Any

import numpy as np
import pytest

from firmware_model.discretisation.tables import build
from firmware_model.discretisation.targets import Target
from firmware_model.law import controller
from firmware_model.law.layout import Table
from firmware_model.law.status import FaultState, Verdict
from firmware_model.law.structs import Records
from firmware_model.law.supervision.likelihood_ratio import update_test
from firmware_model.law.supervision.signatures import DRIFT_ROW, OFFSET_ROW
from firmware_model.law.supervision.verdict import judge, other_car_evidence, torque_evidence
from tests.firmware.law.cases import DESIGN, ROW, TICK_S, changed, covariance_of, other_cars

pytestmark = pytest.mark.every_case  # a case each of few lines

TARGET = Target(TICK_S, 1, "zoh", noise_rms=0.01, mismatch=other_cars(2))
NUMBERS = {"hypotheses": {"ahead": 2.0, "sensor_ahead": 3.0, "jump": 5.0, "both_lost": 100.0}}
TABLES = changed(build(DESIGN, TARGET), decision={"confirm": 20.0, "suspect": 7.0}, **NUMBERS)
LOST, OFFSET, FORCE, BIASED, DRIFTING, FROZEN, CAR_IS_ANOTHER = range(1, 8)


def state_of(verdict: Verdict = Verdict.NOTHING, *, lost: bool = False) -> Any:
    state = controller.init(TABLES[0])[0]
    state.supervision.hypotheses.verdict = verdict
    state.fault_state = FaultState.CONFIRMED if lost else FaultState.CLEAR
    return state


def judged(state: Any, **evidence: float) -> Verdict:
    own = state.supervision
    places = {"lost": LOST, "offset": OFFSET, "force": FORCE, "biased": BIASED,
              "drifting": DRIFTING, "frozen": FROZEN, "car": CAR_IS_ANOTHER}  # fmt: skip
    own.hypotheses.evidence[:] = 0.0
    own.hypotheses.signatures.jump = 5.0  # enough for a bias
    for name, value in evidence.items():
        own.hypotheses.evidence[places[name]] = value
    judge_in(state)
    return Verdict(own.hypotheses.verdict)


def judge_in(state: Any) -> None:
    """Judge the evidence of ``state`` without any witness."""
    own = state.supervision
    lost, test = state.fault_state == FaultState.CONFIRMED, own.sequential_test
    judge(
        TABLES[0], own.hypotheses, own.mismatch, own.echoes, own.witness,
        False, lost, test.candidate.predicted,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("evidence", "verdict"),
    [({}, "NOTHING"), ({"lost": 20.0}, "NOTHING"), ({"lost": 20.1}, "TORQUE_LOST"),
     ({"lost": 25.0, "offset": 24.0}, "TORQUE_LOST"),
     ({"lost": 25.0, "offset": 26.0}, "TORQUE_OFFSET"),
     ({"offset": 26.0, "biased": 13.0}, "CANNOT_BE_TOLD"),
     ({"offset": 26.0, "biased": 12.9}, "TORQUE_OFFSET"),
     ({"force": 30.0, "lost": 14.0}, "FORCE_LOST"),
     ({"force": 30.0, "lost": 16.0}, "CANNOT_BE_TOLD"),
     ({"biased": 30.0, "drifting": 30.0}, "SENSOR_WRONG"),
     ({"biased": 30.0, "drifting": 31.0}, "SENSOR_DRIFTING"),
     ({"frozen": 50.0, "biased": 40.0, "force": 16.0}, "SENSOR_FROZEN"),
     ({"frozen": 50.0, "biased": 40.0, "force": 17.0}, "CANNOT_BE_TOLD"),
     ({"car": 20.1, "lost": 20.0}, "ANOTHER_CAR"), ({"car": 500.0, "lost": 20.1}, "TORQUE_LOST")],
)  # fmt: skip
def test_a_place_must_be_far_ahead_of_both_others(evidence, verdict):
    assert judged(state_of(), **evidence).name == verdict


@pytest.mark.parametrize(
    ("before", "verdict"), [(3.9, "FORCE_LOST"), (4.1, "CANNOT_BE_TOLD"), (30.0, "CANNOT_BE_TOLD")]
)
def test_what_channel_2_explained_before_a_loss_of_channel_1_is_no_evidence_against_that(
    before, verdict
):
    """With 13 for a lost channel 1 it takes more than twice as much since its onset."""
    state = state_of()
    state.supervision.hypotheses.signatures.before = before
    assert judged(state, force=30.0, lost=13.0).name == verdict


def test_of_the_other_faults_all_evidence_counts():
    state = state_of()
    state.supervision.hypotheses.signatures.before = 30.0
    assert judged(state, offset=30.0, force=13.0) == Verdict.TORQUE_OFFSET


@pytest.mark.parametrize(
    ("before", "stands"),
    [("TORQUE_LOST", False), ("TORQUE_OFFSET", True), ("FORCE_LOST", True), ("SENSOR_WRONG", True),
     ("SENSOR_DRIFTING", True), ("ANOTHER_CAR", False), ("BOTH_LOST", False),
     ("CANNOT_BE_TOLD", False)],
)  # fmt: skip
def test_what_has_been_found_stands_where_nothing_else_is_found(before, stands):
    after = judged(state_of(Verdict[before]))
    assert after.name == (before if stands else "NOTHING")


def test_what_has_been_found_stands_where_it_cannot_be_told_what_there_is_now():
    after = judged(state_of(Verdict.TORQUE_OFFSET), offset=26.0, biased=13.0)
    assert after == Verdict.TORQUE_OFFSET


def test_a_number_that_is_repeated_keeps_no_other_verdict():
    state = state_of(Verdict.CANNOT_BE_TOLD)
    state.supervision.hypotheses.frozen.repetitions = 1.0
    assert judged(state) == Verdict.NOTHING


def test_a_fault_is_found_in_one_tick_and_stands_in_the_next():
    state = state_of()
    for evidence, found in (({"offset": 30.0}, OFFSET), ({}, Verdict.NOTHING)):
        assert judged(state, **evidence) == Verdict.TORQUE_OFFSET
        assert state.supervision.hypotheses.found == found


def test_what_comes_after_the_end_of_a_fault_is_another_whatever_its_sign():
    """Of an offset that has ended no size is kept, which the next could be the end of."""
    state, verdicts = state_of(), []
    for size in (20.0, -20.0, 20.0):
        state.supervision.hypotheses.signatures.rows[OFFSET_ROW].candidate.size_now = size
        verdicts.append(judged(state, offset=30.0))
    assert verdicts == [Verdict.TORQUE_OFFSET, Verdict.NOTHING, Verdict.TORQUE_OFFSET]


def test_a_sensor_is_frozen_as_long_as_it_repeats_itself():
    state = state_of(Verdict.SENSOR_FROZEN)
    state.supervision.hypotheses.frozen.repetitions = 1.0
    assert judged(state) == Verdict.SENSOR_FROZEN
    state.supervision.hypotheses.frozen.repetitions = 0.0
    assert judged(state) == Verdict.NOTHING


def test_the_jump_to_a_repeated_number_is_no_error_of_the_sensor_after_that():
    state = state_of(Verdict.SENSOR_WRONG)
    state.supervision.hypotheses.sensor_error.offset = 0.3
    assert judged(state, frozen=50.0) == Verdict.SENSOR_FROZEN
    assert state.supervision.hypotheses.sensor_error.offset == 0.0


def test_another_car_stands_until_its_evidence_is_no_suspicion():
    assert judged(state_of(Verdict.ANOTHER_CAR), car=7.1) == Verdict.ANOTHER_CAR
    assert judged(state_of(Verdict.ANOTHER_CAR), car=7.0) == Verdict.NOTHING
    assert judged(state_of(), car=19.0) == Verdict.NOTHING


@pytest.mark.parametrize(
    ("first", "then", "gone"),
    [
        (("sensor_biased", 0.1), ("sensor_biased", -0.1), True),
        (("sensor_biased", 0.1), ("sensor_biased", 0.05), False),
        (("sensor_drifting", 0.1), ("sensor_biased", -0.1), True),
        (("torque_offset", 20.0), ("torque_offset", -20.0), True),
        (("torque_offset", 20.0), ("sensor_biased", -0.3), False),
    ],
)
def test_the_opposite_at_the_same_place_is_the_end_of_a_fault(first, then, gone):
    short = {"sensor_biased": "biased", "sensor_drifting": "drifting", "torque_offset": "offset"}
    named = Verdict[then[0].replace("biased", "wrong").upper()]
    state = state_of()
    for name, size in (first, then):
        candidate = state.supervision.hypotheses.signatures.rows[ROW[name]].candidate
        state.supervision.hypotheses.signatures.rows[DRIFT_ROW].ramp = -1.0
        candidate["size_now"] = size
        verdict = judged(state, **{short[name]: 30.0})
        assert not candidate["size_now"]  # its onset is yet to come
    assert verdict == (Verdict.NOTHING if gone else named)
    if gone:  # and the next one is another
        state.supervision.hypotheses.signatures.rows[ROW[then[0]]].candidate["size_now"] = then[1]
        assert judged(state, **{short[then[0]]: 30.0}) == named


def silent(state: Any, missing: float = 0.51) -> Any:
    """So much of what channel 2 was told is missing in y."""
    own = state.supervision
    (own.hypotheses.signatures.commanded, own.hypotheses.signatures.missing) = 1.0, missing
    return state


def test_both_are_lost_only_where_y_follows_less_than_half_of_channel_2():
    for missing, verdict in ((0.5, Verdict.TORQUE_LOST), (0.51, Verdict.BOTH_LOST)):
        state = silent(state_of(Verdict.TORQUE_LOST, lost=True), missing)
        assert judged(state, lost=900.0, force=101.0) == verdict


@pytest.mark.parametrize(("jump", "verdict"), [(5.0, "SENSOR_WRONG"), (4.9, "CANNOT_BE_TOLD")])
def test_a_bias_begins_with_a_jump(jump, verdict):
    state = state_of()
    state.supervision.hypotheses.signatures.jump = jump
    state.supervision.hypotheses.evidence[BIASED] = 90.0
    judge_in(state)
    assert Verdict(state.supervision.hypotheses.verdict).name == verdict


def test_of_another_fault_no_jump_is_asked():
    state = state_of()
    state.supervision.hypotheses.evidence[OFFSET] = 90.0
    judge_in(state)
    assert state.supervision.hypotheses.verdict == Verdict.TORQUE_OFFSET


@pytest.mark.parametrize(
    ("before", "evidence", "verdict"),
    [("NOTHING", {"lost": 20.1}, "TORQUE_LOST"), ("NOTHING", {"lost": 20.0}, "CANNOT_BE_TOLD"),
     ("SENSOR_WRONG", {"lost": 30.0}, "TORQUE_LOST"),
     ("TORQUE_LOST", {"lost": 30.0, "biased": 90.0}, "TORQUE_LOST"),
     ("TORQUE_LOST", {"lost": 900.0, "force": 100.1}, "BOTH_LOST"),
     ("TORQUE_LOST", {"lost": 900.0, "force": 190.0, "drifting": 90.0}, "TORQUE_LOST"),
     ("TORQUE_LOST", {"lost": 900.0, "force": 190.1, "drifting": 90.0}, "BOTH_LOST"),
     ("TORQUE_LOST", {"lost": 900.0, "force": 140.0, "offset": 41.0}, "TORQUE_LOST"),
     ("BOTH_LOST", {"lost": 0.0}, "BOTH_LOST"), ("FORCE_LOST", {"lost": 0.0}, "CANNOT_BE_TOLD"),
     ("FORCE_LOST", {"lost": 20.1}, "TORQUE_LOST")],
)  # fmt: skip
def test_of_a_confirmed_loss_it_is_asked_whether_the_other_channel_is_lost_too(
    before, evidence, verdict
):
    state = silent(state_of(Verdict[before], lost=True))
    assert judged(state, **evidence).name == verdict


def test_the_end_of_a_confirmed_loss_competes_with_the_loss_of_the_other_channel():
    state = silent(state_of(lost=True))
    state.supervision.sequential_test.candidate.predicted = 41.0
    assert judged(state, lost=30.0, force=140.0) == Verdict.TORQUE_LOST
    state.supervision.sequential_test.candidate.predicted = 39.0
    assert judged(state, lost=30.0, force=140.0) == Verdict.BOTH_LOST


def with_learnt_car(tables: Records[Table], lost: bool) -> Any:
    """A state whose filter has a covariance that is not diagonal."""
    state = controller.init(tables[0])[0]
    draw, n = np.random.default_rng(4), int(tables[0].mismatch.n)
    known = state.supervision.mismatch
    known.covariance.lower[:n, :n] = np.tril(draw.standard_normal((n, n)), -1)
    known.covariance.variances[:n] = draw.uniform(0.01, 0.1, n)
    known.covariance.first = 0
    known.theta[:n] = draw.standard_normal(n)
    state.supervision.loss_model.share = 0.6 - known.theta[0]
    state.fault_state = FaultState.CONFIRMED if lost else FaultState.CLEAR
    return state


def test_of_a_confirmed_loss_the_evidence_is_how_far_its_share_is_from_none():
    state = with_learnt_car(TABLES, lost=True)
    own = state.supervision
    variance = covariance_of(own.mismatch)[0, 0]
    found = torque_evidence(own.mismatch, own.sequential_test.candidate, True, 0.6)
    assert found == pytest.approx(0.5 * 0.6**2 / variance)


@pytest.mark.parametrize(
    ("new", "shown", "evidence"),
    [(0.5, 1.0, 2.0), (3.0, 1.0, 54.0), (3.0, 0.0, 0.0), (-0.5, 1.0, 2.0)],
)
def test_before_that_it_is_that_of_the_share_which_explains_most(new, shown, evidence):
    """ν²/2S, or with the largest share that a car may have, 1.5."""
    table = build(DESIGN, Target(TICK_S, 1, "zoh"))
    state = controller.init(table)[0].supervision
    state.mismatch.variance = 1.0 / 16.0
    update_test(table, state.sequential_test, state.mismatch, shown, new, 0.8)
    found = torque_evidence(state.mismatch, state.sequential_test.candidate, False, 0.6)
    assert found == pytest.approx(evidence)


@pytest.mark.parametrize("clearly", [1.0, 0.01])
def test_another_car_is_told_by_the_direction_in_which_it_differs_most_clearly(clearly):
    state = with_learnt_car(TABLES, lost=False)
    own = state.supervision
    own.mismatch.theta[:] *= clearly
    cars = slice(2, 2 + int(TABLES[0].other_cars.n))
    variances = np.diag(covariance_of(own.mismatch))[cars]
    expected = max(0.5 * np.asarray(own.mismatch.theta)[cars] ** 2 / variances)
    assert other_car_evidence(TABLES[0], own.mismatch) == pytest.approx(expected)
