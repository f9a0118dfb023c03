"""The law line by line in runs of a few dozen ticks: scipy's filters of its own commands."""

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from firmware_model.design.continuous_design import DesignSpecification, design
from firmware_model.design.plants import chapter_2
from firmware_model.discretisation.tables import Filters, build, discretise
from firmware_model.discretisation.targets import Target
from firmware_model.law import controller
from firmware_model.law.core.biquad import advance
from firmware_model.law.core.shortfall import make_up
from firmware_model.law.core.tracking import missing_output, track_on
from firmware_model.law.status import FaultState, Mode
from firmware_model.law.supervision.bumpless_transfer import transfer
from firmware_model.law.supervision.decision import compensated_output
from firmware_model.law.supervision.loss_model import lost_command
from tests.firmware.law.cases import DESIGN, NEVER, TICK_S, changed, late, other_cars, through

OPEN_LOOP = design(chapter_2(), DesignSpecification(tau_s=0.01, feedback=False))
TICKS = 40
HELD = slice(20, 25)
DRAW = np.random.default_rng(4)
REFERENCE, MEASURED = 0.02 * np.cumsum(DRAW.standard_normal((2, TICKS)), axis=1)
FEEDING = ["tustin", "tustin-held", "zoh"]
NAMES = ("command_1", "command_2", "fault_estimate", "mode", "fault_state")

Columns = dict[str, NDArray[Any]]


def run(
    table: Any, state: Any, measured: NDArray[Any] = MEASURED, given: NDArray[Any] = REFERENCE
) -> Columns:
    """The law's answers tick by tick, and the calls of its parts."""
    rows = []
    for reference, y in zip(given, measured, strict=True):
        made_up = [
            make_up(table[f"shortfall_{i}"], table.estimator[f"channel_{i}"],
                    table[f"actuator_{i}"], state[f"shortfall_{i}"])
            for i in (1, 2)
        ]  # fmt: skip
        controller.step(table, state, reference, y)
        known = state.supervision.mismatch
        judged = known.previous_residual, known.previous_model_output
        missing = missing_output(
            table.estimator, state.tracking, state.estimator, state.shortfall_2
        )
        rows.append([*(state[name] for name in NAMES), *judged, missing, *made_up])
    names = (*NAMES, "judged", "modelled", "missing", "made_up_1", "made_up_2")
    return dict(zip(names, np.array(rows, dtype=np.float64).T, strict=True))


def of(target: Target, **changes: Any) -> tuple[Any, Any, Filters]:
    """A table that decides nothing, a state at rest, and the filters."""
    table = changed(build(DESIGN, target), decision=NEVER, **changes)[0]
    return table, controller.init(table)[0], discretise(DESIGN, target)


@pytest.mark.parametrize("latency", [0, 2])
@pytest.mark.parametrize("rule", FEEDING)
def test_the_decision_sees_the_residual_and_what_both_models_add(rule, latency):
    """With feedthrough the held command 2 counts, because this tick's command is unknown.

    Commands count as the plant gets them: limited, rounded and late.
    """
    steps = {"lsb_1": 0.25, "lsb_2": 2.0}
    table, state, filters = of(Target(TICK_S, latency, rule, limit_1=40.0, limit_2=500.0, **steps))
    told = run(table, state)
    for command, limit, lsb in (("command_1", 40.0, 0.25), ("command_2", 500.0, 2.0)):
        assert np.abs(told[command]).max() == limit
        np.testing.assert_array_equal(told[command] % lsb, 0.0)
    u1, u2 = late(told["command_1"], latency), late(told["command_2"], latency)
    both = through(filters.estimator_1, u1) + through(filters.estimator_2, u2)
    np.testing.assert_allclose(told["fault_estimate"], both - MEASURED, atol=1e-9)
    through_now = float(table.estimator.feedthrough_2)
    assert (through_now != 0.0) == (latency == 0 and rule == "tustin")
    before = late(told["command_2"], 1)
    expected = both - MEASURED + through_now * (before - told["command_2"])
    np.testing.assert_allclose(told["judged"], expected, atol=1e-9)
    at_rest = both - through_now * told["command_2"]
    np.testing.assert_allclose(told["modelled"], at_rest, atol=1e-9)
    assert (told["mode"] == Mode.RUN).all()


@pytest.mark.parametrize("on_confirmation", [False, True])
@pytest.mark.parametrize("latency", [0, 2])
def test_what_channel_2_cannot_do_is_missing_in_the_measurement(latency, on_confirmation):
    """G2 of asked - possible, which C then does not take for its own error."""
    limit = 300.0 if on_confirmation else 2000.0
    target = Target(TICK_S, latency, "zoh", limit_2=limit, on_confirmation=on_confirmation)
    table, state, filters = of(target, loss_model={"follow": 0.0})
    state.supervision.loss_model.share = state.supervision.loss_model.followed = 1.0
    state.fault_state = FaultState.CONFIRMED
    told = run(table, state)
    lost = through(filters.estimator_1, told["command_1"])
    drive = lost if on_confirmation else told["fault_estimate"]
    asked = through(filters.compensator, drive)
    possible = np.clip(asked + told["made_up_2"], -limit, limit)
    np.testing.assert_allclose(told["command_2"], possible, atol=1e-6 * np.abs(asked).max())
    assert 3 < (np.abs(asked) > limit).sum() < TICKS
    assert told["made_up_2"].any()
    short = late(asked - possible, latency)
    missing = through(filters.estimator_2, short)
    np.testing.assert_allclose(told["missing"][:-1], missing[1:], rtol=1e-6, atol=1e-9)
    # And C works on y + missing: u1 = Q (r - y - missing + G1 u1).
    shown = late(through(filters.estimator_1, late(told["command_1"], latency)), 0)
    error = REFERENCE - MEASURED - late(told["missing"], 1) + shown
    u1 = through(filters.tracking, error)
    np.testing.assert_allclose(told["command_1"], u1, atol=1e-7 * np.abs(u1).max())


@pytest.mark.parametrize("rule", ["zoh", "tustin"])
def test_a_make_up_of_channel_2_comes_on_top_of_f_hat_s_answer_to_it(rule):
    """Also where d̂ and u2 are solved for at once, because G2 feeds through."""
    table, state, filters = of(Target(TICK_S, 0, rule, limit_2=2000.0))
    told = run(table, state)
    asked = through(filters.compensator, told["fault_estimate"])
    possible = np.clip(asked + told["made_up_2"], -2000.0, 2000.0)
    np.testing.assert_allclose(told["command_2"], possible, atol=1e-6 * np.abs(asked).max())
    free = np.abs(told["command_2"]) < 2000.0
    assert np.abs(told["made_up_2"][free]).max() > 100.0
    assert (table.compensator.loop_inverse != 1.0) == (rule == "tustin")


@pytest.mark.parametrize("latency", [0, 2])
def test_what_channel_1_cannot_do_is_made_up_for(latency):
    """Beside C's own answer to the commands as they were limited."""
    table, state, filters = of(Target(TICK_S, latency, "zoh", limit_1=60.0, on_confirmation=True))
    told = run(table, state)
    shown = through(filters.estimator_1, late(told["command_1"], latency))
    asked = through(filters.tracking, REFERENCE - MEASURED + shown)
    possible = np.clip(asked + told["made_up_1"], -60.0, 60.0)
    np.testing.assert_allclose(told["command_1"], possible, atol=1e-7 * np.abs(asked).max())
    assert np.abs(told["made_up_1"][np.abs(told["command_1"]) < 60.0]).max() > 1.0


@pytest.mark.parametrize("latency", [0, 2])
def test_after_a_loss_f_hat_makes_up_for_w_whatever_is_measured(latency):
    """Also of the commands in ticks without a measurement."""
    target = Target(TICK_S, latency, "zoh", on_confirmation=True)
    table, state, filters = of(target, loss_model={"follow": 0.0})
    state.supervision.loss_model.share = state.supervision.loss_model.followed = 1.0
    state.fault_state = FaultState.CONFIRMED
    measured = MEASURED.copy()
    measured[HELD] = math.nan
    told = run(table, state, measured)
    assert (told["mode"][HELD] == Mode.BLIND).all()
    assert (told["mode"] == Mode.BLIND).sum() == 5
    expected = through(filters.compensator, through(filters.estimator_1, told["command_1"]))
    difference = np.abs(told["command_2"] - expected - told["made_up_2"])
    assert difference.max() < 1e-8 * np.abs(expected).max()
    shown = [late(told[name], latency) for name in NAMES[:2]]
    modelled = through(filters.estimator_1, shown[0]) + through(filters.estimator_2, shown[1])
    after = slice(HELD.stop, None)
    np.testing.assert_allclose(
        told["fault_estimate"][after], (modelled - MEASURED)[after], atol=1e-9
    )


def test_a_tick_without_a_measurement_tells_the_other_cars_and_the_candidate_what_goes_on():
    """The acting command drives w."""
    table, state, _ = of(Target(TICK_S, 2, "zoh", on_confirmation=True))
    own = state.supervision
    for _ in range(3):
        controller.step(table, state, 1.0, 0.0)
    queues = [state.estimator.queue_1, state.estimator.queue_2]
    acting = [float(queue.commands[queue.index]) for queue in queues]
    w = float(own.sequential_test.previous_output)
    controller.step(table, state, math.inf, 0.0)
    assert [float(own.other_cars.command_1), float(own.other_cars.command_2)] == acting
    assert acting[0] != 0.0
    assert own.sequential_test.previous_output != w
    assert (state.reference, state.measurement) == (1.0, 0.0)


def test_the_open_loop_gives_channel_2_its_share_of_the_reference():
    """Chapter 2: u1 = r, u2 = r + F̂ d̂, whatever C would have made of y."""
    target = Target(0.005)
    table, filters = build(OPEN_LOOP, target), discretise(OPEN_LOOP, target)
    told = run(table, controller.init(table)[0])
    np.testing.assert_allclose(told["command_1"], REFERENCE, rtol=1e-12)
    estimate = told["fault_estimate"]
    expected = REFERENCE + through(filters.compensator, estimate)
    np.testing.assert_allclose(told["command_2"], expected, atol=1e-9 * np.abs(expected).max())
    modelled = through(filters.estimator_1, REFERENCE) + through(
        filters.estimator_2, told["command_2"]
    )
    np.testing.assert_allclose(estimate, modelled - MEASURED, atol=1e-9)


@pytest.mark.parametrize("on_confirmation", [False, True])
def test_the_open_loop_compensates_beside_the_reference_on_confirmation(on_confirmation):
    table = build(OPEN_LOOP, Target(0.005, on_confirmation=on_confirmation))
    state = controller.init(table)[0]
    controller.step(table, state, 2.0, 0.0)
    if on_confirmation:  # nothing is lost
        assert (state.command_1, state.command_2) == (2.0, 2.0)
    assert state.fault_estimate != 0.0


@pytest.mark.parametrize("on_confirmation", [False, True])
@pytest.mark.parametrize("huge", [1e308, -1e308])
def test_an_overflow_holds_both_commands_and_says_so(huge, on_confirmation):
    """C's sum is no number; channel 2, where nothing is lost, would be zero all the same."""
    table, state, _ = of(Target(TICK_S, lsb_1=0.5, lsb_2=0.5, on_confirmation=on_confirmation))
    controller.step(table, state, 1.0, 0.1)
    before = [float(state[name]) for name in NAMES[:3]]
    controller.step(table, state, huge, -huge)
    assert [float(state[name]) for name in NAMES[:3]] == before
    assert state.mode == Mode.BLIND
    assert before[0] != 0.0
    controller.step(table, state, 1.0, 0.1)
    assert state.mode == Mode.RUN
    assert np.isfinite([state[name] for name in NAMES[:3]]).all()


def test_nor_does_channel_2_follow_what_is_no_number():
    table, state, _ = of(Target(TICK_S))
    controller.step(table, state, 1.0, 0.1)
    before = [float(state[name]) for name in NAMES[:3]]
    state.compensator.filter.accumulators[0, 0] = math.inf
    controller.step(table, state, 1.0, 0.1)
    assert [float(state[name]) for name in NAMES[:3]] == before
    assert state.mode == Mode.BLIND


@pytest.mark.parametrize("on_confirmation", [False, True])
def test_a_stop_owes_what_c_and_f_hat_would_have_asked_for(on_confirmation):
    target = Target(TICK_S, 1, "zoh", on_confirmation=on_confirmation, blind_s=0.0)
    table, state, _ = of(target, loss_model={"follow": 0.0})
    state.supervision.loss_model.share = state.supervision.loss_model.followed = 1.0
    state.fault_state = FaultState.CONFIRMED
    for _ in range(6):
        controller.step(table, state, 1.0, 0.0)
    was = state.copy()
    was.command_1 = was.command_2 = 0.0
    short_1 = track_on(table.tracking, was.tracking, was.command_1) - was.command_1
    short_2 = 0.0
    if on_confirmation:
        own, lost = was.supervision, lost_command(was.fault_state, was.command_1)
        missing = compensated_output(table, own.loss_model, own.echoes, lost)
        drive = transfer(own.bumpless_transfer, missing)
        short_2 = advance(table.compensator.filter, was.compensator.filter, drive) - was.command_2
        assert short_2 != 0.0
    advance(table.estimator.channel_1, was.shortfall_1, short_1)
    advance(table.estimator.channel_2, was.shortfall_2, short_2)
    controller.step(table, state, 1.0, math.nan)
    for name in ("shortfall_1", "shortfall_2"):
        np.testing.assert_array_equal(state[name].accumulators, was[name].accumulators)
    assert was.shortfall_1.accumulators.any()


@pytest.mark.parametrize("latency", [0, 2])
def test_the_model_among_other_cars_moves_as_f1_does(latency):
    table, state, _ = of(Target(TICK_S, latency, "zoh", mismatch=other_cars(1)))
    measured = MEASURED.copy()
    measured[HELD] = math.nan
    run(table, state, measured)
    for name in ("channel_1", "channel_2"):
        ours, theirs = state.supervision.other_cars.model[name], state.estimator[name]
        np.testing.assert_allclose(ours.accumulators, theirs.accumulators, rtol=1e-12)
        assert ours.accumulators.any()


def test_c_tracks_the_shaped_reference_where_there_is_a_shaper():
    shaping, shaped, _ = of(Target(TICK_S, reference_acceleration=40.0))
    plain, followed, _ = of(Target(TICK_S))
    for _ in range(5):
        controller.step(shaping, shaped, 1.0, 0.0)
        controller.step(plain, followed, float(shaped.reference_shaper.shaped), 0.0)
        assert shaped.command_1 == followed.command_1 != 0.0
    assert 0.0 < shaped.reference_shaper.shaped < 1e-3
    assert followed.reference_shaper.shaped == 0.0


# --- the thesis's law alone ----------------------------------------------------------------------


def alone(target: Target, reference: NDArray[Any], measured: NDArray[Any]) -> Columns:
    table = build(DESIGN, target)
    return run(table, controller.init(table)[0], measured, reference)


@pytest.mark.parametrize("latency", [0, 2])
@pytest.mark.parametrize("rule", FEEDING)
def test_alone_the_law_is_the_filters_of_chapter_3(rule, latency):
    """u1 = Q (r - y + G1 u1), d̂ = G1 u1 + G2 u2 - y, u2 = r2 + F̂ d̂, each a filter of scipy."""
    target = Target(TICK_S, latency, rule, supervised=False)
    told, filters = alone(target, REFERENCE, MEASURED), discretise(DESIGN, target)
    model_1 = through(filters.estimator_1, late(told["command_1"], latency))
    model_2 = through(filters.estimator_2, late(told["command_2"], latency))
    asked = through(filters.tracking, REFERENCE - MEASURED + model_1)
    np.testing.assert_allclose(told["command_1"], asked, rtol=1e-9, atol=1e-9)
    d_hat = model_1 + model_2 - MEASURED
    np.testing.assert_allclose(told["fault_estimate"], d_hat, rtol=1e-9, atol=1e-9)
    carried = through(filters.compensator, d_hat)
    np.testing.assert_allclose(told["command_2"], carried, atol=1e-8 * np.abs(carried).max())
    assert (told["mode"] == Mode.RUN).all()
    assert (told["fault_state"] == FaultState.CLEAR).all()


@pytest.mark.parametrize("which", ["reference", "measured"])
def test_alone_a_missing_input_keeps_its_last_value(which):
    given = {"reference": REFERENCE.copy(), "measured": MEASURED.copy()}
    held = {name: values.copy() for name, values in given.items()}
    given[which][HELD], held[which][HELD] = np.nan, held[which][HELD.start - 1]
    target = Target(TICK_S, 1, "zoh", supervised=False)
    told, expected = alone(target, **given), alone(target, **held)
    for name in NAMES[:3]:
        np.testing.assert_array_equal(told[name], expected[name])
    assert np.flatnonzero(told["mode"] == Mode.BLIND).tolist() == [*range(20, 25)]


def test_alone_an_overflow_holds_the_commands():
    reference = REFERENCE.copy()
    reference[20] = 1e308
    told = alone(Target(TICK_S, supervised=False), reference, MEASURED)
    assert told["mode"][20] == Mode.BLIND
    assert told["command_1"][20] == told["command_1"][19]
    assert math.isfinite(told["command_2"][20])
