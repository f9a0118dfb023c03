"""Is channel 1 lost? The tick-by-tick decision on the fault estimate d̂.

``mismatch`` removes the effect of other cars from d̂, ``loss_model`` removes known losses, and
``likelihood_ratio`` weighs the rest for a loss, or for the return of a lost channel. The evidence g
makes a loss

    SUSPECTED   from ``suspect`` on: the driver may be told
    CONFIRMED   from ``confirm`` on, by chance once in a given number of hours: F̂ compensates;
                a candidate of a takeover from ``takeover`` on

and clears a confirmed loss from ``recover`` on for the return: a false return costs more than a
late return. A suspicion ends with its candidate and moves no actuator: most faults that are no loss
of channel 1 reach ``suspect`` before they contradict the candidate, and a compensation would add to
their harm.

The echo of channel 1 says at each tick what is missing, whatever the fault. Where the echo
contradicts the lost share, the law believes the echo instead: no loss is confirmed, and a confirmed
loss ends.

A fault of the sensor or of channel 2 changes d̂ too. If ``hypotheses`` finds such a fault, the
suspicion ends. If channel 1 contributes too little to show its loss within ``horizon``, a small d̂
proves no health, and the state is CANNOT_TELL instead of CLEAR.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

from firmware_model.compiled import firmware
from firmware_model.law.precision import real
from firmware_model.law.status import FaultState
from firmware_model.law.structs import Struct
from firmware_model.law.supervision import echoes, likelihood_ratio, loss_model, verdict
from firmware_model.law.supervision.bumpless_transfer import begin_transfer
from firmware_model.law.supervision.corroboration import follow_residual, torque_waits
from firmware_model.law.supervision.echoes import (
    FORCE,
    TORQUE,
    Echo,
    confesses,
    contradicts_share,
    denies,
    known_output,
    moves,
    says_lost,
    told_share,
)
from firmware_model.law.supervision.frozen import weigh_frozen
from firmware_model.law.supervision.health import clear_health, is_healthy
from firmware_model.law.supervision.likelihood_ratio import (
    candidate_shown,
    forget_candidate,
    lost_share,
    start_candidate,
    update_test,
)
from firmware_model.law.supervision.loss_model import (
    clear_loss_model,
    earlier_missing,
    earlier_shown,
    fading_output,
    follow_share,
    known_share,
    loss_output,
    loss_shown,
    lost_command,
    possible_share,
    take_over_candidate,
)
from firmware_model.law.supervision.mismatch import (
    forget_car,
    innovation,
    learn_loss,
    predict_mismatch,
)
from firmware_model.law.supervision.other_cars import show_other_cars
from firmware_model.law.supervision.sensor_error import sensor_error_shown
from firmware_model.law.supervision.signatures import (
    FORCE_ECHO_ROW,
    TORQUE_ECHO_ROW,
    begin_all,
    keep_before,
    weigh_signatures,
)
from firmware_model.law.supervision.verdict import (
    NOTHING,
    TORQUE_LOST,
    TORQUE_OFFSET,
    clear_hypotheses,
    find_by_echo,
    found_elsewhere,
    judge,
    take_evidence,
    torque_evidence,
)

if TYPE_CHECKING:
    from firmware_model.law.core import thesis
    from firmware_model.law.layout import Supervision, Table


CLEAR, SUSPECTED, CONFIRMED, CANNOT_TELL = (
    int(FaultState.CLEAR),
    int(FaultState.SUSPECTED),
    int(FaultState.CONFIRMED),
    int(FaultState.CANNOT_TELL),
)


class Constants(Struct):
    """Constants."""

    confirm: Annotated[float, "1", "evidence that confirms a loss"]
    recover: Annotated[
        float, "1", "evidence that ends a loss: more, because a return is not urgent"
    ]
    certain: Annotated[float, "1", "evidence of a loss beside a known fault"]
    suspect: Annotated[float, "1", "evidence of a suspicion"]
    takeover: Annotated[float, "1", "evidence that confirms a candidate of a takeover"]
    horizon: Annotated[float, "tick", "time within which a new loss must show"]
    shown: Annotated[float, "1", "energy of a constant of size 1 after W within ``horizon``"]


@firmware
def decide(table: Table, core: thesis.State, own: Supervision, residual: float) -> None:
    """The fault state of this tick.

    Args:
        table: the constant table.
        core: the thesis's law of this tick; its fault state changes.
        own: changed in place.
        residual: G1 u1 + G2 u2 - y of this tick.
    """
    test, known, found = own.sequential_test, own.mismatch, own.hypotheses
    loss, heard, seen, model = own.loss_model, own.echoes, own.witness, core.estimator
    torque = test.candidate
    model_1, modelled = core.tick.model_1, core.tick.model_1 + core.tick.model_2
    show_acting_commands(table, core, own)
    if table.corroboration.gust > 0.0:
        follow_residual(table.corroboration, own.corroboration, residual)
    before = core.fault_state
    w = loss_shown(table, loss, model, lost_command(before, core.command_1))
    error = sensor_error_shown(table, found.sensor_error)
    earlier = earlier_shown(table, loss)
    predict_mismatch(table, known, own.other_cars.shown, modelled, w, earlier)
    fading = earlier_missing(table, loss, model, heard)
    new = innovation(table.mismatch, known, residual, error, fading, loss.share)
    share = known_share(loss, known)
    follow_share(table.loss_model, loss, share)
    shown = candidate_shown(table, test, model, core.command_1)
    sought = -share if before == CONFIRMED else table.sequential_test.share
    if update_test(table, test, known, shown, new, sought):
        restart_test(table, core, own)
    command_2 = own.other_cars.command_2
    weigh_signatures(table, found.signatures, known, heard, command_2, found.verdict, new)
    keep_before(found.signatures, torque.age)
    expected = modelled - fading - loss.share * w
    weigh_frozen(table, found.frozen, known, core.measurement, new, expected)
    evidence = torque_evidence(known, torque, before == CONFIRMED, share)
    take_evidence(table, found, known, heard, evidence)
    waits = torque_waits(table, own.corroboration, heard, seen, torque.age)
    believed = heard.actuators[TORQUE].believed
    judge(table, found, known, heard, seen, waits, before == CONFIRMED, torque.predicted)
    if heard.actuators[TORQUE].believed != believed:
        transfer_to_losses(table, core, own)
    if shows_no_fault(table, own, residual, model_1, w, error):
        forget_faults(table, core, own)
    elif found_elsewhere(found):
        core.fault_state = CLEAR
        restart_test(table, core, own)
    elif before == CONFIRMED:
        share = known_share(loss, known)
        echo = heard.actuators[TORQUE]
        contradicted = contradicts_share(table.echoes.actuators[TORQUE], echo, share)
        if contradicted and echo.lied == 0:
            hand_over_to_echo(table, core, own)
        elif torque.predicted > table.decision.recover:
            recover(table, core, own)
    else:
        look_for_loss(table, core, own, before, model_1)


@firmware
def shows_no_fault(
    table: Table, own: Supervision, residual: float, model_1: float, w: float, error: float
) -> bool:
    """Whether the plant shows none of the known faults; a finding begins the sums anew.

    Args:
        table: the constant table.
        own: with the verdict of this tick; changed in place.
        residual: d̂.
        model_1: G1 u1 in d̂: what an offset of the torque is compared with.
        w: G1 u1 since the loss, in d̂.
        error: what the known error of the sensor hides in d̂.
    """
    found, heard = own.hypotheses, own.echoes
    told = heard.actuators[TORQUE].believed == 1 or heard.actuators[FORCE].believed == 1
    if told or found.found != NOTHING:
        clear_health(found.health)
        return False
    share = known_share(own.loss_model, own.mismatch)
    lost = model_1 if found.verdict == TORQUE_OFFSET else w
    return is_healthy(table.hypotheses.health, found.health, residual, share, lost, error)


@firmware
def look_for_loss(
    table: Table, core: thesis.State, own: Supervision, before: int, model_1: float
) -> None:
    """The fault state of a tick in which no loss is known; ``before``: of the tick before."""
    constants, test, seen = table.decision, own.sequential_test, own.witness
    torque = test.candidate
    heard, echo = own.echoes, own.echoes.actuators[TORQUE]
    needed = needed_evidence(table, test, echo)
    echo.lied = 0
    if is_acquitted(table, own.hypotheses):
        core.fault_state = CANNOT_TELL
    elif torque.predicted > needed and not torque_waits(
        table, own.corroboration, heard, seen, torque.age
    ):
        confirm_or_believe(table, core, own)
    elif torque.predicted > constants.suspect or (before == SUSPECTED and torque.predicted > 0.0):
        core.fault_state = SUSPECTED
    else:
        shows = constants.shown * model_1 * model_1
        core.fault_state = CLEAR
        if shows < constants.confirm * own.mismatch.variance:
            core.fault_state = CANNOT_TELL


@firmware
def is_acquitted(table: Table, own: verdict.State) -> bool:
    """Whether the echo of actuator 2 explains d̂ at least half as well as a loss of channel 1."""
    other = own.signatures.rows[FORCE_ECHO_ROW].candidate.evidence
    half = real(0.5, other)
    acquitted: bool = other > table.decision.suspect and other > half * own.evidence[TORQUE_LOST]
    return acquitted


@firmware
def needed_evidence(table: Table, test: likelihood_ratio.State, echo: Echo) -> float:
    """The evidence that confirms a loss of channel 1.

    Less is needed where the echo of actuator 1 says so too.
    """
    constants = table.decision
    needed: float = constants.confirm
    if echo.believed == 1:  # the missing output is known already
        needed = constants.certain
    elif says_lost(table.echoes.actuators[TORQUE], echo):
        needed = constants.suspect
    elif test.of_takeover == 1:
        needed = constants.takeover
    return needed


@firmware
def show_acting_commands(table: Table, core: thesis.State, own: Supervision) -> None:
    """Tell the other cars the commands visible in the measurement, without the known loss."""
    model, one = core.estimator, real(1.0, core.command_1)
    share = one
    if core.fault_state == CONFIRMED:
        share = one - known_share(own.loss_model, own.mismatch)
    command_1 = model.showing_1 * share
    command_2 = model.showing_2
    if table.estimator.shown_ticks_2 == 0:  # this tick's command is unknown yet, or held
        command_2 = core.command_2
    show_other_cars(table, own.other_cars, model.measured, command_1, command_2)


@firmware
def restart_test(table: Table, core: thesis.State, own: Supervision) -> None:
    """A new candidate for a loss, or the return, of channel 1 begins now."""
    test, in_takeover = own.sequential_test, own.takeover.active
    start_candidate(table, test, core.estimator, core.command_1, in_takeover)


@firmware
def confirm_or_believe(table: Table, core: thesis.State, own: Supervision) -> None:
    """Confirm the lost share of channel 1, or believe the echo that contradicts the share.

    An echo that d̂ has contradicted is believed only if it explains d̂ half as well as a loss;
    otherwise the loss stays a suspicion. Against a believed echo no such loss is known: only the
    signature of a wrong echo ends the belief.
    """
    told, echo = table.echoes.actuators[TORQUE], own.echoes.actuators[TORQUE]
    share = lost_share(table.sequential_test, own.sequential_test.candidate)
    contradicted = contradicts_share(told, echo, possible_share(share))
    if contradicted or (confesses(told, echo) and moves(told, echo)):
        share = told_share(told, echo)
        contradicted = not share > 0.0 or contradicts_share(told, echo, share)
    row, half = own.hypotheses.signatures.rows[TORQUE_ECHO_ROW].candidate, real(0.5, share)
    if not contradicted:
        confirm(table, core, own, share)
    elif echo.believed == 1:
        restart_test(table, core, own)
        core.fault_state = CLEAR
    elif echo.doubted == 0 or row.evidence > half * own.sequential_test.candidate.predicted:
        believe_torque_echo(table, own)
        transfer_to_losses(table, core, own)
        restart_test(table, core, own)
        core.fault_state = CLEAR
    else:
        core.fault_state = SUSPECTED


@firmware
def hand_over_to_echo(table: Table, core: thesis.State, own: Supervision) -> None:
    """The echo contradicts the share of the confirmed loss: the echo says what is missing."""
    before = missing_by_loss(table, core, own)
    believe_torque_echo(table, own)
    clear_loss_model(own.loss_model)
    difference = missing_by_loss(table, core, own) - before  # C takes it over, or gives it back
    own.echoes.between += difference
    own.echoes.handed += difference
    withdraw_loss(table, core, own)


@firmware
def believe_torque_echo(table: Table, own: Supervision) -> None:
    """Believe the echo of actuator 1 from the onset of its signature on."""
    find_by_echo(table, own.hypotheses, own.mismatch, own.echoes, TORQUE_ECHO_ROW)


@firmware
def confirm(table: Table, core: thesis.State, own: Supervision, share: float) -> None:
    """Take a ``share`` of channel 1 for lost since the start of the candidate."""
    echo = own.echoes.actuators[TORQUE]
    if echo.good > 0 and denies(table.echoes.actuators[TORQUE], echo):
        echo.lied = 1
    core.fault_state = CONFIRMED
    take_candidate(table, core, own, share, real(1.0, share))


@firmware
def recover(table: Table, core: thesis.State, own: Supervision) -> None:
    """Channel 1 works again, since the start of the candidate."""
    core.fault_state = CLEAR
    share = known_share(own.loss_model, own.mismatch)
    take_candidate(table, core, own, share, -real(1.0, share))


@firmware
def withdraw_loss(table: Table, core: thesis.State, own: Supervision) -> None:
    """Nothing was lost: the compensation fades out."""
    clear_loss_model(own.loss_model)
    transfer_to_losses(table, core, own)
    core.fault_state = CLEAR
    none = real(0.0, core.command_1)
    learn_loss(table.mismatch, own.mismatch, none, none)
    set_aside(table, core, own)


@firmware
def forget_faults(table: Table, core: thesis.State, own: Supervision) -> None:
    """The plant shows none of the faults that were known, and θ has learnt from the faults."""
    white = own.mismatch.white
    forget_car(table.mismatch, own.mismatch)
    withdraw_loss(table, core, own)
    white.fading.memory[:] = white.sensor_error.memory[:] = 0.0


@firmware
def set_aside(table: Table, core: thesis.State, own: Supervision) -> None:
    """No d̂ up to now is evidence."""
    restart_test(table, core, own)
    clear_hypotheses(own.hypotheses)
    if core.fault_state == SUSPECTED:
        core.fault_state = CLEAR


@firmware
def take_candidate(
    table: Table, core: thesis.State, own: Supervision, share: float, sign: float
) -> None:
    """Accept the candidate: ``share`` is lost (``sign`` 1) or works again (-1).

    From now on the filter learns the errors of share and moment.
    """
    constants, test, known = table.loss_model, own.sequential_test, own.mismatch
    clear_health(own.hypotheses.health)
    doubt = constants.doubt / max(test.candidate.information, table.decision.suspect)
    doubt = max(doubt, constants.least_doubt)
    moment = constants.moment * test.candidate.age
    take_over_candidate(table, own.loss_model, known, test, share, sign)
    transfer_to_losses(table, core, own)
    forget_candidate(table, test, known, sign * share)
    learn_loss(table.mismatch, known, min(constants.share_variance, doubt), moment * moment)
    restart_test(table, core, own)
    begin_all(own.hypotheses.signatures)


@firmware
def transfer_to_losses(table: Table, core: thesis.State, own: Supervision) -> None:
    """Begin a bumpless transfer of F̂ to the known loss."""
    loss, heard = own.loss_model, own.echoes
    lost = loss.previous_fading + loss.followed * loss.previous_output
    lost += heard.actuators[TORQUE].previous - heard.handed
    speed = missing_by_loss(table, core, own) - lost
    begin_transfer(table.bumpless_transfer, own.bumpless_transfer, lost, speed)


@firmware
def missing_by_loss(table: Table, core: thesis.State, own: Supervision) -> float:
    """The input of F̂ in this tick: the known missing output."""
    command = lost_command(core.fault_state, core.command_1)
    return compensated_output(table, own.loss_model, own.echoes, command)


@firmware
def compensated_output(
    table: Table, loss: loss_model.State, heard: echoes.State, command: float
) -> float:
    """The input of F̂: the known missing output, of this tick's lost ``command``."""
    lost: float = fading_output(table, loss) + loss.followed * loss_output(table, loss, command)
    if table.echoes.longest > 0:
        g1, echo = table.estimator.channel_1, heard.actuators[TORQUE]
        lost += known_output(table.echoes.actuators[TORQUE], g1, echo) - heard.handed
    return lost
