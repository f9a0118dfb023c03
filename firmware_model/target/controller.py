"""The control law, once: u1 = C(r - y), d̂ = F1 u + F2 y, u2 = F̂ d̂ (2.1), (2.37), (3.32).

Everything that runs the controller calls ``step``: a node on a bus, a simulation, a replay, a
batch of thousands. It allocates nothing and reads nothing but its arguments.

**The algebraic loop.** With a Tustin estimator at zero latency this tick's d̂ depends on this
tick's u2, which depends on this tick's d̂: F̂ is biproper and Tustin's G2 feeds through, with loop
gain T/(2τ+T) for the thesis's design. It is solved exactly, in one division made at design time,
and exactly too under saturation: for a loop gain below 1 the saturated solution of the linear loop
is the solution of the saturated loop. With a held-input estimator, or any latency, the gain is 0.

**Commands as the plant gets them.** A command is limited in size and rate and rounded to the grid
of its frame first, and that value is what the estimator works on; C goes on from the limited one.

**Compensation on confirmation.** The thesis feeds F̂ with d̂, which has waited for the bus twice:
once in the model, once on the way of u2. After a confirmed loss the lost channel's own command is
known at once, so F̂ may work on s w = s G1 u1 instead, s the share that is lost, and the delay
around the loop is halved.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from firmware_model.compiled import firmware
from firmware_model.target.adaptive_threshold import begin_watching
from firmware_model.target.biquad import advance, output, settle, settle_integrator
from firmware_model.target.bumpless_transfer import hand_over, let_go
from firmware_model.target.decision import CLEAR, decide, lost_now, remember
from firmware_model.target.layout import (
    MAX_LATENCY_TICKS,
    Mode,
    Record,
    RecordArray,
    state_type,
)
from firmware_model.target.probe import probe_response, probe_torque
from firmware_model.target.reference_shaper import govern, start

MODE_INIT, MODE_RUN, MODE_HOLD = int(Mode.INIT), int(Mode.RUN), int(Mode.HOLD)


def init(table: Record, n: int = 1) -> RecordArray:
    """``n`` states at rest for ``table``, in its precision: every memory zero, mode INIT."""
    precision = table.dtype["limit_1"].name
    return np.zeros(n, state_type(precision))


@firmware
def limited(command: float, before: float, limit: float, slew: float) -> float:
    """The command that the actuator can follow: within ``limit``, and ``slew`` from the last."""
    low, high = max(-limit, before - slew), min(limit, before + slew)
    return min(max(command, low), high)


@firmware
def as_sent(command: float, lsb: float) -> float:
    """The command as its frame carries it: on the grid of the frame."""
    if lsb > 0.0:
        command = np.rint(command / lsb) * lsb
    return command


@firmware
def step(table: Record, state: Record, reference: float, measurement: float) -> None:
    """One tick: from the reference and D* of this tick to the commands of this tick.

    Answers in ``state.command_1``, ``state.command_2``, ``state.fault_estimate``, ``state.mode``
    and ``state.fault_state``. An input that is not a finite number changes no command: the last
    good ones are held, the estimator follows them, and the mode says HOLD.

    Args:
        table: the constant table of ``tables.build``.
        state: what ``init`` made; changed in place.
        reference: r, in the measurement's unit.
        measurement: y (D*).
    """
    if not (math.isfinite(reference) and math.isfinite(measurement)):
        state.mode = MODE_HOLD
        follow_commands(table, state)
        return
    state.reference = reference  # stored first: the arithmetic is in the table's own precision
    state.measurement = measurement
    held_1, held_2 = state.command_1, state.command_2

    error = wanted(table, state) - table.feedback * state.measurement
    torque = output(table.tracking, state.tracking, table.tracking_n, error)
    if state.probe_at > 0:
        torque = torque + probe_torque(table, state)
    possible = limited(torque, held_1, table.limit_1, table.slew_1)
    # No wind-up: C goes on from the error that would have asked for what is possible (Hanus 1987).
    realisable = error + (possible - torque) * table.conditioning
    advance(table.tracking, state.tracking, table.tracking_n, realisable)
    state.command_1 = as_sent(possible, table.lsb_1)

    at_stake, kept = model_output(table, state)
    known = at_stake + kept - state.measurement

    # Every filter's answer to a zero: what this tick's u2 finds already there.
    zero = error - error
    q_rest = output(table.one_plus_q, state.one_plus_q, table.one_plus_q_n, zero)
    rest = output(table.compensator, state.compensator, table.compensator_n, zero)
    from_reference = table.reference_to_2 * state.reference

    # Without feedthrough of u2 this is already d̂; with it, all but what u2 changes in this tick.
    before = known + table.estimator_feedthrough_2 * held_2
    decide(table, state, q_rest + table.q_feedthrough * before, at_stake, kept)

    if table.on_confirmation:  # u2 = r2 + F̂w, with the w that is known before it reaches the plant
        drive, force = zero, from_reference
        if state.engaged:
            drive = hand_over(state, state.share_lost * lost_now(table, state))
            force = from_reference + rest + table.compensator_feedthrough * drive
    else:  # the thesis: u2 = r2 + rest + f(q_rest + q(known + g u2)), solved for u2
        estimate = q_rest + table.q_feedthrough * known
        force = from_reference + rest + table.compensator_feedthrough * estimate
        force = force * table.loop_inverse
        drive = zero
    state.command_2 = as_sent(limited(force, held_2, table.limit_2, table.slew_2), table.lsb_2)

    residual = known + table.estimator_feedthrough_2 * state.command_2
    estimate = advance(table.one_plus_q, state.one_plus_q, table.one_plus_q_n, residual)
    drive = drive if table.on_confirmation else estimate
    advance(table.compensator, state.compensator, table.compensator_n, drive)
    if not (math.isfinite(torque) and math.isfinite(force)):
        state.command_1, state.command_2 = held_1, held_2
        forget(state)
        state.mode = MODE_HOLD
        follow_commands(table, state)
        return
    state.fault_estimate = estimate
    state.mode = MODE_RUN
    remember(table, state)
    follow_commands(table, state)


@firmware
def wanted(table: Record, state: Record) -> float:
    """What C follows: the reference, governed where the motor has a limit, and a probe's answer."""
    r: float = state.reference
    if table.governs:
        govern(table, state)
        r = state.governed
    if state.probe_at > 0:
        r = r + probe_response(table, state)
    return r


@firmware
def forget(state: Record) -> None:
    """Empty every memory after an overflow: a number that is lost must not stay lost."""
    start(state, 0.0, 0.0)
    state.probe_at = 0
    state.tracking[:] = 0
    state.estimator_1[:] = 0
    state.estimator_2[:] = 0
    state.one_plus_q[:] = 0
    state.compensator[:] = 0
    state.lost[:] = 0
    begin_watching(state, 0.0)
    let_go(state)


@firmware
def model_output(table: Record, state: Record) -> tuple[float, float]:
    """G1 u1 and G2 u2 as the plant shows them at this tick, without what this tick's u2 adds."""
    u1 = state.command_1
    u2 = u1 - u1
    if table.latency_ticks > 0:
        u1 = state.delay_1[state.delay_at]
        u2 = state.delay_2[state.delay_at]
    return (
        output(table.estimator_1, state.estimator_1, table.estimator_1_n, u1),
        output(table.estimator_2, state.estimator_2, table.estimator_2_n, u2),
    )


@firmware
def follow_commands(table: Record, state: Record) -> None:
    """Advance F1 by the commands that reach the plant this tick, and the delay line by one."""
    u1, u2 = state.command_1, state.command_2
    if table.latency_ticks > 0:
        at = state.delay_at
        u1, state.delay_1[at] = state.delay_1[at], u1
        u2, state.delay_2[at] = state.delay_2[at], u2
        state.delay_at = (at + 1) % table.latency_ticks
    state.acting_1 = u1
    advance(table.estimator_1, state.estimator_1, table.estimator_1_n, u1)
    advance(table.estimator_2, state.estimator_2, table.estimator_2_n, u2)


@firmware
def reset(table: Record, state: Record, reference: float) -> None:
    """Put a healthy loop where a constant ``reference`` would have brought it.

    The next ``step`` with that reference, and the measurement that settles at it, repeats the
    commands: no bump.
    """
    state.reference = reference
    start(state, state.reference, 0.0)
    target = state.reference
    zero = target - target
    limit_1, limit_2 = table.limit_1, table.limit_2
    torque = as_sent(limited(table.steady_1 * target, zero, limit_1, limit_1), table.lsb_1)
    force = as_sent(limited(table.reference_to_2 * target, zero, limit_2, limit_2), table.lsb_2)
    if table.integrates:
        settle_integrator(table.tracking, state.tracking, table.tracking_n, torque)
    else:
        settle(table.tracking, state.tracking, table.tracking_n, target)
    settle(table.estimator_1, state.estimator_1, table.estimator_1_n, torque)
    settle(table.estimator_2, state.estimator_2, table.estimator_2_n, force)
    settle(table.one_plus_q, state.one_plus_q, table.one_plus_q_n, zero)
    settle(table.compensator, state.compensator, table.compensator_n, zero)
    for i in range(MAX_LATENCY_TICKS):
        state.delay_1[i] = torque
        state.delay_2[i] = force
        state.delay_lost[i] = zero
    state.delay_at = 0
    state.lost[:] = zero
    state.command_1, state.command_2 = torque, force
    state.acting_1 = torque
    state.fault_estimate = zero
    begin_watching(state, model_output(table, state)[0])
    state.decide_ticks = 0
    state.probe_at = 0
    state.engaged = 0
    let_go(state)
    state.mode = MODE_INIT
    state.fault_state = CLEAR


@firmware
def step_many(tables: RecordArray, states: RecordArray, references: Any, measurements: Any) -> None:
    """``step`` for each of n controllers: record arrays (n,), reference and measurement (n,)."""
    for i in range(len(states)):
        step(tables[i], states[i], references[i], measurements[i])


@firmware
def step_first(
    tables: RecordArray, states: RecordArray, reference: float, measurement: float
) -> tuple[float, float, float, int, int]:
    """``step`` for the first of the controllers, and what it answers.

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
    )
