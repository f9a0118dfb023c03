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
from firmware_model.law.core.estimator import model_output, take_measurement
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
from firmware_model.law.core.tracking import missing_output, track_on
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
from firmware_model.law.supervision.lost_commands import revise
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
from firmware_model.law.supervision.steady_state import settle_estimator, settle_tracking
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
    from firmware_model.law import monitor
    from firmware_model.law.core import thesis
    from firmware_model.law.layout import Supervision, Table


MODE_STANDBY, MODE_SAFE_STOP = int(Mode.STANDBY), int(Mode.SAFE_STOP)


def init(table: Table, n: int = 1) -> Records[State]:
    """``n`` states at rest for ``table``, in its precision: every memory zero, mode STANDBY."""
    states = zeroed(State, precision_of(table), n)
    start_up(table, states[0])
    rows = states.view("u1").reshape(n, -1)  # a copy field by field takes long
    rows[1:] = rows[0]
    return states


@firmware
def start_up(table: Table, state: State) -> None:
    """Turn a state of zeros into a state at rest."""
    none = real(0.0, state.command_1)
    clear_mismatch(table.mismatch, state.supervision.mismatch)
    learn_loss(table.mismatch, state.supervision.mismatch, none, none)


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
    own = state.supervision
    repair(table, state, own)
    r, y = real(reference, state.reference), real(measurement, state.measurement)
    told = math.isfinite(r)
    frozen = own.hypotheses.verdict == SENSOR_FROZEN and y == state.measurement
    measured = math.isfinite(y) and not frozen
    begins = table.prediction.enabled == 1 and own.takeover.pending != BEGUN
    makes = table.witness.makes == 1
    if (begins or makes) and not measured and has_news(own.witness):
        y = said(table.witness, own.witness)
        measured = math.isfinite(y)
    if makes:
        use_samples(own.witness)
    seen = (measured and own.witness.denied == 0) or own.witness.left > 0
    predicts = table.prediction.enabled == 1 and own.takeover.pending == BEGUN
    suspected = state.fault_state == CONFIRMED or own.hypotheses.verdict == BOTH_LOST
    lost = both_lost(table, own.safe_stop, suspected, state.monitor.powerless)
    if table.supervised == 0:
        run_alone(table, state, r, y)
    elif lost or is_blind(table, own.prediction, told and seen):
        stop(table, state, own, lost)
    elif stands_by(table, own.standby, told and measured):
        nearer_to_zero(table, state, ticks_left_in_standby(table, own.standby))
        go_on(table, state, own)
        clear_prediction(own.prediction)
        state.mode = MODE_STANDBY
    elif told and (measured or predicts):
        if own.standby.elapsed > 0.0:
            save(own, state.fault_state)
            own.takeover.pending = AT_REST
        if own.takeover.pending != BEGUN:
            take_over(table, state, own, r, y)
        own.takeover.pending = BEGUN
        compute(table, state, own, r, y, measured)
    else:
        go_on(table, state, own)
        state.mode = MODE_BLIND
    take_away(table, state, state.monitor, r, y)
    if state.monitor.reason != 0:
        own.hypotheses.verdict = state.monitor.reason


@firmware
def stop(table: Table, core: thesis.State, own: Supervision, lost: bool) -> None:
    """A tick of a safe stop, because both actuators are ``lost`` or an input is missing."""
    if lost:
        own.hypotheses.verdict = BOTH_LOST
    left = ticks_left(table, own.safe_stop, own.prediction.elapsed, lost)
    nearer_to_zero(table, core, left)
    go_on(table, core, own)
    core.mode = MODE_SAFE_STOP


@firmware
def take_away(table: Table, core: thesis.State, own: monitor.State, r: float, y: float) -> None:
    """Let the monitor have the last word on the commands; F1 follows what is left.

    Without latency F1 has taken in the commands already: d̂ is no estimate from then on.
    """
    estimator, constants = core.estimator, table.estimator
    left_1, left_2 = watch(table.monitor, own, r, y, core.command_1, core.command_2)
    core.command_1, core.command_2 = left_1, left_2
    if own.reason == 0:
        return
    if own.reason > COMPENSATION_OFF:
        core.mode = MODE_SAFE_STOP
    if constants.latency_ticks > 0:
        revise(estimator.queue_1, constants.shown_ticks_1, 1, left_1)
        revise(estimator.queue_2, constants.shown_ticks_2, 1, left_2)


@firmware
def take_over(table: Table, core: thesis.State, own: Supervision, r: float, y: float) -> None:
    """The first tick with both inputs: a takeover, if the plant moves."""
    model_1, model_2 = model_output(table.estimator, core.estimator, core.command_1, core.command_2)
    y = y - known_offset(own.saved)
    difference = y - predicted(table, core.estimator.measurement, model_1 + model_2)
    moves = table.takeover.enabled == 1 and abs(difference) > table.takeover.least
    level = real(0.0, y)
    if moves and own.takeover.pending == UNKNOWN:
        level = wanted_level(r, y)
    if moves or own.saved.fingerprint != 0:
        settle_loop(table, core, own, level)
    if moves:
        begin_takeover(table.estimator.channel_1, own.takeover, level, y - level)


@firmware
def compute(
    table: Table, core: thesis.State, own: Supervision, r: float, y: float, measured: bool
) -> None:
    """A tick with a reference ``r``, and a measurement ``y`` to be used where ``measured``."""
    core.reference = r
    show_motion(table.estimator.channel_1, own.takeover)
    r = led_reference(table.takeover, own.takeover, r)
    listening = measured and listens(table.takeover, own.takeover)
    held_1, held_2, tick = core.command_1, core.command_2, core.tick
    begin_tick(table, core)
    model = tick.model_1 + tick.model_2
    if table.witness.longest > 0 and table.witness.makes == 0:
        witness(table, core, own, y, model)
        measured = measured and own.witness.denied == 0
    y = measurement_or_prediction(table, core, own, y, measured, model)
    tracked = tracked_reference(table.reference_shaper, core.reference_shaper, r)
    seen = y + own.prediction.fading
    seen += missing_output(table.estimator, core.tracking, core.estimator, core.shortfall_2)
    command_torque(table, core, tracked, seen, y)

    # Without feedthrough of u2 the sum is the residual; with feedthrough u2 of this tick is
    # missing.
    if measured and not listening:
        residual = tick.residual + table.estimator.feedthrough_2 * held_2
        decide(table, core, own, residual)
    else:
        show_acting_commands(table, core, own)

    loss = real(0.0, held_1)
    if table.compensator.on_confirmation > 0:  # F̂ works on s w, with the w of this tick's command
        loss = transfer(own.bumpless_transfer, missing_by_loss(table, core, own))
    estimate = command_force(table, core, r, loss)
    if tick.overflows == 1:
        forget(table, core, own, held_1, held_2)
        return
    core.fault_estimate = estimate
    core.mode = MODE_RUN if measured else MODE_BLIND
    advance_models(table, core, own, tick.asked_1 - tick.possible_1, tick.asked_2 - tick.possible_2)


@firmware
def witness(
    table: Table, core: thesis.State, own: Supervision, y: float, model_output: float
) -> None:
    """Let the witness judge the sensor, and a known loss of channel 1."""
    seen, before, m = own.witness, own.witness.denied, core.estimator.measurement
    expected = predicted(table, m, model_output - missing_now(table, core, own))
    weigh_witness(table, seen, y, expected, predicted(table, m, model_output))
    if seen.denied > before:
        set_aside(table, core, own)
        turn_to_witness(own.prediction, seen.difference)
    told = says_lost(table.echoes.actuators[TORQUE], own.echoes.actuators[TORQUE])
    if core.fault_state == CONFIRMED and refutes(table.witness, seen) and not told:
        own.prediction.difference -= missing_now(table, core, own)
        withdraw_loss(table, core, own)
        forget_loss(seen)
    if seen.denied == 1:
        believe_with_witness(table, own.hypotheses, own.mismatch, own.echoes, seen)
        own.hypotheses.verdict = SENSOR_WRONG
    elif before == 1:
        own.hypotheses.verdict = NOTHING


@firmware
def forget(
    table: Table, core: thesis.State, own: Supervision, held_1: float, held_2: float
) -> None:
    """A tick whose numbers overflow: its measurement is not used, and the commands are held."""
    core.command_1, core.command_2 = held_1, held_2
    clear_memories(table, core, own)
    go_on(table, core, own)
    core.mode = MODE_BLIND


@firmware
def measurement_or_prediction(
    table: Table,
    core: thesis.State,
    own: Supervision,
    y: float,
    measured: bool,
    model_output: float,
) -> float:
    """Return y less the motion of a takeover where ``measured``, otherwise what stands in for y."""
    stand, constants, m = own.prediction, table.prediction, core.estimator.measurement
    expected = predicted(table, m, model_output - missing_now(table, core, own))
    if measured:
        core.measurement = y
    y = y - own.takeover.shown
    if measured and listens(table.takeover, own.takeover):
        own.takeover.error = y - stand.difference - expected
    elif measured:
        note_measurement(constants, stand, y, expected)
        return y
    elif math.isfinite(y):
        distrust(stand, y, expected)
    if own.witness.left > 0:
        follow_witness(constants, stand, own.witness.difference)
    stood_in: float = stand_in(constants, stand, expected)
    return stood_in


@firmware
def go_on(table: Table, core: thesis.State, own: Supervision) -> None:
    """A tick whose commands do not follow from its inputs: the models follow the commands."""
    own.prediction.elapsed += real(1.0, core.command_1)
    model_1, model_2 = model_output(table.estimator, core.estimator, core.command_1, core.command_2)
    shown = model_1 + model_2 - missing_now(table, core, own)
    expected = predicted(table, core.estimator.measurement, shown)
    take_measurement(table.estimator, core.estimator, expected)
    show_acting_commands(table, core, own)
    asked_1 = track_on(table.tracking, core.tracking, core.command_1)
    short_1 = asked_1 - core.command_1
    short_2 = real(0.0, core.command_2)
    if table.compensator.on_confirmation > 0:
        drive = transfer(own.bumpless_transfer, missing_by_loss(table, core, own))
        force = advance(table.compensator.filter, core.compensator.filter, drive)
        short_2 = force - core.command_2
    advance_models(table, core, own, short_1, short_2)


@firmware
def advance_models(
    table: Table, core: thesis.State, own: Supervision, short_1: float, short_2: float
) -> None:
    """Advance every model of the plant by the commands of this tick.

    ``short_1`` and ``short_2`` are asked minus possible commands of the channels.
    """
    model, heard, found = core.estimator, own.echoes, own.hypotheses
    command_1, command_2 = core.command_1, core.command_2
    advance_loss_model(table, own.loss_model, model, lost_command(core.fault_state, command_1))
    advance_candidate(table, own.sequential_test, model, command_1)
    advance_other_cars(table, own.other_cars, model.measured, command_2)
    advance_signatures(table, found.signatures, heard, own.other_cars.command_2)
    advance_echoes(table, heard, model, command_1, command_2, core.fault_state == CONFIRMED)
    advance_witness(table, own.witness)
    advance_sensor_error(table, found.sensor_error)
    end_tick(table, core, short_1, short_2)
    advance_motion(table.takeover, table.estimator.channel_1, own.takeover)
    if own.takeover.active and own.takeover.elapsed == table.takeover.listening:
        doubt_motion(table.mismatch, own.mismatch, doubt(table.takeover, own.takeover))
        restart_test(table, core, own)


@firmware
def missing_now(table: Table, core: thesis.State, own: Supervision) -> float:
    """All that is known to be missing in the measurement of this tick."""
    lost = lost_command(core.fault_state, core.command_1)
    loss, known = own.loss_model, own.mismatch
    return missing_shown(table, loss, known, core.estimator, own.echoes, lost)


@firmware
def reset(table: Table, state: State, reference: float) -> None:
    """Put the controller into the steady state of a healthy loop at a constant ``reference``.

    The next ``step`` with the same reference and the settled measurement repeats the commands: no
    bump.
    """
    own = state.supervision
    repair(table, state, own)
    own.saved.fingerprint = 0
    state.reference = reference
    settle_loop(table, state, own, state.reference)
    clear_monitor(state.monitor)
    own.takeover.pending = BEGUN
    state.mode = MODE_STANDBY


@firmware
def settle_loop(table: Table, core: thesis.State, own: Supervision, target: float) -> None:
    """Put the loop into the steady state at a constant ``target``, with what ``saved`` knows."""
    zero, one = real(0.0, target), real(1.0, target)
    start(core.reference_shaper, target)
    shown = settle(table.estimator.measurement, core.estimator.measurement, target)
    asked_1 = settle_tracking(table.tracking, core.tracking, shown)
    core.actuator_1.rounded_off = core.actuator_2.rounded_off = zero
    torque = quantise(table.actuator_1, core.actuator_1, saturate(table.actuator_1, asked_1))
    core.fault_state = CLEAR
    clear_loss_model(own.loss_model)
    release(own.bumpless_transfer)
    lost = recall_loss(table, own.saved, own.loss_model, torque)
    if knows_loss(own.saved):
        core.fault_state = CONFIRMED
        own.bumpless_transfer.carried = lost
    asked_2 = table.compensator.reference_share * target
    asked_2 += settle(table.compensator.filter, core.compensator.filter, lost)
    force = quantise(table.actuator_2, core.actuator_2, saturate(table.actuator_2, asked_2))
    core.command_1, core.command_2, core.fault_estimate = torque, force, lost
    settle_estimator(table.estimator, core.estimator, torque, force, target)
    settle(table.estimator.one_plus_q, core.estimator.one_plus_q, lost)
    model_1, model_2 = model_output(table.estimator, core.estimator, torque, force)
    measured, left = core.estimator.measured, (one - own.loss_model.share) * torque
    settle_other_cars(table, own.other_cars, measured, left, force)
    settle_mismatch(table, own.mismatch, own.other_cars.shown, model_1 + model_2)
    restart_test(table, core, own)
    clear_hypotheses(own.hypotheses)
    settle_echoes(table.echoes, own.echoes, torque, force)
    settle_witness(own.witness, target)
    settle_corroboration(own.corroboration)
    clear_prediction(own.prediction)
    own.prediction.difference = known_offset(own.saved)
    w = own.loss_model.previous_output
    recall_car(table, own.saved, own.mismatch, own.hypotheses, w, lost)
    own.safe_stop.elapsed = own.standby.elapsed = 0.0
    own.standby.slow = 0
    core.shortfall_1.accumulators[:] = 0.0
    core.shortfall_2.accumulators[:] = 0.0
    end_takeover(own.takeover)


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
        state.supervision.hypotheses.verdict,
    )
