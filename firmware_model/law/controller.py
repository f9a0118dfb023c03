"""The control law, once: the thesis's law (``core.thesis``), supervised, watched by the monitor.

Every runner calls ``step``: a node on a bus, a simulation, a replay, a batch of thousands. ``step``
allocates no memory and reads only its arguments. A table that is not ``supervised`` runs the
thesis's law and the monitor alone.

**Compensation on confirmation.** The thesis feeds F̂ with d̂, and d̂ waits for the bus twice: once
in the model, once on the way of u2. After a confirmed loss the controller knows the lost channel's
command at once, so F̂ may work on s w = s G1 u1 instead, with s the lost share. The delay around
the loop is then halved.

**Whose fault it is.** The decision subtracts a known sensor bias from d̂; no other module does. A
frozen sensor gives no information: its measurement counts as missing. With both channels lost the
commands go to zero, if the table asks for a safe stop. F̂ on d̂ compensates under every verdict.

**Inputs that are missing.** The model's prediction stands in for a missing measurement
(``supervision.prediction``): C is a feedforward then, and only the decision waits. Without a
reference the controller holds the commands. The held commands act on the plant, so every model of
the plant goes on with them: F1, w (a lost channel owes these commands too), and F̂ where F̂ works on
w. After the longest time without an input the commands go to zero, until both inputs come. Below
the lowest design the controller stands by (``standby``).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from firmware_model.compiled import firmware
from firmware_model.law.core.actuator import quantise, saturate
from firmware_model.law.core.biquad import advance, settle
from firmware_model.law.core.estimator import (
    model_output,
    revise,
    settle_estimator,
    take_measurement,
)
from firmware_model.law.core.reference_shaper import start, tracked_reference
from firmware_model.law.core.thesis import (
    MODE_BLIND,
    MODE_RUN,
    begin_tick,
    command_force,
    command_torque,
    end_tick,
    run_alone,
)
from firmware_model.law.core.tracking import missing_output, settle_tracking, track_on
from firmware_model.law.layout import State, precision_of
from firmware_model.law.monitor import COMPENSATION_OFF, clear_monitor, watch
from firmware_model.law.precision import real
from firmware_model.law.status import Mode
from firmware_model.law.structs import Records, zeroed
from firmware_model.law.supervision.bumpless_transfer import release, transfer
from firmware_model.law.supervision.corroboration import settle_corroboration
from firmware_model.law.supervision.decision import (
    CLEAR,
    CONFIRMED,
    decide,
    missing_by_loss,
    restart_test,
    set_aside,
    show_acting_commands,
    withdraw_loss,
)
from firmware_model.law.supervision.echoes import TORQUE, advance_echoes, says_lost, settle_echoes
from firmware_model.law.supervision.knowledge import (
    known_offset,
    knows_loss,
    recall_car,
    recall_loss,
    save,
)
from firmware_model.law.supervision.likelihood_ratio import advance_candidate
from firmware_model.law.supervision.loss_model import (
    advance_loss_model,
    clear_loss_model,
    lost_command,
    missing_shown,
)
from firmware_model.law.supervision.mismatch import (
    clear_mismatch,
    doubt_motion,
    learn_loss,
    settle_mismatch,
)
from firmware_model.law.supervision.other_cars import advance_other_cars, settle_other_cars
from firmware_model.law.supervision.overflow import clear_memories, repair
from firmware_model.law.supervision.prediction import (
    clear_prediction,
    distrust,
    follow_witness,
    note_measurement,
    predicted,
    stand_in,
    turn_to_witness,
)
from firmware_model.law.supervision.safe_stop import both_lost, is_blind, nearer_to_zero, ticks_left
from firmware_model.law.supervision.sensor_error import advance_sensor_error
from firmware_model.law.supervision.signatures import advance_signatures
from firmware_model.law.supervision.standby import stands_by, ticks_left_in_standby
from firmware_model.law.supervision.takeover import (
    AT_REST,
    BEGUN,
    UNKNOWN,
    advance_motion,
    begin_takeover,
    doubt,
    end_takeover,
    led_reference,
    listens,
    show_motion,
    wanted_level,
)
from firmware_model.law.supervision.verdict import (
    BOTH_LOST,
    NOTHING,
    SENSOR_FROZEN,
    SENSOR_WRONG,
    believe_with_witness,
    clear_hypotheses,
)
from firmware_model.law.supervision.witness import (
    advance_witness,
    forget_loss,
    has_news,
    refutes,
    said,
    settle_witness,
    use_samples,
    weigh_witness,
)

if TYPE_CHECKING:
    from firmware_model.law.layout import Table


MODE_STANDBY, MODE_SAFE_STOP = int(Mode.STANDBY), int(Mode.SAFE_STOP)


def init(table: Table, n: int = 1) -> Records[State]:
    """``n`` states at rest for ``table``, in its precision: every memory zero, mode STANDBY."""
    states = zeroed(State, precision_of(table), n)
    for state in states:
        start_up(table, state)
    return states


@firmware
def start_up(table: Table, state: State) -> None:
    """Turn a state of zeros into a state at rest."""
    none = real(0.0, state.command_1)
    clear_mismatch(table.mismatch, state.mismatch)
    learn_loss(table.mismatch, state.mismatch, none, none)


@firmware
def step(table: Table, state: State, reference: float, measurement: float) -> None:
    """One tick: from the reference and D* of this tick to the commands of this tick.

    The answers are ``state.command_1``, ``state.command_2``, ``state.fault_estimate``,
    ``state.mode`` and ``state.fault_state``. An input that is not finite is missing.

    Args:
        table: the constant table of ``tables.build``.
        state: what ``init`` made; changed in place.
        reference: r, in the measurement's unit, in any precision.
        measurement: y (D*), likewise.
    """
    repair(table, state)
    r, y = real(reference, state.reference), real(measurement, state.measurement)
    told = math.isfinite(r)
    frozen = state.hypotheses.verdict == SENSOR_FROZEN and y == state.measurement
    measured = math.isfinite(y) and not frozen
    begins = table.prediction.enabled == 1 and state.takeover.pending != BEGUN
    makes = table.witness.makes == 1
    if (begins or makes) and not measured and has_news(state.witness):
        y = said(table.witness, state.witness)
        measured = math.isfinite(y)
    if makes:
        use_samples(state.witness)
    seen = (measured and state.witness.denied == 0) or state.witness.left > 0
    predicts = table.prediction.enabled == 1 and state.takeover.pending == BEGUN
    suspected = state.fault_state == CONFIRMED or state.hypotheses.verdict == BOTH_LOST
    lost = both_lost(table, state.safe_stop, suspected, state.monitor.powerless)
    if table.supervised == 0:
        run_alone(table, state, r, y)
    elif lost or is_blind(table, state.prediction, told and seen):
        stop(table, state, lost)
    elif stands_by(table, state.standby, told and measured):
        nearer_to_zero(table, state, ticks_left_in_standby(table, state.standby))
        go_on(table, state)
        clear_prediction(state.prediction)
        state.mode = MODE_STANDBY
    elif told and (measured or predicts):
        if state.standby.elapsed > 0.0:
            save(state)
            state.takeover.pending = AT_REST
        if state.takeover.pending != BEGUN:
            take_over(table, state, r, y)
        state.takeover.pending = BEGUN
        compute(table, state, r, y, measured)
    else:
        go_on(table, state)
        state.mode = MODE_BLIND
    take_away(table, state, r, y)


@firmware
def stop(table: Table, state: State, lost: bool) -> None:
    """A tick of a safe stop, because both actuators are ``lost`` or an input is missing."""
    if lost:
        state.hypotheses.verdict = BOTH_LOST
    left = ticks_left(table, state.safe_stop, state.prediction.elapsed, lost)
    nearer_to_zero(table, state, left)
    go_on(table, state)
    state.mode = MODE_SAFE_STOP


@firmware
def take_away(table: Table, state: State, r: float, y: float) -> None:
    """Let the monitor have the last word on the commands; F1 follows what is left.

    Without latency F1 has taken in the commands already: d̂ is no estimate from then on.
    """
    own, estimator, constants = state.monitor, state.estimator, table.estimator
    left_1, left_2 = watch(table.monitor, own, r, y, state.command_1, state.command_2)
    state.command_1, state.command_2 = left_1, left_2
    if own.reason == 0:
        return
    state.hypotheses.verdict = own.reason
    if own.reason > COMPENSATION_OFF:
        state.mode = MODE_SAFE_STOP
    if constants.latency_ticks > 0:
        revise(estimator.queue_1, constants.shown_ticks_1, 1, left_1)
        revise(estimator.queue_2, constants.shown_ticks_2, 1, left_2)


@firmware
def take_over(table: Table, state: State, r: float, y: float) -> None:
    """The first tick with both inputs: a takeover, if the plant moves."""
    model_1, model_2 = model_output(
        table.estimator, state.estimator, state.command_1, state.command_2
    )
    y = y - known_offset(state.saved)
    difference = y - predicted(table, state.estimator.measurement, model_1 + model_2)
    moves = table.takeover.enabled == 1 and abs(difference) > table.takeover.least
    level = real(0.0, y)
    if moves and state.takeover.pending == UNKNOWN:
        level = wanted_level(r, y)
    if moves or state.saved.fingerprint != 0:
        settle_loop(table, state, level)
    if moves:
        begin_takeover(table.estimator.channel_1, state.takeover, level, y - level)


@firmware
def compute(table: Table, state: State, r: float, y: float, measured: bool) -> None:
    """A tick with a reference ``r``, and a measurement ``y`` to be used where ``measured``."""
    state.reference = r
    show_motion(table.estimator.channel_1, state.takeover)
    r = led_reference(table.takeover, state.takeover, r)
    listening = measured and listens(table.takeover, state.takeover)
    held_1, held_2, tick = state.command_1, state.command_2, state.tick
    begin_tick(table, state)
    model = tick.model_1 + tick.model_2
    if table.witness.longest > 0 and table.witness.makes == 0:
        witness(table, state, y, model)
        measured = measured and state.witness.denied == 0
    y = measurement_or_prediction(table, state, y, measured, model)
    tracked = tracked_reference(table.reference_shaper, state.reference_shaper, r)
    seen = y + state.prediction.fading
    seen += missing_output(table.estimator, state.tracking, state.estimator, state.shortfall_2)
    command_torque(table, state, tracked, seen, y)

    # Without feedthrough of u2 the sum is the residual; with feedthrough u2 of this tick is
    # missing.
    if measured and not listening:
        residual = tick.residual + table.estimator.feedthrough_2 * held_2
        decide(table, state, residual, tick.model_1, tick.model_2)
    else:
        show_acting_commands(table, state)

    loss = real(0.0, held_1)
    if table.compensator.on_confirmation > 0:  # F̂ works on s w, with the w of this tick's command
        loss = transfer(state.bumpless_transfer, missing_by_loss(table, state))
    estimate = command_force(table, state, r, loss)
    if tick.overflows == 1:
        forget(table, state, held_1, held_2)
        return
    state.fault_estimate = estimate
    state.mode = MODE_RUN if measured else MODE_BLIND
    advance_models(table, state, tick.asked_1 - tick.possible_1, tick.asked_2 - tick.possible_2)


@firmware
def witness(table: Table, state: State, y: float, model_output: float) -> None:
    """Let the witness judge the sensor, and a known loss of channel 1."""
    own, before, m = state.witness, state.witness.denied, state.estimator.measurement
    expected = predicted(table, m, model_output - missing_now(table, state))
    weigh_witness(table, own, y, expected, predicted(table, m, model_output))
    if own.denied > before:
        set_aside(table, state)
        turn_to_witness(state.prediction, own.difference)
    told = says_lost(table.echoes.actuators[TORQUE], state.echoes.actuators[TORQUE])
    if state.fault_state == CONFIRMED and refutes(table.witness, own) and not told:
        state.prediction.difference -= missing_now(table, state)
        withdraw_loss(table, state)
        forget_loss(own)
    if own.denied == 1:
        believe_with_witness(table, state.hypotheses, state.mismatch, state.echoes, own)
        state.hypotheses.verdict = SENSOR_WRONG
    elif before == 1:
        state.hypotheses.verdict = NOTHING


@firmware
def forget(table: Table, state: State, held_1: float, held_2: float) -> None:
    """A tick whose numbers overflow: its measurement is not used, and the commands are held."""
    state.command_1, state.command_2 = held_1, held_2
    clear_memories(table, state)
    go_on(table, state)
    state.mode = MODE_BLIND


@firmware
def measurement_or_prediction(
    table: Table, state: State, y: float, measured: bool, model_output: float
) -> float:
    """Return y less the motion of a takeover where ``measured``, otherwise what stands in for y."""
    own, constants, m = state.prediction, table.prediction, state.estimator.measurement
    expected = predicted(table, m, model_output - missing_now(table, state))
    if measured:
        state.measurement = y
    y = y - state.takeover.shown
    if measured and listens(table.takeover, state.takeover):
        state.takeover.error = y - own.difference - expected
    elif measured:
        note_measurement(constants, own, y, expected)
        return y
    elif math.isfinite(y):
        distrust(own, y, expected)
    if state.witness.left > 0:
        follow_witness(constants, own, state.witness.difference)
    stood_in: float = stand_in(constants, own, expected)
    return stood_in


@firmware
def go_on(table: Table, state: State) -> None:
    """A tick whose commands do not follow from its inputs: the models follow the commands."""
    state.prediction.elapsed += real(1.0, state.command_1)
    model_1, model_2 = model_output(
        table.estimator, state.estimator, state.command_1, state.command_2
    )
    shown = model_1 + model_2 - missing_now(table, state)
    expected = predicted(table, state.estimator.measurement, shown)
    take_measurement(table.estimator, state.estimator, expected)
    show_acting_commands(table, state)
    asked_1 = track_on(table.tracking, state.tracking, state.command_1)
    short_1 = asked_1 - state.command_1
    short_2 = real(0.0, state.command_2)
    if table.compensator.on_confirmation > 0:
        drive = transfer(state.bumpless_transfer, missing_by_loss(table, state))
        force = advance(table.compensator.filter, state.compensator.filter, drive)
        short_2 = force - state.command_2
    advance_models(table, state, short_1, short_2)


@firmware
def advance_models(table: Table, state: State, short_1: float, short_2: float) -> None:
    """Advance every model of the plant by the commands of this tick.

    ``short_1`` and ``short_2`` are asked minus possible commands of the channels.
    """
    model, heard, found = state.estimator, state.echoes, state.hypotheses
    command_1, command_2 = state.command_1, state.command_2
    advance_loss_model(table, state.loss_model, model, lost_command(state.fault_state, command_1))
    advance_candidate(table, state.sequential_test, model, command_1)
    advance_other_cars(table, state.other_cars, model.measured, command_2)
    advance_signatures(table, found.signatures, heard, state.other_cars.command_2)
    advance_echoes(table, heard, model, command_1, command_2, state.fault_state == CONFIRMED)
    advance_witness(table, state.witness)
    advance_sensor_error(table, found.sensor_error)
    end_tick(table, state, short_1, short_2)
    advance_motion(table.takeover, table.estimator.channel_1, state.takeover)
    if state.takeover.active and state.takeover.elapsed == table.takeover.listening:
        doubt_motion(table.mismatch, state.mismatch, doubt(table.takeover, state.takeover))
        restart_test(table, state)


@firmware
def missing_now(table: Table, state: State) -> float:
    """All that is known to be missing in the measurement of this tick."""
    lost = lost_command(state.fault_state, state.command_1)
    loss, known = state.loss_model, state.mismatch
    return missing_shown(table, loss, known, state.estimator, state.echoes, lost)


@firmware
def reset(table: Table, state: State, reference: float) -> None:
    """Put the controller into the steady state of a healthy loop at a constant ``reference``.

    The next ``step`` with the same reference and the settled measurement repeats the commands: no
    bump.
    """
    repair(table, state)
    state.saved.fingerprint = 0
    state.reference = reference
    settle_loop(table, state, state.reference)
    clear_monitor(state.monitor)
    state.takeover.pending = BEGUN
    state.mode = MODE_STANDBY


@firmware
def settle_loop(table: Table, state: State, target: float) -> None:
    """Put the loop into the steady state at a constant ``target``, with what ``saved`` knows."""
    zero, one = real(0.0, target), real(1.0, target)
    start(state.reference_shaper, target)
    shown = settle(table.estimator.measurement, state.estimator.measurement, target)
    asked_1 = settle_tracking(table.tracking, state.tracking, shown)
    state.actuator_1.rounded_off = state.actuator_2.rounded_off = zero
    torque = quantise(table.actuator_1, state.actuator_1, saturate(table.actuator_1, asked_1))
    state.fault_state = CLEAR
    clear_loss_model(state.loss_model)
    release(state.bumpless_transfer)
    lost = recall_loss(table, state.saved, state.loss_model, torque)
    if knows_loss(state.saved):
        state.fault_state = CONFIRMED
        state.bumpless_transfer.carried = lost
    asked_2 = table.compensator.reference_share * target
    asked_2 += settle(table.compensator.filter, state.compensator.filter, lost)
    force = quantise(table.actuator_2, state.actuator_2, saturate(table.actuator_2, asked_2))
    state.command_1, state.command_2, state.fault_estimate = torque, force, lost
    settle_estimator(table.estimator, state.estimator, torque, force, target)
    settle(table.estimator.one_plus_q, state.estimator.one_plus_q, lost)
    model_1, model_2 = model_output(table.estimator, state.estimator, torque, force)
    measured, left = state.estimator.measured, (one - state.loss_model.share) * torque
    settle_other_cars(table, state.other_cars, measured, left, force)
    settle_mismatch(table, state.mismatch, state.other_cars.shown, model_1 + model_2)
    restart_test(table, state)
    clear_hypotheses(state.hypotheses)
    settle_echoes(table.echoes, state.echoes, torque, force)
    settle_witness(state.witness, target)
    settle_corroboration(state.corroboration)
    clear_prediction(state.prediction)
    state.prediction.difference = known_offset(state.saved)
    w = state.loss_model.previous_output
    recall_car(table, state.saved, state.mismatch, state.hypotheses, w, lost)
    state.safe_stop.elapsed = state.standby.elapsed = 0.0
    state.standby.slow = 0
    state.shortfall_1.accumulators[:] = 0.0
    state.shortfall_2.accumulators[:] = 0.0
    end_takeover(state.takeover)


@firmware
def step_many(
    tables: Records[Table], states: Records[State], references: Any, measurements: Any
) -> None:
    """``step`` for each of n controllers: record arrays (n,), reference and measurement (n,)."""
    for i in range(len(states)):
        step(tables[i], states[i], references[i], measurements[i])


@firmware
def step_first(
    tables: Records[Table], states: Records[State], reference: float, measurement: float
) -> tuple[float, float, float, int, int, int]:
    """Run ``step`` for the first controller and return its answers.

    Arrays of one record are the fastest way from interpreted code to compiled code and back.
    """
    state = states[0]
    step(tables[0], state, reference, measurement)
    return (
        state.command_1,
        state.command_2,
        state.fault_estimate,
        state.mode,
        state.fault_state,
        state.hypotheses.verdict,
    )
